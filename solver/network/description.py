"""The description of a network: frozen dataclasses with units and allowed ranges.

Everything here is in SI. Every number that a user may change is a *quantity*: a dataclass field that carries a
:class:`~solver.quantities.quantity.Quantity`. The variables of the FMU, the keys of the network file, the error
messages and the batch parameters of the solver all follow from these fields, so a new one needs no change elsewhere.
Beside these fields, which every network has, segments, fluid and channels have *terms* by key: numbers of the effects
of :mod:`solver.laws.effects` in this network.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, cast

import numpy as np

from ..errors import InputError
from ..laws import effects
from ..laws import outlets as outlet_kinds
from ..laws.catalogue import quantities_of, terms_of
from ..laws.effect import Effect, value_of
from ..laws.outlets import Outlet
from ..quantities.quantity import Quantity, quantities, quantity
from ..quantities.text import did_you_mean
from ..quantities.units import SIGNAL_UNITS
from .curve import Curve
from .inlet import Inlet
from .table_source import TableSource, check
from .validation import check_network, check_parameters, check_terms

_BOTH = ("network", "wall")


def _terms() -> Any:
    """A field for the object's terms of :mod:`solver.laws.effects`, SI values by key."""
    return field(default_factory=dict, hash=False)


def _effect_field(effect: type[Effect], key: str) -> Any:
    """A field for a number of an effect that every owner of its kind has; the effect defines it."""
    return field(default=effect.neutral[key], metadata={"quantity": effect.terms[key]})


@dataclass(frozen=True)
class Fluid:
    """Blood. Friction and convection of `momentumConserv_AQ`: C_f = friction π ν (22πν), ∂(α Q²/A)/∂x."""

    rho: float = quantity(1060.0, "kg/m^3", "blood density rho", 1.0, 1e5, nominal=1e3, tunable=False)
    nu: float = quantity(3.5e-6, "m^2/s", "kinematic viscosity nu", 0.0, 1.0, nominal=1e-6, tunable=False)
    alpha: float = _effect_field(effects.VelocityProfile, "alpha")
    friction: float = quantity(22.0, "1", "friction factor C_f/(pi nu)", 0.0, 1e4, nominal=10.0, tunable=False)
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "fluid"


@dataclass(frozen=True)
class Segment:
    """One artery: geometry and wall. Symbols of the paper's Table 1 and of `eq:general`."""

    name: str
    L: float = quantity(None, "m", "length L", 1e-4, 10.0, nominal=0.1, display="cm", tunable=False)
    R0: float = quantity(
        None,
        "m",
        "radius R0 at P_ref",
        1e-5,
        0.2,
        nominal=5e-3,
        display="mm",
        tunable=False,
        spread=0.01,
        refit=("wall",),
        individual=0.02,
    )
    h: float = quantity(None, "m", "wall thickness h", 1e-6, 0.1, nominal=1e-3, display="mm", tunable=False)
    E: float = quantity(
        None,
        "Pa",
        "Young's modulus E",
        1e2,
        1e10,
        nominal=1e6,
        display="MPa",
        spread=0.2,
        refit=_BOTH,
        individual=0.08,
    )
    phi0: float = _effect_field(effects.WallViscosity, "phi0")
    phiNL: float = _effect_field(effects.NonlinearWallViscosity, "phiNL")
    ENL: float = _effect_field(effects.NonlinearElasticity, "ENL")
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "segment"


@dataclass(frozen=True)
class Junction:
    """Vessels that meet at one point: ΣQ = 0, and P + k (ρ/2)(Q/A)² equal in all of them.

    ``k`` = 0 conserves the static pressure (the paper), 1 the total pressure. A junction is named after its first
    inflowing segment.
    """

    inflow: tuple[str, ...]
    outflow: tuple[str, ...]
    k: float = _effect_field(effects.JunctionLoss, "k")
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "junction"

    @property
    def name(self) -> str:
        return self.inflow[0] if self.inflow else "(no inflow)"


@dataclass(frozen=True)
class Site:
    """A position where pressure, flow and radius are reported: ``position`` is x/L along the segment."""

    name: str
    segment: str
    position: float = quantity(0.5, "1", "position x/L", 0.0, 1.0, tunable=False)


@dataclass(frozen=True)
class Channel:
    """The sensor that records an output of the network (``CA.P``) or ``inlet.Q``: see
    :func:`solver.laws.catalogue.observe`.

    The observation is part of the network's description, but not of the FMU, whose outputs are the true quantities.
    """

    name: str
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "channel"

    def quantities(self) -> dict[str, Quantity]:
        """Its possible terms, in the unit of its signal."""
        unit = SIGNAL_UNITS[self.name.rpartition(".")[2]]
        return {key: replace(q, unit=unit) if q.unit == "signal" else q for key, q in terms_of("channel").items()}


