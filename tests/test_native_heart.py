"""Hearts and bodies that need no Python against those of pythonfmu: the same numbers, sentences, variables, states."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from c_host import CHost, unpack
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Discard, fmi2Error, fmi2Fatal
from fmpy.validation import validate_fmu
from fmus import MS, Instance, Store
from native_fmus import needs_compiler
from test_heart import evenly
from test_native_fmu import table
from typer.testing import CliRunner

from arterial_fmu.cli.build import app
from build_fmu import build_native_model
from fmu_src.contents.models import FMUContents, body_model, heart_model
from fmu_src.importer import doctor
from fmu_src.slaves import body_slave, heart_slave
from solver.lumped import heart as heart_module
from solver.lumped.species import HUMAN_HEART, SPECIES
from solver.quantities.units import MMHG

pytestmark = needs_compiler
Array = np.ndarray

ML = 1e-6
EQUAL = 1e-13  # of the pulse of each output
R1, C, R2 = 0.05 * MMHG / ML, 1.6 * ML / MMHG, 1.2 * MMHG / ML  # of a Windkessel
MODELS: Mapping[str, Callable[..., FMUContents]] = {"heart": heart_model, "body": body_model}
# a valve of a resistance alone, which opens and closes at once: Newton's method fails, bisection goes on
STIFF = {f"aortic_valve.{key}": x for key, x in {"l": 0.0, "R": R1, "K_open": 1e3, "K_close": 1e3}.items()}


def built(stored: Store, make: Callable[..., FMUContents], species: str = "human") -> tuple[Path, Path]:
    """Both FMUs: pythonfmu's and the native one."""
    return stored.lumped(make, species), stored.lumped(make, species, 2)


def instances(files: tuple[Path, Path], folder: Path) -> tuple[Instance, Instance]:
    return Instance(files[0], folder / "a"), Instance(files[1], folder / "b")


@pytest.fixture(scope="module")
def files(stored: Store) -> dict[str, tuple[Path, Path]]:
    """Both FMUs of the human heart and body."""
    return {kind: built(stored, make) for kind, make in MODELS.items()}


@pytest.fixture(scope="module")
def hearts(files: dict[str, tuple[Path, Path]], tmp_path_factory: pytest.TempPathFactory) -> tuple[Instance, Instance]:
    return instances(files["heart"], tmp_path_factory.mktemp("hearts"))


def anew(instance: Instance, start: Mapping[str, float | str] | None = None) -> list[str]:
    """Initialize again; the names of all outputs."""
    instance.slave.reset()
    instance.messages.clear()
    instance.initialize(start)
    return [*instance.outputs, *instance.others]


def beats(
    heart: Instance, steps: Sequence[float], start: Mapping[str, float] | None = None,
    tuned: Mapping[int, Mapping[str, float]] | None = None,
) -> Array:  # fmt: skip
    """All outputs of a heart on a Windkessel, after steps [s]; at some of these parameters are set."""
    names = anew(heart, start)
    t, P_C, Q, found = 0.0, 80 * MMHG, 0.0, [heart.get(names)]
    for i, h in enumerate(steps):
        a = 0.5 * h / (C * R2)
        kept, Z_0 = (1.0 - a) / (1.0 + a), 0.5 * h / C / (1.0 + a)
        heart.set({"aorta.P_0": kept * P_C, "aorta.Z": Z_0 + R1, "aorta.Z_0": Z_0})
        heart.set({"venous.P": 11 * MMHG + 30.0 * float(np.sin(i / 50)), **(tuned or {}).get(i, {})})
        heart.slave.doStep(t, h)
        t += h
        found.append(heart.get(names))
        Q, before = found[-1][names.index("aorta.Q")], Q
        P_C = kept * P_C + Z_0 * (before + Q)
    return np.array(found)


def off(found: Array, expected: Array) -> float:
    return float((np.abs(found - expected).max(axis=0) / np.ptp(expected, axis=0)).max())


# --- the same numbers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("species", SPECIES)
def test_ten_beats_of_a_heart(stored: Store, tmp_path: Path, species: str) -> None:
    """On a Windkessel, with rate, contractility and a valve changed in mid-run (measured 2e-15)."""
    one, two = instances(built(stored, heart_model, species), tmp_path)
    T = 1.0 / SPECIES[species][0].heart.rate
    tuned = {2000: {"heart.rate": 1.2 / T, "heart.contractility": 1.3}, 3000: {"aortic_valve.regurgitation": 0.05}}
    expected, found = (beats(each, [MS] * round(10 * T / MS), tuned=tuned) for each in (one, two))
    assert off(found, expected) <= EQUAL
    assert one.messages == two.messages == []
    assert np.ptp(expected[:, one.outputs.index("left_ventricle.P")]) > 80 * MMHG


