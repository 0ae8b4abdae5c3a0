"""Sections of a network file: named, joined and written as TOML, with the inflow in a table beside it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...io.writing import Content, check_new, write_all
from ..files import Sections, toml


@dataclass(frozen=True)
class Edge:
    """A vessel between two nodes; ``where`` : its name in errors."""

    name: str
    start: str
    end: str
    where: str


def names(labels: Sequence[str]) -> list[str]:
    """Valid names from labels: "1-Ascending aorta" becomes Ascending_aorta, or v1_… if that is taken.

    Raises ValueError for a label without a letter or digit, or for two labels with the same name.
    """
    for label in labels:
        if not re.search("[A-Za-z0-9]", label):
            raise InputError(f"{label!r}: a name needs a letter from A to Z or a digit; rename it.")
    plain = [re.sub(r"\W+", "_", label, flags=re.ASCII).strip("_") for label in labels]
    short = [re.sub(r"^[\d_]+", "", name) for name in plain]
    found = [
        s if s and short.count(s) == 1 else (p if p[:1].isalpha() else f"v{p}")
        for s, p in zip(short, plain, strict=True)
    ]
    for name, label in zip(found, labels, strict=True):
        other = labels[found.index(name)]
        if other != label:  # the caller reports a duplicate label
            raise InputError(f"{other!r} and {label!r}: both would be called {name}; rename one of them.")
    return found


def joined(edges: Iterable[Edge], further: Collection[str] = ()) -> tuple[str, list[dict[str, Any]], list[str]]:
    """The name of the first vessel, the sections of the junctions, and the names of the vessels with a free end.

    further : names of vessels with their own inlet. Raises ValueError unless exactly one other vessel begins at a node
    where no vessel ends.
    """
    edges = list(edges)
    taken = Counter(e.name for e in edges)
    for e in edges:
        if taken[e.name] > 1:
            raise InputError(f"{e.where}: the name {e.name} occurs {taken[e.name]} times; names must be unique.")
        if e.start == e.end:
            raise InputError(f"{e.where}: it begins and ends at the same node, {e.start}; correct one of them.")
    starts, ends = [{getattr(e, side) for e in edges} for side in ("start", "end")]
    roots = [e for e in edges if e.start not in ends and e.name not in further]
    if len(roots) != 1:
        labels = ", ".join(e.where if e.where == e.name else f"{e.where}, here {e.name}" for e in roots[:5])
        who = f"{len(roots)} vessels begin" + (f" ({labels})" if roots else "")
        more = "; say inlets.NAME.Q_max or inlets.NAME.Q of each but the first" if len(roots) > 1 else ""
        raise InputError(f"{who} where no other ends; there must be one, the inlet{more}.")
    junctions = []
    for node in dict.fromkeys(e.end for e in edges):
        if node in starts:
            inflow, outflow = ([e.name for e in edges if getattr(e, side) == node] for side in ("end", "start"))
            junctions.append({"in": inflow, "out": outflow})
    free = [e for e in edges if e.end not in starts]
    for e in free:
        if sum(other.end == e.end for other in free) > 1:
            raise InputError(f"{e.where}: others end at its node {e.end} too, and none begins there; part their ends.")
    return roots[0].name, junctions, [e.name for e in free]


def write(sections: Sections, path: Path, force: bool = False) -> list[Path]:
    """Write a network file, and the table of its inlet beside it; return the written paths.

    Raises ValueError if one exists and may not be replaced (force), or cannot be written.
    """
    inlet = dict(sections["inlet"])
    files: dict[Path, Content] = {}
    if isinstance(inlet.get("t"), list):
        times = inlet.pop("t")
        signal = next(key for key, value in inlet.items() if isinstance(value, list))
        unit = {"Q": "m^3/s", "P": "Pa"}[signal]
        table = path.with_name(f"{path.stem}_inlet.csv")
        rows = [f"{t!r},{value!r}" for t, value in zip(times, inlet[signal], strict=True)]
        files[table] = "\n".join([f"time [s],{signal} [{unit}]", *rows]) + "\n"
        inlet[signal] = table.name
    files[path] = toml({**sections, "inlet": inlet})
    check_new(files, force)
    write_all(files)
    return list(reversed(files))
