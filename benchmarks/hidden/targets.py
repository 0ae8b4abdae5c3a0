"""The targets of the bank against what was measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import numpy as np

from solver.network import Network

from . import words as w
from .counts import Share, markdown, share
from .tables import SEPARABLE, calibration_error

Line = dict[str, Any]

VISIBLE = {"bench": 12.0, "network": 30.0}
ALL_SENSORS, THREE_PRESSURES = "all", "three pressures"


def targets(lines: Sequence[Line], network: Network) -> str:
    """The table of the targets."""
    bench = [x for x in lines if x["kind"] == "bench"]
    net = [x for x in lines if x["kind"] == "network"]
    rows: list[tuple[str, str, str, str]] = []

    def add(what: str, target: str, measured: object, met: bool | None) -> None:
        rows.append((what, target, str(measured), "–" if met is None else "yes" if met else "**no**"))

    def at_least(what: str, least: float, s: Share) -> None:
        add(what, f"≥ {100 * least:g} %", s, s.value >= least if s.n else None)

    def at_most(what: str, most: float, s: Share) -> None:
        add(what, f"≤ {100 * most:g} %", s, s.value <= most if s.n else None)

    for kind, own in (("bench", bench), ("network", net)):
        at_most(f"false alarms on nulls, {kind}", 0.02, share(w.of(own, "null"), w.detected))
    for dB, least in ((40.0, 0.95), (30.0, 0.88)):
        seen = [x for x in w.of(bench, "single", VISIBLE["bench"]) if x["dB"] == dB]
        apart = [x for x in seen if w.separation(x) >= SEPARABLE]
        at_least(f"bench, d′ ≥ 12, {dB:g} dB: named right", least, share(seen, w.named_right))
        at_least("– of these with separation ≥ 6: named right", least, share(apart, w.named_right))
        add("– and as a single name", "all", share(apart, w.single_right), None)
    for kind, own in (("bench", bench), ("network", net)):
        at_most(f"{kind}, single name but wrong, all sizes", 0.01, share(w.of(own, "single"), w.wrong))
        at_least(f"{kind}, truth in the class, d′ ≥ 6", 0.98, share(w.of(own, "single", 6.0), w.in_class))
    full = [x for x in w.of(net, "single", VISIBLE["network"]) if x["channels"] == ALL_SENSORS]
    at_least("network, P, Q, R at 7 sites, d′ ≥ 30: named right", 0.95, share(full, w.named_right))
    at_least("– right place", 0.90, share(full, w.right_place))
    at_least("– right or adjacent place", 0.98, share(full, lambda x: w.adjacent_place(x, network)))
    three = [x for x in w.of(net, "single", VISIBLE["network"]) if x["channels"] == THREE_PRESSURES]
    at_least("network, pressures at 3 sites, d′ ≥ 30: truth in the class", 0.95, share(three, w.in_class))
    for kind, own in (("bench", bench), ("network", net)):
        at_most(
            f"{kind}, outside the catalogue, d′ ≥ 30: wrongly named",
            0.05,
            share(w.of(own, "outside", 30.0), w.committed),
        )
    for kind, own in (("bench", bench), ("network", net)):
        pairs = w.of(own, "pair", 30.0)
        at_least(f"{kind}, two effects, both d′ ≥ 30: both named", 0.80, share(pairs, w.both_named))
        at_least("– one, and more remains", 0.95, share(pairs, w.one_and_more))
        alone = [x for x in own if w.pair_alone(x)]
        add(f"{kind}, two names without rivals, not both of them hidden", "–", share(alone, w.wrong_pair), None)
    for kind, own in (("bench", bench), ("network", net)):
        _gap_targets(add, kind, own)
    for kind, own in (("bench", bench), ("network", net)):
        _parameter_targets(add, kind, own)
        stated = [x for x in own if w.claims(x)]
        if stated:
            e = calibration_error(stated)
            add(f"{kind}, calibration error of the confidence", "≤ 0.05", f"{e:.3f} ({len(stated)})", e <= 0.05)
    for kind, own, most in (("bench", bench, 10.0), ("network", net, 90.0)):
        seconds = [x["seconds"] for x in own if "seconds" in x]
        if seconds:
            text = f"median {median(seconds):.2g}, 95 % {np.quantile(seconds, 0.95):.2g}, largest {max(seconds):.2g} s"
            add(f"{kind}, CPU time of find and name", f"≤ {most:g} s", text, max(seconds) <= most)
    return markdown(("quantity", "target", "measured (95 % bounds)", "met"), rows, left=2)


def _gap_targets(add: Callable[..., None], kind: str, own: Sequence[Line]) -> None:
    """Whitened RMS of held-out beats, of what was named right and left a gap of at least 2."""
    gaps = [x["gap"]["held_out"] for x in own if w.group(x) == "single" and w.named_right(x)]
    gaps = [g for g in gaps if g.get("refitted", 0.0) >= 2.0 and "best" in g]
    if gaps:
        after = [g["best"] for g in gaps]
        text = (
            f"median {median(after):.2f}, 90 % {np.quantile(after, 0.9):.2f}; {share(gaps, lambda g: g['best'] <= 1.1)}"
        )
        add(f"{kind}, whitened RMS after, held-out beats (≥ 2 before)", "≤ 1.1", text, median(after) <= 1.1)


def _parameter_targets(add: Callable[..., None], kind: str, own: Sequence[Line]) -> None:
    found = [e for x in own if w.group(x) == "single" and w.right_place(x) and w.single(x) for e in w.errors(x)]
    if found:
        bias = median(error / size for _, size, error, _ in found if size)
        covered = Share(sum(e[3] for e in found), len(found))
        add(f"{kind}, parameter: median relative error", "≤ 10 %", f"{100 * bias:+.2f} %", abs(bias) <= 0.1)
        add(f"{kind}, parameter: 95 % interval covers", "90–98 %", covered, 0.9 <= covered.value <= 0.98)
