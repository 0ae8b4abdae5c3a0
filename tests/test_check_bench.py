"""A parameter set against a bench FMU and a recording of one wall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from checked import BEATS, COARSE, Array, T, bench_set, recorded

from fitting.check.fmu_check import check
from fitting.check.fmu_run import RunFailed
from fitting.inference.models.bench_network import LENGTH, bench_network
from fitting.records.read.record import read_record, write_record
from fitting.records.virtual import jarvik_pressure, measured, pressure_at, solve_radius, table_wall
from fitting.results.parameter_set import ParameterSet, Value, read_set
from solver import Settings, load

pytestmark = pytest.mark.usefixtures("one_process")


@cache
def loop_channels(site: str = "AA", n: int = 100) -> dict[str, Array]:
    """P and R of a virtual wall on the bench, from rest to periodic by DOP853."""
    p = jarvik_pressure(T)
    return {f"{site}.P": pressure_at(p, T, np.arange(n) * T / n), f"{site}.R": solve_radius(table_wall(site), p, T, n)}


@pytest.fixture(scope="module")
def bench(fast_fmu: Callable[..., Path]) -> Path:
    return fast_fmu(bench_network("AA", bench_set()), COARSE)


def test_bench(fast_fmu: Callable[..., Path], tmp_path: Path) -> None:
    """The radius of an independent integrator, nonlinear viscosity and all: to 7e-5 of its pulse; its loop to 4e-4."""
    fmu = fast_fmu(bench_network("AA", bench_set()), Settings())
    report = check(bench_set(), fmu, recorded(tmp_path, loop_channels()))
    (channel,), (loop,) = report.channels, report.loops
    assert (report.mode, report.driver, channel.name) == ("bench", "AA.P", "AA.R")
    assert channel.largest <= 8e-5
    assert loop.simulated == pytest.approx(loop.measured, rel=5e-4)
    assert not report.warnings


def test_bench_sees_the_law(tmp_path: Path, bench: Path) -> None:
    """The other elastic law, as a start value, is off by 15 % in strain; what does not count here is said."""
    other = bench_set()
    values = {**other.values, "CA.E": Value(4e6, "Pa"), "AA.L": Value(0.04, "m")}
    other = ParameterSet("other", values, {**other.texts, "network.elastic_law": "beta"})
    report = check(other, bench, recorded(tmp_path, loop_channels()))
    assert report.worst.largest > 0.1
    assert report.warnings == ("Not used on this bench: CA.E, AA.L.",)


@pytest.mark.slow
def test_bench_with_noise(tmp_path: Path, bench: Path) -> None:
    """40 dB on P and R: the whitened residual is 1 ± 0.25, the noise of P seen through the wall included."""
    rng = np.random.default_rng(2)
    clean = loop_channels()
    samples = {name: measured(np.tile(beat, BEATS), rng, 40.0) for name, beat in clean.items()}
    write_record(tmp_path / "loop.csv", np.arange(100 * BEATS) * T / 100, samples)
    report = check(bench_set(), bench, read_record(tmp_path / "loop.csv"))
    assert report.worst.whitened == pytest.approx(1.0, abs=0.25)
    assert report.title.startswith("agrees to the noise; worst channel AA.R: 0.")


def test_bench_network() -> None:
    """One millimetre of the site with its wall and laws, closed at the inlet; R0, h and E are needed."""
    network = bench_network("CA", read_set("sheep_table1"), T=0.4)
    table = load("sheep").segment("CA")
    assert network.segments == (replace(table, L=LENGTH),)
    assert (network.name, network.elastic_law, network.inlet.Q_max, network.inlet.T) == (
        "bench_CA",
        "regression",
        0,
        0.4,
    )
    with pytest.raises(ValueError, match=r"parameter set x: a bench of CA needs CA\.R0, CA\.h; add it\."):
        bench_network("CA", ParameterSet("x", {"CA.E": Value(4e6, "Pa")}))


def test_fmu_that_stops(tmp_path: Path, bench: Path) -> None:
    """The paper's quadratic viscosity beyond its monotone range: the sentence of the FMU, without its folder, with
    place and time."""
    with pytest.raises(RunFailed, match=r"^bench_AA\.fmu: .*segment AA at x = .*, t = .* s: .*; .*\.$"):
        check(bench_set(viscous="quadratic", phiNL=-2.0 * 25451.0), bench, recorded(tmp_path, loop_channels()))
