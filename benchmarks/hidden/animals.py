"""The targets of the groups: standard, and those with more realistic animals, sensors and beats; all are synthetic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

from solver.network.description import Network

from . import words as w
from .counts import share
from .tables import SEPARABLE
from .targets import Targets, gaps
from .words import Line

VISIBLE = {"bench": 12.0, "network": 30.0}
ALL_SENSORS, THREE_PRESSURES = "all", "three pressures"


def standard(lines: Sequence[Line], network: Network) -> str:
    """Records of identical beats, from animals that differ from their model in common."""
    kinds = {kind: [x for x in lines if x["kind"] == kind] for kind in ("bench", "network")}
    t = Targets()
    for kind, own in kinds.items():
        t.at_most(f"false alarms on nulls, {kind}", 0.02, share(w.of(own, "null"), w.detected))
    _bench(t, kinds["bench"])
    for kind, own in kinds.items():
        t.at_most(f"{kind}, single wrong name, all sizes", 0.01, share(w.of(own, "single"), w.wrong))
        t.at_least(f"{kind}, truth in the class, d′ ≥ 6", 0.98, share(w.of(own, "single", 6.0), w.in_class))
    _network(t, kinds["network"], network)
    for kind, own in kinds.items():
        t.outside(kind, own)
    for kind, own in kinds.items():
        _pairs(t, kind, own)
    for kind, own in kinds.items():
        after = [g["best"] for g in gaps(own, 2.0)]
        t.median_at_most(f"{kind}, whitened RMS after, held-out beats (≥ 2 before)", 1.1, after)
    for kind, own in kinds.items():
        t.parameters(kind, own)
        t.confidence(kind, own)
    t.seconds("bench", 10.0, 10.0, kinds["bench"])
    t.seconds("network", 60.0, 90.0, kinds["network"])
    return str(t)


def _bench(t: Targets, bench: Sequence[Line]) -> None:
    for dB, least in ((40.0, 0.95), (30.0, 0.88)):
        seen = [x for x in w.of(bench, "single", VISIBLE["bench"]) if x["dB"] == dB]
        apart = [x for x in seen if w.separation(x) >= SEPARABLE]
        t.at_least(f"bench, d′ ≥ 12, {dB:g} dB: named right", least, share(seen, w.named_right))
        t.at_least("– of these with separation ≥ 6: named right", least, share(apart, w.named_right))
        t.every("– and as a single name", share(apart, w.single_right))


def _network(t: Targets, net: Sequence[Line], network: Network) -> None:
    seen = w.of(net, "single", VISIBLE["network"])
    full = [x for x in seen if x["channels"] == ALL_SENSORS]
    t.at_least("network, P, Q, R at 7 sites, d′ ≥ 30: named right", 0.95, share(full, w.named_right))
    t.at_least("– right place", 0.90, share(full, w.right_place))
    t.at_least("– right or adjacent place", 0.98, share(full, lambda x: w.adjacent_place(x, network)))
    three = [x for x in seen if x["channels"] == THREE_PRESSURES]
    t.at_least("network, pressures at 3 sites, d′ ≥ 30: truth in the class", 0.95, share(three, w.in_class))


def _pairs(t: Targets, kind: str, own: Sequence[Line]) -> None:
    pairs = w.of(own, "pair", 30.0)
    t.at_least(f"{kind}, two effects, both d′ ≥ 30: both named", 0.80, share(pairs, w.both_named))
    t.at_least("– one, and more remains", 0.95, share(pairs, w.one_and_more))
    if apart := [x for x in pairs if x["separation"] is not None and x["separation"] >= SEPARABLE]:
        t.at_least("– of these with separation ≥ 6: both named", 0.80, share(apart, w.both_named))
        t.at_least("– one, and more remains", 0.95, share(apart, w.one_and_more))
    alone = [x for x in own if w.pair_alone(x)]
    t.add(f"{kind}, two names without rivals, not both true", "–", share(alone, w.wrong_pair))


_MOST, _LONGEST = 60.0, 300.0  # [s] of CPU time of nearly every record, and of any


def walls(lines: Sequence[Line]) -> str:
    """Individual walls."""
    t = Targets()
    nulls, seen = w.of(lines, "null"), w.of(lines, "single", 30.0)
    t.at_most("nothing hidden: false alarms", 0.03, share(nulls, w.detected))
    for spread in sorted({x["walls"] for x in nulls}):
        t.add(f"– spread × {spread:g}", "–", share((x for x in nulls if x["walls"] == spread), w.detected))
    t.add("– individual walls selected", "–", share(nulls, lambda x: x.get("held") == "individual"))
    full = [x for x in seen if x["channels"] == ALL_SENSORS]
    t.at_least("one effect, P, Q, R at 7 sites, d′ ≥ 30: right name in the class", 0.90, share(full, w.in_class))
    t.at_least("– right place", 0.85, share(full, w.right_place))
    t.at_most("– single wrong name", 0.02, share(full, w.wrong))
    t.add("– named, and more remains", "–", share(full, w.partial))
    t.add("– no name", "–", share(full, lambda x: not w.claims(x)))
    three = [x for x in seen if x["channels"] == THREE_PRESSURES]
    t.at_least("the same, pressures at 3 sites: truth in the class", 0.90, share(three, w.in_class))
    t.at_most("all sizes and sensors: single wrong name", 0.02, share(w.of(lines, "single"), w.wrong))
    _rest(t, lines)
    return str(t)


def sensors(lines: Sequence[Line]) -> str:
    """Noise in the units of the sensors."""
    t = Targets()
    for kind, own in _kinds(lines):
        t.at_most(f"{kind}, nothing hidden: false alarms", 0.02, share(w.of(own, "null"), w.detected))
        t.at_least(f"{kind}, truth in the class, d′ ≥ 6", 0.98, share(w.of(own, "single", 6.0), w.in_class))
        t.at_most(f"{kind}, single wrong name", 0.01, share(w.of(own, "single"), w.wrong))
    _rest(t, lines)
    return str(t)


def varying(lines: Sequence[Line]) -> str:
    """Intervals and strokes that vary from beat to beat."""
    t = Targets()
    for kind, own in _kinds(lines):
        nulls = w.of(own, "null")
        t.at_most(f"{kind}, nothing hidden: false alarms", 0.05, share(nulls, w.alarm))
        t.at_most(f"{kind}, nothing hidden: unusable", 0.25, share(nulls, w.unusable))
        usable = [x for x in w.of(own, "single", 30.0) if not w.unusable(x)]
        t.add(f"{kind}, d′ ≥ 30 and usable: truth in the class", "–", share(usable, w.in_class))
        t.add(f"{kind}, single wrong name", "–", share(w.of(own, "single"), w.wrong))
    _rest(t, lines)
    return str(t)


def offcentre(lines: Sequence[Line]) -> str:
    """Local effects away from the middle of their segment."""
    t = Targets()
    seen = w.of(lines, "single", 30.0)
    for what, test in _spreads():
        own = [x for x in seen if test(x)]
        t.add(f"{what}, d′ ≥ 30: named right", "–", share(own, w.named_right))
        t.add("– right segment", "–", share(own, w.right_place))
        t.add("– right name in the class", "–", share(own, w.in_class))
        t.add("– single wrong name", "–", share(own, w.wrong))
    places = [e for x in seen if w.right_place(x) for e in w.errors(x) if e[0].endswith("_position")]
    if places:
        t.add("position x/L: median error", "–", f"{median(abs(e[2]) for e in places):.3f}; {len(places)}")
        t.covered("position x/L: 95 % interval covers", [e[3] for e in places])
    _rest(t, lines)
    return str(t)


def outside_walls(lines: Sequence[Line]) -> str:
    """Effects outside the catalogue, in individual walls."""
    t = Targets()
    for kind, own in _kinds(lines):
        t.outside(kind, own)
        seen = w.of(own, "outside", 30.0)
        if kind == "network":
            placed = [x for x in seen if not w.wanders(x)]
            t.at_least("– the map has the place (wandering tones excluded)", 0.90, share(placed, w.acts_right))
            t.add("– and no other place is as probable", "–", share(placed, lambda x: w.acts_right(x, 1)))
        t.add("– named, and more remains", "–", share(seen, w.partial))
        t.add("– unknown", "–", share(seen, lambda x: x["verdict"] == "unknown"))
    return str(t)


def own(lines: Sequence[Line]) -> str:
    """A parameter of one wall or outlet that is far off. Its d' is at most its distance in the spread of the animal."""
    t = Targets()
    for least in (0.0, 12.0):
        named, radius = (w.of(lines, what, least) for what in ("single", "outside"))
        t.at_least(f"outlier of E or R_t, d′ ≥ {least:g}: named at its place", 0.95, share(named, w.right_place))
        t.add("– on the map at its place", "–", share(named, w.acts_right))
        t.at_most("– single wrong name", 0.02, share(named, w.wrong))
        t.at_least(f"outlier of R0, d′ ≥ {least:g}: on the map at its place", 0.95, share(radius, w.acts_right))
        t.add("– single name", "–", share(radius, w.single))
    _rest(t, lines)
    return str(t)


