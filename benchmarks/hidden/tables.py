"""The tables behind the targets: power, confusion, classes, places, confidence and parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from solver.network.description import Network

from . import words as w
from .counts import Share, markdown, share
from .words import Line

POWER_BINS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 20.0, 30.0, 60.0, 120.0, np.inf)
SEPARABLE = 6.0
LEAST = 6.0  # d' of a single effect in most tables


def verdicts(lines: Sequence[Line]) -> str:
    """The number of verdicts of each kind in each group."""
    names = ("none", "effect", "ambiguous", "several", "partial", "unknown", "unusable", "crashed")
    rows = []
    for group in ("null", "single", "pair", "outside"):
        count = Counter(x["verdict"] for x in lines if w.hides(x) == group)
        rows.append((group, sum(count.values()), *(count[name] or "" for name in names)))
    return markdown(("hidden", "records", *names), rows)


def power(lines: Sequence[Line]) -> str:
    """Detected, named right, in the class, single, wrong, by d'."""
    rows = []
    singles = w.of(lines, "single")
    for low, high in zip(POWER_BINS, POWER_BINS[1:], strict=False):
        own = [x for x in singles if low <= w.d_prime(x) < high]
        if own:
            tests = (w.detected, w.named_right, w.in_class, w.single_right, w.wrong)
            cells = [f"{100 * share(own, test).value:.0f} %" for test in tests]
            rows.append((f"{low:g}–{high:g}" if np.isfinite(high) else f"≥ {low:g}", len(own), *cells))
    header = ("d′", "records", "detected", "named right", "in the class", "single and right", "single and wrong")
    return markdown(header, rows)


def confusion(lines: Sequence[Line]) -> str:
    """Rows: hidden effects (single ones with d' of at least LEAST, and all nulls); columns: the first name."""
    chosen = w.of(lines, "single", LEAST) + w.of(lines, "null")
    truth = sorted({w.truths(x)[0] for x in chosen if x["effects"]})
    columns = sorted({*truth, *(w.reported(x) for x in chosen)} - set(_VERDICTS)) + list(_VERDICTS)
    columns = [c for c in columns if c in truth or any(w.reported(x) == c for x in chosen)]
    rows = []
    for name in [*truth, ""]:
        own = [x for x in chosen if w.truths(x) == ((name,) if name else ())]
        count = Counter(w.reported(x) for x in own)
        label = f"{columns.index(name) + 1} {name}" if name else "nothing hidden"
        rows.append((label, *(_bold(count[c], c == name) for c in columns)))
    header = [c if c in _VERDICTS else str(i + 1) for i, c in enumerate(columns)]
    rest = [f"{i + 1} {c}" for i, c in enumerate(columns) if c not in truth and c not in _VERDICTS]
    note = f"Single effects with d′ ≥ {LEAST:g}, and all nulls." + (f" {', '.join(rest)}." if rest else "")
    return f"{note}\n\n" + markdown(("hidden \\ reported", *header), rows)


_VERDICTS = ("none", "several", "partial", "unknown", "unusable", "crashed")


def _bold(n: int, diagonal: bool) -> str:
    return f"**{n}**" if diagonal and n else str(n or "")


def by_effect(lines: Sequence[Line]) -> str:
    """Per hidden effect, with d' of at least LEAST: separable or not."""
    rows = []
    for name in sorted({w.truths(x)[0] for x in w.of(lines, "single")}):
        own = [x for x in w.of(lines, "single", LEAST) if w.truths(x)[0] == name]
        apart = [x for x in own if w.separation(x) >= SEPARABLE]
        cells = [_of(own, w.named_right), _of(own, w.in_class), _of(apart, w.named_right), _of(apart, w.single_right),
                 _of(own, w.wrong)]  # fmt: skip
        rows.append((name, *cells))
    header = (f"hidden, d′ ≥ {LEAST:g}", "named right", "in the class", "separable: named right", "– single", "wrong")
    return markdown(header, rows)


def _of(lines: Sequence[Line], test: Callable[[Line], bool]) -> str:
    s = share(lines, test)
    return f"{s.hits}/{s.n}" if s.n else ""


def places(lines: Sequence[Line], network: Network) -> str:
    """Of the effects named right, by d': right place, adjacent place."""
    rows = []
    for sensors in ("all", "three pressures"):
        for least in (6.0, 30.0):
            own = [x for x in w.of(lines, "single", least) if x["channels"] == sensors and w.named_right(x)]
            apart = [x for x in own if x["place_separation"] is None or x["place_separation"] >= SEPARABLE]
            adjacent = share(own, lambda x: w.adjacent_place(x, network))
            rows.append((sensors, f"≥ {least:g}", share(own, w.right_place), adjacent, share(apart, w.right_place)))
    header = ("sensors", "d′", "right place", "right or adjacent", "right, separation of places ≥ 6")
    return "Of the effects named right:\n\n" + markdown(header, rows)


