"""Directional derivatives of native hearts and bodies against complex steps and differences of the NumPy components."""

from __future__ import annotations

import copy
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmus import MS, Instance, Store
from native_fmus import needs_compiler
from test_native_heart import MODELS, R1, R2, STIFF, C

from fmu_src.contents.models import FMUContents
from solver.lumped import heart as heart_module
from solver.lumped.arithmetic import repeated, solution
from solver.lumped.component import Arithmetic
from solver.quantities.units import MMHG
from solver.tracing.arithmetic import recorded
from solver.tracing.program import Shared
from solver.tracing.recorder import Untraceable

pytestmark = needs_compiler
Array = np.ndarray
Steps = Iterator[tuple[Arithmetic, float, float]]  # a component before a step, the step's time and length

TINY = 1e-30  # of a complex step, which has no truncation error
EXACT = 1e-12  # of the largest derivatives (measured 6e-14)
DIFFERENCES = 2e-6  # of the same (measured 7e-7)
SMALL = 1e-3
BEAT = 900  # steps


class Complex(float):
    """A complex number that is compared by its real part, so that code takes the same decisions as for this one."""

    z: complex

    def __new__(cls, z: complex) -> Complex:
        made = super().__new__(cls, z.real)
        made.z = z
        return made

    def __abs__(self) -> Complex:
        return self if self >= 0.0 else -self

    def __neg__(self) -> Complex:
        return Complex(-self.z)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        found = getattr(ufunc, method)(*(np.complex128(plain(x)) for x in inputs), **options)
        return bool(found) if found.dtype == bool else Complex(complex(found))


def plain(x: Any) -> Any:
    return x.z if isinstance(x, Complex) else x


def _add(name: str) -> None:
    """An operation, with the complex number on either side."""
    apply = getattr(operator, name)
    setattr(Complex, f"__{name}__", lambda a, b: Complex(apply(plain(a), plain(b))))
    setattr(Complex, f"__r{name}__", lambda a, b: Complex(apply(plain(b), plain(a))))


for operation in ("add", "sub", "mul", "truediv", "pow"):
    _add(operation)


@dataclass
class Pair:
    """A component in NumPy and as an FMU, which make the same steps."""

    component: Arithmetic
    fmu: Instance
    table: Mapping[str, Any]
    values: dict[str, Any]

    @property
    def known(self) -> list[str]:
        """Inputs and tunable parameters."""
        return [name for name, v in self.table.items() if v.causality != "output" and v.variability != "fixed"]

    @property
    def outputs(self) -> list[str]:
        return [name for name, v in self.table.items() if v.causality == "output"]

    def step(self, t: float, h: float, values: Mapping[str, float]) -> Arithmetic:
        """Make one; the component before it."""
        before = copy.copy(self.component)
        self.values |= values
        self.component.retune(self.values)
        self.component.advance(t, h, self.values)
        self.fmu.set(values)
        self.fmu.slave.doStep(t, h)
        return before

    def size(self, name: str) -> float:
        """Of an input or parameter, or its nominal one."""
        return max(abs(self.values[name]), self.table[name].quantity.nominal)

    def after(self, before: Arithmetic, t: float, h: float, values: Mapping[str, float]) -> list[Any]:
        """The outputs of another step from there."""
        component = copy.copy(before)
        component.retune({**self.values, **values})
        component.advance(t, h, {**self.values, **values})
        return list(component.outputs())

    def found(self, name: str) -> list[float]:
        """By an input or parameter, as the FMU says."""
        unknowns = [self.fmu.references[output] for output in self.outputs]
        return self.fmu.slave.getDirectionalDerivative(unknowns, [self.fmu.references[name]], [1.0])

    def complex_step(self, before: Arithmetic, t: float, h: float, name: str) -> list[float]:
        outputs = self.after(before, t, h, {name: Complex(complex(self.values[name], TINY))})
        return [plain(x).imag / TINY for x in outputs]

    def differences(self, before: Arithmetic, t: float, h: float, name: str) -> Array:
        """Central, of fourth order, with steps of 1e-6 of the value or of its nominal one."""
        here, by = self.values[name], 1e-6 * self.size(name)
        at = {k: np.array(self.after(before, t, h, {name: here + k * by})) for k in (-2, -1, 1, 2)}
        return (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * by)


