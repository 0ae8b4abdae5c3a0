"""The coefficients of the equations: the numbers of a network's objects, with those of a batch replaced."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..errors import InputError
from ..laws import effects
from ..laws.effect import Effect, value_of
from ..laws.outlets import Condition, Load, Outlet, steady
from ..laws.wall import Wall
from ..laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from ..quantities.quantity import quantities
from .description import Network
from .validation import check_parameters

Array = np.ndarray
Parameters = Mapping[str, Any]

_ALONG = ("segment", "fluid")  # owners of what acts along segments


@dataclass(frozen=True)
class EffectValues:
    """An active effect, and its numbers (B, n): of n segments, outlets or junctions, or of the fluid."""

    effect: Effect
    values: Mapping[str, Array]

    def at(self, index: Array | slice | int) -> dict[str, Array]:
        """Its numbers at some of its owners."""
        return {key: value[:, index] for key, value in self.values.items()}

    @property
    def on(self) -> Array:
        """(n,) where it is active in any member of the batch."""
        neutral = self.effect.neutral
        each = [np.any(self.values[key] != neutral[key], axis=0) for key in self.effect.switches]
        return np.any(np.stack(each), axis=0)

    @property
    def active(self) -> bool:
        """Whether it is active anywhere."""
        return any(bool((self.values[key] != self.effect.neutral[key]).any()) for key in self.effect.switches)


@dataclass(frozen=True)
class Ends:
    """The outlets of one kind, and their numbers (B, n) before the effects of outlets.

    index : (n,) which of the network's outlets. terms : the effects of outlets that are on.
    """

    kind: type[Outlet]
    index: Array
    given: Mapping[str, Array]
    terms: tuple[EffectValues, ...]

    @cached_property
    def numbers(self) -> Mapping[str, Array]:
        """The numbers by key, (B, n)."""
        return self.changed({})

    def changed(self, driven: Mapping[str, Array]) -> Mapping[str, Array]:
        """The numbers, with some driven from outside."""
        numbers: Mapping[str, Array] = {**self.given, **driven}
        for term in self.terms:
            numbers = term.effect.outlet(numbers, term.at(self.index))
        return numbers

    def load(self, wall: Wall, tau: float) -> Load:
        """The condition over an implicit stage of length tau [s], plus the flow that effects add to it."""
        load = self.kind.load(self.numbers, wall, tau)
        for effect, values in self.outflows:
            load = load.beside(partial(effect.outflow, values=values))
        return load

    def condition(self, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        """That of small waves, as :meth:`solver.laws.outlets.Outlet.condition`: a (F + Z_ref q) + b P' = r."""
        a, b, r = self.kind.condition(self.numbers, wall, P_0, omega, Z_ref)
        for effect, values in self.outflows:
            q, slope = (Z_ref * x[:, None] for x in effect.outflow(P_0 - self.numbers["P_venous"], values))
            b, r = b + a * slope, r - a * q * steady(omega)
        return a, b, r

    @property
    def outflows(self) -> list[tuple[Effect, Mapping[str, Array]]]:
        """The effects that let out a further flow, with their numbers."""
        return [(t.effect, t.at(self.index)) for t in self.terms if changes(t.effect, "outflow")]


