"""Calibrations from many starts.

Two branches alike but for 2 mm of length, with different E, seen from the trunk alone: nearly the same record if the
two are exchanged. The truth is one minimum, its mirror image another one.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, SETTINGS, T, exact, record
from refused import refused
from typer.testing import CliRunner

import arterial_fmu.__main__
from fitting.calibrate.multistart import Starts, calibrate_from
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.inference.unknown import starting_points
from fitting.inference.unknown_text import parse_unknowns
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import write_record
from solver import InputError, Network, Reflection
from solver.network.files import write_network

UNKNOWNS = ("B.E", "C.E")
TRUTH = np.log([1.25, 0.8])


def twins(length: float) -> Network:
    """The fork with branches B of 50 mm and C, the same but for its length [m]."""
    A, B, _ = NETWORK.segments
    outlets = tuple(Reflection(name, R_t=0.4) for name in "BC")
    return replace(NETWORK, segments=(A, B, replace(B, name="C", L=length)), outlets=outlets)


@cache
def seen(length: float, noise: float = 0.0) -> Beats:
    """P and Q of the trunk, E of B 25 % up and of C 20 % down."""
    true = twins(length).with_parameters({"B.E": 1.25 * 9e5, "C.E": 0.8 * 9e5})
    return record({name: exact(1.0, true)[name] for name in ("inlet.Q", "A.P", "A.Q")}, 15, noise, 3)


def found(
    starts: int, length: float = 0.052, noise: float = 0.0, jobs: int = 1, scheduler: str | None = None
) -> Starts:
    return calibrate_from(
        seen(length, noise), twins(length), UNKNOWNS, starts, settings=SETTINGS, jobs=jobs, scheduler=scheduler
    )


def same(one: Starts, other: Starts) -> None:
    """Every number of the two, bit by bit."""
    assert one.plain() == other.plain()
    assert [each.found.x.tolist() for each in one.minima] == [each.found.x.tolist() for each in other.minima]
    assert one.best.parameter_set() == other.best.parameter_set()


@pytest.mark.deep
def test_truth_and_mirror_image() -> None:
    """Noise-free, 4 starts: the truth to 2e-4 (1e-5 measured), from two of them; from two the mirror image, whose cost
    is 300 times as high. The first start, the network's own values, leads to the truth: its numbers are those of one
    calibration, bit by bit. Two processes find the same."""
    tried = found(4)
    best, other = tried.minima
    assert (best.starts, other.starts) == ((0, 2), (1, 3)) and not tried.failures
    np.testing.assert_allclose(best.found.x, TRUTH, atol=2e-4)
    np.testing.assert_allclose(other.found.x, TRUTH[::-1], atol=0.03)
    assert best.found.cost < 10.0 and other.found.cost > 500.0
    alone = calibrate(seen(0.052), twins(0.052), UNKNOWNS, settings=SETTINGS)
    assert best.found.x.tolist() == alone.x.tolist() and tried.best.report[: len(alone.report)] == alone.report
    first, second = tried.best.report[-2:]
    assert first == "2 of 4 starts ended in this minimum, within 0.1 standard deviations of every unknown"
    assert second.startswith(f"2 of 4 starts ended in another minimum, with cost {other.found.cost:.4g} instead of ")
    assert second.endswith("(SI)") and f"B.E {other.found.values['B.E']:.4g}" in second
    assert tried.best.parameter_set().provenance["report"][-1] == second
    same(tried, found(4, jobs=2))


def test_exact_mirror_image() -> None:
    """Branches alike, 1 % noise: from the network's own values the search stays between the two, where the cost has a
    saddle; from other starts it finds both minima, of one cost to 1e-3, and the report says that the record does not
    tell them apart."""
    tried = found(4, 0.05, 0.01)
    one, other, saddle = tried.minima
    assert saddle.starts == (0,) and saddle.found.cost > one.found.cost + 10.0
    assert saddle.found.x[0] == pytest.approx(saddle.found.x[1], abs=1e-6)
    assert one.found.x == pytest.approx(other.found.x[::-1], abs=2e-3)
    assert other.found.cost == pytest.approx(one.found.cost, abs=1e-2)
    assert tried.best.report[-2].endswith("; the record cannot distinguish the two")
    assert not tried.best.report[-1].endswith("apart")


def test_one_minimum() -> None:
    """C 10 mm longer: all starts end within 0.1 standard deviations."""
    tried = found(3, 0.06, 0.01)
    assert [each.starts for each in tried.minima] == [(0, 1, 2)]
    assert tried.best.report[-1].startswith("3 of 3 starts ended in this minimum")


def test_starting_points() -> None:
    """The network's own values, then points twice as wide as the priors: moments of 255 to 2 %; the first of many are
    those of few; within the allowed range."""
    unknowns = parse_unknowns(["all.E", "C.outlet.R_t:none", "B.phi0:0.1"], NETWORK)
    x = starting_points(unknowns, 256, 1)
    assert x[0].tolist() == [0.0, 0.0, 0.0]
    assert x[1:, 0].std() == pytest.approx(2.0 * unknowns[0].typical_sd, rel=0.02)
    assert x[1:, 2].std() == pytest.approx(0.2, rel=0.02) and abs(x[1:, 2].mean()) < 0.004
    assert x[:, 1].min() >= unknowns[1].low and x[:, 1].max() <= unknowns[1].high
    assert starting_points(unknowns, 5, 1).tolist() == x[:5].tolist()
    assert starting_points(unknowns, 1, 1).tolist() == [[0.0, 0.0, 0.0]]
    assert (starting_points(unknowns, 5, 2)[1:] != x[1:5]).all()


def test_a_start_that_breaks_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counted, with its sentence; the others stand. Where none leads anywhere, the first sentence is raised."""
    import fitting.calibrate.multistart

    def broken(*given: Any, x0: Any, **options: Any) -> Calibration:
        if len(lost) == 2 or x0.any():
            raise InputError("too soft to be simulated.")
        return calibrate(*given, **options)

    lost = [1]
    monkeypatch.setattr(fitting.calibrate.multistart, "calibrate", broken)
    tried = found(2, 0.06, 0.01)
    assert [each.starts for each in tried.minima] == [(0,)] and tried.failures == {1: "too soft to be simulated."}
    assert tried.best.report[-1] == "1 of 2 starts could not be simulated: too soft to be simulated"
    lost = [0, 1]
    refused(lambda: found(2), "too soft", ["simulated."])


