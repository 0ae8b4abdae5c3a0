"""Studies: what is varied, which sets, what is kept of each, indices against a function whose indices are known, and
that a study that was killed goes on to the same bytes."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from rich.console import Console
from SALib.test_functions import Ishigami
from typer.testing import CliRunner

import arterial_fmu.__main__
from arterial_fmu.study.batch import FAILED, POINTS, Batch, largest, measures, run_batch, smallest
from arterial_fmu.study.command import _table
from arterial_fmu.study.models import NetworkModel, read_model
from arterial_fmu.study.outcome import Study, findings, summary
from arterial_fmu.study.plan import Plan, base_of, plan_of
from arterial_fmu.study.report import write
from arterial_fmu.study.store import Store, run
from arterial_fmu.study.varied import parse_varied
from build_fmu import build
from fitting.parallel.threads import ENVIRONMENT
from fitting.records.channels.spectral import interpolated
from fitting.records.read.columns import Reading
from solver import Settings, Site, load, repeating_beat
from solver.network.files import write_network
from solver.quantities.quantity import Quantity

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ("plan.json", "finer.parquet", "waveforms.parquet", "sets.parquet", "indices.csv", "study.json", "study.html")

Array = np.ndarray


def sheep(sites: str = "CA") -> NetworkModel:
    return NetworkModel(load("sheep"), Settings(dt=5e-3), 1e-4).at(sites.split(","))


def varied(*texts: str) -> Any:
    model = sheep()
    return parse_varied(texts, model.known, model.nominal, model.name)


# --- what is varied -------------------------------------------------------------------------------------------------


def test_ranges() -> None:
    """A unit at the end is that of both ends; x makes factors of the file's values; names as in the FMU."""
    (one,) = varied("CA.phi0=10..120kPa*s")
    assert (one.low, one.high, one.unit, one.factor) == (10e3, 120e3, "Pa.s", False)
    assert varied("CA.phi0 = 10 .. 0.12e3 kPa*s")[0].high == 120e3
    assert varied("CA.phi0=10 kPa*s..0.12 MPa*s")[0].low == 10e3
    assert varied("CA.L=0.1..0.2m")[0].low == 0.1
    (all_E,) = varied("all.E=0.8..1.2x")
    assert len(all_E.nominal) == 10
    assert all_E.values(np.array([0.5]))["CA.E"] == pytest.approx(0.5 * 4.142e6)
    assert varied("all.E=0.8x..1.2x")[0].low == 0.8
    assert set(varied("all.outlet.R_t=0..0.5")[0].nominal) == {
        f"{s}.outlet.R_t" for s in ("CA", "VA1", "VA2", "VA3", "FA")
    }
    assert set(varied("CA+FA.E=1..2MPa")[0].nominal) == {"CA.E", "FA.E"}


WRONG = {
    "CA.phi0": "must look like NAME=LOW..HIGH",
    "CA.phi0=10kPa*s": "must look like NAME=LOW..HIGH",
    "CA.phi=1..2": "CA.phi is not a parameter of sheep; check the name (did you mean CA.phi0?).",
    "all.phi=1..2": "nothing in sheep has phi; check the name (did you mean all.phi0?).",
    "all.=1..2": "nothing in sheep has no name",
    "CA+CA.E=1..2MPa": "CA.E occurs twice",
    "CA.phi0=10..120": 'it has no unit; write one, such as "10..120kPa*s", or x for factors.',
    "all.E=1..2": 'such as "1..2MPa"',
    "CA.phi0=10..120kg": "the unit kg does not convert to the expected Pa*s",
    "CA.phi0=120..10kPa*s": "the range must begin with its lower end",
    "CA.phi0=-1..10kPa*s": "CA.phi0 = -1000 Pa.s is not allowed",
    "CA.phiNL=0.5..2x": "CA.phiNL is 0 in sheep, which no factor can change",
    "all.E=-1..2x": "is not allowed",
    "CA.E=a..bMPa": "must be a number in Pa",
}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_ranges(text: str) -> None:
    """One sentence that begins with the option."""
    with pytest.raises(ValueError, match=r"^--vary ") as refused:
        varied(text)
    assert WRONG[text] in str(refused.value)
    assert "\n" not in str(refused.value)


