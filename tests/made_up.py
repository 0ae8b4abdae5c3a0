"""Outcomes of every verdict, with numbers that are made up: every part of a page has something to show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from discrepancy.findings.outcome import (
    ADDED,
    Absorbed,
    Balance,
    Candidate,
    ChannelBeats,
    Detectable,
    Isolability,
    Located,
    NamedEffect,
    Outcome,
    OwnNumber,
    Walls,
)
from discrepancy.findings.shown_map import Acting, SourceMapShown
from discrepancy.report.page import figure_files, report_files
from fitting.inference.places import Place
from fitting.inference.source_maps.source_map import Rival
from fitting.results.estimate import Estimate
from solver import Network
from solver.io.writing import write_folder

Array = np.ndarray

VERDICTS = (*ADDED, "none", "unknown", "unusable")
T, N = 0.5, 200
SITES = ("AA", "PD", "MD", "DD", "BT", "CA", "FA")
SIZE = {"P": (13000.0, 3000.0), "Q": (2e-5, 2e-5), "R": (8e-3, 3e-4)}  # mean and amplitude, synthetic
CA = NamedEffect(
    "wall_viscosity",
    ("CA",),
    {"CA.phi0": Estimate(7.7e4, "Pa.s", (7.1e4, 8.3e4))},
    0.97,
    "P = P_ext + elastic(R) + (h/(1-η²)/R) φ_0 ε̇",
)
LAG = NamedEffect("channel_lag", ("CA.P",), {"CA.P.lag": Estimate(3.1e-3, "s", (2.6e-3, 3.6e-3))}, 0.55)
OUTLET = NamedEffect("terminal_reflection", ("FA",), {"FA.outlet.R_t": Estimate(0.62, "1", (0.6, 0.64))}, 0.9)


def synthetic_beat(i: int, signal: str, size: float = 1.0) -> Array:
    """A made-up beat with a steep upstroke, later by site."""
    mean, amplitude = SIZE[signal]
    t = np.arange(N) / N - 0.02 * i - (0.01 if signal == "R" else 0.0)
    wave = sum(np.cos(2 * np.pi * k * t - 0.8 * k) / k**1.5 for k in range(1, 15))
    return mean + size * amplitude * np.asarray(wave)


def synthetic_channel(i: int, name: str, added: bool) -> ChannelBeats:
    signal = name[-1]
    measured = synthetic_beat(i, signal)
    worse = 1.3 if name.startswith("CA") else 1.03
    before = synthetic_beat(i, signal, worse)
    band = np.full(N, 0.004 * SIZE[signal][1])
    gap = (9.0, 9.3) if name.startswith("CA") else (1.2, 1.3)
    after = synthetic_beat(i, signal, 1.001) if added else None
    rms = tuple(None if beat is None else (size := float(np.sqrt(np.mean((beat - measured) ** 2))), size)
                for beat in (before, after))  # fmt: skip
    return ChannelBeats(name, measured, band, before, after, gap, (1.01, 1.04) if added else None, *rms)


def candidate(effect: NamedEffect, behind: float, in_class: bool) -> Candidate:
    return Candidate(effect.name, effect.where, effect.parameters, behind, 1.0, 1.1, behind / 2, in_class)


def isolability(n: int) -> Isolability:
    labels = tuple(f"wall_viscosity at S{i}" for i in range(n - 1)) + ("channel_lag at CA.P",)
    separation = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * 4.0
    return Isolability(labels, separation, np.linspace(1.0, 300.0, n), (labels[0],))


def acting() -> SourceMapShown:
    """A made-up pressure in the wall of CA, which a drop there does nearly as well."""
    time = np.arange(N) * T / N
    pressure = 900.0 * np.exp(-(((time - 0.12) / 0.05) ** 2)) - 150.0
    drop = Place("drop", "CA", at=0.3)
    wall = Acting(Place("wall", "CA"), "Pa", pressure, np.full(N, 60.0), 3, "uniform along CA", "CA.P",
                  6000.0, rivals=(Rival((drop,), 4.2),))  # fmt: skip
    return SourceMapShown((wall,), time, T, True, 1.02)


def write_report(outcome: Outcome, folder: Path) -> None:
    """The page and its figures in a folder, without those of an earlier one: as a study writes them."""
    files = report_files(outcome)
    write_folder(folder, files, gone=set(figure_files()) - set(files))


def synthetic(verdict: str, network: Network) -> Outcome:
    """An outcome of that verdict with everything that it can have."""
    sentence = f"A synthetic outcome of the verdict {verdict}."
    plain = Outcome(verdict, sentence, "bench/sheep 1.csv", "sheep.toml", "network", seconds=48.2)
    if verdict == "unusable":
        return replace(
            plain, reason="CA.P <dead>: it does not change; check its sensor.", warnings=("Line 7 is empty.",)
        )
    added = verdict in ADDED
    sites = SITES if verdict == "effect" else ("AA", "CA")  # figures of seven sites take a while
    names = [f"{site}.{signal}" for site in sites for signal in "PQR"]
    rng = np.random.default_rng(1)
    z = np.abs(rng.normal(size=(41, len(names))))
    if verdict != "none":
        z[:15, [name.startswith("CA") for name in names]] += 60.0 * np.exp(-np.arange(15.0) / 5)[:, None]
    z[30, 0] = np.nan
    effects = {"several": (CA, OUTLET)}.get(verdict, (CA,) if added else ())
    others = {"ambiguous": ((LAG,),), "several": ((LAG, OUTLET), (CA, LAG))}.get(verdict, ())
    own = {"CA.E": OwnNumber(9e5, Estimate(1.2e6, "Pa", (1.1e6, 1.3e6)), 3.1)}
    own |= {"FA.outlet.R_t": OwnNumber(0.5, Estimate(0.48, "1", (0.45, 0.51)), -0.7, "calibration")}
    walls = Walls("individual", {"E": (0.08, 0.06)}, own) if verdict == "partial" else Walls()
    smallest = {
        "wall_viscosity at CA": Detectable("CA.phi0", 2.1e3, "Pa.s", either=True),
        "side_branch at MD": Detectable("MD.leak", 2e-12, "m^2/(Pa.s)"),
    }
    return replace(
        plain,
        effects=effects,
        members=tuple(tuple((e.name, e.where) for e in each) for each in ((effects, *others) if added else ())),
        reason="A residual at harmonics 5 to 9 of CA that no effect explains." if verdict == "unknown" else None,
        remains="Whitened RMS 3.1, most in CA.P." if verdict == "partial" else None,
        confidence=None if verdict == "unknown" else 0.87,
        complete=verdict != "partial",
        walls=walls,
        map=replace(acting(), acting=()) if verdict == "none" else acting(),
        notes=("CA.E: 33 % above the file's.",) if verdict == "partial" else (),
        separating_measurement="Measure CA.R: its loop opens only for the wall." if verdict == "ambiguous" else None,
        located=() if verdict == "none" else (Located("CA", "Q", 7, 41.2, -35.0), Located("CA", "P", 1, 30.0)),
        balances=(Balance("mass", "MD", 0.8), Balance("wall law", "CA", 12.0)),
        channels=tuple(synthetic_channel(i // 3, name, added) for i, name in enumerate(names)),
        time=np.arange(N) * T / N,
        z_map=z,
        candidates=(
            candidate(CA, 0.0, True),
            candidate(LAG, 1.9, verdict == "ambiguous"),
            candidate(OUTLET, 210.0, False),
        ),
        absorbed=(Absorbed("all.E", 0.31, 0.02, 1.0), Absorbed("all.outlet.R_t", -2.4, 0.1, 1.0)),
        isolability=isolability(12),
        smallest=smallest if verdict == "none" else {},
        gap_before=(9.1, 9.3),
        gap_after=(1.01, 1.04) if added else None,
        parity=3e-12 if added else None,
        network_before=network,
        network_after=network if added else None,
        warnings=("The record has a drift of 0.3 mmHg in an hour & more.",),
        provenance={"record_sha256": "ab12", "seed": 1, "versions": {"numpy": "2.4"}, "notes": []},
    )