def pair(stored: Store, kind: str, folder: Path, start: Mapping[str, Any] | None = None) -> Pair:
    model: FMUContents = MODELS[kind]("human", None, 2)
    subject = model.subject
    assert subject is not None
    fmu = Instance(stored.lumped(MODELS[kind], fmi=2), folder / "fmu")
    values = {v.name: v.start for v in model.table if v.causality != "output"} | dict(start or {})
    fmu.initialize(start)
    component = subject.make()
    assert isinstance(component, Arithmetic)
    component.initialize(0.0, values)
    return Pair(component, fmu, {v.name: v for v in model.table}, values)


def beat(heart: Pair, lengths: Iterator[float], steps: int = BEAT) -> Steps:
    """A heart on a Windkessel."""
    t, P_C, Q = 0.0, 80 * MMHG, 0.0
    for _ in range(steps):
        h = next(lengths)
        half = 0.5 * h / C  # the Windkessel by the trapezoidal rule: P = P_0 + Z_0 Q(t) + Z Q(t + h)
        part = 1.0 / (1.0 + half / R2)
        inputs = {"aorta.P_0": part * (1.0 - half / R2) * P_C, "aorta.Z_0": part * half, "aorta.Z": R1 + part * half}
        before = heart.step(t, h, inputs)
        Q_end = heart.component.outputs()[heart.outputs.index("aorta.Q")]
        P_C = inputs["aorta.P_0"] + part * half * (Q + Q_end)
        yield before, t, h
        t, Q = t + h, Q_end


def lengths(random: bool = False) -> Iterator[float]:
    generator = np.random.default_rng(28)
    while True:
        yield float(generator.uniform(0.3, 2.5)) * MS if random else MS


def off(each: Pair, steps: Steps, asked: Callable[[int], bool], by: Callable[..., Any]) -> float:
    """How far the FMU is from what is expected after some of the steps, in parts of the largest derivative of each
    output by each input or parameter; where that is less than SMALL of the output's pulse by the parameter, of this."""
    found, expected, outputs = [], [], []
    for i, (before, t, h) in enumerate(steps):
        outputs.append(each.component.outputs())
        if asked(i):
            found.append([each.found(name) for name in each.known])
            expected.append([by(before, t, h, name) for name in each.known])
    assert found
    least = SMALL * np.ptp(outputs, axis=0) / np.array([[each.size(name)] for name in each.known])
    return float((np.abs(np.subtract(found, expected)) / np.maximum(np.abs(expected).max(0), least)).max())


def now_and_then(i: int) -> bool:
    return i % 23 == 0


@pytest.mark.parametrize("random", [False, True], ids=["even", "uneven"])
def test_heart_by_complex_steps(stored: Store, tmp_path: Path, random: bool) -> None:
    """A beat, every output by every input and tunable parameter: the FMU's implicit function theorem against NumPy's
    iterations with complex numbers. From the first step on, in all phases, at the ends of ranges."""
    heart = pair(stored, "heart", tmp_path)
    assert off(heart, beat(heart, lengths(random)), now_and_then, heart.complex_step) <= EXACT


# inside the ranges of all parameters
INSIDE = {"mitral_valve.regurgitation": 0.01, "aortic_valve.regurgitation": 0.02, "left_ventricle.begin": 0.03}


