"""Directional derivatives of native FMUs against differences of repeated steps, and what is refused."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmus import MS, Instance, Store, mixed
from native_fmus import elastic, half_sine, needs_compiler
from test_several_inlets import fork
from test_table_source import table

from build_fmu import build_native
from solver import Network, Settings, load

pytestmark = needs_compiler
TIGHT = Settings(tolerance=1e-12)
EQUAL = 1e-6  # of the largest derivative of its kind of output, P, Q or R (measured 3e-7 at most)
BEFORE = 25  # steps
PORTS = ("Z", "Z_0", "P_0", "Y", "Y_0", "Q_0")


class Differences:
    """An FMU at a state, from which steps are made with some values changed."""

    def __init__(self, file: Path, folder: Path, start: Mapping[str, float | str], h: float) -> None:
        self.instance, self.h = Instance(file, folder), h
        self.names = [n for n in (*self.instance.outputs, *self.instance.others) if n.rpartition(".")[2] not in PORTS]
        self.instance.initialize(start)
        for i in range(BEFORE):
            self.instance.step(i, half_sine((i + 1) * h), h)
        self.state = self.instance.slave.getFMUState()

    def step(self, values: Mapping[str, float]) -> np.ndarray:
        """The outputs after the next step from there."""
        self.instance.slave.setFMUState(self.state)
        self.instance.set({"inlet.Q": half_sine((BEFORE + 1) * self.h), **values})
        self.instance.slave.doStep(BEFORE * self.h, self.h)
        return np.array(self.instance.get(self.names))

    def by(self, direction: Mapping[str, float]) -> np.ndarray:
        """What the FMU says, after a step."""
        unknowns = [self.instance.references[name] for name in self.names]
        knowns = [self.instance.references[name] for name in direction]
        return np.array(self.instance.slave.getDirectionalDerivative(unknowns, knowns, [*direction.values()]))

    def expected(self, direction: Mapping[str, float]) -> np.ndarray:
        """Central differences of fourth order."""
        here = dict(zip(direction, self.instance.get([*direction]), strict=True))

        def at(k: int) -> np.ndarray:
            return self.step({name: here[name] + k * by for name, by in direction.items()})

        return (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12.0

    def off(self, direction: Mapping[str, float]) -> float:
        """How far it is from them, in parts of the largest of each kind of output."""
        self.step({})
        found, expected = self.by(direction), self.expected(direction)
        kinds = np.array([name[-2:] if name in self.instance.outputs else name for name in self.names])
        size = {kind: np.abs(expected[kinds == kind]).max() for kind in (".P", ".Q", ".R")}
        return max(np.abs(found - expected)[kinds == kind].max() / size[kind] for kind in size)


SHEEP = ({"inlet.Q": 1e-6}, {"CA.E": 1e4}, {"CA.phi0": 500.0}, {"CA.outlet.R_t": 0.01}, {"VA1.outlet.P_venous": 50.0},
         {"AA.ENL": 1e5, "CA.phiNL": 1e4}, {"inlet.Q": 1e-6, "CA.E": -1e4})  # fmt: skip


@pytest.mark.parametrize("way", ["hold", "linear", "smooth"])
def test_inputs_and_parameters(stored: Store, tmp_path: Path, way: str) -> None:
    """Viscoelastic sheep: by the inflow, walls, an outlet and P_venous, two at once; nonlinear walls about none."""
    file = stored(build_native, load("sheep"), settings=TIGHT)
    made = Differences(file, tmp_path / "fmu", {"inlet.interpolation": way}, MS)
    for direction in SHEEP:
        assert made.off(direction) <= EQUAL, direction


def test_at_the_default_tolerance(stored: Store, tmp_path: Path) -> None:
    """The steps that are subtracted are themselves solved to 3e-5 only: 1e-4 (measured 3e-5 at most)."""
    made = Differences(
        stored(build_native, load("sheep"), fmi=2), tmp_path / "fmu", {"inlet.interpolation": "smooth"}, MS
    )
    offs = [made.off(direction) for direction in SHEEP]
    assert EQUAL < max(offs) <= 1e-4


def test_volumes(stored: Store, tmp_path: Path) -> None:
    """Those of the arteries, of what has left, and the flow that leaves, by the inflow: 1e-6 of the first two, and of
    the inflow."""
    file = stored(build_native, load("sheep"), settings=TIGHT)
    made = Differences(file, tmp_path / "fmu", {"inlet.interpolation": "hold"}, MS)
    made.step({})
    found, expected = made.by({"inlet.Q": 1e-6}), made.expected({"inlet.Q": 1e-6})
    at = {name: i for i, name in enumerate(made.names)}
    size = {"network.V": 1e-9, "venous.V": 1e-9, "venous.Q": 1e-6}
    assert found[at["network.V"]] == pytest.approx(1e-9, rel=1e-3)
    for name, whole in size.items():
        assert abs(found[at[name]] - expected[at[name]]) <= 1e-6 * whole, name


ELSE: Mapping[str, tuple[Callable[[], Network], float, tuple[Mapping[str, float], ...]]] = {
    "outlets": (mixed, 5e-3, ({"CA.outlet.C": 4e-12}, {"CA.outlet.R1": 1e7, "CA.outlet.R2": 3e7}, {"VA1.outlet.R": 3e7},
                              {"VA2.outlet.P_venous": 50.0}, {"VA3.outlet.P_venous": 300.0})),
    "nonlinear": (lambda: load("sheep_nonlinear"), MS, ({"inlet.Q": 1e-7}, {"CA.phiNL": 1e3})),
    "elastic": (lambda: elastic(load("sheep")), MS, ({"inlet.Q": 1e-8}, {"CA.E": 1e4})),
    "relaxation": (lambda: load("sheep").with_terms({"CA.tau": 0.01}), MS, ({"CA.tau": 1e-4, "CA.phi0": 100.0},)),
    "springpot": (lambda: load("sheep").with_terms({"CA.springpot": 0.3}), MS, ({"CA.phi0": 100.0},)),
    "unsteady": (lambda: load("sheep").with_terms({"fluid.unsteady_scale": 1.0}), MS,
                 ({"fluid.unsteady_scale": 0.01},)),
    "leak": (lambda: load("sheep").with_terms({"CA.leak": 1e-9}), MS, ({"inlet.Q": 1e-6}, {"CA.leak": 1e-11})),
    "sources": (lambda: replace(load("sheep"), sources=(table("outlet", "CA", 0.5), table("wall", "CA", 0.5))), MS,
                ({"inlet.Q": 1e-6}, {"CA.E": 1e4})),
    "pressure": (lambda: fork(B="pressure"), MS, ({"inlet.Q": 1e-7}, {"B.inlet.P": 1.0}, {"A.E": 1e3})),
    "off the grid": (lambda: load("sheep"), 2.7e-3, ({"inlet.Q": 1e-6}, {"CA.E": 1e4})),
}  # fmt: skip


LONG = ("unsteady", "elastic", "relaxation", "springpot", "leak", "off the grid")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in ELSE])
def test_networks(stored: Store, tmp_path: Path, name: str) -> None:
    """Every outlet, effects with memory and without, damping, tables of sources, an inlet whose pressure is given."""
    make, h, directions = ELSE[name]
    file = stored(build_native, make(), settings=TIGHT)
    made = Differences(file, tmp_path / "fmu", {"inlet.interpolation": "smooth"}, h)
    for direction in directions:
        assert made.off(direction) <= EQUAL, direction


def test_a_halved_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each part of a step that does not converge has its derivative."""
    monkeypatch.setattr(f"{__name__}.half_sine", lambda t: 3e-3 * (t > 0.05))
    file = build_native(elastic(load("human")), tmp_path, replace(TIGHT, dt=5e-3))
    made = Differences(file, tmp_path / "fmu", {"inlet.interpolation": "smooth"}, 5e-3)
    made.instance.messages.clear()
    made.step({})
    assert "was cut into halves" in made.instance.messages[0]
    assert made.off({"inlet.Q": 1e-7}) <= EQUAL


