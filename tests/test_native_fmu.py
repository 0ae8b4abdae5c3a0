"""The FMU that needs no Python against that of pythonfmu, through FMPy: the same numbers, states, parameters."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from ctypes import c_double, c_uint32
from dataclasses import dataclass, replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from fmus import COARSE, MS, Instance, Store
from native_fmus import apart, elastic, half_sine, needs_compiler, pair, rows
from test_command import run as command
from test_table_source import table as source
from test_toy import Orifice, TissueSupport
from threadpoolctl import threadpool_limits

from build_fmu import build, build_native
from fmu_src import compiler
from fmu_src.importer import doctor
from fmu_src.importer.run import FMUError, run_fmu
from fmu_src.native import binaries
from fmu_src.native.arrays import checksum
from solver import Settings, load, simulate
from solver.errors import InputError
from solver.laws import effects, outlets, wall_laws
from solver.network.table_source import KINDS

pytestmark = needs_compiler
EQUAL = 1e-12  # of the largest value of each output
DIVIDED = 2e-11  # the same of what is a difference of outputs, divided: venous.Q, and Z of ports (measured 4e-12)
TUNED = {30: {"CA.phi0": 3e4, "AA.E": 1.5e6}, 60: {"CA.outlet.R_t": 0.5, "VA1.outlet.P_venous": 200.0}}


@pytest.fixture(scope="module")
def both(stored: Store, tmp_path_factory: pytest.TempPathFactory) -> tuple[Instance, Instance]:
    return pair(stored, load("sheep"), tmp_path_factory.mktemp("both"))


@pytest.fixture(scope="module")
def native(stored: Store) -> Path:
    return stored(build_native, load("sheep"), settings=COARSE)


def same(one: Instance, two: Instance, *run: object, equal: float = EQUAL, **more: object) -> None:
    found, expected = rows(two, *run, **more), rows(one, *run, **more)  # type: ignore[arg-type]
    off, divided = apart(one, found, expected)
    assert off <= equal
    assert divided <= DIVIDED
    assert two.messages == one.messages == []


@pytest.mark.parametrize("way", ["hold", "linear", "smooth"])
def test_equals_the_other_fmu(both: tuple[Instance, Instance], way: str) -> None:
    """Viscoelastic sheep, walls and an outlet retuned in mid-run; all outputs, ports too (measured 3e-13, 4e-12)."""
    same(*both, {"inlet.interpolation": way}, 100, tuned=TUNED)


@pytest.mark.parametrize("h", [0.7e-3, 2.5e-3])
def test_off_the_grid(both: tuple[Instance, Instance], h: float) -> None:
    """Communication steps that are no multiples of the internal one."""
    same(*both, {"inlet.interpolation": "linear"}, 150, h=h)


def test_start_values(both: tuple[Instance, Instance]) -> None:
    """Walls, laws, fluid and steps that are set before initialization, and the network's own inflow."""
    values = {
        "inlet.drive": "network", "inlet.Q_mean": 1e-5, "inlet.T": 0.4, "solver.dt": 5e-4, "network.P_0": 5e3,
        "network.elastic_law": "regression", "network.viscous_law": "monotone", "CA.phiNL": 4e3, "AA.ENL": 1e5,
        "CA.R0": 4e-3, "fluid.rho": 1040.0, "MD.L": 0.099,
    }  # fmt: skip
    same(*both, values, 40)


def test_periodic_start(both: tuple[Instance, Instance]) -> None:
    """The periodic start of the start values is held; of other values it is refused with their name."""
    same(*both, {"network.start": "periodic", "inlet.drive": "network"}, 40)
    both[1].slave.reset()
    with pytest.raises(FMICallException):
        both[1].initialize({"network.start": "periodic", "CA.E": 2e6})
    assert "CA.E is another one; build it anew with --set" in both[1].messages.pop()