@dataclass(frozen=True)
class Coefficients:
    """The numbers of a network, or of a batch of them: leading axis B (1 when nothing is batched).

    L : (B, n_segments) [m]. base : the walls without further effects, arrays (B, n_segments). rho, nu, C_f, alpha,
    P_0 : (B, 1). k : (B, n_junctions) weight of the kinetic pressure that a junction keeps. outlets : by kind.
    P_venous : (B, n_outlets) [Pa]. terms : the effects that are on.
    """

    L: Array
    base: Wall
    terms: tuple[EffectValues, ...]
    rho: Array
    nu: Array
    k: Array
    C_f: Array
    alpha: Array
    P_0: Array
    outlets: tuple[Ends, ...]
    P_venous: Array
    batched: bool

    @property
    def B(self) -> int:
        return self.L.shape[0]

    def wall_at(self, segment: Array, x: Array) -> Wall:
        """The walls at points x : (n,) = x/L of segments : (n,), arrays (B, n), with the effects that are on."""
        return _with_effects(self.base, self.terms, segment, x)

    @cached_property
    def wall(self) -> Wall:
        """The walls at the middles of the segments : (B, n_segments)."""
        n = self.L.shape[1]
        return self.wall_at(np.arange(n), np.full(n, 0.5))

    @property
    def numbers(self) -> Array:
        """All numbers of the segments and the fluid in them : (B, n_segments, m)."""
        along = [value for term in self.terms if term.effect.owner in _ALONG for value in term.values.values()]
        base = self.base.A0, self.base.K, self.base.K_h, self.base.P_ref
        groups = self.L, *base, self.rho, self.nu, self.C_f, self.P_0, *along
        found = np.empty((*self.L.shape, len(groups)))
        for i, values in enumerate(groups):
            found[..., i] = values
        return found

    def picked(self, member: Array, segment: Array) -> Coefficients:
        """Segments : (n,) of members : (n,) of the batch, and the fluid in them, as the segments of one member."""

        def one(values: Array) -> Array:
            return np.asarray(values[member[None], segment % values.shape[1]])  # one column of the fluid

        terms = (term for term in self.terms if term.effect.owner in _ALONG)
        return replace(
            self,
            L=one(self.L),
            base=self.base.picked(member[None], segment),
            terms=tuple(EffectValues(term.effect, {key: one(x) for key, x in term.values.items()}) for term in terms),
            outlets=(),
            batched=False,
            rho=one(self.rho),
            nu=one(self.nu),
            C_f=one(self.C_f),
            alpha=one(self.alpha),
            P_0=one(self.P_0),
        )

    @property
    def cuts(self) -> tuple[tuple[float, ...], ...]:
        """x/L at which elements must end, for every segment."""
        n = self.L.shape[1]
        terms = [term for term in self.terms if term.effect.owner == "segment"]
        found = ((term.effect.cut_at(term.at(s)) for term in terms if term.on[s]) for s in range(n))
        return tuple(tuple(sorted({x for cuts in each for x in cuts})) for each in found)

    def venous(self, P_venous: Array) -> Array:
        """P_venous : (1 or B, n_outlets) [Pa] after the effects of outlets."""
        if all(ends.numbers["P_venous"] is ends.given["P_venous"] for ends in self.outlets):
            return P_venous
        changed = np.empty_like(self.P_venous)
        for ends in self.outlets:
            changed[:, ends.index] = ends.changed({"P_venous": P_venous[..., ends.index]})["P_venous"]
        return changed


def batch_size(parameters: Parameters) -> int | None:
    """Common length of the array parameters, or None if all are scalars. Raises ValueError unless they agree."""
    sizes = {name: np.shape(value) for name, value in parameters.items() if np.ndim(value)}
    first = next(iter(sizes), "")
    for name, shape in sizes.items():
        if len(shape) != 1 or shape[0] == 0:
            raise InputError(
                f"{name}: batch of shape {shape}, where that of B parameter sets is (B,), B at least 1; give a number "
                "or a one-dimensional array."
            )
        if shape != sizes[first]:
            raise InputError(
                f"{name}: batch of shape {shape} does not fit {first} of shape {sizes[first]}; give numbers and arrays "
                "of one length."
            )
    return sizes[first][0] if sizes else None


def coefficients(
    network: Network, parameters: Parameters | None = None, *, checked: bool = True, every: bool = False
) -> Coefficients:
    """The coefficients of a network with some parameters replaced by numbers or by arrays of B numbers.

    checked : whether the parameters must be allowed: then raises ValueError for an unknown name, a value out of range,
    or arrays of different lengths. every : whether effects that the network holds count as on where they are neutral.
    """
    parameters = parameters or {}
    if checked:
        check_parameters(network, parameters)
    size = batch_size(parameters)
    numbers = _Numbers(network, parameters, size or 1)
    segments, fluid = numbers.owners["segment"], numbers.owners["fluid"]
    present = (term for term in map(numbers.term, effects.ALL) if term is not None)
    terms = tuple(term for term in present if every or term.active)
    rho, nu = numbers.of(fluid, "rho"), numbers.of(fluid, "nu")
    C_f, alpha = numbers.of(fluid, "friction") * np.pi * nu, np.ones_like(rho)
    junctions: Mapping[str, Array] = {"k": np.zeros((numbers.size, len(network.junctions)))}
    for term in terms:
        if term.effect.owner == "fluid":
            C_f = term.effect.friction(C_f, term.values)
            alpha = term.effect.convection(alpha, term.values)
        if term.effect.owner == "junction":
            junctions = term.effect.junction(junctions, term.values)
    outlets = _outlets(numbers, tuple(term for term in terms if term.effect.owner == "outlet"))
    P_venous = np.empty_like(rho, shape=(numbers.size, len(network.outlets)))
    for ends in outlets:
        P_venous[:, ends.index] = ends.numbers["P_venous"]
    return Coefficients(
        L=numbers.of(segments, "L"),
        base=_walls(numbers),
        terms=terms,
        rho=rho,
        nu=nu,
        k=junctions["k"],
        C_f=C_f,
        alpha=alpha,
        P_0=numbers.of(numbers.owners["network"], "P_0"),
        outlets=outlets,
        P_venous=P_venous,
        batched=size is not None,
    )