def test_refused() -> None:
    """One sentence each."""
    cases = {"--starts = 0": {"starts": 0}, "--starts = 10001": {"starts": 10001}, "--seed = -1": {"seed": -1}}
    cases |= {"--jobs = 0": {"jobs": 0}}
    for start, wrong in cases.items():
        asked = {"starts": 2, **wrong}
        refused(
            lambda asked=asked: calibrate_from(seen(0.052), twins(0.052), UNKNOWNS, settings=SETTINGS, **asked),
            start,
            ["must be a whole number"],
        )


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    """--starts in the command line: the set says what was tried, and the notes how many starts agree."""
    write_network(twins(0.06), tmp_path / "twins.toml")
    waves = {name: np.append(wave.ravel(), wave[0, 0]) for name, wave in seen(0.06, 0.01).values.items()}
    write_record(tmp_path / "trunk.csv", np.arange(len(waves["A.P"])) * (T / 50), waves)
    line = ["calibrate", str(tmp_path / "trunk.csv"), str(tmp_path / "twins.toml"), "--free", "B.E", "--free", "C.E"]
    done = CliRunner().invoke(
        arterial_fmu.__main__.app, [*line, "--starts", "2", "--jobs", "2", "--out", str(tmp_path / "set.json")]
    )
    assert done.exit_code == 0, done.output
    assert "2 of 2 starts ended in this minimum" in " ".join(done.output.split())
    tried = json.loads((tmp_path / "set.json").read_text())["provenance"]["starts"]
    assert (tried["starts"], tried["seed"], tried["minima"][0]["starts"]) == (2, 1, [0, 1])