def test_uneven_steps(hearts: tuple[Instance, Instance]) -> None:
    steps = np.random.default_rng(1).choice([1e-3, 1e-5, 4e-3, 7e-4, 0.04], 1500).tolist()
    expected, found = (beats(each, steps) for each in hearts)
    assert off(found, expected) <= EQUAL


def test_valves_that_open_at_once(hearts: tuple[Instance, Instance], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Newton's method does not converge, valve after valve is bisected (measured 1e-14)."""
    expected, found = (beats(each, [2 * MS] * 900, STIFF) for each in hearts)
    assert off(found, expected) <= EQUAL
    assert np.ptp(expected[:, hearts[0].outputs.index("aorta.Q")]) > 1e-4


def test_bisection_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """In that run Newton's method fails in some steps, in Python, where it can be counted."""
    converged, one_by_one = list[bool](), heart_module.one_by_one

    def counted(residuals: Any, Q_m: float, Q_a: float, found: bool) -> Any:
        converged.append(found)
        return one_by_one(residuals, Q_m, Q_a, found)

    monkeypatch.setattr(heart_module, "one_by_one", counted)
    evenly(HUMAN_HEART.with_values(STIFF), 2 * MS, 900)
    assert converged.count(False) > 0  # 3 of 900


def test_nothing_received_yet(hearts: tuple[Instance, Instance]) -> None:
    """Zeros before the first step are no port; after it they are."""
    found = []
    for each in hearts:
        names = anew(each)
        each.set({"aorta.P_0": 0.0, "venous.P": 0.0})
        rows = []
        for i in range(200):
            each.slave.doStep(i * MS, MS)
            rows.append(each.get(names))
        found.append(np.array(rows))
    assert off(found[1], found[0]) <= EQUAL
    P = found[0][:, names.index("aorta.P")]
    assert P[0] == pytest.approx(80 * MMHG) and abs(P[-1]) < 1e-6


def test_any_parameters(hearts: tuple[Instance, Instance]) -> None:
    """Random values in their ranges: every output to 1e-10 of its largest value,
    or of its nominal one where it is smaller (measured 1.2e-11, an opening; others 1e-13)."""
    random = np.random.default_rng(11)
    variables = [v for v in heart_slave.table(HUMAN_HEART) if v.quantity is not None]
    given = [v.quantity for v in variables if v.start is not None and v.quantity]
    names = [v.name for v in variables if v.start is not None]
    nominal = {v.name: v.quantity.nominal for v in variables if v.quantity}

    def anything(low: float, high: float) -> float:
        if low < 0.0 or high > 1e12:
            return float(np.clip(random.choice([-1.0, 0.0, 1.0]) * 10 ** random.uniform(-3, 12), low, high))
        return float(np.exp(random.uniform(*np.log([low, high]))) if low > 0.0 else random.uniform(low, high))

    for _ in range(150):
        values = {name: anything(q.low, q.high) for name, q in zip(names, given, strict=True) if random.random() < 0.3}
        found = []
        for each in hearts:
            outputs, rows = anew(each, values), []
            for i in range(30):
                each.slave.doStep(i * MS, MS)
                rows.append(each.get(outputs))
            found.append(np.array(rows))
        size = np.maximum(np.abs(found[0]).max(axis=0), [nominal[name] for name in outputs])
        assert (np.abs(found[1] - found[0]).max(axis=0) <= 1e-10 * size).all()


@pytest.mark.parametrize("exchange", body_slave.EXCHANGES)
def test_body(files: dict[str, tuple[Path, Path]], tmp_path: Path, exchange: str) -> None:
    """Volumes at the end and at the start of steps, some of which are short; its compliance changes."""
    found, bodies = [], instances(files["body"], tmp_path)
    for each in bodies:
        names, t, rows = anew(each, {"body.exchange": exchange, "arteries.V": 1e-5}), 0.0, []
        for i in range(3000):
            h = 1e-4 if i % 7 == 0 else 2 * MS
            each.set({"arteries.V": 1e-5 + 80e-6 * t, "heart.V": 3e-5 * (1.0 - float(np.cos(7 * t)))})
            each.set({"body.C": 2e-7} if i == 1500 else {})
            each.slave.doStep(t, h)
            t += h
            rows.append(each.get(names))
        found.append(np.array(rows))
    assert off(found[1], found[0]) <= EQUAL
    assert bodies[0].messages == bodies[1].messages == []


# --- bad input --------------------------------------------------------------------------------------------------------


TOO_LONG = "a heart of {} beats per second needs steps above 0 and up to {} s; take shorter ones."
UNSOLVED = [
    {"aortic_valve.K_open": 0.76, "aortic_valve.K_close": 410.0, "aortic_valve.regurgitation": 1.0,
     "aortic_valve.l": 0.5, "aortic_valve.A": 0.057, "mitral_valve.A": 0.0025, "mitral_valve.K_open": 0.11,
     "mitral_valve.K_close": 0.032, "aorta.P_0": 2.6e5, "aorta.Z": 0.0, "aorta.Z_0": -6.8e6, "venous.P": 6.7e4},
    {"aorta.P_0": 1.9e5, "aorta.Z": 9e12, "aorta.Z_0": 0.0, "venous.P": 6.3e5},
    {"aorta.P_0": 6.6e5, "aorta.Z": 0.0, "aorta.Z_0": 28.0, "venous.P": 9.2e5},
    {"aorta.P_0": 6e5, "aorta.Z": 3.8e6, "aorta.Z_0": -1.3e11, "venous.P": 7.9e5},
]  # fmt: skip
# what is set before initialization and before each step; the steps; the sentence of the last one
BAD: dict[str, tuple[list[dict[str, float]], list[tuple[float, float]], str]] = {
    "another time": ([{}] * 3, [(0.0, MS), (0.5, MS)], "but the component stands at 0.001 s; step on"),
    "no step": ([{}] * 2, [(0.0, 0.0)], "communication step of 0 s: must be positive."),
    "NaN": ([{}] * 2, [(0.0, float("nan"))], "communication step of nan s: must be positive."),
    "too long": ([{}] * 2, [(0.0, 0.046)], f"communication step of 0.046 s: {TOO_LONG.format(1.11111, 0.045)}"),
    "fast heart": ([{}, {}, {"heart.rate": 9.0}], [(0.0, 0.04), (0.04, 0.04)], TOO_LONG.format(9, 0.00555556)),
    "unsolved": (UNSOLVED, [(0.0, 0.014), (0.014, 0.0045), (0.0185, 0.00063)],
                 "t = 0.01913 s: the flows through the valves have no solution over a step of 0.00063 s (aorta.P_0 = "
                 "600000 Pa, aorta.Z = 3.8e+06 Pa.s/m^3); take shorter steps."),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_refused_steps(files: dict[str, tuple[Path, Path]], tmp_path: Path, case: str) -> None:
    """The same sentence from both, and what was there before stays: a right step is the one of another instance."""
    settings, steps, sentence = BAD[case]
    found, said = [], []
    for i, file in enumerate(files["heart"]):
        each = Instance(file, tmp_path / str(i))  # FMPy has one log: that of the newest instance
        each.initialize(settings[0])
        names = [*each.outputs, *each.others]
        for given, (t, h) in zip(settings[1:-1], steps[:-1], strict=True):
            each.set(given)
            each.slave.doStep(t, h)
        before, state = each.get(names), each.slave.getFMUState()
        each.set(settings[-1])
        with pytest.raises(FMICallException) as error:
            each.slave.doStep(*steps[-1])
        assert error.value.status == fmi2Discard
        assert each.get(names) == before
        each.slave.setFMUState(state)
        each.slave.doStep(sum(h for _, h in steps[:-1]), MS)
        found.append(each.get(names))
        said += each.messages
    assert said[0] == said[1] and len(said) == 2
    assert sentence in said[0]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [("heart", "aorta.Z", -1.0), ("heart", "heart.rate", float("nan")), ("heart", "aorta.Q", 1.0),
     ("body", "body.C", 0.0), ("body", "P", 1.0)],
)  # fmt: skip
def test_refused_values(
    files: dict[str, tuple[Path, Path]], tmp_path: Path, kind: str, name: str, value: float
) -> None:
    """Out of range, not finite, an output: the sentences of the other FMU, but as errors."""
    said = []
    for file, status in zip(files[kind], (fmi2Fatal, fmi2Error), strict=True):
        each = Instance(file, tmp_path / str(status))
        with pytest.raises(FMICallException) as error:
            each.initialize({name: value})
        assert error.value.status == status
        said += each.messages
    assert len(said) == 2 and said[1] in said[0] and name in said[1]  # pythonfmu says where it was raised, too


# --- description, standards, states -----------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", MODELS)
def test_the_same_variables(stored: Store, tmp_path: Path, kind: str, fmi: int) -> None:
    """Names, references, causalities, units, ranges and start values; no Python, no fault that FMPy finds."""
    one, two = stored.lumped(MODELS[kind]), stored.lumped(MODELS[kind], fmi=fmi)
    assert validate_fmu(os.fspath(two)) == []
    description = fmpy.read_model_description(os.fspath(two))
    assert (description.fmiVersion, description.coSimulation.needsExecutionTool) == (f"{fmi}.0", False)
    assert table(two) == table(one)
    with zipfile.ZipFile(two) as archive:
        page = archive.read("documentation/index.html").decode()
        told = archive.read("modelDescription.xml").decode()
    assert f'providesDirectionalDerivative{"s" * (fmi == 3)}="true"' in told
    assert f"(FMI {fmi}.0)" in page and "Nothing: no Python" in page and "Python 3.10" not in page
    again = build_native_model(MODELS[kind]("human", {}, fmi), tmp_path / "again")
    assert again.read_bytes() == two.read_bytes()


def test_fmi_3(stored: Store) -> None:
    """FMI 3.0 gives the numbers of 2.0, bit by bit."""
    found = []
    for fmi in (2, 3):
        file = stored.lumped(heart_model, fmi=fmi)
        names = ["left_ventricle.P", "left_ventricle.V", "aorta.Q"]
        found.append(fmpy.simulate_fmu(os.fspath(file), output=names, stop_time=1.0, output_interval=2e-3))
    assert len(found[0]) == 501 and np.ptp(found[0]["left_ventricle.P"]) > 80 * MMHG
    assert found[0].tobytes() == found[1].tobytes()


def test_states(files: dict[str, tuple[Path, Path]], hearts: tuple[Instance, Instance], tmp_path: Path) -> None:
    """In the middle of ejection and after a change of the heart rate: the same bits from a state, and from its bytes in
    another instance."""
    heart = hearts[1]
    other = Instance(files["heart"][1], tmp_path / "other")
    names = anew(heart)

    def run(each: Instance, first: int, last: int) -> list[list[float]]:
        found = []
        for i in range(first, last):
            each.set({"aorta.P_0": 78 * MMHG, "aorta.Z": R1})
            each.slave.doStep(i * MS, MS)
            found.append(each.get(names))
        return found

    run(heart, 0, 150)
    heart.set({"heart.rate": 1.5})
    run(heart, 150, 160)
    state = heart.slave.getFMUState()
    blob = heart.slave.serializeFMUState(state)
    expected = run(heart, 160, 400)
    heart.set({"heart.rate": 1.0})
    heart.slave.setFMUState(state)
    assert run(heart, 160, 400) == expected
    other.slave.setFMUState(other.slave.deSerializeFMUstate(blob))
    assert run(other, 160, 400) == expected


@pytest.mark.parametrize("kind", MODELS)
def test_doctor(stored: Store, tmp_path: Path, kind: str) -> None:
    """Whole, without Python, and one step made; a change is found by the GUID."""
    file = stored.lumped(MODELS[kind], "sheep", 2)
    found = {finding.what: finding for finding in doctor.examine(file)}
    assert {finding.state for finding in found.values()} == {doctor.OK}
    assert found["one step"].found == "loaded, initialized, stepped, read, freed"
    changed = tmp_path / "changed.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name) + b" " * name.endswith(".json"))
    assert doctor.state(doctor.examine(changed)) == doctor.FATAL


def test_a_host_without_python(stored: Store, c_host: CHost, tmp_path: Path) -> None:
    """A host in C with no Python on its path: every step done, nothing logged."""
    fmu = unpack(stored.lumped(heart_model, fmi=2), tmp_path / "fmu")
    steps = [f"step 0 {k * MS!r} {MS!r}" for k in range(200)]
    read = "getReal 0 " + " ".join(str(fmu.references[name]) for name in fmu.outputs)
    lines = [
        f"library 0 {fmu.library}",
        fmu.instantiate(0),
        "setup 0 0 10",
        "enter 0",
        "exit 0",
        *steps,
        read,
        "free 0",
    ]
    done = c_host.run(lines, {"PATH": "/nonexistent", "LD_PRELOAD": ""})
    assert (done.code, done.errors) == (0, "")
    assert [(a.status, a.log) for a in done.answers] == [("ok", ())] * len(lines)
    assert dict(zip(fmu.outputs, done[-2].values, strict=True))["left_ventricle.P"] > 70 * MMHG


def test_command(tmp_path: Path) -> None:
    """build heart --native --fmi 3; its options are refused without it."""
    line = [sys.executable, "-m", "arterial_fmu", "build", "heart", "--out", os.fspath(tmp_path), "--fmi", "3"]
    refused = CliRunner().invoke(app, line[4:])
    assert refused.exit_code == 2
    assert "--fmi and --platforms: for FMUs that need no Python; add --native." in refused.stderr
    done = subprocess.run([*line, "--native", "--set", "heart.rate=1.3 Hz"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    description = fmpy.read_model_description(os.fspath(tmp_path / "human_heart.fmu"))
    starts = {v.name: v.start for v in description.modelVariables}
    assert (description.fmiVersion, float(starts["heart.rate"])) == ("3.0", 1.3)
