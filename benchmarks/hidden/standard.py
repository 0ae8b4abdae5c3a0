"""The targets of the standard group: records of identical beats, from animals that differ from their model in
common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from solver.network.description import Network

from . import words as w
from .counts import share
from .tables import SEPARABLE
from .targets import Targets, gaps

Line = dict[str, Any]

VISIBLE = {"bench": 12.0, "network": 30.0}
ALL_SENSORS, THREE_PRESSURES = "all", "three pressures"


def standard(lines: Sequence[Line], network: Network) -> str:
    """The table of the targets."""
    kinds = {kind: [x for x in lines if x["kind"] == kind] for kind in ("bench", "network")}
    t = Targets()
    for kind, own in kinds.items():
        t.at_most(f"false alarms on nulls, {kind}", 0.02, share(w.of(own, "null"), w.detected))
    _bench(t, kinds["bench"])
    for kind, own in kinds.items():
        t.at_most(f"{kind}, single name but wrong, all sizes", 0.01, share(w.of(own, "single"), w.wrong))
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
        t.at_least("– of these no single one leaves less than 6: both named", 0.80, share(apart, w.both_named))
        t.at_least("– one, and more remains", 0.95, share(apart, w.one_and_more))
    alone = [x for x in own if w.pair_alone(x)]
    t.add(f"{kind}, two names without rivals, not both of them hidden", "–", share(alone, w.wrong_pair))