def test_wrong_together() -> None:
    with pytest.raises(ValueError, match="--vary CA.E: CA.E is varied by all.E, too; keep one of them"):
        varied("all.E=0.8..1.2x", "CA.E=1..2MPa")
    with pytest.raises(ValueError, match="--vary: nothing is varied"):
        varied()


# --- what is kept ---------------------------------------------------------------------------------------------------


def test_extremes_of_a_beat() -> None:
    """The top of 1 + cos between samples: 1e-3 of 50 samples by the samples alone, 2e-5 by the parabola."""
    t = np.arange(50) / 50 + 0.5 / 50
    beat = 1.0 + np.cos(2 * np.pi * np.stack([t, t + 0.003]))
    assert largest(beat) == pytest.approx([2.0, 2.0], abs=2e-5)
    assert smallest(beat) == pytest.approx([0.0, 0.0], abs=2e-5)
    assert largest(np.ones((2, 8))).tolist() == [1.0, 1.0]
    assert measures(["CA"], ["CA.P", "CA.Q"])["CA.P.pulse"] == "Pa"


@pytest.mark.parametrize("n", [100, 200, 157, 64])
def test_waves_of_a_beat(n: int) -> None:
    """100 points of the trigonometric interpolant: exact for what the samples resolve."""
    phase = np.arange(n) / n
    beat = np.cos(2 * np.pi * 3 * phase) + np.sin(2 * np.pi * 20 * phase)
    fine = np.arange(100) / 100
    expected = np.cos(2 * np.pi * 3 * fine) + np.sin(2 * np.pi * 20 * fine)
    np.testing.assert_allclose(interpolated(beat, POINTS), expected, atol=1e-12)


def test_a_batch_is_what_the_solver_gives() -> None:
    """A set of a batch against its own run, its waves in float32; one that breaks down has its sentence."""
    plan = Plan(sheep(), varied("CA.E=1..6MPa"), 2, 1, ("CA",))
    parameters = {"CA.E": np.array([2e6, 4e6, 1e2])}
    batch = Batch(plan.model, np.arange(3), parameters, tuple(plan.measures), plan.waves)
    frame = pl.read_parquet(run_batch(batch))
    alone = repeating_beat(load("sheep").with_parameters({"CA.E": 4e6}), settings=Settings(dt=5e-3), tolerance=1e-4)
    P = alone["CA.P"][:-1]
    assert frame["CA.P.mean"][1] == pytest.approx(P.mean(), rel=1e-6)
    assert frame["CA.P.systolic"][1] == pytest.approx(P.max(), rel=1e-3)
    np.testing.assert_allclose(frame["CA.P"][1].to_numpy(), P, rtol=1e-5)
    assert frame[FAILED][:2].to_list() == [None, None]
    assert "segment" in frame[FAILED][2] and frame["CA.P.mean"][2] is None and frame["CA.P"][2] is None


# --- indices --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Function:
    """Ishigami's function as the mean pressure of a site; sets with x1 < ``least`` break down."""

    least: float = -4.0
    name: str = "ishigami"
    T: float = 1.0
    batch: int = 512
    tolerance: float = 0.0
    channels: tuple[str, ...] = ("A.P", "A.Q")
    identity: dict[str, Any] = field(default_factory=dict)

    @property
    def known(self) -> dict[str, Quantity]:
        return {f"x.{i}": Quantity("1", "x", -4.0, 4.0) for i in (1, 2, 3)}

    @property
    def nominal(self) -> dict[str, float]:
        return dict.fromkeys(self.known, 1.0)

    def finer(self) -> None:
        return None

    def run(self, parameters: dict[str, Array]) -> list[Any]:
        x = np.stack([parameters[name] for name in self.known], axis=1)
        y = Ishigami.evaluate(x)
        beats = [{"A.P": np.full(8, value), "A.Q": np.ones(8)} for value in y]
        return ["broken." if x1 < self.least else beat for x1, beat in zip(x[:, 0], beats, strict=True)]


