"""The two kinds of FMU in a check: pythonfmu's, and the one with the compiled engine, which is built if possible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checked import N, T, recorded
from fmus import Store
from native_fmus import can_build
from test_check import inflow, slow_network

from build_fmu import build, build_native
from fitting.check import fmu_build, fmu_check, fmu_run
from fitting.check.fmu_build import build_fmu, with_starts
from fitting.check.fmu_check import check
from fitting.check.fmu_run import RunFailed, periodic_answer, read_fmu, takes
from fitting.results.parameter_set import ParameterSet
from solver import Network, Segment, Settings, Site, load, simulate_periodic
from solver.network.files import write_network
from solver.tracing.native import NoEngine

pytestmark = [
    pytest.mark.usefixtures("one_process"),
    pytest.mark.skipif(not can_build(), reason="needs what builds an FMU with the compiled engine"),
]
NOTHING = ParameterSet("none", {})


def tube(name: str) -> Network:
    """The first artery of the sheep alone, with its own outlet resistance."""
    sheep = load("sheep")
    own = replace(sheep.segment("AA"), name=name)
    assert isinstance(own, Segment)
    outlet = replace(sheep.outlets[0], segment=name)
    return replace(
        sheep, name=f"tube_{name}", segments=(own,), junctions=(), outlets=(outlet,), sites=(Site(name, name),),
        inlet=replace(sheep.inlet, segment=name), channels=(),
    )  # fmt: skip


def test_both_kinds_give_the_same_check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of one tube with noise of 40 dB, each run until its beat repeats to 1e-11: all numbers of all channels to 1e-9.

    The two start differently, from a periodic beat and at rest, and so differ by what is left of the start. The report
    names the kind of FMU.
    """
    for module in (fmu_run, fmu_check):
        monkeypatch.setattr(module, "PERIODIC", 1e-11)
    network, settings = tube("AA"), Settings(dt=4e-3)
    write_network(network, tmp_path / "tube.toml")
    beat = simulate_periodic(network, inflow, settings=settings)
    names = ("inlet.Q", "AA.P", "AA.R")
    record = recorded(tmp_path, {name: beat[name][:-1][:: (len(beat.time) - 1) // N] for name in names}, 0.01)
    reports = [check(NOTHING, tmp_path / "tube.toml", record, backend=backend, period=T, as_measured=True)
               for backend in ("numpy", "native", "auto")]  # fmt: skip
    tools = [report.sources["fmu"]["tool"] for report in reports]
    assert "PythonFMU" in tools[0]
    assert all(tool.endswith("compiled engine") for tool in tools[1:])
    for one, *others in zip(*(report.channels for report in reports), strict=True):
        for other in others:
            for key in ("rmse", "relative", "mean_error", "whitened", "whitened_sensor", "worst_z"):
                assert getattr(other, key) == pytest.approx(getattr(one, key), rel=1e-9), (one.name, key)
    assert reports[2].to_json() == reports[1].to_json()


def test_a_slow_windkessel_starts_at_its_pressure(stored: Store) -> None:
    """A Windkessel of 1.2 s, which at rest needs 75 beats: at a corrected pressure at most 20 in runs of five, and the
    answer is pythonfmu's, which starts from a periodic beat, to 2e-4 of its pulse (1e-4 are left of either start)."""
    network, settings = slow_network(), Settings(dt=4e-3, element_length=0.1)
    beat = inflow(np.arange(N) * (T / N))
    both = [periodic_answer(read_fmu(stored(make, network, settings=settings)), "inlet.Q", beat, T, {})
            for make in (build, build_native)]  # fmt: skip
    assert [answer.beats for answer in both] == [5, 5]
    assert all(answer.change <= 1e-4 for answer in both)
    P, P_native = (answer.values["AA.P"] for answer in both)
    assert np.abs(P_native - P).max() <= 2e-4 * np.ptp(P)


def test_without_an_engine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """auto builds pythonfmu's FMU where this machine has no engine, and where the other kind cannot be built; native
    says why not; another word is refused."""

    def none() -> None:
        raise NoEngine("the compiled engine is not built")

    file = tmp_path / "tube.toml"
    write_network(tube("AA"), file)
    with pytest.raises(ValueError, match="backend = 'wasm': must be "):
        build_fmu(file, tmp_path, "wasm")
    real, lines = fmu_build.run_module, list[tuple[str, ...]]()

    def run(*line: str) -> tuple[int, str]:
        lines.append(line)
        return (2, "no compiler is there.") if "--native" in line else real(*line)

    monkeypatch.setattr(fmu_build, "run_module", run)
    assert "PythonFMU" in read_fmu(build_fmu(file, tmp_path, "auto")).tool
    assert len(lines) == 2
    with pytest.raises(ValueError, match=r"no compiler is there\."):
        build_fmu(file, tmp_path, "native")
    monkeypatch.setattr(fmu_build, "library", none)
    assert "PythonFMU" in read_fmu(build_fmu(file, tmp_path, "auto")).tool
    assert len(lines) == 4
    with pytest.raises(ValueError, match=r"backend = 'native': the compiled engine is not built\."):
        build_fmu(file, tmp_path, "native")


def test_a_native_run_that_fails(stored: Store) -> None:
    """A start value that is out of its range: the FMU's sentence, which names it."""
    fmu = read_fmu(stored(build_native, tube("AA")))
    assert fmu.native
    with pytest.raises(RunFailed, match=r"AA\.R0"):
        periodic_answer(fmu, "inlet.Q", np.full(N, 1e-5), T, {"AA.R0": -1.0}, 1)


def test_start_values_that_need_other_elements(stored: Store) -> None:
    """An FMU with the compiled engine has the elements of its own length: for three times that length another one is
    built, with that start value and law; for another modulus it is the same."""
    fmu = read_fmu(stored(build_native, tube("AA")))
    starts: dict[str, float | str] = {"AA.L": 3.0 * float(fmu.starts["AA.L"]), "network.elastic_law": "regression"}
    assert not takes(fmu, starts)
    with with_starts(fmu, starts) as other:
        assert {name: other.starts[name] for name in starts} == pytest.approx(starts)
        assert takes(other, starts)
    with with_starts(fmu, {"AA.E": 2.0 * float(fmu.starts["AA.E"])}) as same:
        assert same is fmu
