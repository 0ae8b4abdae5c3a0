"""The compiled engine: steps of the staggered scheme in C, recorded by :mod:`~solver.tracing` from the Python code.

The engine is one library for all networks, built from ``native/``. The Python code repeats a step that the engine does
not solve, and halves it or reports the failure. Without the library everything runs on NumPy.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import platform
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..errors import InputError
from ..scheme.model import Model
from ..scheme.sdirk import GAMMA, INFLOW_TIMES, SDIRK3, STAGES
from ..scheme.step import State, at_stages_of, step
from .program import OPERATIONS
from .recorder import Untraceable
from .steps import PLACES, Recorded, recorded

Array = np.ndarray

BACKENDS = ("numpy", "auto", "native")
# processor and system in the spelling of FMI 3.0
PLATFORM = "-".join([
    {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower()),
    {"win32": "windows"}.get(sys.platform, sys.platform),
])  # fmt: skip
_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
ENGINES = Path(__file__).parents[1] / "engine"
LIBRARY = ENGINES / f"arterial_engine-{PLATFORM}{_SUFFIX}"
# the C files: a wheel contains them beside its libraries, one for every platform; a checkout builds from native/
_BROUGHT = ENGINES / "sources"
SOURCES = _BROUGHT if _BROUGHT.is_dir() else Path(__file__).parents[2] / "native"
_WHEELS = "published wheels have it for Linux and macOS on x86-64 and arm64, and for Windows on x86-64"
_BUILD = _WHEELS if _BROUGHT.is_dir() else "in a checkout, python native/build.py makes it"
_EQUAL = 1e-10  # largest difference between a step of the engine and NumPy, relative to the largest number of each kind


class NoEngine(Exception):
    """The reason why the engine cannot run something."""


class Program(ctypes.Structure):
    """As arterial_program in native/engine.h."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("code", "begin", "index", "constants")),
        *((name, ctypes.c_int32) for name in ("n_fixed", "n_work", "n_y", "n_A", "n_Q", "at_Q", "n_H", "n_inlets",
                                              "n_outlets", "n_report", "n_sources")),
        ("place", ctypes.c_int32 * len(PLACES)),
        ("wide", ctypes.c_int32),
    ]  # fmt: skip


