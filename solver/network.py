"""The description of a network: frozen dataclasses with units and allowed ranges.

Everything here is in SI. Every number that a user may change is a *quantity*: a dataclass field that carries a
:class:`~solver.quantity.Quantity`. The variables of the FMU, the keys of the network file, the error messages and the
batch parameters of the solver all follow from these fields, so a new one is added here and nowhere else. Beside the
fields, which every network has, segments, fluid and channels hold *terms* by key: numbers of the effects of
:mod:`solver.effects` that this network has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from . import effects
from .catalogue import quantities_of, terms_of, value_of
from .curve import Curve
from .effect import Effect
from .outlets import OUTLETS, Outlet
from .quantity import Quantity, quantities, quantity
from .units import SIGNAL_UNITS
from .validation import check_network, check_parameters, check_terms

CAUSALITY = {"Q": "flow", "P": "pressure"}  # of an inlet, by the signal that is given there
_BOTH = ("network", "wall")


def _terms() -> Any:
    """A field for the terms of :mod:`solver.effects` that the object holds, SI values by key."""
    return field(default_factory=dict, hash=False)


def _held(effect: type[Effect], key: str) -> Any:
    """A field for a number of an effect that every owner of its kind holds; the effect says what it is."""
    return field(default=effect.neutral[key], metadata={"quantity": effect.terms[key]})


@dataclass(frozen=True)
class Fluid:
    """Blood. Friction and convection of `momentumConserv_AQ`: C_f = friction π ν (22πν), ∂(α Q²/A)/∂x."""

    rho: float = quantity(1060.0, "kg/m^3", "blood density rho", 1.0, 1e5, nominal=1e3, tunable=False)
    nu: float = quantity(3.5e-6, "m^2/s", "kinematic viscosity nu", 0.0, 1.0, nominal=1e-6, tunable=False)
    alpha: float = _held(effects.VelocityProfile, "alpha")
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
    phi0: float = _held(effects.WallViscosity, "phi0")
    phiNL: float = _held(effects.NonlinearWallViscosity, "phiNL")
    ENL: float = _held(effects.NonlinearElasticity, "ENL")
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "segment"


@dataclass(frozen=True)
class Junction:
    """Vessels that meet at one point: ΣQ = 0, and P + k (ρ/2)(Q/A)² equal in all of them.

    ``k`` = 0 joins the static pressure (the paper), 1 the total pressure. A junction is named after its first
    inflowing segment.
    """

    inflow: tuple[str, ...]
    outflow: tuple[str, ...]
    k: float = _held(effects.JunctionLoss, "k")
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "junction"

    @property
    def name(self) -> str:
        return self.inflow[0] if self.inflow else "(no inflow)"


@dataclass(frozen=True)
class Site:
    """A place where pressure, flow and radius are reported: ``position`` is x/L along the segment."""

    name: str
    segment: str
    position: float = quantity(0.5, "1", "position x/L", 0.0, 1.0, tunable=False)


@dataclass(frozen=True)
class Channel:
    """How a sensor shows an output of the network (``CA.P``) or ``inlet.Q``: see :func:`solver.catalogue.observe`.

    The observation is part of the network's description, but not of the FMU, whose outputs are the true quantities.
    """

    name: str
    terms: Mapping[str, float] = _terms()

    OWNER: ClassVar[str] = "channel"

    def quantities(self) -> dict[str, Quantity]:
        """The terms that it may hold, in the unit of its signal."""
        unit = SIGNAL_UNITS[self.name.rpartition(".")[2]]
        return {key: replace(q, unit=unit) if q.unit == "signal" else q for key, q in terms_of("channel").items()}


@dataclass(frozen=True)
class Inlet:
    """Where blood enters, and the default inflow: Q(t) = Q_max max(0, sin 2πt/T), the paper's cyclic half-sine.

    causality : what is given there, the flow or the pressure; the other one is an output.
    curve : what is given there in place of the half-sine; Q_max and T are then those of the curve.
    """

    segment: str
    Q_max: float = quantity(55e-6, "m^3/s", "peak inflow Q_max", 0.0, 1.0, nominal=1e-4, display="mL/s")
    T: float = quantity(0.5, "s", "period T", 1e-3, 100.0)
    causality: str = "flow"
    curve: Curve | None = None

    def __post_init__(self) -> None:
        if self.curve is not None:
            object.__setattr__(self, "T", self.curve.period)
        if self._flow is not None:
            object.__setattr__(self, "Q_max", max(0.0, self._flow.largest))

    @property
    def _flow(self) -> Curve | None:
        return self.curve if self.curve is not None and self.curve.signal == "Q" else None

    @property
    def drive(self) -> str:
        """What is given at the inlet: inlet.Q or inlet.P."""
        return {"flow": "inlet.Q", "pressure": "inlet.P"}[self.causality]

    @property
    def answer(self) -> str:
        """What follows there: inlet.P or inlet.Q."""
        return {"flow": "inlet.P", "pressure": "inlet.Q"}[self.causality]

    @property
    def shape(self) -> str:
        """The default inflow in words."""
        return "a half-sine" if self._flow is None else "the inflow of the network"

    @property
    def Q_mean(self) -> float:
        """The mean of the inflow [m³/s]."""
        return self.Q_max / np.pi if self._flow is None else self._flow.mean

    @property
    def P_mean(self) -> float | None:
        """The mean of the pressure [Pa], where there is a curve of it."""
        return self.curve.mean if self.curve is not None and self.curve.signal == "P" else None

    def with_mean(self, Q_mean: float, T: float) -> Inlet:
        """The same inlet with an inflow scaled to a mean [m³/s] and a period [s]; a half-sine where its mean is 0."""
        if self._flow is None or self.Q_mean == 0.0:
            return replace(self, Q_max=np.pi * Q_mean, T=T, curve=None)
        return replace(self, curve=self._flow.scaled(Q_mean / self.Q_mean, T / self.T))

    def Q(self, t: np.ndarray | float) -> np.ndarray:
        """Inflow Q(t) [m³/s] at times t [s], any shape."""
        # the phase is reduced first: sin(2π t/T) after many beats loses digits
        phase = np.mod(np.asarray(t, float) / self.T, 1.0)
        if self._flow is not None:
            return self._flow.at(phase)
        return self.Q_max * np.maximum(0.0, np.sin(2 * np.pi * phase))

    @property
    def given(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """What drives the inlet by default, Q(t) [m³/s] or P(t) [Pa]; None for a pressure inlet without a curve."""
        if self.causality == "flow":
            return self.Q
        curve = self.curve
        return None if curve is None or curve.signal == "Q" else lambda t: curve.at(np.asarray(t, float) / self.T)


@dataclass(frozen=True)
class Network:
    """A network of arteries, checked when it is made.

    eta : Poisson's ratio of the walls. P_ref : pressure at which R = R0. P_0 : uniform pressure at the start.
    elastic_law, viscous_law : names from :mod:`solver.wall`.
    Raises ValueError, one sentence that names the thing, its value, what is allowed and what to do.
    """

    name: str
    segments: tuple[Segment, ...]
    inlet: Inlet
    junctions: tuple[Junction, ...] = ()
    outlets: tuple[Outlet, ...] = ()
    sites: tuple[Site, ...] = ()
    fluid: Fluid = Fluid()
    channels: tuple[Channel, ...] = field(default=(), kw_only=True)
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
        check_network(self)

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
        """As :meth:`with_parameters`; terms that the network has not yet (``CA.tau``, ``CA.P.lag``) are added to it.

        Raises ValueError for a name that is neither a parameter nor a term of :mod:`solver.effects`.
        """
        known = self.parameter_quantities()
        added = {name: value for name, value in values.items() if name not in known}
        check_terms(self, added)
        check_parameters(self, {name: value for name, value in values.items() if name in known})
        return self._with(values)

    def _with(self, values: Mapping[str, float]) -> Network:
        for name, value in values.items():
            if np.ndim(value):
                raise ValueError(
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
        """SI unit of every output, by name: inlet.P or .Q, <site>.P, .Q, .R and <segment>.outlet.P, .Q."""
        units = {self.inlet.answer: SIGNAL_UNITS[self.inlet.answer[-1]]}
        for site in self.sites:
            units |= {f"{site.name}.{signal}": unit for signal, unit in SIGNAL_UNITS.items()}
        for outlet in self.outlets:
            units |= {f"{outlet.segment}.outlet.{signal}": SIGNAL_UNITS[signal] for signal in "PQ"}
        return units

    def channel_names(self) -> tuple[str, ...]:
        """What a sensor may show: the outputs and what is given at the inlet."""
        return (self.inlet.drive, *self.output_units())

    def segment(self, name: str) -> Segment:
        """The segment of that name (KeyError if there is none)."""
        for segment in self.segments:
            if segment.name == name:
                return segment
        raise KeyError(name)


# --- plain data: what the FMU carries -----------------------------------------------------------------------------


def to_dict(network: Network) -> dict[str, Any]:
    """The network as nested dicts, tuples, strings and SI floats (JSON-ready); :func:`from_dict` inverts it exactly."""
    outlets = [{"condition": type(outlet).__name__, **asdict(outlet)} for outlet in network.outlets]
    return {**asdict(network), "outlets": outlets}


def from_dict(data: Mapping[str, Any]) -> Network:
    """The network of a :func:`to_dict` result."""
    conditions = {kind.__name__: kind for kind in OUTLETS}
    junctions = [{**j, "inflow": tuple(j["inflow"]), "outflow": tuple(j["outflow"])} for j in data["junctions"]]
    outlets = [(conditions[o["condition"]], {k: v for k, v in o.items() if k != "condition"}) for o in data["outlets"]]
    parts: dict[str, Any] = {
        "fluid": Fluid(**data["fluid"]),
        "inlet": _inlet(data["inlet"]),
        "segments": tuple(Segment(**s) for s in data["segments"]),
        "junctions": tuple(Junction(**j) for j in junctions),
        "outlets": tuple(kind(**own) for kind, own in outlets),
        "sites": tuple(Site(**s) for s in data["sites"]),
        "channels": tuple(Channel(**c) for c in data["channels"]),
    }
    return Network(**{**data, **parts})


def _inlet(data: Mapping[str, Any]) -> Inlet:
    c = data["curve"]
    curve = Curve(c["signal"], tuple(c["t"]), tuple(c["values"]), c["interpolation"]) if c else None
    return Inlet(**{**data, "curve": curve})
