"""One class and one entry: a toy effect of the wall, a toy outlet and a toy sensor reach every part of the product.

Each is one class below. It is put into a copy of the product, class and entry and nothing else, and a process there
walks through all that must follow by itself: file, batch, FMU, candidates, fit, rebuilt model, report, table.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import traceback
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
import pytest

from solver.laws.effect import Array, Effect, SearchSpec, Values
from solver.laws.outlets import Load, Outlet
from solver.laws.sensors import Sensor
from solver.laws.wall import Wall
from solver.quantities.quantity import Quantity, quantity

if TYPE_CHECKING:  # the toys run in the copy alone
    from solver.laws.outlets import Condition, Numbers

ROOT = Path(__file__).resolve().parents[1]


# --- the toys --------------------------------------------------------------------------------------------------------


class TissueSupport(Effect):
    """Tissue that resists the wall along a segment."""

    name = "tissue_support"
    equation = "P = … + (k_near (1 - x/L) + k_far x/L) (R - R0)"
    owner = "segment"
    places = ("segment",)
    terms = {
        "k_near": Quantity("Pa/m", "stiffness k_near of the tissue where the segment begins", 0.0, 1e10, nominal=5e6),
        "k_far": Quantity("Pa/m", "stiffness k_far of the tissue where the segment ends", 0.0, 1e10, nominal=5e6),
    }
    neutral = {"k_near": 0.0, "k_far": 0.0}
    search = SearchSpec(local=True)
    signature = "a wall that is stiffer toward one end"
    confusable = ("wall_stiffness",)
    separator = "radius at two places"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        k = values["k_near"] * (1.0 - x) + values["k_far"] * x
        K = wall.K + k * np.sqrt(wall.A0 / np.pi)
        return replace(wall, K=K, e=wall.e * wall.K / K)


@dataclass(frozen=True)
class Orifice(Outlet):
    """P - P_venous = R_v Q + b Q|Q|: friction, and a jet."""

    R_v: float = quantity(None, "Pa.s/m^3", "viscous resistance R_v", 1.0, 1e15, nominal=1e9)
    b: float = quantity(None, "Pa.s^2/m^6", "resistance b of the jet", 1.0, 1e25, nominal=1e14)

    symbol = "O"
    noun = "orifice"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        R, b = numbers["R_v"], numbers["b"]

        def flow(P: Array) -> Array:
            return 2.0 * P / (R + np.sqrt(R * R + 4.0 * b * np.abs(P)))

        def slope(P: Array) -> Array:
            return 1.0 / np.sqrt(R * R + 4.0 * b * np.abs(P))

        return Load(1.0, flow, slope)

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        load, P = cls.load(numbers, wall, 0.0), P_0 - numbers["P_venous"]
        slope = (load.slope(P)[:, None] + 0.0 * omega[:, None]) * Z_ref
        steady = np.where(omega == 0.0, 1.0, 0.0)[:, None]
        return np.ones_like(slope), slope, -load.flow(P)[:, None] * Z_ref * steady


class Coupling(Sensor):
    """An amplifier that lets the low harmonics pass only in part; the mean is added again."""

    name = "ac_coupling"
    equation = "Y/X = iω/(iω + cutoff), the mean as it is"
    terms = {"cutoff": Quantity("1/s", "cut-off rate of the amplifier", 0.0, 1e3, nominal=1.0)}
    neutral = {"cutoff": 0.0}
    search = SearchSpec(typical={"cutoff": 0.3})
    reach = {"cutoff": (0.0, 30.0)}
    signature = "one channel only: low harmonics are early"
    confusable = ("channel_lag",)
    separator = "calibration of the sensor"

    def transfer(self, values: Values, omega: Array) -> Array:
        rate = 1j * np.where(omega == 0.0, 1.0, omega)
        return np.where(omega == 0.0, 1.0, rate / (rate + values["cutoff"]))


def insert(path: Path, table: str, toy: type, imports: str = "") -> None:
    """Put a class before the table of a module, and its entry into that table."""
    text = path.read_text(encoding="utf-8")
    entry = toy.__name__ if issubclass(toy, Outlet) else f"{toy.__name__}()"
    head = re.search(rf"^{table}\b[^=\n]*= \(", text, flags=re.MULTILINE)
    assert head, f"{path}: no {table}"
    source = f"{imports}{inspect.getsource(toy)}\n\n"
    path.write_text(text[: head.start()] + source + head[0] + f"{entry}, " + text[head.end() :], encoding="utf-8")


# --- the walk: what runs in the copy ---------------------------------------------------------------------------------

SUPPORT = {"B.k_near": 2e6, "B.k_far": 3e7}
NAMES = ("A.P", "A.Q", "B.P", "B.Q", "B.R", "C.P", "C.Q", "C.R")
CUTOFF = 2.0  # 1/s


def base() -> Any:
    """The small network, C ending in the toy outlet."""
    from forked import NETWORK

    from solver.laws import outlets

    orifice = outlets.Orifice("C", R_v=5e8, b=2e14)  # type: ignore[attr-defined]
    return replace(NETWORK, name="toys", outlets=(NETWORK.outlets[0], orifice))


def equal(one: Any, two: Any, tolerance: float = 0.0) -> None:
    """Equal outputs, to a part of each one's largest magnitude."""
    for name in two:
        if name not in ("time", "inlet.Q"):
            error = np.abs(np.asarray(one[name]) - two[name]).max()
            assert error <= tolerance * np.abs(two[name]).max(), (name, error)