def ishigami(samples: int, least: float = -4.0) -> Plan:
    model = Function(least)
    ranges = [f"x.{i}=-3.14159265..3.14159265" for i in (1, 2, 3)]
    return plan_of(model, parse_varied(ranges, model.known, model.nominal, model.name), samples, 3, None)


def test_indices_of_a_known_function(tmp_path: Path) -> None:
    """Ishigami, a = 7, b = 0.1: S1 = 0.3139, 0.4424, 0; ST = 0.5576, 0.4424, 0.2437. N = 1024: within 0.03."""
    plan = ishigami(5120)
    assert (plan.base, plan.size) == (1024, 5120)
    store = Store(tmp_path, plan)
    assert run(plan, store, jobs=1) == 5120
    found = findings(plan, store.read("sets"))
    mean = [index for index in found.indices if index.measure == "A.P.mean"]
    np.testing.assert_allclose([i.S1 for i in mean], [0.3139, 0.4424, 0.0], atol=0.03)
    np.testing.assert_allclose([i.ST for i in mean], [0.5576, 0.4424, 0.2437], atol=0.03)
    assert all(0.0 < i.ST_conf < 0.1 for i in mean)
    assert not [index for index in found.indices if index.measure == "A.Q.mean"]  # does not vary: no index


def test_a_mean_flow_that_is_given_has_no_indices(tmp_path: Path) -> None:
    """The inflow gives the mean flow of the root: what varies of it is the tolerance to which beats repeat."""
    network = load("human")
    root = network.inlet.segment
    network = replace(network, sites=(Site("root", root, 0.5), Site("LC", "LC", 0.5)))
    model = NetworkModel(network, Settings(dt=2.5e-3), 1e-4)
    ranges = ["LC.outlet.R2=0.5..2x", "all.E=0.8..1.2x"]
    store = Store(tmp_path, plan_of(model, parse_varied(ranges, model.known, model.nominal, model.name), 32, 3, None))
    run(store.plan, store, jobs=1)
    sets = store.read("sets")
    found = findings(store.plan, sets)
    mean = sets["root.Q.mean"].to_numpy()
    assert 1e-9 < np.ptp(mean) / mean.max() < 1e-4
    assert {index.measure for index in found.indices} == set(store.plan.measures) - {"root.Q.mean"}


def test_indices_of_few_sets_tell_how_sure_they_are(tmp_path: Path) -> None:
    """N = 16: every index with its interval on page and terminal, and how many samples would do; N = 1024: no note."""
    studies = {}
    for samples in (80, 5120):
        plan = ishigami(samples)
        store = Store(tmp_path / str(samples), plan)
        run(plan, store, jobs=1)
        studies[plan.base] = Study.of(store)
    few = studies[16]
    widest = max(few.found.indices, key=lambda index: index.widest)
    assert widest.widest > 0.3
    (note,) = [note for note in few.notes if "too wide to rank" in note]
    assert f"up to ± {widest.widest:.2f} ({widest.varied} on {widest.measure}), because N = 16 is small" in note
    wanted = int(re.findall(r"--samples (\d+)", note)[0]) // few.plan.group
    assert 16 * (widest.widest / 0.2) ** 2 <= wanted < 32 * (widest.widest / 0.2) ** 2
    assert not [note for note in studies[1024].notes if "too wide" in note]
    write(few, tmp_path)
    html = (tmp_path / "study.html").read_text()
    index = few.indices("A.P.mean")[0]
    assert f"<td>{index.total}<br>{index.first}</td>" in html.replace(' class="marked"', "") and " ± " in index.total
    assert f'<p class="warning">{note[0].upper()}{note[1:]}</p>' in html
    printed = io.StringIO()
    Console(width=100, file=printed).print(_table(few))
    assert re.search(rf"x\.1 {index.ST:.2f}±{index.ST_conf:.2f}", printed.getvalue())