def sources() -> str:
    """A digest of the engine's sources, "" if they are missing; a library of other sources is not used."""
    files = sorted(SOURCES.glob("*.[ch]"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16] if files else ""


@cache
def library() -> ctypes.CDLL:
    """The library of the engine. Raises NoEngine if none matches this code."""
    if not LIBRARY.is_file():
        raise NoEngine(f"the compiled engine is not built; {_BUILD}")
    try:
        found = ctypes.CDLL(str(LIBRARY))
        operations = "".join(f"{name} " for name in OPERATIONS).encode()
        if not found.arterial_fits(operations, len(PLACES), ctypes.sizeof(Program), sources().encode()):
            raise NoEngine(f"the compiled engine is of other sources; {_BUILD}")
    except (OSError, AttributeError) as error:
        raise NoEngine(f"the compiled engine does not load: {error}") from None
    pointer, number = ctypes.c_void_p, ctypes.c_int32
    found.arterial_bind.argtypes = [pointer, pointer, pointer]
    found.arterial_steps.argtypes = [
        pointer, number, number, ctypes.c_double, *[pointer] * 5, ctypes.c_int, *[pointer] * 3
    ]  # fmt: skip
    found.arterial_steps.restype = found.arterial_wide.restype = number
    return found


def check_backend(asked: str) -> None:
    """Raise ValueError for an unknown backend."""
    if asked not in BACKENDS:
        raise InputError(f"backend = {asked!r}: must be {', '.join(map(repr, BACKENDS))}.")


def refuse_without(reason: NoEngine) -> NoReturn:
    """Raise InputError with the reason why the requested engine is not available."""
    raise InputError(f"backend = 'native': {reason}. Or use 'auto', or 'numpy'.") from None


def available() -> str:
    """The backends, for --version."""
    try:
        library()
    except NoEngine as reason:
        return f"NumPy; {reason}"
    return f"NumPy and the compiled engine ({LIBRARY.name})"


class Bound:
    """A program with the numbers of a model, in the form of the engine. c : the structure. work : workspace. fixed :
    (B, n_fixed) numbers of every member and their consequences. Raises NoEngine for singular equations at rest."""

    def __init__(self, model: Model, recorded: Recorded, arrays: list[Array]) -> None:
        p, layout, n_H = recorded.program, model.layout, model.mesh.n_nodes
        n_A, n_Q = (math.prod(layout.shapes[name]) for name in ("A", "Q"))
        pointers = (x.ctypes.data for x in (p.code, p.begin, p.index, p.constants))
        counts = (
            p.n_fixed, p.n_work, layout.size, n_A, n_Q, layout.places["Q"].start, n_H, len(model.inlets.by_flow),
            len(model.mesh.topology.outlet_segment), len(model.network.output_units()), len(model.tables.tables),
        )  # fmt: skip
        self.program = p  # keeps the memory of the pointers alive
        self.c = Program(
            *pointers, *counts, tuple(p.address.get(name, 0) for name in PLACES), library().arterial_wide()
        )
        self.work = np.zeros(p.n_work + STAGES * layout.size + 2 * n_Q + n_H)
        self.fixed = np.zeros((model.coefficients.B, p.n_fixed))
        for rows, place in zip(arrays, recorded.places, strict=True):
            if place >= 0:
                self.fixed[:, place // 4 : place // 4 + rows.shape[1]] = rows
        for row in self.fixed:
            if not library().arterial_bind(ctypes.byref(self.c), row.ctypes.data, self.work.ctypes.data):
                raise NoEngine("the equations at rest are singular")


class Engine:
    """The steps of a model, of length dt [s]. Raises NoEngine if the engine cannot make them."""

    def __init__(self, model: Any, dt: float) -> None:
        if not isinstance(model, Model):
            raise NoEngine("the engine has the staggered scheme alone")
        self.model, self.dt, self.library = model, dt, library()
        try:
            self.recorded, arrays = recorded(model, GAMMA * dt)
        except Untraceable as reason:
            raise NoEngine(f"this network is not recorded: {reason}") from None
        self.n_inlets, self.n_outlets = len(model.inlets.by_flow), len(model.mesh.topology.outlet_segment)
        bound = Bound(model, self.recorded, arrays)
        self._c, self._work, self._fixed = bound.c, bound.work, bound.fixed
        given = np.zeros((model.coefficients.B, self.n_outlets))
        for ends in model.coefficients.outlets:
            given[:, ends.index] = ends.given["P_venous"]
        self._venous = given

    def steps(self, state: State, drive: Array, table: Array) -> tuple[int, State]:
        """Step from a state with drive : (n, n_inlets, 4) or (n, n_inlets, 4, B). Returns the number of steps made and
        the state after them; table : (n, B, n_outputs) receives the outputs.

        In the first call of a program, the last step is compared with NumPy's. Raises NoEngine if they differ.
        """
        if self.recorded.checked:
            return self._steps(state, drive, table)
        done, before = self._steps(state, drive[:-1], table[:-1]) if len(drive) > 1 else (0, state)
        if done < len(drive) - 1:
            return done, before
        more, after = self._steps(before, drive[-1:], table[-1:])
        if more:
            _compare(self.model, after, step(self.model, before, self.dt, drive[-1]))
            self.recorded.checked = True
        return done + more, after

    def _steps(self, state: State, drive: Array, table: Array) -> tuple[int, State]:
        B, n, pair = len(state.y), len(drive), at_stages_of(state, self.dt)
        parts = [state.y, state.A_t.reshape(B, -1), state.H, *(x.swapaxes(0, 1).reshape(B, -1) for x in pair)]
        now = np.concatenate(parts, axis=1)
        spare, drive = np.empty_like(now), np.ascontiguousarray(drive.reshape(n, self.n_inlets, len(INFLOW_TIMES), -1))
        acting = self._acting(state.t, n)
        done = self.library.arterial_steps(
            ctypes.byref(self._c), n, B, self.dt, self._fixed.ctypes.data, now.ctypes.data, spare.ctypes.data,
            self._work.ctypes.data, drive.ctypes.data, drive.shape[-1] > 1, self._venous.ctypes.data,
            acting.ctypes.data, table.ctypes.data,
        )  # fmt: skip
        if not done:
            return 0, state
        y, A_t, H, *unknowns = np.split(now, np.cumsum([part.shape[1] for part in parts])[:-1], axis=1)
        last, before = (np.ascontiguousarray(x.reshape(B, STAGES, -1).swapaxes(0, 1)) for x in unknowns)
        after = replace(state, t=state.t + done * self.dt, y=y, A_t=A_t.reshape(state.A_t.shape), H=H, dt=self.dt)
        return done, replace(after, unknowns=last, unknowns_before=before)

    def _acting(self, t: float, n: int) -> Array:
        """Amplitudes of tables at the start and at the stages of n steps from time t [s] : (n, 4, n_sources)."""
        moments = np.concatenate([[0.0], SDIRK3.sum(axis=1)])
        times = t + self.dt * np.add.outer(np.arange(n), moments)
        each = [np.zeros(0) if g is None else g for g in self.model.tables.at(times.ravel())]
        return np.array(each, float).reshape(n, len(moments), -1) if n else np.zeros((0, 4, 0))


def _compare(model: Model, found: State, expected: State) -> None:
    """Raise NoEngine if two states differ by more than round-off, which is a large part of a minute wave."""
    floor = {"A": np.finfo(float).tiny, "Q": model.flow_floor.max(), "H": model.pressure_floor.max()}
    for name in ("A", "Q", "H"):
        one, other = getattr(found, name), getattr(expected, name)
        off = np.abs(one - other).max() / max(np.abs(other).max(), floor[name] / _EQUAL)
        if not off <= _EQUAL:
            raise NoEngine(f"a step of it is not that of NumPy: {name} is {off:.1e} off")


class Backend:
    """The backend of a run: the engine, or None, which leaves the steps to NumPy. name : the backend, with the reason
    if it is not the requested one. Raises ValueError for an unknown one, and for "native" if the engine cannot run the
    model."""

    def __init__(self, asked: str, model: Any, dt: float) -> None:
        check_backend(asked)
        self.asked, self.reason = asked, ""
        self.engine: Engine | None = None
        try:
            if asked != "numpy":
                self.engine = Engine(model, dt)
        except NoEngine as reason:
            self._without(reason)

    @property
    def name(self) -> str:
        return "native" if self.engine else f"numpy: {self.reason}" if self.reason else "numpy"

    def again(self, model: Any) -> Backend:
        """The same for another model with steps of equal length."""
        return Backend(self.asked, model, self.engine.dt) if self.engine else self

    def steps(self, state: Any, drive: Array, table: Array) -> tuple[int, Any]:
        """As :meth:`Engine.steps`; no steps without an engine."""
        if self.engine is None:
            return 0, state
        try:
            return self.engine.steps(state, drive, table)
        except NoEngine as reason:
            self._without(reason)
            return 0, state

    def _without(self, reason: NoEngine) -> None:
        self.engine, self.reason = None, str(reason)
        if self.asked == "native":
            refuse_without(reason)
