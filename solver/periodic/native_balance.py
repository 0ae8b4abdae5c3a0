"""Harmonic balance by the compiled engine: :mod:`~solver.periodic.harmonic_balance` in C, member by member.

If the engine does not solve a member, NumPy solves the whole batch, so that failures have the same sentences.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..mesh.sources import NO_FORCING, Forcing
from ..scheme.model import Model
from ..scheme.sdirk import GAMMA
from ..scheme.stage import loads_of
from ..scheme.step import State, initial_state
from ..tracing.native import Bound, NoEngine, Program, check_backend, library, refuse_without
from ..tracing.recorder import Untraceable
from .balance_program import PLACES, Sizes, recorded
from .harmonic_balance import LONG, started
from .waves import Near, Waves, taus_of

Array = np.ndarray


class Unsolved(NoEngine):
    """A member that the engine does not solve."""


class _Balance(ctypes.Structure):
    """As arterial_balance in native/balance.h."""

    _fields_ = [
        ("p", Program),
        *((name, ctypes.c_int32) for name in ("n_held", "n_now", "n_left", "n_unfilled", "n_unremembered", "n_memories",
                                              "n_past", "n_observed", "n_stored", "at_stored", "at_memories")),
        ("more", ctypes.c_int32 * len(PLACES)),
    ]  # fmt: skip


class _Period(ctypes.Structure):
    """As arterial_period there."""

    _fields_ = [("omega", ctypes.c_void_p), ("turn", ctypes.c_void_p), ("stage", ctypes.c_double),
                ("harmonics", ctypes.c_int32)]  # fmt: skip


class Beat(NamedTuple):
    """The beat of one member. Its steady state is y : (n,), H : (n_nodes,); the waves (K+1, 2, n + n_nodes) about it
    have real and imaginary parts; last : size of the last correction; left : (K+1, 2, n_left) the residuals, if kept.
    """

    y: Array
    H: Array
    waves: Array
    last: float
    left: Array | None


def engine_for(model: Model, backend: str) -> BalanceEngine | None:
    """The engine for the balances of a model; None for NumPy. Raises ValueError for an unknown backend, and for
    "native" if the engine cannot run the model."""
    check_backend(backend)
    if backend == "numpy":
        return None
    try:
        return BalanceEngine(model)
    except NoEngine as reason:
        if backend == "native":
            refuse_without(reason)
        return None


def waves_by(backend: str, model: Model, *balance: Any) -> tuple[State, Waves] | None:
    """As :meth:`BalanceEngine.waves`; None if NumPy must compute them."""
    engine = engine_for(model, backend)
    try:
        return None if engine is None else engine.waves(*balance)
    except Unsolved:
        return None


class BalanceEngine:
    """The balances of a model. Raises NoEngine if the engine cannot compute them."""

    def __init__(self, model: Model) -> None:
        self.model, self._library = model, _library()
        try:
            # tables are part of the forcing
            self.recorded, arrays = recorded(replace(model, tables=model.tables.none()))
        except Untraceable as reason:
            raise NoEngine(f"this network is not recorded: {reason}") from None
        bound, places, size = Bound(model, self.recorded, arrays), model.layout.places, Sizes.of(model)
        address, n_held = bound.program.address, bound.program.n_held
        counts = (n_held, *size, places["P_C"].start, places["stress"].start)
        self._bound, self._size, self._n_held = bound, size, n_held
        self._c = ctypes.byref(_Balance(bound.c, *counts, tuple(address.get(name, 0) for name in PLACES)))

    @cached_property
    def _rest(self) -> State:
        return initial_state(self.model)

    def _run(self, name: str, *arguments: Any) -> Any:
        given = (x.ctypes.data if isinstance(x, np.ndarray) else x for x in arguments)
        return getattr(self._library, name)(self._c, *given)

    # --- one member -----------------------------------------------------------------------------------------------

    def steady(self, b: int, mean: Array) -> tuple[Array, Array]:
        """y and H of the steady state of member b. mean : (n_inlets,) of the drive. Raises Unsolved."""
        y, H = self._rest.y[b].copy(), self._rest.H[b].copy()
        given, guess = self.model.inlets.gain[b] * mean, np.empty(self._size.left)
        if not self._run(
            "arterial_steady", self._bound.fixed[b], self._bound.work, given, _LONG, len(LONG), y, H, guess
        ):
            raise Unsolved("a member has no steady state")
        return y, H

    def held(self, b: int, taus: Array, y: Array, H: Array, into: Array | None = None) -> Array:
        """(K+1, n_held): the Jacobians of small waves about a steady state, in the memory ``into`` if it is given.
        Raises Unsolved."""
        held = np.empty((len(taus), self._n_held)) if into is None else into
        if not self._run("arterial_linearise", self._bound.fixed[b], self._bound.work, y, H, taus, len(taus), held):
            raise Unsolved("nothing determines waves of some frequency")
        return held

    def to_sources(self, taus: Array, mean: Array, momentum: Array, nodes: Array) -> tuple[State, Array, Array]:
        """The steady state of the only member, and y and H of waves about it as
        :meth:`~solver.periodic.harmonic_balance.Response.to_sources`, for stages of lengths taus : (K+1,). Raises
        Unsolved."""
        y, H = self.steady(0, mean)
        held, S = self.held(0, taus, y, H), len(nodes)
        sources = np.concatenate([momentum.reshape(S, -1), nodes], axis=1)
        found = np.empty((len(taus), S, 2, len(y) + len(H)))
        self._run("arterial_answer", self._bound.fixed[0], self._bound.work, held, sources, len(taus), S, found)
        waves = found[:, :, 0] + 1j * found[:, :, 1]
        return self.resting([y], [H]), waves[..., : len(y)], waves[..., len(y) :]

    # --- all ------------------------------------------------------------------------------------------------------

    def beats(
        self, drive: Array, T: float, tolerance: float, most: int, tell: Callable[[], None] | None = None,
        forcing: Forcing = NO_FORCING, observe: bool = True, near: Near | None = None, of_first: float = 0.0,
        keep: bool = False,
    ) -> Iterator[tuple[Beat, Array | None]]:  # fmt: skip
        """For every member the waves, as :func:`~solver.periodic.harmonic_balance.balanced` about the steady state of
        the mean drive, and amplitudes (K+1, n_outputs) of the outputs; these are None if a moment is not physical, or
        without ``observe``. near, of_first, keep : as there.

        drive : (K+1, B or 1, n_inlets). Raises Unsolved.
        """
        B, K = self.model.coefficients.B, len(drive) - 1
        omega, turns, last = 2.0 * np.pi / T * np.arange(K + 1), _turns(K), ctypes.c_double()
        period = ctypes.byref(_Period(omega.ctypes.data, turns.ctypes.data, GAMMA * self.model.settings.dt, K))
        scratch, taus = np.empty(self._run("arterial_scratch", period)), np.array(taus_of(omega), complex)
        means, drives = np.broadcast_to(drive[0].real, (B, drive.shape[2])), _planes(drive + forcing.inlets, B)
        forced, let_out = self._forced(forcing, near, K + 1)
        told = 0
        rest = [self.steady(b, means[b]) for b in range(B)]
        still = self.resting([y for y, _ in rest], [H for _, H in rest])
        begun = started(self.model, still, omega, near)
        begins = _planes(np.concatenate([begun.y, begun.H], axis=2), B)
        held = np.empty((K + 1, self._n_held))  # once for all: new memory of this size costs page faults
        for b, (y, H) in enumerate(rest):
            self.held(b, taus, y, H, held)
            own, X = (self._bound.fixed[b], self._bound.work), begins[b]
            left = np.full((K + 1, 2, self._size.left), np.nan) if keep else None
            made = self._run("arterial_balanced", period, *own, held, drives[b], forced and forced[b],
                             let_out and let_out[b], tolerance, of_first, most, X, scratch, ctypes.byref(last),
                             left)  # fmt: skip
            while tell and told * B < made * (b + 1):  # as many calls as corrections of a whole batch, evenly spread
                told += 1
                tell()
            found = np.empty((K + 1, 2, self._size.observed - 1)) if observe else None
            if observe and not self._run("arterial_observed", period, *own, X, scratch, found):
                found = None
            yield Beat(y, H, X, last.value, left), None if found is None else found[:, 0] + 1j * found[:, 1]

    def waves(self, drive: Array, T: float, tolerance: float, most: int, forcing: Forcing) -> tuple[State, Waves]:
        """The steady state, and the waves about it, as in :meth:`beats`."""
        beats = [beat for beat, _ in self.beats(drive, T, tolerance, most, forcing=forcing, observe=False)]
        return self.joined(beats, T)

    def joined(self, beats: Sequence[Beat], T: float) -> tuple[State, Waves]:
        """The steady state of all members, and the waves about it."""
        n = self.model.layout.size
        X = np.stack([beat.waves[:, 0] + 1j * beat.waves[:, 1] for beat in beats], axis=1)
        omega = 2.0 * np.pi / T * np.arange(len(X))
        return self.resting([b.y for b in beats], [b.H for b in beats]), Waves(omega, X[..., :n], X[..., n:])

    def near(self, beats: Sequence[Beat], T: float) -> Near:
        """Beats with their residuals, for others to start at."""
        rest, waves = self.joined(beats, T)
        left = np.stack([b.left[:, 0] + 1j * b.left[:, 1] for b in beats if b.left is not None], axis=1)
        shape = self.model.mass.shape[1:]
        momentum, nodes = np.split(left, [np.prod(shape)], axis=2)
        return Near.of(waves, rest, momentum.reshape(*momentum.shape[:2], *shape), nodes)

    def resting(self, y: Sequence[Array], H: Sequence[Array]) -> State:
        """The steady state of all members, from the results of :meth:`steady`."""
        return replace(self._rest, y=np.stack(y), H=np.stack(H), A_t=np.zeros_like(self._rest.A_t))

    def _forced(self, forcing: Forcing, near: Near | None, n: int) -> tuple[list[Array] | None, list[Array] | None]:
        """For every member the residuals by sources, less those that beats near it leave, (n, 2, n_left), and the flows
        of sources just before outlets, (n, 2, n_outlets); None if there are none."""
        if forcing is NO_FORCING and near is None:
            return None, None
        model, mesh = self.model, self.model.mesh
        B, scale = model.coefficients.B, loads_of(model, GAMMA * model.settings.dt).scale
        momentum, nodes = (
            np.broadcast_to(np.asarray(x, complex), (n, B, *shape))
            for x, shape in ((forcing.momentum, model.mass.shape[1:]), (forcing.nodes, (mesh.n_nodes,)))
        )
        accepted = (near.momentum, near.nodes) if near else (0.0, 0.0)
        left = np.concatenate([(momentum - accepted[0]).reshape(n, B, -1), nodes * scale - accepted[1]], axis=2)
        stores = self._size.outlets and isinstance(forcing.nodes, np.ndarray)
        return _planes(left, B), _planes(nodes[..., mesh.topology.outlets], B) if stores else None


def _planes(x: Array, B: int) -> list[Array]:
    """For every member (K+1, 2, n) real and imaginary parts of x : (K+1, B or 1, n)."""
    x = np.broadcast_to(x, (len(x), B, x.shape[2]))
    return [np.ascontiguousarray(np.stack([x[:, b].real, x[:, b].imag], axis=1)) for b in range(B)]


@lru_cache(maxsize=8)
def _turns(K: int) -> Array:
    """(K+1, 2, K+1) cosines and sines of 2π j k/(4 K)."""
    angle = 2.0 * np.pi / (4 * K) * (np.multiply.outer(np.arange(K + 1), np.arange(K + 1)) % (4 * K))
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


_LONG = np.array(LONG)


@cache
def _library() -> ctypes.CDLL:
    """The library with the functions of the balance."""
    found, pointer, number = library(), ctypes.c_void_p, ctypes.c_int32
    if not found.arterial_balance_fits(len(PLACES), ctypes.sizeof(_Balance), ctypes.sizeof(_Period)):
        raise NoEngine("the compiled engine is of other sources")
    for name, *arguments in (
        ("steady", *[pointer] * 5, number, *[pointer] * 3),
        ("linearise", *[pointer] * 6, number, pointer),
        ("answer", *[pointer] * 5, number, number, pointer),
        ("scratch", *[pointer] * 2),
        ("balanced", *[pointer] * 8, ctypes.c_double, ctypes.c_double, number, *[pointer] * 4),
        ("observed", *[pointer] * 7),
    ):
        getattr(found, f"arterial_{name}").argtypes = arguments
    found.arterial_scratch.restype = ctypes.c_int64
    return found