def test_broken_sets_are_kept_and_counted(tmp_path: Path) -> None:
    """Rows with their sentence; of their groups no set is left in the indices."""
    plan = ishigami(640, least=-2.9)
    store = Store(tmp_path, plan)
    run(plan, store, jobs=1)
    sets = store.read("sets")
    broken = sets.filter(pl.col(FAILED).is_not_null())
    assert len(sets) == plan.size and set(broken[FAILED]) == {"broken."} and 0 < len(broken) < 64
    study = Study.of(store)
    assert study.found.dropped == len(broken["group"].unique()) > 0
    assert study.found.groups == plan.base - study.found.dropped
    assert f"{len(broken)} of 640 parameter sets could not be simulated" in study.notes[0]
    write(study, tmp_path)
    assert "broken." in (tmp_path / "study.html").read_text()
    assert summary(study)["failures"][0]["sentence"] == "broken."


def test_nothing_could_be_simulated(tmp_path: Path) -> None:
    plan = ishigami(40, least=4.0)
    store = Store(tmp_path, plan)
    run(plan, store, jobs=1)
    with pytest.raises(ValueError, match=r"none of the 40 parameter sets could be simulated; the first: broken\."):
        Study.of(store)


def test_how_many_sets() -> None:
    """N: the largest power of two with N (D + 2) <= samples."""
    assert [base_of(n, 3) for n in (10, 4096, 5119, 5120)] == [2, 512, 512, 1024]
    with pytest.raises(ValueError, match="--samples = 9: 3 ranges need 10 parameter sets at least"):
        base_of(9, 3)
    with pytest.raises(ValueError, match="--samples = 5: 1 range needs 6 parameter sets at least"):
        base_of(5, 1)


# --- the folder -----------------------------------------------------------------------------------------------------

LINE = ["study", "sheep", "--vary", "CA.phi0=10..120kPa*s", "--vary", "all.E=0.8..1.2x", "--sites", "CA",
        "--dt", "5 ms", "--samples", "256"]  # fmt: skip


def started(*more: str) -> subprocess.Popen[bytes]:
    line = [sys.executable, "-m", "arterial_fmu", *LINE, *more, "--quiet"]
    return subprocess.Popen(line, env={**os.environ, **ENVIRONMENT, "PYTHONPATH": str(ROOT)})


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in RESULTS}


@pytest.mark.slow
def test_killed_and_gone_on(tmp_path: Path) -> None:
    """SIGKILL in mid-run, then the same command with two processes: the bytes of a run that nothing disturbed."""
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    with started("--out", str(killed), "--jobs", "1") as process:
        while len(list((killed / "parts").glob("*.parquet"))) < 2:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    done = sorted((killed / "parts").glob("*.parquet"))
    assert 2 <= len(done) < 5 and not (killed / "sets.parquet").exists()
    with started("--out", str(killed), "--jobs", "2") as process:
        assert process.wait() == 0
    with started("--out", str(whole), "--jobs", "1") as process:
        assert process.wait() == 0
    assert contents(killed) == contents(whole)
    assert not (killed / "parts").exists()


@pytest.mark.slow
def test_goes_on_and_is_the_same(tmp_path: Path) -> None:
    """Only what is missing is simulated; the results are those of one go, byte for byte; and then nothing is left."""
    plan = Plan(sheep(), varied("CA.phi0=10..120kPa*s", "all.E=0.8..1.2x"), 32, 1, ("CA",))
    assert [len(each) for each in plan.batches] == [64, 64]
    whole, resumed = (Store(tmp_path / name, plan) for name in ("whole", "resumed"))
    assert run(plan, whole, jobs=1) == 128
    first = Batch(plan.model, plan.batches[1], plan.parameters(plan.batches[1]), tuple(plan.measures), plan.waves)
    resumed.keep(1, run_batch(first))
    assert run(plan, resumed, jobs=1) == 64
    for name in ("sets", "waveforms", "finer"):
        assert (tmp_path / "whole" / f"{name}.parquet").read_bytes() == (
            tmp_path / "resumed" / f"{name}.parquet"
        ).read_bytes()
    assert run(plan, resumed, jobs=1) == 0
    differences = Study.of(whole).differences
    assert max(float(each.max()) for each in differences.values()) < 1e-3  # steps of 5 ms: 6e-4 measured


