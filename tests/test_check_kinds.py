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
from fitting.check.fmu_build import answering, build_fmu
from fitting.check.fmu_check import check
from fitting.check.fmu_run import RunFailed, periodic_answer, read_fmu
from fitting.results.parameter_set import ParameterSet
from solver import Network, Segment, Settings, Site, load, read_network, simulate_periodic
from solver.network.files import write_network
from solver.tracing.native import NoEngine

pytestmark = [
    pytest.mark.usefixtures("one_process"),
    pytest.mark.skipif(not can_build(), reason="needs what builds an FMU with the compiled engine"),
]
NOTHING = ParameterSet("none", {})
SOFT = """
name = "soft"
network = { P_ref = "11041 Pa", P_0 = "11041 Pa" }
outlets.Pe = { R1 = "10428 Pa*s/m^3", C = "1.016e-8 m^3/Pa", R2 = "1.2946e8 Pa*s/m^3", P_venous = "666.6 Pa" }
sites.Pe = { segment = "Pe", position = 1 }

[inlet]
segment = "Pe"
T = "0.8 s"
Q_mean = 8.05e-5
Q_cos = [7.92e-05, -7.76e-05, -7.42e-05, -7.92e-06, -1.86e-05, 1.19e-05]
Q_sin = [1.492e-4, 1.061e-4, -1.55e-05, -2.06e-05, -1.19e-05, -1.10e-05]

[segments.Pe]
L = "1.19 cm"
R0 = "14.6 mm"
h = "2.34 mm"
E = "85630 Pa"
phi0 = "15600 Pa*s"
"""


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


@pytest.mark.slow
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


@pytest.mark.slow
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
    """A start value that is out of its range: the sentence of the FMU, without its folder, which names it."""
    fmu = read_fmu(stored(build_native, tube("AA")))
    assert fmu.native
    with pytest.raises(RunFailed, match=r"^[^/]+\.fmu: .*AA\.R0"):
        periodic_answer(fmu, "inlet.Q", np.full(N, 1e-5), T, {"AA.R0": -1.0}, 1)


def test_start_values_that_need_other_elements(stored: Store) -> None:
    """An FMU with the compiled engine has the elements of its own length: for three times that length another one is
    built, with that start value and law; for another modulus it is the same."""
    fmu = read_fmu(stored(build_native, tube("AA")))
    starts: dict[str, float | str] = {"AA.L": 3.0 * float(fmu.starts["AA.L"]), "network.elastic_law": "regression"}
    beat = np.full(N, 1e-5)
    with answering(fmu, "inlet.Q", beat, T, starts) as (other, _):
        assert other.native
        assert {name: other.starts[name] for name in starts} == pytest.approx(starts)
    with answering(fmu, "inlet.Q", beat, T, {"AA.E": 2.0 * float(fmu.starts["AA.E"])}) as (same, _):
        assert same is fmu


@pytest.mark.slow
def test_a_beat_that_no_run_from_rest_reaches(stored: Store, tmp_path: Path) -> None:
    """A soft wall that creeps (phi0/E = 1.8 s): supercritical in the first beat from rest, never in the periodic one.

    The FMU with the compiled engine has the periodic start of its own values alone, so pythonfmu's answers, as the
    solver: to 3e-5 of the pulse, by what is left of the start (1e-4).
    """
    (tmp_path / "soft.toml").write_text(SOFT, encoding="utf-8")
    network = read_network(tmp_path / "soft.toml")
    beat = network.inlet.Q(network.inlet.T / 400 * np.arange(400))
    fmu = read_fmu(stored(build_native, network))
    starts: dict[str, float | str] = {"Pe.E": 8563.0}
    with pytest.raises(RunFailed, match="supercritical"):
        periodic_answer(fmu, "inlet.Q", beat, network.inlet.T, starts)
    with answering(fmu, "inlet.Q", beat, network.inlet.T, starts) as (other, answer):
        assert not other.native
    soft = replace(network, segments=(replace(network.segments[0], E=8563.0),))
    own = simulate_periodic(soft, settings=Settings(dt=fmu.dt))["Pe.P"][:-1]
    assert answer.values["Pe.P"] == pytest.approx(own, abs=3e-5 * np.ptp(own))