class Parts(tuple[Any, ...]):
    """Parts of a network in their order, indexed by position or by name: ``network.segments["CA"]``.

    An outlet has the name of its segment. Raises KeyError for a name that no part has.
    """

    __slots__ = ()

    def __getitem__(self, at: Any) -> Any:
        if not isinstance(at, str):
            return super().__getitem__(at)
        names = [getattr(part, "name", None) or part.segment for part in self]
        if at not in names:
            raise KeyError(f"{at}: not among {', '.join(names) or 'none'}{did_you_mean(at, names)}.")
        return super().__getitem__(names.index(at))


@dataclass(frozen=True)
class Network:
    """A network of arteries, checked when it is made.

    eta : Poisson's ratio of the walls. P_ref : pressure at which R = R0. P_0 : uniform pressure at the start.
    elastic_law, viscous_law : names from :mod:`solver.laws.wall_laws`. inlet : the first or only one; further_inlets :
    others.
    sources : tables of additional terms; they describe a record and explain nothing.
    Raises ValueError, one sentence that names the quantity, its value, the allowed range and the remedy.
    """

    name: str
    segments: tuple[Segment, ...]
    inlet: Inlet
    junctions: tuple[Junction, ...] = ()
    outlets: tuple[Outlet, ...] = ()
    sites: tuple[Site, ...] = ()
    fluid: Fluid = Fluid()
    channels: tuple[Channel, ...] = field(default=(), kw_only=True)
    further_inlets: tuple[Inlet, ...] = field(default=(), kw_only=True)
    sources: tuple[TableSource, ...] = field(default=(), kw_only=True)
    eta: float = quantity(0.5, "1", "Poisson's ratio eta", 0.0, 0.5, tunable=False)
    P_ref: float = quantity(
        0.0, "Pa", "reference pressure P_ref", -1e5, 1e6, nominal=1e4, display="mmHg", tunable=False
    )
    P_0: float = quantity(
        0.0, "Pa", "uniform start pressure P_0", -1e5, 1e6, nominal=1e4, display="mmHg", tunable=False
    )
    elastic_law: str = "beta"
    viscous_law: str = "quadratic"
    reference: str = ""
    species: str = ""

    OWNER: ClassVar[str] = "network"

    def __post_init__(self) -> None:
        object.__setattr__(self, "further_inlets", tuple(replace(i, first=False) for i in self.further_inlets))
        for field_name in ("segments", "junctions", "outlets", "sites", "channels"):
            object.__setattr__(self, field_name, Parts(getattr(self, field_name)))
        check_network(self)
        check(self.sources, self)

    @property
    def inlets(self) -> tuple[Inlet, ...]:
        """All inlets, the one named ``inlet`` first."""
        return (self.inlet, *self.further_inlets)

    # --- numbers by name: these names are the FMU's -------------------------------------------------------------

    def owners(self) -> Iterator[tuple[str, Any]]:
        """Every object that has parameters, with the prefix of its variables: ``fluid``, ``AA``, ``CA.outlet`` …"""
        yield self.OWNER, self
        yield "fluid", self.fluid
        for segment in self.segments:
            yield segment.name, segment
        for outlet in self.outlets:
            yield f"{outlet.segment}.outlet", outlet
        for junction in self.junctions:
            yield f"{junction.name}.junction", junction

    def parameters(self) -> dict[str, float]:
        """All parameters by variable name (``AA.E``, ``CA.outlet.R_t``, ``fluid.rho``, ``network.P_ref``), in SI."""
        return {
            f"{prefix}.{key}": value_of(owner, key) for prefix, owner in self.owners() for key in quantities_of(owner)
        }

    def parameter_quantities(self) -> dict[str, Quantity]:
        """The :class:`Quantity` of every parameter, by variable name."""
        return {f"{prefix}.{key}": q for prefix, owner in self.owners() for key, q in quantities_of(owner).items()}

    def with_parameters(self, values: Mapping[str, float]) -> Network:
        """The same network with some parameters replaced. Raises ValueError for a name or value that is not allowed."""
        check_parameters(self, values)
        return self._with(values)

    def with_terms(self, values: Mapping[str, float]) -> Network:
        """As :meth:`with_parameters`, and add terms that the network lacks (``CA.tau``, ``CA.P.lag``).

        Raises ValueError for a name that is neither a parameter nor a term of :mod:`solver.laws.effects`.
        """
        known = self.parameter_quantities()
        added = {name: value for name, value in values.items() if name not in known}
        check_terms(self, added)
        check_parameters(self, {name: value for name, value in values.items() if name in known})
        return self._with(values)

    def _with(self, values: Mapping[str, float]) -> Network:
        for name, value in values.items():
            if np.ndim(value):
                raise InputError(
                    f"{name}: one network holds one number, not {np.size(value)}; batches go to simulate()."
                )

        def changed(prefix: str, owner: Any) -> Any:
            mine = {key: float(values[f"{prefix}.{key}"]) for key in quantities(owner) if f"{prefix}.{key}" in values}
            known = terms_of(owner.OWNER)
            terms = {key: float(values[f"{prefix}.{key}"]) for key in known if f"{prefix}.{key}" in values}
            if terms:
                mine["terms"] = {**owner.terms, **terms}  # type: ignore[assignment]
            return replace(owner, **mine) if mine else owner

        names = {name.rpartition(".")[0] for name in values} & set(self.channel_names())
        new = sorted(names - {channel.name for channel in self.channels})
        return replace(
            changed(self.OWNER, self),
            fluid=changed("fluid", self.fluid),
            segments=tuple(changed(s.name, s) for s in self.segments),
            outlets=tuple(changed(f"{o.segment}.outlet", o) for o in self.outlets),
            junctions=tuple(changed(f"{j.name}.junction", j) for j in self.junctions),
            channels=tuple(changed(c.name, c) for c in (*self.channels, *map(Channel, new))),
        )

    def with_outlet(self, outlet: Outlet) -> Network:
        """The same network with another condition at the end of one segment."""
        return replace(self, outlets=tuple(outlet if o.segment == outlet.segment else o for o in self.outlets))

    # --- outputs --------------------------------------------------------------------------------------------------

    def output_units(self) -> dict[str, str]:
        """SI unit of every output, by name: P or Q of the inlets, <site>.P, .Q, .R and <segment>.outlet.P, .Q."""
        units = {inlet.answer: SIGNAL_UNITS[inlet.answer[-1]] for inlet in self.inlets}
        for site in self.sites:
            units |= {f"{site.name}.{signal}": unit for signal, unit in SIGNAL_UNITS.items()}
        for outlet in self.outlets:
            units |= {f"{outlet.segment}.outlet.{signal}": SIGNAL_UNITS[signal] for signal in "PQ"}
        return units

    def channel_names(self) -> tuple[str, ...]:
        """The signals that a sensor may record: the outputs and the prescribed inlet signals."""
        return (*(inlet.drive for inlet in self.inlets), *self.output_units())

    def segment(self, name: str) -> Segment:
        """The segment of that name. Raises KeyError if there is none."""
        return cast(Segment, cast(Parts, self.segments)[name])

    def plot(self) -> Any:
        """A figure of the network from left to right, for notebooks: vessels, inlets, outlets and sites."""
        from ..displays import door

        return door().display(self).figure(self)