def elastic(lines: Sequence[Line]) -> str:
    """Individual walls without viscosity."""
    t = Targets()
    seen = w.of(lines, "single", 30.0)
    t.at_least("one effect, d′ ≥ 30: right name in the class", 0.90, share(seen, w.in_class))
    t.at_least("– right place", 0.85, share(seen, w.right_place))
    t.at_most("– single wrong name", 0.02, share(seen, w.wrong))
    _two(t, lines)
    _rest(t, lines)
    return str(t)


def pairs(lines: Sequence[Line]) -> str:
    """Two effects in individual walls."""
    t = Targets()
    _two(t, lines)
    _rest(t, lines)
    return str(t)


def three(lines: Sequence[Line]) -> str:
    """One effect in individual walls, observed by the inflow and three pressures."""
    t = Targets()
    for least in (12.0, 30.0):
        seen = w.of(lines, "single", least)
        t.at_least(f"d′ ≥ {least:g}: the reported places include the true one", 0.95, share(seen, w.holds_place))
        sizes = [float(len(w.reported_places(x))) for x in seen if w.reported_places(x)]
        t.median_at_most("– number of reported places, if any", 3, sizes)
        t.add("– right name in the class", "–", share(seen, w.in_class))
        t.at_most("– single wrong name", 0.02, share(seen, w.wrong))
        t.add("– `none`", "–", share(seen, lambda x: not w.detected(x)))
    _rest(t, lines)
    return str(t)