@pytest.mark.parametrize("start", [INSIDE, INSIDE | STIFF], ids=["valves", "stiff valves"])
def test_heart_by_differences(stored: Store, tmp_path: Path, start: Mapping[str, float]) -> None:
    """The same against differences of steps in NumPy, also of valves that open and close at once."""
    heart = pair(stored, "heart", tmp_path, start)
    assert off(heart, beat(heart, lengths()), now_and_then, heart.differences) <= DIFFERENCES


def test_where_flows_are_bisected(stored: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where Newton's method fails, too: the derivative of a bisection itself is none of its root's."""
    heart, newton, failed = pair(stored, "heart", tmp_path, INSIDE | STIFF), heart_module.newton, list[bool]()

    def counted(*given: Any) -> Any:
        found = newton(*given)
        failed.append(not found[0])
        return found

    monkeypatch.setattr(heart_module, "newton", counted)
    assert off(heart, beat(heart, lengths()), lambda _: failed[-1], heart.differences) <= DIFFERENCES


@pytest.mark.parametrize("exchange", ["end", "start"])
def test_body(stored: Store, tmp_path: Path, exchange: str) -> None:
    """Volumes that oscillate, in steps of different lengths, with both exchanges: by complex steps, and P by hand."""
    body = pair(stored, "body", tmp_path, {"body.exchange": exchange})

    def filled() -> Steps:
        t, each = 0.0, lengths(random=True)
        for _ in range(60):
            h = next(each)
            inputs = {"arteries.V": 1e-5 * np.sin(40.0 * t), "heart.V": 2e-5 * np.sin(30.0 * t)}
            yield body.step(t, h, inputs), t, h
            t += h

    assert off(body, filled(), lambda _: True, body.complex_step) <= EXACT
    if exchange == "end":
        assert body.found("arteries.V") == pytest.approx([1.0 / body.values["body.C"], 1.0], rel=1e-15)


def ejecting(file: Path, folder: Path) -> Instance:
    """A heart after 150 steps, in ejection."""
    heart = Instance(file, folder)
    heart.initialize()
    for i in range(150):
        again(heart, i)
    return heart


def again(heart: Instance, i: int) -> list[float]:
    heart.set({"aorta.P_0": 78 * MMHG, "aorta.Z": R1})
    heart.slave.doStep(i * MS, MS)
    return heart.get([*heart.outputs, *heart.others])


def derivatives(heart: Instance, seed: Mapping[str, float]) -> list[float]:
    unknowns = [heart.references[name] for name in (*heart.outputs, *heart.others)]
    return heart.slave.getDirectionalDerivative(unknowns, [heart.references[name] for name in seed], [*seed.values()])


BOTH = {"aorta.P_0": 2.0, "heart.rate": -0.5}


def test_states(stored: Store, tmp_path: Path) -> None:
    """The same bits after a restored state, in another instance from bytes, and if a value was set since the step;
    linear in the direction. Asking changes nothing: steps and states are the same bits."""
    file = stored.lumped(MODELS["heart"], fmi=2)
    heart, other, silent = (ejecting(file, tmp_path / name) for name in "abc")
    state = heart.slave.getFMUState()
    bytes_before = heart.slave.serializeFMUState(state)
    outputs = again(heart, 150)
    found = derivatives(heart, BOTH)
    heart.set({"heart.rate": 2.0, "aorta.P_0": 0.0})
    assert derivatives(heart, BOTH) == found
    parts = [derivatives(heart, {name: by}) for name, by in BOTH.items()]
    np.testing.assert_allclose(np.sum(parts, axis=0), found, rtol=1e-12, atol=0.0)
    heart.slave.setFMUState(state)
    other.slave.setFMUState(other.slave.deSerializeFMUstate(bytes_before))
    for each in (heart, other):
        assert again(each, 150) == outputs
        assert derivatives(each, BOTH) == found
    again(silent, 150)
    assert heart.slave.serializeFMUState(heart.slave.getFMUState()) == silent.slave.serializeFMUState(
        silent.slave.getFMUState()
    )


def test_nothing_received_yet(stored: Store, tmp_path: Path) -> None:
    """In a first step with zeros at the port the start values apply: inputs have no effect, parameters have theirs."""
    heart = Instance(stored.lumped(MODELS["heart"], fmi=2), tmp_path / "fmu")
    heart.initialize()
    heart.set({"aorta.P_0": 0.0})
    heart.slave.doStep(0.0, MS)
    assert not any(derivatives(heart, {"aorta.P_0": 1.0, "aorta.Z": 1.0, "venous.P": 1.0}))
    assert any(derivatives(heart, {"left_ventricle.P_0": 1.0}))
    heart.slave.doStep(MS, MS)
    assert any(derivatives(heart, {"aorta.P_0": 1.0}))


def test_fmi_3(stored: Store, tmp_path: Path) -> None:
    """The same bits."""
    files = [stored.lumped(MODELS["heart"], fmi=fmi) for fmi in (2, 3)]
    two = ejecting(files[0], tmp_path / "two")
    description = fmpy.read_model_description(str(files[1]))
    folder = fmpy.extract(str(files[1]), str(tmp_path / "three"))
    three = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
    three.enterInitializationMode()
    three.exitInitializationMode()
    for i in range(150):
        three.setFloat64([two.references["aorta.P_0"], two.references["aorta.Z"]], [78 * MMHG, R1])
        three.doStep(i * MS, MS)
    unknowns = [two.references[name] for name in (*two.outputs, *two.others)]
    knowns = [two.references[name] for name in BOTH]
    assert three.getDirectionalDerivative(unknowns, knowns, [*BOTH.values()]) == derivatives(two, BOTH)
    three.freeInstance()


def test_refused(stored: Store, tmp_path: Path) -> None:
    """Before a step, after a restored state; by fixed parameters, Enumerations, outputs; of inputs; infinite ones."""
    body = Instance(stored.lumped(MODELS["body"], fmi=2), tmp_path / "fmu")
    body.initialize()

    def refusal(unknown: str, known: str, seed: float = 1.0) -> str:
        with pytest.raises(FMICallException):
            body.slave.getDirectionalDerivative([body.references[unknown]], [body.references[known]], [seed])
        return body.messages.pop()

    assert "directional derivatives are those of the last step" in refusal("P", "arteries.V")
    body.slave.doStep(0.0, MS)
    for known in ("body.P_start", "body.exchange", "V"):
        assert "there are derivatives by inputs and tunable parameters" in refusal("P", known)
    assert "some are not finite; give a smaller seed" in refusal("P", "arteries.V", 1e305)
    assert "has no directional derivative" in refusal("heart.V", "arteries.V")
    body.slave.setFMUState(body.slave.getFMUState())
    assert "directional derivatives are those of the last step" in refusal("P", "arteries.V")


class At(NamedTuple):
    """Whether a search goes on, or a time; and y."""

    t: Any
    y: Any


class Root(Arithmetic):
    """y with y² = x by Newton's method, a toy."""

    kept = ("state",)
    implicit = True

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        self.state = At(t0, 1.0)

    def advance(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        def correction(y: Any) -> tuple[Any]:
            return (0.5 * (values["x"] / y - y),)

        def better(s: At) -> At:
            (dy,) = correction(s.y)
            return At(abs(dy) > 1e-9, s.y + dy)

        y = repeated(better, better(At(True, self.state.y))).y
        self.state = At(t + h, solution((y,), correction)[0] if self.implicit else y)

    def outputs(self) -> list[Any]:
        return [self.state.y]


def test_a_loop_that_searches_for_nothing() -> None:
    """Its result has no derivative, and so the component is refused, instead of a wrong one."""
    toy = Root()
    begun, _, derivative = recorded(toy, ["x"], {}, Shared())
    assert derivative.loops == (2,) and begun.loops == ()
    toy.implicit = False
    with pytest.raises(Untraceable, match="a loop has no derivative"):
        recorded(toy, ["x"], {}, Shared())
