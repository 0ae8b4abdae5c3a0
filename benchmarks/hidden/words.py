"""The properties of a line that the bank counts.

- **d'** of a hidden effect and its **separation** from the nearest rival are the generator's, from truth and noise.
- **named right**: the truth tops the class. **single name**: verdict ``effect``, or ``partial`` with one name alone.
  **wrong**: a single name, and another one. **in the class**: one of its members has the true name. ``partial`` names,
  and says that more remains; what ``unknown`` says comes nearest is not a name.
- On the bench "where" is left out: only the site's wall and its two sensors are there, and the effect says which.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from solver.laws import effects
from solver.network.description import Network
from tests.truth.hide import OUTSIDE, OUTSIDE_SENSOR, OUTSIDE_WALL

Line = dict[str, Any]
Where = tuple[str, ...]

NOT_MADE, NOT_JUDGED = "not made", "not judged"  # without a periodic state; below the required d'


def judged(lines: Iterable[Line]) -> list[Line]:
    """The lines with a verdict, or a crash instead; without records that could not be generated or were excluded."""
    return [x for x in lines if x["verdict"] not in (NOT_MADE, NOT_JUDGED)]


def group(line: Line) -> str:
    """The group of the plan."""
    return str(line.get("group", "standard"))


def hides(line: Line) -> str:
    """ "null", "single", "pair" of the catalogue, or "outside" it."""
    effects = line["effects"]
    if any(e["name"] in OUTSIDE for e in effects):
        return "outside"
    return ("null", "single", "pair")[len(effects)]


def beyond(line: Line) -> str:
    """The part of a line outside the catalogue."""
    return str(next(e["name"] for e in line["effects"] if e["name"] in OUTSIDE))


def of(lines: Iterable[Line], wanted: str, least: float = 0.0) -> list[Line]:
    """Lines that hide what is wanted (see ``hides``) with d' of at least ``least``."""
    return [x for x in lines if hides(x) == wanted and d_prime(x) >= least]


def truths(line: Line) -> tuple[str, ...]:
    """Names of the hidden effects."""
    return tuple(e["name"] for e in line["effects"])


def d_prime(line: Line) -> float:
    """Of a single effect; of two the smaller one; 0 of a null."""
    return min((e["d_prime"] for e in line["effects"]), default=0.0)


def separation(line: Line) -> float:
    """From the nearest rival; infinite without one."""
    return float("inf") if line["separation"] is None else line["separation"]


def detected(line: Line) -> bool:
    """Whether anything was found at all."""
    return claims(line) or line["verdict"] == "unknown"


def claims(line: Line) -> bool:
    """Whether names were given: one, a class, or several, even if more remains."""
    return line["verdict"] in ("effect", "ambiguous", "several", "partial")


def partial(line: Line) -> bool:
    """Names were given, and that more remains."""
    return line["verdict"] == "partial"


def unusable(line: Line) -> bool:
    """The record was refused."""
    return line["verdict"] == "unusable"


def alarm(line: Line) -> bool:
    """Anything but silence, or a refusal of the record."""
    return line["verdict"] not in ("none", "unusable")


def top(line: Line) -> tuple[str, ...]:
    """Names of the first member of the class; for ``unknown`` the nearest hypothesis; none otherwise."""
    if detected(line) and line.get("top"):
        return tuple(t["name"] for t in line["top"][0]["terms"])
    return ()


def single(line: Line) -> bool:
    """One name is given, without an alternative."""
    alone = line["verdict"] == "partial" and len(line.get("class", ())) < 2 and len(top(line)) == 1
    return alone or line["verdict"] == "effect"


def committed(line: Line) -> bool:
    """Verdict effect or several: names are given without an alternative, and without saying that more remains."""
    return line["verdict"] in ("effect", "several")


def named_right(line: Line) -> bool:
    """The one true name is the first member of the class."""
    return line["verdict"] in ("effect", "ambiguous", "partial") and top(line) == truths(line)


def single_right(line: Line) -> bool:
    """One name is given, and it is the true one."""
    return single(line) and named_right(line)


def wrong(line: Line) -> bool:
    """One name is given, and it is none of what is hidden."""
    return single(line) and top(line)[0] not in truths(line)


def in_class(line: Line) -> bool:
    """A member of the class has the one true name and nothing else."""
    return any(tuple(t["name"] for t in member) == truths(line) for member in line.get("class", ()))


def both_named(line: Line) -> bool:
    """Two names are the first member of the class, and they are exactly the hidden effects."""
    return claims(line) and len(top(line)) == 2 and sorted(top(line)) == sorted(truths(line))


def pair_alone(line: Line) -> bool:
    """Two names are given, without another pair in the class."""
    return line["verdict"] == "several" and len(line.get("class", ())) < 2


def wrong_pair(line: Line) -> bool:
    """Two names are given without another pair, and one of them is not hidden."""
    return pair_alone(line) and sorted(top(line)) != sorted(truths(line))


