"""The sections of arteries to the sites: one path in the order of the delays, or the given paths, and side branches;
their walls, and the Windkessels at their ends.

Arteries narrow on their way: R0(x) = R0 (1 + s (x/L - 1/2)), with s = TAPER for the whole way to the farthest site.
With h and E constant, c ∝ R^(-1/2) and Z ∝ R^(-5/2) along a tube.

The shares of the flow that no measurement gives are unknowns of a fit. Where a tube forks, the branches whose flow is
not measured divide the remaining flow: the first takes the part

    f' = f e^u/(1 - f + f e^u)

of it for an estimate f, and the others share the remainder in the same ratio as before. A tube with r times the flow
has √r times the radius and thickness, so that its impedance is divided by r, and its Windkessel has R1/r, r C and 1/r
of the resistance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.laws.effects import Taper
from solver.laws.outlets import Windkessel
from solver.network.description import Fluid
from solver.quantities.units import INFLOW, of_signal

from ..records.alignment.beats import Array, Beats
from .options import Typical

_SIDE = 0.05  # of the flow: a larger loss between two sites leaves through a side branch
_ROOT = "root"  # name of the first tube of a record without a site at the root
_TRUNK = 0.5  # of the first delay: the common part of vessels that fork at the root


@dataclass(frozen=True)
class Section:
    """A section of the arteries without its wall, named after the site at its end, or at the root.

    parent : name of the one upstream, "" at the root. site : at its end, "" if none. time : transit time of a wave [s].
    share : fraction of the inflow that enters it. end : whether a Windkessel is at its end. measured : whether a
    measurement gives the share.
    """

    name: str
    parent: str
    site: str
    time: float
    share: float
    end: bool = True
    measured: bool = False


def parents(paths: Sequence[str], root: str, delays: Mapping[str, float]) -> dict[str, str]:
    """The site upstream of each site, "" next to the root. paths : "Ao,CA", each from the root; none: by the delays.

    Raises ValueError for a path with unknown sites, for two ways to a site and for a site on no path.
    """
    known = sorted(delays, key=lambda site: delays[site])
    found: dict[str, str] = {}
    for path in paths or [",".join(known)]:
        sites = [site for site in path.replace(",", " ").split() if site not in (root, "inlet")]
        for site, before in zip(sites, ["", *sites], strict=False):
            if site not in delays or found.get(site, before) != before or delays.get(before, 0.0) > delays[site]:
                others = ", ".join(known) or "none beside the root"
                raise InputError(
                    f'--path "{path}": {site} must be a site of the record ({others}), later than the one before it, '
                    "and reached by one way; give each path from the root on."
                )
            found[site] = before
    if set(found) != set(delays):
        raise InputError(
            f"--path: {', '.join(sorted(set(delays) - set(found)))} is on none of the paths; add it to one."
        )
    return found


def layouts(
    beats: Beats, root: str, upstream: Mapping[str, str], delays: Mapping[str, float], alone: float, area: float,
    stated: bool,
) -> list[list[Section]]:  # fmt: skip
    """Tubes that a record may have: as the paths say if they are stated; otherwise one path, or for several sites a
    fork at the end of a trunk, with a branch for each."""
    ways = [upstream] if stated or len(upstream) < 2 else [upstream, dict.fromkeys(upstream, "")]
    return [sections(beats, root, way, delays, alone, area) for way in ways]


def with_side_branch(tubes: Sequence[Section], root: str) -> list[Section]:
    """The tubes with another side branch on the longest way to a site, in the middle of the last tube whose flow is not
    measured. The branch takes half of the flow that no measurement claims; there is none if all is claimed. The second
    half of the tube keeps the name; that of a single tube without a site is called ``<root>_end``."""
    until = arrivals(tubes)
    ends = [each for each in tubes if each.end and each.site] or tubes
    last = max(ends, key=lambda each: until[each.name])
    while last.measured and last.parent:
        last = next(each for each in tubes if each.name == last.parent)
    claimed = sum(each.share for each in tubes if each.measured and each.parent == last.name)
    if last.measured or claimed > (1.0 - _SIDE) * last.share:
        return []
    alone = len(tubes) == 1 and not last.site
    names = {each.name for each in tubes if each is not last or not alone}
    start, end = root or _ROOT, f"{last.name}_end" if alone else last.name
    if start in names:
        start = next(name for i in count(1) if (name := f"to_{end}_{i}") not in names)
    half = 0.5 * last.time
    trunk = replace(last, name=start, site="", time=half, end=False)
    side = Section(f"{start}_side", start, "", half, 0.5 * (last.share - claimed))
    downstream = replace(last, name=end, parent=start, time=half, share=last.share - side.share)
    at = tubes.index(last)
    return shared([*tubes[:at], trunk, downstream, side, *tubes[at + 1 :]])


def shared(tubes: Sequence[Section]) -> list[Section]:
    """The tubes with the flow that they carry: the measured flow, and in the others the remaining flow in proportion to
    their shares."""
    flows = carried(tubes, {})
    return [replace(each, share=float(flows[each.name])) for each in tubes]


def carried(tubes: Sequence[Section], odds: Mapping[str, Array]) -> dict[str, Array]:
    """The share of the inflow in each tube. odds : factors of the shares of tubes whose flow is not measured, before
    these tubes divide the remaining flow."""
    found: dict[str, Array] = {"": np.ones(())}
    for each in tubes:
        siblings = [other for other in tubes if other.parent == each.parent]
        whole = found[each.parent]
        unmeasured = np.maximum(whole - sum(other.share for other in siblings if other.measured), _SIDE * whole)
        weights = {o.name: o.share * odds.get(o.name, np.ones(())) for o in siblings if not o.measured}
        found[each.name] = np.asarray(
            each.share if each.measured else unmeasured * weights[each.name] / sum(weights.values())
        )
    return found


def arrivals(tubes: Sequence[Section]) -> dict[str, float]:
    """When a wave from the root is at the end of each tube [s]."""
    found = {"": 0.0}
    for each in tubes:
        found[each.name] = found[each.parent] + each.time
    return found


def sections(
    beats: Beats, root: str, upstream: Mapping[str, str], delays: Mapping[str, float], alone: float, area: float,
) -> list[Section]:  # fmt: skip
    """The tubes, each after the one upstream of it.

    upstream : as :func:`parents`. alone : time [s] through the one tube of a record without other sites. area : of a
    tube with all of the flow [m²].

    Flow is shared as measured, or in proportion to the measured areas, or otherwise equally; flow lost on the way
    leaves through a side branch.
    """
    if not upstream:
        return [Section(root or _ROOT, "", "", alone, 1.0)]
    first = [site for site, before in upstream.items() if not before]
    trunk = _TRUNK * min(delays[site] for site in first)
    shares = _shares(beats, upstream, area)
    measured = {site for site in upstream if f"{site}.Q" in beats.values or f"{site}.R" in beats.values}
    found: list[Section] = []
    lost = 1.0 - sum(shares[site] for site in first)
    if len(first) > 1 or lost > _SIDE:
        found = [Section(root or _ROOT, "", "", trunk, 1.0)]
        found += _side(found[0], lost)
    for site in sorted(upstream, key=lambda site: delays[site]):
        before = upstream[site]
        parent = next((each.name for each in found if each.site == before), "")
        time = delays[site] - (delays[before] if before else trunk if found and found[0].site == "" else 0.0)
        time = max(time, beats.T / beats.N)
        found.append(Section(site, parent, site, time, shares[site], measured=site in measured))
        children = [other for other in upstream if upstream[other] == site]
        if children:
            found += _side(found[-1], shares[site] - sum(shares[child] for child in children))
    heads = {each.parent for each in found}
    return [replace(each, end=each.name not in heads) for each in found]


def _side(of: Section, lost: float) -> list[Section]:
    """The side branch at the end of a section for the flow lost there."""
    return [Section(f"{of.name}_side", of.name, "", of.time, lost)] if lost > _SIDE else []


def _shares(beats: Beats, upstream: Mapping[str, str], area: float) -> dict[str, float]:
    """The share of the mean inflow that reaches each site: never more than that of the site upstream."""
    whole = beats.mean(INFLOW).mean()
    found: dict[str, float] = {"": 1.0}
    waiting = list(upstream)
    while waiting:
        before = next(upstream[site] for site in waiting if upstream[site] in found)
        here = [site for site in waiting if upstream[site] == before]
        measured = {s: np.pi * float(beats.mean(f"{s}.R").mean()) ** 2 / area for s in here if f"{s}.R" in beats.values}
        measured |= {s: float(beats.mean(f"{s}.Q").mean() / whole) for s in here if f"{s}.Q" in beats.values}
        unmeasured, others = found[before] - sum(measured.values()), len(here) - len(measured)
        mine = {s: measured.get(s, max(unmeasured, _SIDE * found[before]) / max(others, 1)) for s in here}
        total = sum(mine.values())
        if min(mine.values()) <= 0.0:
            least = f"{min(mine, key=lambda s: mine[s])}.Q"
            unit, shown = of_signal(least)
            mean = f"{shown * float(beats.mean(least).mean()):.3g} {unit}"
            raise InputError(
                f"{beats.source}: the mean of {least} is {mean}, and that "
                f'of an artery is positive; check its sign (--map "TITLE=-{least}" turns it) and its zero.'
            )
        found |= {s: x * min(1.0, found[before] / total) for s, x in mine.items()}
        waiting = [site for site in waiting if site not in here]
    return {site: share for site, share in found.items() if site}


SPREAD, FARTHEST = 1.0, 3.0  # standard deviation and range of u: judgement; a half becomes 0.05 to 0.95


def forks(tubes: Sequence[Section]) -> list[tuple[Section, ...]]:
    """The branches of each tube whose flow is not measured, if there are several."""
    found = [tuple(each for each in tubes if each.parent == tube.name and not each.measured) for tube in tubes]
    return [branches for branches in found if len(branches) > 1]


def ratios(tubes: Sequence[Section], u: Array) -> Mapping[str, Array]:
    """r of each tube, for u : (…, n_forks)."""
    odds = {first.name: np.exp(u[..., i]) for i, (first, *_) in enumerate(forks(tubes))}
    flows = carried(tubes, odds)
    return {each.name: flows[each.name] / each.share * np.ones(u.shape[:-1]) for each in tubes}


# --- walls and Windkessels --------------------------------------------------------------------------------------------

# s of a whole way, and its standard deviation: radii of the bundled aortas fall by 0.14 (sheep, AA to DD) to 0.75
# (human, to its bifurcation) of their mean, and a tube of a laboratory by nothing
TAPER, TAPER_ERROR = -0.4, 0.3
TAPERED = Taper.at_ends["R0"]  # the key of s
KEYS = tuple(Windkessel.__annotations__)[:3]  # of what windkessel() gives
_ETA = 0.5  # of a network file without eta
_PROXIMAL = 0.5  # of the resistance of an end: upper limit of R1
_LEAST = 0.1  # of the same: lower limit of R2


def keyed(**values: Any) -> dict[str, Any]:
    """Values by the keys of walls and Windkessels."""
    return values


@dataclass(frozen=True)
class Tube:
    """A tube: a section with its wall [SI]; R0, Z : radius and impedance at its middle."""

    section: Section
    L: float
    R0: float
    h: float
    E: float
    phi0: float
    Z: float
    taper: float

    @property
    def R_end(self) -> float:
        """The radius at its end [m]."""
        return self.R0 * (1.0 + 0.5 * self.taper)

    @property
    def Z_end(self) -> float:
        """The impedance at its end [Pa·s/m³]."""
        return self.Z * (self.R0 / self.R_end) ** 2.5


def narrowed(sections: Sequence[Section], s: Array | float) -> dict[str, tuple[Array, Array]]:
    """The taper of each tube and its R0 over the radius of the root, for all of the flow, if the way to the farthest
    site narrows by s.

    A tube narrows by its part of the time of that way. Impedances match at junctions, Z ∝ c/A, so that a tube b behind
    a tube a has R0_b/R0_a = ((1 + s_a/2)/(1 - s_b/2))^(5/4) with all of the flow.
    """
    until = arrivals(sections)
    found: dict[str, tuple[Array, Array]] = {}
    for each in sections:
        taper = np.asarray(s * each.time / max(until.values()))
        start = 1.0 - 0.5 * taper
        if each.parent:
            before, R0 = found[each.parent]
            found[each.name] = taper, R0 * ((1.0 + 0.5 * before) / start) ** 1.25
        else:
            found[each.name] = taper, 1.0 / start
    return found


def on_the_way(sections: Sequence[Section], values: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
    """The resistance of the way to the end of each tube for the flow there, by friction along it, with C_f = friction π
    ν: in a tube ρ C_f L/A² at its middle times the mean of (R0/R)⁴, (1 + a²/3)/(1 - a²)³ for a = s/2. A way also
    carries the flow of other tubes. values : L, R0 and taper of each tube, and the share of the flow.
    """
    fluid, found = Fluid(), dict[str, Array]()
    for each in sections:
        L, R0, taper, share = (values[each.name][key] for key in ("L", "R0", TAPERED, "share"))
        a2 = 0.25 * taper**2
        own = fluid.rho * fluid.friction * np.pi * fluid.nu * L / (np.pi * R0**2) ** 2
        own = own * (1.0 + a2 / 3.0) / (1.0 - a2) ** 3
        before = found[each.parent] * values[each.parent]["share"] if each.parent else 0.0
        found[each.name] = own + before / share
    return found


def mean_speed(start: float) -> float:
    """The wave speed at the middle of a tube from that at its start."""
    return start * (1.0 - 0.5 * TAPER) ** 0.5


def made(sections: Sequence[Section], c: float, area: float, usual: Typical) -> list[Tube]:
    """The tubes, with the wave speed c [m/s] at their middles and the area [m²] at the root, for all of the flow:
    Z = ρ c/(π R0²), and c² = E h/(2 ρ (1 - η²) R0)."""
    rho, found = Fluid().rho, list[Tube]()
    shape = narrowed(sections, TAPER)
    for each in sections:
        taper, factor = map(float, shape[each.name])
        R0 = float(np.sqrt(area * each.share / np.pi)) * factor
        E = 2.0 * rho * c**2 * (1.0 - _ETA**2) / usual.h_R
        Z = rho * c / (np.pi * R0**2)
        found.append(Tube(each, c * each.time, R0, usual.h_R * R0, E, usual.relaxation * E, Z, taper))
    return found


def windkessel(end: Tube, tubes: Sequence[Tube], R: float, C: float) -> tuple[float, float, float]:
    """R1 [Pa·s/m³], C [m³/Pa] and R2 at the end of a tube, for a network of resistance R with C at all ends together.

    Including the friction on the way, a share s has the resistance R/s.
    """
    share = end.section.share
    values = {t.section.name: {**keyed(L=t.L, R0=t.R0, share=t.section.share), TAPERED: np.asarray(t.taper)}
              for t in tubes}  # fmt: skip
    way = float(on_the_way([t.section for t in tubes], values)[end.section.name])
    R1 = min(end.Z_end, _PROXIMAL * R / share)
    return R1, C * share, float(rest_of(R / share, R1, way))


def rest_of(whole: Array | float, R1: Array | float, way: Array | float) -> Array:
    """R2 of an end whose whole resistance includes R1 and that of the way."""
    return np.maximum(whole - R1 - way, _LEAST * np.asarray(whole))