def test_a_wall_that_closes_at_its_outlet(both: tuple[Instance, Instance]) -> None:
    """P_venous above what the beta law carries, at the last outlet: the sentence names its segment."""
    _, native = both
    name = f"{load('sheep').outlets[-1].segment}.outlet.P_venous"
    native.slave.reset()
    with pytest.raises(FMICallException):
        native.initialize({name: 1e6})
    assert native.messages.pop() == (
        f"sheep: {name}: the wall at the outlet cannot carry P_0 - P_venous under the beta law; bring {name} nearer to "
        "network.P_0."
    )


def test_another_mesh_is_refused(native: Path, tmp_path: Path) -> None:
    """The sentence names the parameter, its value and how far it may go, where it is then accepted; one of several,
    too, and also where all other values were run with before."""
    instance = Instance(native, tmp_path / "one")

    def refusal(values: dict[str, float]) -> str:
        instance.slave.reset()
        with pytest.raises(FMICallException):
            instance.initialize(values)
        return instance.messages.pop()

    instance.initialize({})
    for name, given in (
        ("solver.element_length", {"solver.element_length": 1e-3}),
        ("CA.L", {"CA.E": 2e6, "CA.L": 0.3}),
        ("CA.L", {"CA.L": 0.3, "MD.L": 0.4}),
    ):
        said = re.fullmatch(
            rf"sheep: {name} = {given[name]:g} m: needs another mesh, .* {name} may lie in \[(.+), (.+)\] m here; "
            r"build it anew with --set, or take the FMU that needs Python\.",
            refusal(given),
        )
        assert said
        for end, outward in zip(map(float, said.groups()), (-1.0, 1.0), strict=True):
            instance.slave.reset()
            instance.initialize({**given, "MD.L": 0.1, name: end * (1.0 - 1e-3 * outward)})
            assert f"{name} = " in refusal({**given, "MD.L": 0.1, name: end * (1.0 + 1e-2 * outward)})


def test_a_single_value_that_is_refused(stored: Store, tmp_path: Path) -> None:
    """A stiffer part of a wall cannot be switched off where it has elements: the sentence excludes that value alone."""
    sheep = load("sheep").with_terms({"CA.E_scale": 1.5, "CA.E_length": 0.3})
    instance = Instance(stored(build_native, sheep, settings=COARSE), tmp_path / "part")
    instance.initialize({"CA.E_scale": 1.001})
    instance.slave.reset()
    with pytest.raises(FMICallException):
        instance.initialize({"CA.E_scale": 1.0})
    assert "CA.E_scale may lie in [0.01, 100] (no unit) here, except at this value; build" in instance.messages.pop()


def test_a_start_pressure_that_closes_the_wall(native: Path, tmp_path: Path) -> None:
    """P_0 below what the beta law carries: the solver's sentence, which does not say to lower it."""
    with pytest.raises(InputError, match="nearer to the pressure at which R = R0") as refused:
        simulate(load("sheep").with_parameters({"network.P_0": -9e4}), duration=1e-3)
    instance = Instance(native, tmp_path / "closed")
    with pytest.raises(FMICallException):
        instance.initialize({"network.P_0": -9e4})
    assert instance.messages.pop() == f"sheep: {refused.value}"


@pytest.mark.slow
def test_halved_steps(stored: Store, tmp_path: Path) -> None:
    """Steps that do not converge: both FMUs cut the same ones, and outputs stay equal (measured 3e-14)."""
    told, outputs = list[list[int]](), list[np.ndarray]()
    for which, make in (("python", build), ("native", build_native)):
        file = stored(make, elastic(load("human")), settings=Settings(dt=5e-3))
        instance = Instance(file, tmp_path / f"{which}_fmu")
        instance.initialize({"inlet.interpolation": "smooth"})
        halved = []
        for i in range(40):
            instance.step(i, 3e-3 * (i % 20 > 9), 5e-3)
            halved += [i] * len(instance.messages)
            assert all("cut into halves" in message for message in instance.messages)
            instance.messages.clear()
        told.append(halved)
        outputs.append(np.array(instance.get()))
    assert told[0] == told[1] and len(told[0]) > 5
    np.testing.assert_allclose(outputs[1], outputs[0], rtol=1e-13)


