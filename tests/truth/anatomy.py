"""What flows and what holds it: a network's numbers with room for every hidden effect, zero by default.

The effects of the catalogue act here, on these numbers; how a number enters the equations is said in ``wall.py``
(walls) and ``network.py`` (flow, junctions, outlets).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from solver.laws.outlets import Pressure, Reflection, Resistance, Windkessel
from solver.network.description import Network


@dataclass(frozen=True)
class Vessel:
    """One artery, SI. r = phi_NL/phi0 [s] and e = E_NL/E [-] are ratios, so that a change of E or phi0 carries them.

    tau [s]: memory of the viscous stress. P_ext [Pa]. taper s: R0(x) = R0 (1 + s (x/L - 1/2)). leak [m²/(Pa s)].
    K [-]: all of a stenosis. E_scale: E becomes E_scale E. What these three act on is the part of a vessel that is
    _length L long about _position L, as far as it lies in it: the middle tenth, and else all.
    springpot w, order a: the share w of the viscous stress is phi0 ω1 (iω/ω1)^a ε instead of phi0 iω ε.
    phi3 [Pa s³]: stress phi3 ε̇³. c: phi0 grows with strain as 1 + cε. coulomb [Pa]: friction against ε̇, whatever its
    size.
    """

    name: str
    L: float
    R0: float
    h: float
    E: float
    phi0: float
    r: float = 0.0
    e: float = 0.0
    tau: float = 0.0
    P_ext: float = 0.0
    taper: float = 0.0
    leak: float = 0.0
    K: float = 0.0
    springpot: float = 0.0
    order: float = 0.5
    phi3: float = 0.0
    c: float = 0.0
    coulomb: float = 0.0
    E_scale: float = 1.0
    K_position: float = 0.5
    K_length: float = 0.1
    leak_position: float = 0.5
    leak_length: float = 1.0
    E_position: float = 0.5
    E_length: float = 1.0

    def part(self, key: str) -> tuple[float, float]:
        """Where what acts on a part of the vessel (K, leak, E) begins and ends [x/L]."""
        middle, half = getattr(self, f"{key}_position"), 0.5 * getattr(self, f"{key}_length")
        return round(max(0.0, middle - half), 12), round(min(1.0, middle + half), 12)

    def parts(self) -> dict[str, tuple[float, float]]:
        """The parts of those that act."""
        on = {"K": self.K != 0.0, "leak": self.leak != 0.0, "E": self.E_scale != 1.0}
        return {key: self.part(key) for key, acts in on.items() if acts}

    def at(self, x: float) -> Vessel:
        """The vessel as it is at x/L, K spread over its part: K/(length of the part)."""
        parts = {key: (start, stop) for key, (start, stop) in self.parts().items() if start < x < stop}
        K = self.K / (parts["K"][1] - parts["K"][0]) if "K" in parts else 0.0
        E = self.E * self.E_scale if "E" in parts else self.E
        return replace(self, K=K, leak=self.leak if "leak" in parts else 0.0, E=E)


@dataclass(frozen=True)
class Join:
    """Vessels that meet: ends that flow in (their right ends) and out (their left ends), and the k of P + k ρU²/2."""

    inflow: tuple[str, ...]
    outflow: tuple[str, ...]
    k: float = 0.0


@dataclass(frozen=True)
class End:
    """The load of a vessel's end.

    ``kind`` "reflection": R_t, which swings over the beat as R_t + swing sin(2π (t/T - swing_phase));
    "impedance": P - P_venous = (R1 + R2/(1 + iω R2 C)) Q.
    """

    vessel: str
    kind: str
    R_t: float = 0.0
    swing: float = 0.0
    swing_phase: float = 0.0
    R1: float = 0.0
    R2: float = 0.0
    C: float = 0.0
    P_venous: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where a sensor sits: x/L along a vessel."""

    name: str
    vessel: str
    position: float


@dataclass(frozen=True)
class Anatomy:
    """A network as the generator sees it.

    unsteady: share of the frequency-dependent wall shear, 0 none … 1 exact. tone: how far E of all walls wanders over a
    record, of itself; tone_phase where it begins, of its cycle.
    """

    vessels: tuple[Vessel, ...]
    joins: tuple[Join, ...]
    ends: tuple[End, ...]
    places: tuple[Place, ...]
    inlet: str
    rho: float
    nu: float
    alpha: float
    friction: float
    eta: float
    P_ref: float
    P_0: float
    elastic_law: str
    viscous_law: str
    unsteady: float = 0.0
    tone: float = 0.0
    tone_phase: float = 0.0
    notes: dict[str, float] = field(default_factory=dict)

    def vessel(self, name: str) -> Vessel:
        """The vessel of that name."""
        return next(v for v in self.vessels if v.name == name)

    def end(self, vessel: str) -> End:
        """The end of that vessel."""
        return next(e for e in self.ends if e.vessel == vessel)

    def with_vessels(self, *changed: Vessel) -> Anatomy:
        """The same with some vessels replaced, by name."""
        new = {v.name: v for v in changed}
        return replace(self, vessels=tuple(new.get(v.name, v) for v in self.vessels))

    def with_ends(self, *changed: End) -> Anatomy:
        """The same with some ends replaced, by vessel."""
        new = {e.vessel: e for e in changed}
        return replace(self, ends=tuple(new.get(e.vessel, e) for e in self.ends))


def anatomy(network: Network) -> Anatomy:
    """The numbers of a network; no hidden effect yet."""
    f = network.fluid
    return Anatomy(
        vessels=tuple(
            Vessel(s.name, s.L, s.R0, s.h, s.E, s.phi0, s.phiNL / s.phi0 if s.phi0 else 0.0, s.ENL / s.E)
            for s in network.segments
        ),
        joins=tuple(Join(j.inflow, j.outflow, j.k) for j in network.junctions),
        ends=tuple(_end(o) for o in network.outlets),
        places=tuple(Place(s.name, s.segment, s.position) for s in network.sites),
        inlet=network.inlet.segment,
        rho=f.rho,
        nu=f.nu,
        alpha=f.alpha,
        friction=f.friction,
        eta=network.eta,
        P_ref=network.P_ref,
        P_0=network.P_0,
        elastic_law=network.elastic_law,
        viscous_law=network.viscous_law,
    )


def _end(outlet: object) -> End:
    match outlet:
        case Reflection():
            return End(outlet.segment, "reflection", R_t=outlet.R_t, P_venous=outlet.P_venous)
        case Windkessel():
            o = outlet
            return End(o.segment, "impedance", R1=o.R1, R2=o.R2, C=o.C, P_venous=o.P_venous)
        case Resistance():
            return End(outlet.segment, "impedance", R1=outlet.R, P_venous=outlet.P_venous)
        case Pressure():
            return End(outlet.segment, "impedance", P_venous=outlet.P_venous)
    raise ValueError(f"{outlet!r}: the generator knows no such outlet; add it to anatomy.py.")