def _two(t: Targets, lines: Sequence[Line]) -> None:
    """Two effects, each beside the other."""
    seen = w.of(lines, "pair", 30.0)
    t.at_least("two effects, both d′ ≥ 30: both named", 0.85, share(seen, w.both_named))
    t.every(
        "– or one of them, with the note that more remains", share(seen, lambda x: w.both_named(x) or w.one_and_more(x))
    )
    alone = [x for x in w.of(lines, "pair") if w.pair_alone(x)]
    t.add("two names without rivals, not both true", "–", share(alone, w.wrong_pair))


GROUPS: dict[str, Callable[[Sequence[Line]], str]] = {
    "walls": walls,
    "sensors": sensors,
    "varying": varying,
    "offcentre": offcentre,
    "outside_walls": outside_walls,
    "own": own,
    "elastic": elastic,
    "pairs": pairs,
    "three": three,
}


def _rest(t: Targets, lines: Sequence[Line]) -> None:
    """The targets of every group: the gap on held-out beats, parameters, confidence, time."""
    for kind, own in _kinds(lines):
        closed = [g["best"] / g["given"] for g in gaps(own) if g.get("given")]
        t.median_at_most(f"{kind}, gap on held-out beats after/before, effects named right", 0.3, closed)
        t.parameters(kind, own)
        t.confidence(kind, own)
        t.add(f"{kind}, search incomplete", "–", share(own, lambda x: not x.get("complete", True)))
        t.seconds(kind, _MOST, _LONGEST, own)


def _kinds(lines: Sequence[Line]) -> list[tuple[str, list[Line]]]:
    found = [(kind, [x for x in lines if x["kind"] == kind]) for kind in ("bench", "network")]
    return [(kind, own) for kind, own in found if own]


def _spreads() -> tuple[tuple[str, Callable[[Line], bool]], ...]:
    return ("walls alike", lambda x: not x["walls"]), ("individual walls", lambda x: bool(x["walls"]))