def walk_table(folder: Path) -> None:
    """Effect and sensor have rows in docs/effects.md."""
    from solver.laws import catalogue

    for name in ("tissue_support", "ac_coupling"):
        assert f"| `{name}` |" in catalogue.table(), name


def walk_file(folder: Path) -> None:
    """Network file: written, read back, equal; with units; by hand with another unit."""
    from solver.network.files import dumps, loads

    network = base().with_terms({**SUPPORT, "B.P.cutoff": CUTOFF})
    text = dumps(network)
    assert loads(text, "x") == network
    for key, unit in (("k_near", "Pa/m"), ("R_v", "Pa.s/m^3"), ("b", "Pa.s^2/m^6"), ("cutoff", "1/s")):
        (line,) = re.findall(rf"^{key} = (.*)$", text, flags=re.MULTILINE)
        assert float(re.findall(r"[\d.e+-]+", line)[0]) > 0.0, (line, unit)
    by_hand = re.sub(r"^k_far = .*$", 'k_far = "30 kPa/mm"', text, flags=re.MULTILINE)
    assert loads(by_hand, "x").parameters()["B.k_far"] == pytest.approx(3e7, rel=1e-12)


def walk_solver(folder: Path) -> None:
    """Off is bit-identical, a batch is its members, and the outlet's law holds between its pressure and flow."""
    from solver import Settings, simulate

    network, settings = base(), Settings(dt=2e-3, tolerance=1e-9)
    plain = simulate(network, duration=0.4, settings=settings)
    held = network.with_terms(dict.fromkeys(SUPPORT, 0.0))
    equal(simulate(held, duration=0.4, settings=settings), plain)
    batch = {name: np.array([0.0, value]) for name, value in SUPPORT.items()} | {"C.outlet.b": np.array([2e14, 8e14])}
    both = simulate(held, duration=0.4, parameters=batch, settings=settings)
    equal(both.member(0), plain, 1e-12)
    alone = held.with_parameters({name: float(values[1]) for name, values in batch.items()})
    equal(both.member(1), simulate(alone, duration=0.4, settings=settings), 1e-12)
    assert np.abs(both["B.P"][1] - plain["B.P"]).max() > 0.01 * np.ptp(plain["B.P"])
    P, Q = plain["C.outlet.P"], plain["C.outlet.Q"]
    assert np.ptp(P) > 100.0
    # P is the total pressure there; the flow of a step is that of its last stage
    assert np.abs(P - 5e8 * Q - 2e14 * Q * np.abs(Q)).max() < 1e-6 * np.ptp(P)


def walk_linear(folder: Path) -> None:
    """Small waves: the toy outlet in the frequency domain is that of the time domain, to a thousandth."""
    from solver import simulate_periodic
    from solver.linear import waveforms

    network = base()
    T = network.inlet.T
    beat = simulate_periodic(network, lambda t: 1e-9 * np.cos(2.0 * np.pi * np.asarray(t) / T), T)
    linear = waveforms(network, beat["inlet.Q"][:-1], T)
    for name in ("A.P", "B.P", "C.Q"):
        one, two = (np.fft.rfft(x[name][: len(beat.time) - 1])[1] for x in (beat, linear))
        assert abs(one - two) < 1e-3 * abs(two), (name, one, two)
    P, Q = (np.fft.rfft(linear[f"C.outlet.{kind}"])[1] for kind in "PQ")
    assert abs(P - 5e8 * Q) < 1e-9 * abs(P)


