"""Tables of vessels (CSV), as in papers: one row per vessel, a row of names and one of units.

A column is ``name`` (or id), ``from`` and ``to`` (nodes) or ``parent`` (a name), or any key of a segment or an outlet
of the network file; the suffixes _in and _out denote values at one end. Settings that do not belong to one vessel
precede the table, ``# key = value`` as in TOML: ``# fluid.rho = "1050 kg/m^3"``.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...io.tables import Table, number, read
from ...laws.catalogue import terms_of
from ...laws.outlets import OUTLETS
from ...quantities.quantity import quantities
from ...quantities.text import check_keys
from ..aliases import ENDS, SEGMENT
from ..description import Network, Segment
from ..files import to_sections, toml_value
from .sections import Edge, Sections, joined, names

_NAMES, _NODES = ("name", "id"), ("from", "to", "parent")
_SETTING = re.compile(
    r"((name|species|reference|elastic_law|viscous_law|sites)\s*=|(network|fluid|inlet|inlets|junctions|sites|channels)\.)"
)
_LIKE_A_SETTING = re.compile(r"[A-Za-z_]+(\.[A-Za-z_]\w*)+\s*=")
_SEGMENT = {key: q.unit for key, q in (quantities(Segment) | terms_of("segment") | SEGMENT).items()}
_OUTLET = {key: q.unit for kind in OUTLETS for key, q in (quantities(kind) | terms_of("outlet")).items()}
_AT_ENDS = {f"{key}_{end}": key for key in (*ENDS, *SEGMENT) for end in ("in", "out")}


def read_sheet(path: str | Path) -> Sections:
    """The sections of a table of vessels. Raises ValueError, one sentence with the file, and the line or the column."""
    table = read(path)
    check_keys(table.path, table.names, (*_NAMES, *_NODES, *_SEGMENT, *_AT_ENDS, *_OUTLET))
    _check_settings(table)
    label = next((key for key in _NAMES if key in table.names), None)
    if label is None:
        raise InputError(f"{path}: no column name, which says how each vessel is called; add it.")
    rows = [(n, dict(zip(table.names, cells, strict=True))) for n, cells in table.rows]
    for n, row in rows:
        if not row[label]:
            raise InputError(f"{path}, line {n}: the vessel has no {label}; give it one, or remove the line.")
    own = dict(zip((row[label] for _, row in rows), names([row[label] for _, row in rows]), strict=False))
    try:
        settings = _settings(table)
        first, junctions, free = joined(_edges(table, rows, own, label), settings.get("inlets", {}))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    units = dict(zip(table.names, table.units, strict=True))
    segments, outlets = {}, {}
    for n, row in rows:
        name, where = own[row[label]], f"{path}, line {n}"
        numbers = {key: cell for key, cell in row.items() if cell and key not in (*_NAMES, *_NODES)}
        segments[name] = _ends({k: _cell(c, units[k], k, where) for k, c in numbers.items() if k not in _OUTLET}, where)
        outlet = {k: _cell(c, units[k], k, where) for k, c in numbers.items() if k in _OUTLET}
        if outlet and name not in free:
            raise InputError(
                f"{where}: {next(iter(outlet))} belongs to a vessel that ends, {name} does not; remove it."
            )
        if outlet:
            outlets[name] = outlet
    of_junctions, at = settings.pop("junctions", {}), {junction["in"][0]: junction for junction in junctions}
    for name, numbers in of_junctions.items():
        if name not in at or not isinstance(numbers, dict):
            raise InputError(
                f"{path}: # junctions.{name}: a junction has the name of the first vessel that flows in; "
                f"write # junctions.NAME.k with one of {', '.join(at) or 'none'}."
            )
        at[name].update(numbers)
    settings["inlet"] = {"segment": first, **settings.get("inlet", {})}
    stem = names([Path(path).stem])[0]
    return {"name": stem, **settings, "segments": segments, "junctions": junctions, "outlets": outlets}


def _edges(table: Table, rows: list[tuple[int, dict[str, str]]], own: dict[str, str], label: str) -> list[Edge]:
    """The vessels between nodes; with a column ``parent``, the end node of a vessel has its name."""
    by_nodes, by_parent = {"from", "to"} <= set(table.names), "parent" in table.names
    if by_nodes == by_parent:
        raise InputError("give either the columns from and to, or the column parent, which say how vessels are joined.")
    edges = []
    for n, row in rows:
        if by_parent and row["parent"] and row["parent"] not in own:
            raise InputError(f"line {n}: there is no vessel {row['parent']!r}; correct the column parent.")
        start, end = (row["from"], row["to"]) if by_nodes else (row["parent"], row[label])
        edges.append(Edge(own[row[label]], start, end, row[label]))
    return edges


def _check_settings(table: Table) -> None:
    """Raise ValueError for a line that looks like a setting, # fluids.rho = …, but is none."""
    for line in table.comments:
        if _LIKE_A_SETTING.match(line) and not _SETTING.match(line):
            raise InputError(f"{table.path}: # {line}: no such setting; correct its name, or write it without =.")