def test_another_study_is_refused(tmp_path: Path) -> None:
    """Any option that the results depend on."""
    ranges = varied("CA.E=1..6MPa")
    Store(tmp_path, Plan(sheep(), ranges, 2, 1, ("CA",)))
    Store(tmp_path, Plan(sheep(), ranges, 2, 1, ("CA",)))  # the same
    others = {
        "--seed 1, not 2": Plan(sheep(), ranges, 2, 2, ("CA",)),
        "another --samples": Plan(sheep(), ranges, 4, 1, ("CA",)),
        "another --vary": Plan(sheep(), varied("CA.E=1..5MPa"), 2, 1, ("CA",)),
        "another network, inflow or step": Plan(sheep("MD"), ranges, 2, 1, ("CA",)),
        "another --vary, another --sites": Plan(sheep("MD"), varied("CA.E=1..5MPa"), 2, 1, ("MD",)),
    }
    for what, plan in others.items():
        with pytest.raises(ValueError, match=rf"it contains another study \({what}\); give another folder"):
            Store(tmp_path, plan)
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(ValueError, match="not the plan of a study"):
        Store(tmp_path, Plan(sheep(), ranges, 2, 1, ("CA",)))


# --- the command ----------------------------------------------------------------------------------------------------


def test_command(tmp_path: Path) -> None:
    """Tables, files, and JSON of what is done already: no progress among it."""
    line = [
        "study",
        "sheep",
        "--vary",
        "CA.E=1..6MPa",
        "--samples",
        "40",
        "--sites",
        "CA",
        "--dt",
        "5 ms",
        "--jobs",
        "1",
    ]
    runner, app = CliRunner(env={"COLUMNS": "160"}), arterial_fmu.__main__.app
    done = runner.invoke(app, [*line, "--out", str(tmp_path / "o")])
    assert done.exit_code == 0, done.output
    assert "CA.P.systolic" in done.stdout and "24 parameter sets of the 40 allowed: N (D + 2) with N = 8" in done.stdout
    again = runner.invoke(app, [*line, "--out", str(tmp_path / "o"), "--json"])
    found = json.loads(again.stdout)
    assert (found["sets"], found["base"]) == (24, 8)
    assert found["numbers"]["CA.P.mean"]["unit"] == "Pa"
    assert found == json.loads((tmp_path / "o" / "study.json").read_text())
    html = (tmp_path / "o" / "study.html").read_text()
    assert html.count("data:image/png") == 2 and "http" not in html.replace("http-equiv", "")


def test_an_inflow_of_a_record_or_a_network() -> None:
    """--inflow: another network's flow; an FMU needs one; a pressure is none."""
    model = read_model("sheep", "sheep", "2.5 ms", "5 cm", 1e-4)
    assert isinstance(model, NetworkModel) and model.flow is not None
    t = np.arange(20) * 0.025
    np.testing.assert_allclose(model.flow(t), load("sheep").inlet.Q(t), atol=2e-4 * 55e-6)
    with pytest.raises(ValueError, match="--tolerance = 0: must be above 0"):
        read_model("sheep", None, "2.5 ms", "5 cm", 0.0)