def walk_fmu(folder: Path) -> None:
    """Valid XML with the units broken down; parameters with start, range and unit; runs equal the solver's."""
    from fmpy.validation import validate_fmu

    from build_fmu import build
    from fmu_src.importer.run import run_fmu
    from solver import sampled_inflow, simulate

    network = base().with_terms({**SUPPORT, "B.P.cutoff": CUTOFF})
    fmu = build(network, folder)
    assert validate_fmu(os.fspath(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    variables = {node.attrib["name"]: node[0].attrib for node in root.iter("ScalarVariable")}
    for name, unit, start in (("B.k_far", "Pa/m", 3e7), ("C.outlet.b", "Pa.s^2/m^6", 2e14)):
        found = variables[name]
        assert (found["unit"], float(found["start"])) == (unit, start), name
        assert float(found["min"]) <= start <= float(found["max"])
    units = {node.attrib["name"]: dict(node[0].attrib) for node in root.iter("Unit") if len(node)}
    assert units["Pa/m"] == {"kg": "1", "m": "-2", "s": "-2"}
    assert units["Pa.s^2/m^6"] == {"kg": "1", "m": "-7"}
    t = np.arange(101) * 1e-3
    for starts in ({}, {"B.k_far": 0.0, "C.outlet.b": 8e14}):
        found = run_fmu(fmu, network.inlet.Q, 0.1, start_values=starts)
        expected = simulate(network, sampled_inflow(t, network.inlet.Q(t)), 0.1, parameters=starts)
        equal(found, expected, 1e-9)


def record_of(network: Any, names: tuple[str, ...], sensed: str = "") -> Any:
    """Sixteen beats at 125 Hz, 40 dB; one channel through the toy sensor."""
    from forked import T, inflow

    from fitting.records.read.record import Record
    from solver import Settings, simulate_periodic
    from solver.laws import effects

    beat, N = simulate_periodic(network, inflow, T, settings=Settings(dt=T / 200, tolerance=1e-7), tolerance=1e-6), 50
    rng, channels = np.random.default_rng(2), {}
    for name in names:
        X = np.fft.rfft(beat[name][:-1], norm="forward")[: N // 2 + 1]
        if name == sensed:
            omega = 2.0 * np.pi / T * np.arange(len(X))
            X = effects.BY_NAME["ac_coupling"].observe({"cutoff": CUTOFF}, X, omega)  # type: ignore[attr-defined]
        x = np.tile(np.fft.irfft(X, N, norm="forward"), 16)
        channels[name] = x + 0.01 * x.std() * rng.normal(size=x.size)
    return Record("toys.csv", "", np.arange(16 * N) * T / N, channels, {})


def walk_bench(folder: Path) -> None:
    """On the bench of B: effect and sensor are candidates there, and nowhere else."""
    from discrepancy.find.study import prepare

    study = prepare(record_of(base().with_terms(SUPPORT), ("B.P", "B.R")), base())
    labels = {term.label for term in study.terms}
    assert {"tissue_support at B", "ac_coupling at B.P", "ac_coupling at B.R"} <= labels, sorted(labels)
    assert not {label for label in labels if label.endswith((" at A", " at C"))}


def walk_network(folder: Path) -> None:
    """On the network: effect and sensor are candidates at every segment and channel."""
    from discrepancy.find.study import prepare

    study = prepare(record_of(base(), ("inlet.Q", *NAMES)), base())
    labels = {term.label for term in study.terms}
    assert {f"tissue_support at {name}" for name in "ABC"} <= labels, sorted(labels)
    assert {f"ac_coupling at {name}" for name in NAMES} <= labels, sorted(labels)


def walk_sensor_named(folder: Path) -> None:
    """A synthetic record with one coupled channel: named there among all sensors and the toy effect, its rate within
    5 %."""
    from judged import judge

    from solver.laws import effects

    among = [e.name for e in effects.ALL if e.owner == "channel" or e.name == "tissue_support"]
    _, naming = judge(record_of(base(), ("inlet.Q", *NAMES), "B.P"), base(), among=among)
    assert (naming.verdict, naming.best.label) == ("effect", "ac_coupling at B.P"), naming.best.label
    step = naming.best.fit.unknowns[-1].moves[0][1]
    assert abs(float(naming.best.fit.x[-1]) * step / CUTOFF - 1.0) < 0.05


def walk_study(folder: Path) -> None:
    """A record with support at B: named among all that are no sensors, refitted, written into model.toml and model.fmu,
    told in the report."""
    from judged import few

    from discrepancy import discover
    from fitting.records.read.record import write_record
    from solver import read_network
    from solver.laws import effects
    from solver.network.files import write_network

    record = record_of(base().with_terms(SUPPORT), ("inlet.Q", *NAMES))
    write_record(folder / "record.csv", record.time, record.channels, {})
    write_network(base(), folder / "model.toml")
    with pytest.MonkeyPatch.context() as patch:
        few(patch, *(e.name for e in effects.ALL if e.owner != "channel"))
        outcome = discover(folder / "record.csv", folder / "model.toml", folder / "out")
    assert (outcome.verdict, [e.name for e in outcome.effects]) == ("effect", ["tissue_support"]), outcome.sentence
    assert outcome.effects[0].where == ("B",)
    found = read_network(folder / "out" / "model.toml").parameters()
    middle, truth = (0.5 * (v["B.k_near"] + v["B.k_far"]) for v in (found, SUPPORT))
    assert abs(middle / truth - 1.0) < 0.17, (middle, truth)  # a standard deviation, by the covariance at the minimum
    told = json.loads((folder / "out" / "verdict.json").read_text(encoding="utf-8"))
    for name, p in told["effects"][0]["parameters"].items():
        assert p["ci95"][0] < SUPPORT[name] < p["ci95"][1], (name, p)
    assert {name: p["unit"] for name, p in told["effects"][0]["parameters"].items()} == dict.fromkeys(SUPPORT, "Pa/m")
    assert told["gap"]["after"]["held_out"] < 1.3 < told["gap"]["before"]["held_out"]
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "tissue support" in page and "B.k_far" in page
    with zipfile.ZipFile(folder / "out" / "model.fmu") as archive:
        assert 'name="B.k_far"' in archive.read("modelDescription.xml").decode("utf-8")


WALK: dict[str, Callable[[Path], None]] = {
    name.removeprefix("walk_"): step for name, step in list(globals().items()) if name.startswith("walk_")
}
LONG = ("sensor_named", "study")


def main(names: list[str]) -> None:
    """Take some steps in the copy, and print as JSON what went wrong in each."""
    said = {}
    for name in names:
        folder = Path("made", name)
        folder.mkdir(parents=True)
        try:
            WALK[name](folder.resolve())
            said[name] = ""
        except Exception:
            said[name] = traceback.format_exc()
    print(json.dumps(said))


# --- the tests -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The product with the toys in it: three classes and three entries more than the original, nothing else."""
    folder = tmp_path_factory.mktemp("toys")
    for name in ("solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu"):
        shutil.copytree(ROOT / name, folder / name)  # what is compiled, too
    here = Path(__file__)
    for path in (ROOT / "build_fmu.py", here, here.with_name("forked.py"), here.with_name("judged.py")):
        shutil.copy(path, folder)
    insert(folder / "solver" / "laws" / "effects.py", "ALL", TissueSupport)
    insert(
        folder / "solver" / "laws" / "effects.py", "ALL", Coupling, "from .sensors import Sensor  # noqa: E402\n\n\n"
    )
    insert(folder / "solver" / "laws" / "outlets.py", "OUTLETS", Orifice)
    return folder


def walked(copy: Path, names: list[str]) -> dict[str, str]:
    environment = {**os.environ, "PYTHONPATH": os.fspath(copy)}
    line = [sys.executable, "-c", f"import test_toy; test_toy.main({names!r})"]
    done = subprocess.run(line, cwd=copy, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def short(copy: Path) -> dict[str, str]:
    """The short steps, in one process."""
    return walked(copy, [name for name in WALK if name not in LONG])


@pytest.fixture(scope="module")
def long(copy: Path) -> dict[str, str]:
    """The long ones."""
    return walked(copy, list(LONG))


@pytest.mark.parametrize("name", [name for name in WALK if name not in LONG])
def test_walk(short: dict[str, str], name: str) -> None:
    """A step of the walk, in the copy, without a complaint."""
    assert not short[name], short[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_study(long: dict[str, str], name: str) -> None:
    """The same of the steps that name what is hidden in a record."""
    assert not long[name], long[name]