def one_and_more(line: Line) -> bool:
    """Two effects, and at least one of the two is named, with another one or with "more remains"."""
    return line["verdict"] in ("several", "unknown", "partial") and bool(set(top(line)) & set(truths(line)))


def reported(line: Line) -> str:
    """The column of the confusion matrix: the name on top, or the verdict where there is none."""
    if line["verdict"] in ("effect", "ambiguous", "partial") and len(top(line)) == 1:
        return top(line)[0]
    return str(line["verdict"])


def place(line: Line) -> Where:
    """Where what tops the class is."""
    return tuple(line["top"][0]["terms"][0]["where"])


def right_place(line: Line) -> bool:
    """Named right, where it is."""
    return named_right(line) and (line["kind"] == "bench" or place(line) == tuple(line["effects"][0]["where"]))


def acts_right(line: Line, most: int = 3) -> bool:
    """The map has what is hidden, a single effect, where it is: a source of its kind there, or of all places of a kind
    at several; or the number that is off. Places that cannot be told from one another, up to ``most``, count if one of
    them is right. A name in the right place counts, too."""
    (effect,) = line["effects"]
    where, kind = effect["where"][0], _KINDS[effect["name"]]
    true = {(kind, where), ("number", f"{where}.{_NUMBERS.get(effect['name'])}")}
    found = (line.get("map") or {"places": []})["places"]
    several = where == "all" and sum(p["kind"] == kind for p in found) > 1
    held = any(true & spots for spots in _alike(line) if len(spots) <= most)
    return several or held or right_place(line)


def _alike(line: Line) -> list[set[tuple[str, str]]]:
    """For every place of the map, kind and name of itself and of those that do as well in its stead."""
    found = line.get("map") or {"places": []}
    mine, sets = found["places"], list[set[tuple[str, str]]]()
    for place in mine:
        instead = [p for spots in found.get("alike", []) if place not in spots for p in spots if p not in mine]
        sets.append({(p["kind"], p["name"]) for p in (place, *instead)})
    return sets


def wanders(line: Line) -> bool:
    """Whether what is hidden makes beats differ and is nothing in their mean, which has then no place for it."""
    return any(e["name"] == "varying_tone" for e in line["effects"])


def reported_places(line: Line) -> set[str]:
    """Where it says that something acts: the places of the class, of ``unknown`` those of the map and of what cannot be
    told from these. Of a junction and an outlet the name is that of its segment."""
    if claims(line):
        return {where for member in line["class"] for term in member for where in term["where"]}
    if line["verdict"] != "unknown" or not line.get("map"):
        return set()
    found = line["map"]
    spots = [spot for spots in (found["places"], *found["alike"]) for spot in spots]
    return {s["name"].partition(".")[0] if s["kind"] == "number" else s["name"] for s in spots}


def holds_place(line: Line) -> bool:
    """Whether the places that are told hold that of what is hidden, a single effect."""
    (effect,) = line["effects"]
    return set(effect["where"]) <= reported_places(line)


_NUMBERS = {"wall_stiffness": "E", "terminal_reflection": "outlet.R_t", "wall_radius": "R0"}
_KINDS = {effect.name: effect.source for effect in effects.ALL} | {
    **dict.fromkeys(OUTSIDE_WALL, "wall"),
    **dict.fromkeys(OUTSIDE_SENSOR, "channel"),
    "swinging_outlet": "outlet",
    "wall_radius": "number",
}


def adjacent_place(line: Line, network: Network) -> bool:
    """Named right, where it is or at a segment that meets that one (a junction, an outlet and a channel are where their
    segment is)."""
    if not named_right(line):
        return False
    return right_place(line) or _meet(network, place(line)[0], line["effects"][0]["where"][0])


def _meet(network: Network, a: str, b: str) -> bool:
    sites = {site.name: site.segment for site in network.sites}
    here, there = (sites.get(x.partition(".")[0], x.partition(".")[0]) for x in (a, b))
    if "all" in (here, there):
        return False
    return here == there or any({here, there} <= {*j.inflow, *j.outflow} for j in network.junctions)


def confident_right(line: Line) -> bool:
    """Whether what the stated confidence is of is true: name and place, of ``several`` both names."""
    if len(top(line)) > 1:
        return both_named(line)
    if hides(line) == "pair":
        return top(line)[0] in truths(line)
    return right_place(line)


def errors(line: Line) -> list[tuple[str, float, float, bool]]:
    """Of a single effect that is named right in the right place, per parameter of the catalogue: its name, its true
    size (value less the value where the effect is absent), its error, and whether the interval covers it."""
    effect = line["effects"][0]
    found = {_key(name): e for name, e in line["top"][0]["parameters"].items()}
    result = []
    for name, value in effect["parameters"].items():
        if name.partition(".")[0] not in (effect["where"][0], effect["where"][0].partition(".")[0]):
            continue  # of a term everywhere only the ratio that is reported
        if (e := found.get(_key(name))) is not None:
            low, high = e["ci95"]
            result.append((_key(name), value - effect["zeros"][name], e["value"] - value, low <= value <= high))
    return result


def _key(name: str) -> str:
    return name.rpartition(".")[2]