def test_the_networks_own_inflow(stored: Store, tmp_path: Path) -> None:
    """What is set at the inlet then has no effect, and parameters have theirs."""
    file = stored(build_native, load("sheep"), settings=TIGHT)
    made = Differences(file, tmp_path / "fmu", {"inlet.drive": "network"}, MS)
    assert made.off({"CA.E": 1e4}) <= EQUAL
    made.step({})
    assert not made.by({"inlet.Q": 1.0}).any()


def test_fmi_3_and_what_it_leaves(stored: Store, tmp_path: Path) -> None:
    """Both versions declare and give the same bits; asking changes nothing: the next steps are the same."""
    files = [stored(build_native, load("sheep"), fmi=fmi) for fmi in (2, 3)]
    two = Instance(files[0], tmp_path / "two")
    two.initialize({"inlet.interpolation": "smooth"})
    description = fmpy.read_model_description(os.fspath(files[1]))
    for file, name in zip(files, ("providesDirectionalDerivative", "providesDirectionalDerivatives"), strict=True):
        assert f'{name}="true"' in zipfile.ZipFile(file).read("modelDescription.xml").decode()
    folder = fmpy.extract(os.fspath(files[1]), os.fspath(tmp_path / "three"))
    three = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
    references = {v.name: v.valueReference for v in description.modelVariables}
    three.setInt64([references["inlet.interpolation"]], [3])
    three.enterInitializationMode()
    three.exitInitializationMode()
    unknowns, knowns = [references[name] for name in two.outputs], [references[n] for n in ("inlet.Q", "CA.E")]
    found = []
    for i in range(10):
        outputs = two.step(i, half_sine((i + 1) * MS))
        three.setFloat64([references["inlet.Q"]], [half_sine((i + 1) * MS)])
        three.doStep(i * MS, MS)
        assert three.getFloat64(unknowns) == outputs
        found.append(two.slave.getDirectionalDerivative(unknowns, knowns, [1.0, 1e9]))
        assert i % 2 or three.getDirectionalDerivative(unknowns, knowns, [1.0, 1e9]) == found[-1]
    assert np.ptp(found, axis=0).all()
    three.freeInstance()


def test_refused(stored: Store, tmp_path: Path) -> None:
    """Before a step and after a restored state; of ports, by fixed parameters and outputs."""
    instance = Instance(stored(build_native, load("sheep"), fmi=2), tmp_path / "fmu")
    instance.initialize()
    references = instance.references

    def refusal(unknown: str, known: str) -> str:
        with pytest.raises(FMICallException):
            instance.slave.getDirectionalDerivative([references[unknown]], [references[known]], [1.0])
        return instance.messages.pop()

    last = "sheep: directional derivatives are those of the last step: make one, after a state was restored, too."
    assert refusal("CA.P", "inlet.Q") == last
    instance.step(0, 1e-6)
    assert "has no directional derivative; outputs have but those of ports" in refusal("inlet.Z", "inlet.Q")
    for known in ("CA.L", "CA.P", "solver.dt"):
        assert "there are derivatives by inputs and tunable parameters" in refusal("CA.P", known)
    instance.slave.setFMUState(instance.slave.getFMUState())
    assert refusal("CA.P", "inlet.Q") == last
