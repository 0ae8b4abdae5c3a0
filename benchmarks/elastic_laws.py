"""Selection between two elastic laws by evidence: rate of correct selections, and coverage of the intervals.

    python benchmarks/elastic_laws.py [--seeds 100] [--dB 40 --dB 30] [--json FILE]

Virtual recordings (synthetic) as in benchmarks/wall_fits.py: 15 beats at 200 Hz, 11 kPa mean, 4 kPa pulse, white noise
on P and R. The walls are Kelvin–Voigt (φ_NL = 0), of either law, so an interval of φ_NL without 0 is a false positive.
Each recording is fitted with `regression` alone and with the selection between both laws. Coverage of 95 % intervals,
in %; of 100 recordings, 90 to 99 are covered in 95 % of cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.table import JsonFile, start, store, tabulate
from benchmarks.wall_fits import Case, recording, series
from fitting.records.alignment.align import align
from fitting.records.virtual import VirtualWall, table_wall
from fitting.wall.indices import E_inc
from fitting.wall.site_fit import fit
from fitting.wall.wall_fit import WallFit
from solver.laws.wall_laws import ELASTIC_LAWS

NAMES = ("E_inc", "E", "R0", "phi0", "phiNL")


@dataclass(frozen=True)
class Kind:
    """A wall, its period [s] and its name in the table."""

    name: str
    wall: VirtualWall
    T: float


KINDS = (
    Kind("soft carotid", VirtualWall(3.0e-3, 0.6e-3, 2e5, 2e3), 0.8),
    Kind("stiff carotid", VirtualWall(3.0e-3, 0.6e-3, 8e5, 8e3), 0.8),
    Kind("AA of the sheep", table_wall("AA", phiNL=0.0), 0.5),
    Kind("CA of the sheep", table_wall("CA", phiNL=0.0), 0.5),
)


def truth(wall: VirtualWall, P: float) -> dict[str, float]:
    """The parameters, and E_inc at the pressure P: E s² of the β-law with s = 1 + P/K, E of the regression law."""
    K = wall.E * wall.h / ((1.0 - wall.eta**2) * wall.R0)
    own = {name: getattr(wall, name) for name in NAMES[1:]}
    return own | {"E_inc": wall.E * ((1.0 + P / K) ** 2 if wall.elastic == "beta" else 1.0)}


def covered(fitted: WallFit, true: dict[str, float]) -> list[bool]:
    """Whether the interval of each of ``NAMES`` has the true value."""
    ends = {name: fitted.ci95(name) for name in NAMES[1:]} | {"E_inc": E_inc(fitted).ci95}
    return [ends[name][0] <= true[name] <= ends[name][1] for name in NAMES]


def measure(kind: Kind, law: str, dB: float, seeds: int) -> dict[str, Any]:
    """Rates over ``seeds`` recordings."""
    wall = replace(kind.wall, elastic=law)
    case, true = Case(dB, T=kind.T), truth(wall, 11e3)
    waves = series(wall, kind.T)
    before, after, right, wrong, alone = [], [], 0, 0, 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, int(dB), list(ELASTIC_LAWS).index(law)])
        kept = fit(align(recording(waves, case, rng, "S")), "S", wall.h)
        assert kept.evidence is not None
        alone += len(kept.evidence.of) == 1
        right += kept.evidence.decided and kept.model.elastic == law
        wrong += kept.evidence.decided and kept.model.elastic != law
        after.append(covered(kept, true))
        before += [covered(f.alone, true) for _, f in kept.laws if f.model.elastic == "regression"]
    percent = 100.0 / seeds
    rates = {"right": right * percent, "wrong": wrong * percent, "one law has no fit": alone * percent}
    shown = {"before": dict(zip(NAMES, 100.0 * np.mean(before, axis=0), strict=True)) if before else {}}
    shown["after"] = dict(zip(NAMES, 100.0 * np.mean(after, axis=0), strict=True))
    strain = float(waves[1][0].real / wall.R0) - 1.0
    return {"wall": kind.name, "law": law, "dB": dB, "strain": strain, **rates, **shown}


def main(
    seeds: Annotated[int, typer.Option(help="Recordings per wall, law and level of noise.")] = 100,
    dB: Annotated[list[float], typer.Option("--dB", help="Noise; may be repeated.")] = [40.0, 30.0],  # noqa: B006
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    found = [measure(kind, law, level, seeds) for level in dB for kind in KINDS for law in ELASTIC_LAWS]
    columns = ("wall", "true law", "dB", "strain %", "decided\nright %", "decided\nwrong %", *NAMES, "φNL ≠ 0\nfalse %")
    cells = []
    for row in found:
        before, after = row["before"], row["after"]
        pairs = [f"{before.get(n, np.nan):.0f} → {after[n]:.0f}" for n in NAMES]
        false = f"{100 - before.get('phiNL', np.nan):.0f} → {100 - after['phiNL']:.0f}"
        numbers = f"{row['dB']:g}", f"{100 * row['strain']:.1f}", f"{row['right']:.0f}", f"{row['wrong']:.0f}"
        cells.append((row["wall"], row["law"], *numbers, *pairs, false))
    tabulate("coverage of 95 % intervals in %: regression alone → both laws weighed", columns, cells, left=2)
    store(json_file, found)


if __name__ == "__main__":
    start(main)