def ambiguous(lines: Sequence[Line]) -> str:
    """The members of the classes, per hidden effect."""
    rows = []
    for name in sorted({w.truths(x)[0] for x in w.of(lines, "single", LEAST)}):
        own = [x for x in w.of(lines, "single", LEAST) if w.truths(x)[0] == name]
        several = [x for x in own if x["verdict"] == "ambiguous"]
        others = Counter(n for x in several for n in {m[0]["name"] for m in x["class"]} - {name})
        if several:
            rivals = Counter(x["rival"].partition("@")[0] for x in several)
            rows.append((name, f"{len(several)}/{len(own)}", _counted(others), _counted(rivals)))
    note = f"Single effects with d′ ≥ {LEAST:g} and verdict `ambiguous`: the other names in their classes, and the\n" \
           "nearest rival that the generator sees."  # fmt: skip
    return f"{note}\n\n" + markdown(("hidden", "ambiguous", "with", "nearest rival"), rows, left=4)


def _counted(count: Counter[str]) -> str:
    return ", ".join(f"{name} {n}" for name, n in count.most_common())


def parameters(lines: Sequence[Line]) -> str:
    """Errors of the parameters of the effects that were named, singly and right, where they are."""
    rows = []
    chosen = [x for x in lines if w.hides(x) == "single" and w.right_place(x) and w.single(x)]
    for name in sorted({w.truths(x)[0] for x in chosen}):
        own = [e for x in chosen if w.truths(x)[0] == name for e in w.errors(x)]
        for key in dict.fromkeys(e[0] for e in own):
            mine = [e for e in own if e[0] == key]
            relative = np.array([error / size for _, size, error, _ in mine if size])
            spread = f"{100 * np.median(np.abs(relative)):.1f} %"
            covered = Share(sum(e[3] for e in mine), len(mine))
            rows.append((f"{name} `{key}`", len(mine), f"{100 * np.median(relative):+.1f} %", spread, covered))
    note = "Errors relative to the effect's size (value minus the neutral value)."
    return f"{note}\n\n" + markdown(("parameter", "records", "median error", "median absolute error", "covered"), rows)


def closed(lines: Sequence[Line]) -> str:
    """The share of the gap on held-out beats that the named effects close, and the remainder, by verdict."""
    rows = []
    for verdict in ("effect", "ambiguous", "several", "partial"):
        own = [x for x in lines if x["verdict"] == verdict]
        found = [x["gap"]["held_out"] for x in own]
        found = [g for g in found if g.get("given") and "best" in g]
        if found:
            before, after, ratio = (
                f"{np.median(v):.2f}"
                for v in zip(*((g["given"], g["best"], g["best"] / g["given"]) for g in found), strict=True)
            )
            rows.append((verdict, len(own), share(own, w.confident_right), before, after, ratio))
    note = "Medians of the whitened RMS on held-out beats; 1 is noise, and more is a remaining gap."
    header = ("verdict", "records", "right name and place", "gap before", "after (remains)", "after/before")
    return f"{note}\n\n" + markdown(header, rows)


def outside(lines: Sequence[Line]) -> str:
    """The verdicts on effects outside the catalogue."""
    rows = []
    for name in sorted({w.beyond(x) for x in w.of(lines, "outside")}):
        for low, high in ((6.0, 30.0), (30.0, np.inf)):
            own = [x for x in w.of(lines, "outside", low) if w.beyond(x) == name and w.d_prime(x) < high]
            if own:
                taken = Counter(w.reported(x) for x in own if w.claims(x))
                verdict = Counter(x["verdict"] for x in own)
                size = f"{low:g}–{high:g}" if np.isfinite(high) else f"≥ {low:g}"
                rows.append((name, size, len(own), _counted(verdict), _counted(taken)))
    return markdown(("hidden", "d′", "records", "verdicts", "names on top"), rows, left=2)


def pairs(lines: Sequence[Line]) -> str:
    """Two effects, by the smaller d' of the two: both named, one and more, and the verdicts."""
    rows = []
    for low, high in ((0.0, 6.0), (6.0, 30.0), (30.0, np.inf)):
        own = [x for x in w.of(lines, "pair", low) if w.d_prime(x) < high]
        if own:
            told = _counted(Counter(x["verdict"] for x in own))
            size = f"{low:g}–{high:g}" if np.isfinite(high) else f"≥ {low:g}"
            rows.append((size, len(own), share(own, w.both_named), share(own, w.one_and_more), told))
    return markdown(("smaller d′", "records", "both named", "one, and more remains", "verdicts"), rows)