def test_an_inflow_of_a_laboratory_file(tmp_path: Path, fmus: dict[str, Path]) -> None:
    """A LabChart text with a title of its own is a record, no network; without --map a sentence gives the option. A
    flow that no artery of the model has is refused, of an FMU by its widest vessel."""
    T, t = 0.5, np.arange(2000) * 0.005
    Q = 20.0 + 30.0 * np.sin(2.0 * np.pi * t / T) + 10.0 * np.sin(4.0 * np.pi * t / T)
    file = tmp_path / "chart.txt"
    head = "Interval=\t0.005 s\nTimeFormat=\tStartOfBlock\nChannelTitle=\tAo Flow\nUnitName=\tmL/s\n"
    file.write_text(head + "".join(f"{s:.3f}\t{x:.4f}\n" for s, x in zip(t, Q, strict=True)))
    model = read_model("sheep", str(file), "2.5 ms", "5 cm", 1e-4, Reading(names={"Ao Flow": "inlet.Q"}))
    assert isinstance(model, NetworkModel) and model.flow is not None
    assert model.flow.T == pytest.approx(T, rel=1e-3)
    assert float(np.mean(model.flow(t[:100]))) == pytest.approx(1e-6 * Q[:100].mean(), rel=1e-3)
    fast = Reading(names={"Ao Flow": "inlet.Q [L/min]"}), Reading(names={"Ao Flow": "inlet.Q [L/s]"})
    assert isinstance(read_model("sheep", str(file), "2.5 ms", "5 cm", 1e-4, fast[0]), NetworkModel)  # 4 m/s
    for model_name in ("sheep", str(fmus["sheep"])):
        with pytest.raises(ValueError, match=r"inlet.Q: its peak is .* no artery's is beyond 5 m/s.* the unit mL/s"):
            read_model(model_name, str(file), "2.5 ms", "5 cm", 1e-4, fast[1])
        read_model(model_name, str(file), "2.5 ms", "5 cm", 1e-4, fast[1], True)
    with pytest.raises(ValueError, match='--map "Ao Flow=inlet.Q"'):
        read_model("sheep", str(file), "2.5 ms", "5 cm", 1e-4)


@pytest.mark.parametrize(
    ("model", "ranges", "dt", "length"),
    [
        ("sheep", "CA.phi0=10..120kPa*s", "2.5 ms", 0.1),
        ("sheep", "CA.phi0=10..120kPa*s", "1 ms", 0.05),
        ("sheep", "CA.phi0=0..120kPa*s", "2.5 ms", 0.05),  # elastic at one end
        ("uta", "all.E=0.8..1.2x", "2.5 ms", 0.05),  # elastic, without junctions
    ],
)
def test_elements_are_longer_where_walls_are_viscous(model: str, ranges: str, dt: str, length: float) -> None:
    """By default; a given length stays."""
    for given, expected in ((None, length), ("5 cm", 0.05)):
        read = read_model(model, None, dt, given, 1e-4)
        plan = plan_of(read, parse_varied([ranges], read.known, read.nominal, model), 64, 1, None)
        assert isinstance(plan.model, NetworkModel)
        assert plan.model.settings.element_length == pytest.approx(expected)


@pytest.mark.slow
def test_an_fmu(tmp_path: Path) -> None:
    """Six sets of a small network, by its FMU and by the solver with the same steps of 8 ms: means to 1e-4 (3e-5
    measured), ends of the beat to 1.5 % of its pulse (0.9 %: the kinks of the inflow between so long steps); a page."""
    from forked import NETWORK, SETTINGS

    write_network(NETWORK, tmp_path / "fork.toml")
    fmu = build(NETWORK, tmp_path, SETTINGS)
    asked = ["--vary", "A.E=0.9..1.1x", "--samples", "6", "--inflow", str(tmp_path / "fork.toml"), "--jobs", "2"]
    runner, app = CliRunner(), arterial_fmu.__main__.app
    for model, out, more in ((fmu, "fmu", []), (tmp_path / "fork.toml", "network", ["--dt", "8 ms"])):
        done = runner.invoke(app, ["study", str(model), *asked, *more, "--out", str(tmp_path / out), "--quiet"])
        assert done.exit_code == 0, done.output
    one, other = (pl.read_parquet(tmp_path / out / "sets.parquet") for out in ("fmu", "network"))
    assert one["A.E"].to_list() == other["A.E"].to_list() and one[FAILED].null_count() == 6
    for channel in ("A.P", "B.P", "C.P", "A.Q", "B.Q", "C.Q"):
        means = (each[f"{channel}.mean"].to_numpy() for each in (one, other))
        np.testing.assert_allclose(*means, rtol=1e-4)
        high, low = ("systolic", "diastolic") if channel.endswith("P") else ("max", "min")
        pulse = other[f"{channel}.{high}"] - other[f"{channel}.{low}"]
        for end in (high, low):
            assert ((one[f"{channel}.{end}"] - other[f"{channel}.{end}"]) / pulse).abs().max() < 0.015
    assert one["A.P.systolic"].n_unique() > 2
    assert (tmp_path / "fmu" / "study.html").is_file()