# --- plain data, as stored in the FMU -----------------------------------------------------------------------------


def to_dict(network: Network) -> dict[str, Any]:
    """The network as nested dicts, tuples, strings and SI floats (JSON-ready); :func:`from_dict` inverts it exactly."""
    outlets = [{"condition": type(outlet).__name__, **asdict(outlet)} for outlet in network.outlets]
    return {**asdict(network), "outlets": outlets}


def from_dict(data: Mapping[str, Any]) -> Network:
    """The network of a :func:`to_dict` result."""
    conditions = {kind.__name__: kind for kind in outlet_kinds.OUTLETS}
    junctions = [{**j, "inflow": tuple(j["inflow"]), "outflow": tuple(j["outflow"])} for j in data["junctions"]]
    outlets = [(conditions[o["condition"]], {k: v for k, v in o.items() if k != "condition"}) for o in data["outlets"]]
    parts: dict[str, Any] = {
        "fluid": Fluid(**data["fluid"]),
        "inlet": _inlet(data["inlet"]),
        "further_inlets": tuple(map(_inlet, data["further_inlets"])),
        "segments": tuple(Segment(**s) for s in data["segments"]),
        "junctions": tuple(Junction(**j) for j in junctions),
        "outlets": tuple(kind(**own) for kind, own in outlets),
        "sites": tuple(Site(**s) for s in data["sites"]),
        "channels": tuple(Channel(**c) for c in data["channels"]),
        "sources": tuple(TableSource(**{**s, "curve": _curve(s["curve"])}) for s in data["sources"]),
    }
    return Network(**{**data, **parts})


def _inlet(data: Mapping[str, Any]) -> Inlet:
    return Inlet(**{**data, "curve": _curve(data["curve"])})


def _curve(c: Mapping[str, Any] | None) -> Any:
    return Curve(**{**c, "t": tuple(c["t"]), "values": tuple(c["values"])}) if c else None