def walls_at(network: Network, parameters: Parameters | None, segment: Array, x: Array) -> Wall:
    """The walls of :func:`coefficients` alone, of parameters that are not checked, as :meth:`Coefficients.wall_at`."""
    numbers = _Numbers(network, parameters or {}, batch_size(parameters or {}) or 1)
    present = (numbers.term(effect) for effect in effects.ALL if effect.owner == "segment")
    return _with_effects(_walls(numbers), [term for term in present if term is not None and term.active], segment, x)


def _with_effects(base: Wall, terms: Sequence[EffectValues], segment: Array, x: Array) -> Wall:
    """The walls ``base`` at points x/L of segments, with effects."""
    wall = base.at(segment)
    for term in terms:
        if term.effect.owner == "segment":
            wall = term.effect.wall(wall, term.at(segment), x)
    return wall


def changes(effect: Effect, hook: str) -> bool:
    """Whether an effect overrides a hook."""
    return getattr(type(effect), hook, None) is not getattr(Effect, hook, None)


class _Numbers:
    """The numbers of a network's objects as arrays of B, with those of a batch replaced."""

    def __init__(self, network: Network, parameters: Parameters, size: int) -> None:
        self.network, self.parameters, self.size = network, parameters, size
        self.like = next(iter(parameters.values()), 0.0)  # of the kind of array that numbers are
        self.owners: dict[str, list[tuple[str, Any]]] = defaultdict(list)
        for prefix, owner in network.owners():
            self.owners[owner.OWNER].append((prefix, owner))

    def of(self, owners: Sequence[tuple[str, Any]], key: str, otherwise: float = 0.0) -> Array:
        """(B, n): the number behind a key of every owner, ``otherwise`` if an owner does not have it."""
        values = np.empty_like(self.like, float, shape=(self.size, len(owners)))
        for i, (prefix, owner) in enumerate(owners):
            name = f"{prefix}.{key}"
            values[:, i] = self.parameters[name] if name in self.parameters else value_of(owner, key, otherwise)
        return values

    def term(self, effect: Effect) -> EffectValues | None:
        """The numbers of an effect, neutral if an owner does not have them; None if no owner has them, or if the effect
        has no neutral values."""
        owners = self.owners[effect.owner]
        present = effect.always or any(key in owner.terms for _, owner in owners for key in effect.terms)
        if not present or not effect.neutral:
            return None
        return EffectValues(effect, {key: self.of(owners, key, effect.neutral[key]) for key in effect.terms})


def _walls(numbers: _Numbers) -> Wall:
    """The walls without further effects."""
    R0, E, h = (numbers.of(numbers.owners["segment"], key) for key in ("R0", "E", "h"))
    eta, P_ref = (numbers.of(numbers.owners["network"], key) for key in ("eta", "P_ref"))
    plate = 1.0 - eta**2
    h_over_R0, none = h / R0, np.zeros_like(R0)
    return Wall(
        elastic=ELASTIC_LAWS[numbers.network.elastic_law],
        viscous=VISCOUS_LAWS[numbers.network.viscous_law],
        A0=np.pi * R0**2,
        K=E * h_over_R0 / plate,
        e=none,
        K_h=h_over_R0 / plate,
        phi0=none,  # until the effect of wall viscosity sets it (:meth:`Coefficients.wall_at`)
        r=none,
        P_ref=np.broadcast_to(P_ref, R0.shape),
        rho=np.broadcast_to(numbers.of(numbers.owners["fluid"], "rho"), R0.shape),
        nonlinear=False,
        bent=False,
    )


def _outlets(numbers: _Numbers, terms: tuple[EffectValues, ...]) -> tuple[Ends, ...]:
    """The outlets by kind."""
    by_kind: dict[type[Outlet], list[int]] = {}
    for i, outlet in enumerate(numbers.network.outlets):
        by_kind.setdefault(type(outlet), []).append(i)
    owners = numbers.owners["outlet"]

    def given(kind: type[Outlet], index: list[int]) -> dict[str, Array]:
        return {key: numbers.of([owners[i] for i in index], key) for key in quantities(kind)}

    found = tuple(Ends(kind, np.array(index), given(kind, index), terms) for kind, index in by_kind.items())
    for ends in (each for each in found if each.kind.stores):
        for effect, values in ends.outflows:
            if any((values[key] != effect.neutral[key]).any() for key in values if key not in effect.how):
                raise InputError(
                    f"network {numbers.network.name}: {effect.name} is no effect of a {ends.kind.noun}, whose flow is "
                    "not one of P - P_venous; leave it out, or give another outlet."
                )
    return found