def _settings(table: Table) -> Sections:
    lines = [line for line in table.comments if _SETTING.match(line) and "=" in line]
    try:
        return tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the lines # key = value: not valid TOML: {error}; correct them.") from None


def _cell(cell: str, given: str, key: str, where: str) -> Any:
    """A number in SI."""
    return number(cell, given, (_SEGMENT | _OUTLET)[_AT_ENDS.get(key, key)], where, key)


def _ends(numbers: dict[str, float], where: str) -> dict[str, Any]:
    """The section of a segment, with values at both ends as pairs."""
    section: dict[str, Any] = {key: x for key, x in numbers.items() if key not in _AT_ENDS}
    for key in dict.fromkeys(_AT_ENDS[k] for k in numbers if k in _AT_ENDS):
        pair = [numbers.get(f"{key}_{end}") for end in ("in", "out")]
        if None in pair or key in section:
            raise InputError(f"{where}: {key} needs both {key}_in and {key}_out, or {key} alone.")
        section[key] = pair
    return section


def to_sheet(network: Network) -> str:
    """The network as a table of vessels in SI, its junctions and outlets in the order of the vessels.

    :func:`read_sheet` gives the same numbers, bit for bit.
    """
    data = to_sections(network)
    texts: list[tuple[str, Any]] = [(key, each) for key, each in data.items() if isinstance(each, str)]
    texts += [(f"{key}.{k}", each) for key in ("network", "fluid", "inlet") for k, each in data[key].items()]
    texts += [(f"inlets.{name}", each) for name, each in data.get("inlets", {}).items()]
    own = {j["in"][0]: {k: v for k, v in j.items() if k not in ("in", "out")} for j in data.get("junctions", [])}
    texts += [(f"junctions.{name}", numbers) for name, numbers in own.items() if any(numbers.values())]
    sites = data["sites"]
    texts += [(f"sites.{name}", each) for name, each in sites.items()] or [("sites", {})]
    texts += [(f'channels."{name}"', each) for name, each in data.get("channels", {}).items()]
    head = [f"# {key} = {toml_value(each)}" for key, each in texts if key != "inlet.segment"]
    start = {data["inlet"]["segment"]: "0"} | {name: f"0{name}" for name in data.get("inlets", {})}
    end = dict[str, str]()
    for n, junction in enumerate(data.get("junctions", []), 1):
        end |= dict.fromkeys(junction["in"], str(n))
        start |= dict.fromkeys(junction["out"], str(n))
    rows = []
    for n, (name, section) in enumerate(data["segments"].items(), len(data.get("junctions", [])) + 1):
        place = {"name": name, "from": start[name], "to": end.get(name, str(n))}
        rows.append(place | {k: str(v) for k, v in (section | data["outlets"].get(name, {})).items()})
    columns = list(dict.fromkeys(key for row in rows for key in row))
    units = {key: row[key].partition(" ")[2] for row in reversed(rows) for key in row if key not in place}
    cells = [[row.get(c, "").partition(" ")[0] if c in units else row.get(c, "") for c in columns] for row in rows]
    lines = [columns, [units.get(column, "") for column in columns], *cells]
    return "\n".join([*head, *(",".join(line) for line in lines)]) + "\n"