@pytest.mark.slow
def test_elastic_walls(stored: Store, tmp_path: Path) -> None:
    """Elastic sheep, and walls that are made viscous in mid-run: 1.4e-12 apart; a density that is 1e-14 larger moves
    beats of the elastic sheep by 1.2e-12 in NumPy alone."""
    one, two = pair(stored, elastic(load("sheep")), tmp_path)
    same(one, two, {"inlet.interpolation": "linear"}, 100, tuned={50: {"CA.phi0": 3e4}}, equal=2e-12)


HELD = {
    "human": lambda: load("human"),
    "nonlinear": lambda: load("sheep_nonlinear"),
    "relaxation": lambda: load("sheep").with_terms({"CA.tau": 0.01, "MD.tau": 0.0}),
    "springpot": lambda: load("sheep").with_terms({"CA.springpot": 0.3}),
    "unsteady friction": lambda: load("sheep").with_terms({"fluid.unsteady_scale": 1.0}),
    "stenosis": lambda: load("sheep").with_terms({"CA.K": 10.0}),
    "leak": lambda: load("sheep").with_terms({"CA.leak": 1e-9}),
    "taper": lambda: load("sheep").with_terms({"CA.taper": 0.2}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", HELD)
def test_networks_and_effects(stored: Store, tmp_path: Path, name: str) -> None:
    """The human network from one beat into the next, a part of a beat of what sheep may hold beside."""
    network = HELD[name]()
    steps = 950 if name == "human" else 150
    same(*pair(stored, network, tmp_path), {"inlet.drive": "network"}, steps)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["hold", "smooth"])
def test_tables_of_sources(stored: Store, tmp_path: Path, way: str) -> None:
    """They act at every stage, in outputs and in ports; they move the pressures by much more."""
    T, plain = load("sheep").inlet.T, load("sheep")
    acting = replace(plain, sources=tuple(source(kind, "CA", T) for kind in KINDS))
    one, two = pair(stored, acting, tmp_path)
    same(one, two, {"inlet.interpolation": way}, 60)
    other = Instance(stored(build_native, plain), tmp_path / "fmu")
    run = ({"inlet.interpolation": way}, 60)
    assert apart(one, rows(other, *run), rows(one, *run))[0] > 1e-2


def test_toy_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect that is one Python class, which the other FMU cannot carry, runs in C; the solver's numbers to 1e-11
    (measured 2e-13)."""
    toy = TissueSupport()
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, toy))
    network = toy.add(load("sheep"), "CA", {"k_near": 2e6, "k_far": 3e7})
    instance = Instance(build_native(network, tmp_path), tmp_path / "toy")
    found = rows(instance, {"inlet.drive": "network"}, 100)[:, : len(instance.outputs)]
    run = simulate(network, duration=0.1, backend="numpy")
    expected = np.column_stack([run[name] for name in instance.outputs])
    assert (np.abs(found - expected) <= 1e-11 * np.abs(expected).max(axis=0)).all()
    plain = simulate(load("sheep"), duration=0.1)
    assert np.abs(run["CA.P"] - plain["CA.P"]).max() > 1.0  # Pa, it does something


@dataclass(frozen=True)
class Power:
    """P_el = K (s⁴ - 1)/4: a law of a script."""

    name: str = "power"

    def pressure(self, s: np.ndarray, K: np.ndarray, e: None) -> np.ndarray:
        return K * (s**4 - 1.0) / 4.0

    def derivative(self, s: np.ndarray, K: np.ndarray, e: None) -> np.ndarray:
        return K * s**3

    def stretch(self, P: np.ndarray, K: np.ndarray, e: None) -> np.ndarray:
        return (1.0 + 4.0 * P / K) ** 0.25

    def simple_wave(self, s: np.ndarray, c0: np.ndarray) -> np.ndarray:
        return c0 * (s * s - 1.0)


def test_an_outlet_and_a_law_of_a_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They run in C like an effect of a script, also with another value of the outlet: the solver's numbers to 1e-11,
    and its description has the outlet's parameters."""
    monkeypatch.setattr(outlets, "OUTLETS", (*outlets.OUTLETS, Orifice))
    monkeypatch.setitem(wall_laws.ELASTIC_LAWS, "power", Power())  # type: ignore[arg-type]
    plain = load("sheep").with_outlet(Orifice("CA", R_v=5e8, b=2e14))
    network = replace(plain, elastic_law="power")
    fmu = build_native(network, tmp_path)
    (b,) = (v for v in fmpy.read_model_description(os.fspath(fmu)).modelVariables if v.name == "CA.outlet.b")
    assert (b.unit, float(b.start), b.variability) == ("Pa.s^2/m^6", 2e14, "tunable")
    instance = Instance(fmu, tmp_path / "own")
    for given in ({}, {"CA.outlet.b": 8e14}):
        found = rows(instance, {"inlet.drive": "network", **given}, 100)[:, : len(instance.outputs)]
        run = simulate(network, duration=0.1, parameters=given, backend="numpy")
        expected = np.column_stack([run[name] for name in instance.outputs])
        assert (np.abs(found - expected) <= 1e-11 * np.abs(expected).max(axis=0)).all()
    assert np.abs(run["CA.P"] - simulate(plain, duration=0.1, parameters=given)["CA.P"]).max() > 1.0  # Pa: the law


# --- description --------------------------------------------------------------------------------------------------


FACTS = ("name", "valueReference", "causality", "variability", "initial", "description", "unit", "displayUnit")
NUMBERS = ("start", "min", "max", "nominal")


def table(file: Path) -> list[tuple[object, ...]]:
    """What a description says of each variable but time."""
    variables = [v for v in fmpy.read_model_description(os.fspath(file)).modelVariables if v.name != "time"]
    return [
        (*(getattr(v, key) for key in FACTS), *(x and float(x) for x in (getattr(v, key) for key in NUMBERS)))
        for v in variables
    ]


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_same_variables(stored: Store, fmi: int) -> None:
    """Names, references, causalities, units, ranges and start values are those of the other; FMPy finds no fault."""
    one = stored(build, load("sheep"), settings=COARSE)
    two = stored(build_native, load("sheep"), settings=COARSE, fmi=fmi)
    assert validate_fmu(os.fspath(two)) == []
    description = fmpy.read_model_description(os.fspath(two))
    assert (description.fmiVersion, description.coSimulation.needsExecutionTool) == (f"{fmi}.0", False)
    assert table(two) == table(one)


def test_fmi_3(native: Path, stored: Store) -> None:
    """FMI 3.0 gives the numbers of 2.0, bit by bit, and time."""
    files = native, stored(build_native, load("sheep"), settings=COARSE, fmi=3)
    names = ["CA.P", "MD.Q", "inlet.Z", "venous.V"]
    two, three = (
        fmpy.simulate_fmu(
            os.fspath(f), output=names, stop_time=0.1, output_interval=2e-3, start_values={"inlet.drive": 2}
        )
        for f in files
    )
    assert len(two) == 51 and np.abs(two["CA.P"]).max() > 100.0
    for name in ("time", *names):
        assert np.array_equal(two[name], three[name]), name
    given = {"start_values": {"CA.phi0": 0.0}, "inputs": {"CA.outlet.P_venous": lambda t: 1e4 * t}}
    two, three = (run_fmu(f, np.zeros_like, 0.1, **given) for f in files)
    assert list(two) == list(three) and np.ptp(two["CA.P"]) > 10.0  # Pa
    for name in two:
        assert np.array_equal(two[name], three[name]), name
    with pytest.raises(FMUError, match=r"CA\.E = -1 Pa is not allowed: Young's modulus"):
        run_fmu(files[1], None, 0.1, start_values={"CA.E": -1.0})


def test_fewer_values_than_variables(stored: Store, tmp_path: Path) -> None:
    """FMI 3.0 tells how many values there are: other ones than variables are refused, and nothing is written."""
    file = stored(build_native, load("sheep"), settings=COARSE, fmi=3)
    description, told = fmpy.read_model_description(os.fspath(file)), list[bytes]()
    slave = FMU3Slave(
        unzipDirectory=fmpy.extract(os.fspath(file), os.fspath(tmp_path / "fmu")), instanceName="fewer",
        guid=description.instantiationToken, modelIdentifier="sheep",
    )  # fmt: skip
    slave.instantiate(loggingOn=True, logMessage=lambda _e, _s, _c, message: told.append(message))
    vr, values = (c_uint32 * 2)(0, 1), (c_double * 2)(-1.0, -1.0)
    for call in (slave.fmi3GetFloat64, slave.fmi3SetFloat64):
        with pytest.raises(FMICallException):
            call(slave.component, vr, 2, values, 1)
        assert told.pop() == b"fewer: 1 values for 2 variables: each has one."
    assert list(values) == [-1.0, -1.0]
    slave.fmi3GetFloat64(slave.component, vr, 2, values, 2)
    slave.freeInstance()


def test_the_same_input_the_same_file(native: Path, tmp_path: Path) -> None:
    """Byte for byte, with the sources and a build description in it."""
    again = build_native(load("sheep"), tmp_path, COARSE)
    assert again.read_bytes() == native.read_bytes()
    other = build_native(load("sheep").with_parameters({"CA.E": 2e6}), tmp_path, COARSE)
    guids = {fmpy.read_model_description(os.fspath(f)).guid for f in (native, other)}
    assert len(guids) == 2
    files = set(zipfile.ZipFile(native).namelist())
    assert {"sources/buildDescription.xml", "sources/engine.c", "sources/fmu/fmi2.c"} <= files


@pytest.mark.slow
def test_the_same_file_for_any_number_of_threads(tmp_path: Path) -> None:
    """Two threads of the linear algebra add in another order than one: 6e-20 in the periodic start of the human."""
    files = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            files.append(build_native(load("human"), tmp_path / str(threads)).read_bytes())
    assert files[0] == files[1]


def test_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence where nothing can compile it, and for a platform that there is not."""
    monkeypatch.setattr(binaries, "ENGINES", tmp_path / "solver" / "engine")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiler, "own", list)
    monkeypatch.setattr(compiler, "ziglang", lambda target: None)
    with pytest.raises(InputError, match="has none for .*, and no C compiler .* is there: pip install ziglang"):
        build_native(load("sheep"), tmp_path)
    with pytest.raises(InputError, match="--platforms amiga: must be linux64, "):
        build_native(load("sheep"), tmp_path, platforms=["amiga"])
    with pytest.raises(InputError, match="--fmi 1: must be 2 or 3"):
        build_native(load("sheep"), tmp_path, fmi=1)


def test_a_fat_library() -> None:
    """A Mach-O universal binary: two parts, each at a page of its own."""
    made = binaries.fat(b"x" * 5, b"a" * 20000)
    assert made[:8].hex() == "cafebabe00000002"
    assert made[1 << 14 : (1 << 14) + 5] == b"x" * 5
    assert made[2 << 14 : (2 << 14) + 20000] == b"a" * 20000
    assert int.from_bytes(made[16:20], "big") == 1 << 14 and int.from_bytes(made[36:40], "big") == 2 << 14


def test_doctor(native: Path, stored: Store, tmp_path: Path) -> None:
    """Whole, without Python, and one step made, FMI 3.0, too; a change is found by the GUID."""
    for fmu in (native, stored(build_native, load("sheep"), settings=COARSE, fmi=3)):
        found = {finding.what: finding for finding in doctor.examine(fmu)}
        assert {finding.state for finding in found.values()} == {doctor.OK}
        assert found["Python"].found == "not needed by the host"
        assert found["one step"].found == "loaded, initialized, stepped, read, freed"
    changed = tmp_path / "changed.fmu"
    with zipfile.ZipFile(native) as old, zipfile.ZipFile(changed, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name) + b" " * name.endswith("toml"))
    assert doctor.state(doctor.examine(changed)) == doctor.FATAL


def test_command(tmp_path: Path) -> None:
    """build --native; the options of it alone are refused without it."""
    line = ["build", "sheep", "--out", tmp_path, "--fmi", "3"]
    refused = command(*line)
    assert refused.exit_code == 2
    assert "--fmi and --platforms: for FMUs that need no Python; add --native." in refused.stderr
    done = command(*line, "--native", "--set", "CA.E=2 MPa")
    assert done.exit_code == 0, done.stderr
    description = fmpy.read_model_description(os.fspath(tmp_path / "sheep.fmu"))
    starts = {v.name: v.start for v in description.modelVariables}
    assert (description.fmiVersion, float(starts["CA.E"])) == ("3.0", 2e6)


# --- states -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["hold", "smooth"])
def test_states(native: Path, tmp_path: Path, way: str) -> None:
    """Save, step, restore, step: the same bits, in the instance, in another one by bytes, and in a new process."""
    one, two = Instance(native, tmp_path / "one"), Instance(native, tmp_path / "two")
    one.initialize({"inlet.interpolation": way})
    for i in range(20):
        one.set({"CA.E": 1.5e6} if i == 10 else {})
        one.step(i, 1e-6 * i)
    state = one.slave.getFMUState()
    blob = one.slave.serializeFMUState(state)
    expected = [one.step(20 + i, 1e-6 * i) for i in range(20)]
    one.slave.setFMUState(state)
    assert [one.step(20 + i, 1e-6 * i) for i in range(20)] == expected
    two.slave.setFMUState(two.slave.deSerializeFMUstate(blob))
    assert [two.step(20 + i, 1e-6 * i) for i in range(20)] == expected
    (tmp_path / "state").write_bytes(blob)
    line = [sys.executable, "-c", CONTINUED, *map(os.fspath, (native, tmp_path / "state", tmp_path / "new"))]
    done = subprocess.run(line, capture_output=True, text=True, cwd=Path(__file__).parent)
    assert done.stderr == ""
    assert [float.fromhex(x) for x in done.stdout.split()] == expected[-1]


def test_bytes_of_no_state(native: Path, tmp_path: Path) -> None:
    """Bytes with a right checksum, but with a law that is none, or numbers of steps that cannot be."""
    instance = Instance(native, tmp_path / "one")
    instance.initialize({})
    blob = instance.slave.serializeFMUState(instance.slave.getFMUState())
    head, law, last_steps = 88, 29 + instance.references["network.elastic_law"], 23  # as native/fmu has them
    for at, value in ((law, 1e9), (law, float("nan")), (last_steps, 1e300), (last_steps, -1.0)):
        numbers = np.frombuffer(blob[head:]).copy()
        assert numbers[at] == 1.0
        numbers[at] = value
        digest = checksum(numbers.tobytes()).to_bytes(8, "little")
        with pytest.raises(FMICallException):
            instance.slave.deSerializeFMUstate(blob[:16] + digest + blob[24:head] + numbers.tobytes())
        assert "incomplete or damaged" in instance.messages.pop()
    instance.slave.deSerializeFMUstate(blob)


CONTINUED = """
import sys
from pathlib import Path
from fmus import Instance
fmu, blob, folder = map(Path, sys.argv[1:])
instance = Instance(fmu, folder)
instance.slave.setFMUState(instance.slave.deSerializeFMUstate(blob.read_bytes()))
print(*[x.hex() for x in [instance.step(20 + i, 1e-6 * i) for i in range(20)][-1]])
"""


def test_two_instances(native: Path, tmp_path: Path) -> None:
    """Two instances of one process, by turns and with other walls, are what each is alone."""
    alone = Instance(native, tmp_path / "alone")
    expected = rows(alone, {"CA.E": 2e6}, 20, h=2 * MS)
    one, two = Instance(native, tmp_path / "one"), Instance(native, tmp_path / "two")
    one.initialize({"CA.E": 2e6})
    two.initialize({})
    names = [*one.outputs, *one.others]
    found = [one.get(names)]
    two.get(names)
    for i in range(20):
        for instance in (two, one):
            instance.set({"inlet.Q": half_sine((i + 1) * (2 * MS))})
            instance.slave.doStep(i * 2 * MS, 2 * MS)
        found.append(one.get(names))
        two.get(names)
    assert np.array_equal(np.array(found), expected)
