"""Network files: TOML in and out. Units are read by pint here, once; inside everything is SI.

A value is text with a unit (``L = "4 cm"``) or a bare number in SI. The keys are the quantities of
:mod:`solver.network`, so a new quantity needs no change here. Reading is exact: the magnitude times the exact
rational factor of the unit, rounded once, so "4 cm" is 0.04 and a written network reads back bit for bit.
"""

from __future__ import annotations

import difflib
import json
import math
import os
import re
import tokenize
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import MISSING, fields
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from .catalogue import quantities_of, terms_of, value_of
from .network import Channel, Fluid, Inlet, Junction, Network, Segment, Site
from .outlets import OUTLETS, Outlet, Pressure
from .quantity import Quantity, quantities

_NETWORKS = Path(__file__).parent / "networks"
_TEXTS = ("name", "reference", "elastic_law", "viscous_law")
_SECTIONS = ("network", "fluid", "inlet", "segments", "junctions", "outlets", "sites", "channels")


def read_network(path: str | os.PathLike[str]) -> Network:
    """The network in a TOML file.

    Raises ValueError: one sentence that starts with the file name and says where, what and how to put it right.
    """
    return loads(read_text(path), str(path))


def loads(text: str, name: str) -> Network:
    """The network in TOML text. Raises ValueError as :func:`read_network`; ``name`` starts the sentence."""
    try:
        return _network(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        if text.lstrip("\ufeff").startswith("time"):
            raise ValueError(
                f"{name}: not a network file but a recording (CSV); give the network that it is of."
            ) from None
        reason = str(error).replace("at end of document", f"at line {text.count(chr(10)) + 1}, the end of the file")
        raise ValueError(
            f'{name}: not valid TOML: {reason}; correct that line (a value with a unit stands in quotes: "4 cm").'
        ) from None
    except RecursionError:
        raise ValueError(f"{name}: not a network file: its lists are nested too deeply; correct it.") from None
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def write_network(network: Network, path: str | os.PathLike[str]) -> None:
    """Write ``dumps(network)`` to a file, whole or not at all. Raises ValueError if it cannot be written."""
    write_whole(path, dumps(network))


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a file in UTF-8. Raises ValueError if it is none or cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8.") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); check the path.") from None


def write_whole(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file whole or not at all: aside first, then moved. Raises ValueError if it cannot be written."""
    path = Path(path)
    if path.exists() and not path.is_file():  # a rename would replace a device or fail on a directory
        raise ValueError(f"{path}: cannot be written (not a regular file); give the name of a file.")
    target = path.resolve()  # a link stays a link
    aside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        os.replace(aside, target)
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror}); check the path and its directory.") from None
    finally:
        with suppress(OSError):
            aside.unlink()


def dumps(network: Network) -> str:
    """The network as TOML text in SI with units; :func:`loads` gives an equal network, bit for bit."""
    blocks = [_texts_out(network, *_TEXTS)]
    blocks += [["[network]", *_numbers_out(network)], ["[fluid]", *_numbers_out(network.fluid)]]
    blocks += [["[inlet]", *_texts_out(network.inlet, "segment", "causality"), *_numbers_out(network.inlet)]]
    blocks += [[f"[segments.{s.name}]", *_numbers_out(s)] for s in network.segments]
    for junction in network.junctions:
        ends = [f"in = {_quoted(junction.inflow)}", f"out = {_quoted(junction.outflow)}"]
        blocks.append(["[[junctions]]", *ends, *_numbers_out(junction)])
    blocks += [[f"[outlets.{o.segment}]", *_numbers_out(o)] for o in network.outlets]
    blocks += [["[sites]"]]  # also when there are none: without the section there would be one per segment
    blocks += [[f"[sites.{s.name}]", f"segment = {_quoted(s.segment)}", *_numbers_out(s)] for s in network.sites]
    blocks += [[f"[channels.{_quoted(c.name)}]", *_lines(c.terms, c.quantities())] for c in network.channels]
    return "\n\n".join("\n".join(lines) for lines in blocks) + "\n"


def bundled(name: str) -> Path:
    """The file of a network that comes with the package ("sheep"). Raises ValueError that lists them."""
    names = sorted(path.stem for path in _NETWORKS.glob("*.toml"))
    if name not in names:
        raise ValueError(
            f"{name}: neither a file nor a bundled network; "
            f"give a path or one of {', '.join(names)}{did_you_mean(name, names)}."
        )
    return _NETWORKS / f"{name}.toml"


def find_network(name_or_path: str | os.PathLike[str]) -> Path:
    """An existing file, or else the bundled network of that name. Raises ValueError that lists the bundled names."""
    return Path(name_or_path) if Path(name_or_path).is_file() else bundled(os.fspath(name_or_path))


# --- numbers and units --------------------------------------------------------------------------------------------

_NUMBER = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?(?:nan|inf)\b)\s*(.*)")


def parse_quantity(value: str | float, unit: str, name: str) -> float:
    """The value in ``unit`` of a number in that unit or of text with its own unit: ("4 cm", "m", "AA.L") -> 0.04.

    value : a number, or text with a number and optionally a unit as pint spells it ("1 mmHg*s/mL").
    unit : as in :class:`solver.network.Quantity` ("Pa.s", "1"). name : what the number is, for the error.
    Raises ValueError, one sentence, if it is not a finite number or the unit is unknown or of another kind.
    """
    shown = f"{name} = {json.dumps(value, ensure_ascii=False, default=str)}"
    wanted = "a number without unit" if unit == "1" else f"a number in {_pint_spelling(unit)}"
    numeric = isinstance(value, str | float | int) and not isinstance(value, bool)
    match = _NUMBER.fullmatch(str(value).strip()) if numeric else None
    if match is None:
        raise ValueError(
            f'{shown}: must be {wanted}; write it bare or with a unit in quotes, such as "{_example(unit)}".'
        )
    magnitude = float(match[1])
    if magnitude == 0.0:
        _factor(match[2], unit, shown)
        return magnitude  # keeps the sign of -0.0
    try:
        result = float(Fraction(match[1]) * _factor(match[2], unit, shown)) if math.isfinite(magnitude) else magnitude
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{shown}: must be {wanted} that is finite; check the value.")
    return result


# a number of three digits, a power of a power, or an exponent that is not a number of two digits at most: 9**9**9**9
# would keep exact arithmetic busy for ever
_ENDLESS = re.compile(
    r"\d{3}|(\*\*|\^)[^*^/]*\d\s*\)*\s*(\*\*|\^)|(\*\*|\^)(?!\s*[+-]?\d{1,2}(?![\d.])|\s*\(\s*[+-]?\d{1,2}\s*\))"
)


def _factor(text: str, unit: str, shown: str) -> Fraction:
    """The exact factor from the unit in ``text`` to ``unit``; no text means that unit itself."""
    wanted, registry = _pint_spelling(unit), _registry()
    try:
        if _ENDLESS.search(text):
            raise ValueError
        given = registry.parse_units(_pint_spelling(text)) if text else registry.parse_units(wanted)
    # the parser of pint lets all of these through for text that is not a unit
    except (tokenize.TokenError, AssertionError, AttributeError, ValueError, TypeError, ArithmeticError, LookupError):
        raise ValueError(
            f'{shown}: the unit {text} is not known; expected {wanted or "no unit"}, such as "{_example(unit)}".'
        ) from None
    target = registry.parse_units(wanted)
    if given.dimensionality != target.dimensionality:
        raise ValueError(
            f"{shown}: the unit {text} does not convert to the expected {wanted or 'number without unit'}; "
            f'correct the unit or the key, such as "{_example(unit)}".'
        )
    return registry.convert(Fraction(1), given, target)


@cache
def _registry() -> Any:
    """pint's units with exact rational factors, made at the first use: it takes half a second."""
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


def _pint_spelling(unit: str) -> str:
    """ "Pa.s" and "Pa·s", as FMI and people write them, in pint's spelling "Pa*s"; "1" as ""."""
    return "" if unit == "1" else re.sub(r"(?<=\w)\s*[.·⋅]\s*(?=[^\W\d])", "*", unit)


def _example(unit: str) -> str:
    return f"1 {_pint_spelling(unit)}".strip()


# --- reading the sections -----------------------------------------------------------------------------------------


def _network(data: Mapping[str, Any]) -> Network:
    check_keys("top level", data, (*_TEXTS, *_SECTIONS))
    texts: dict[str, Any] = {key: _text(data, key, "top level") for key in _TEXTS if key in data or key == "name"}
    segments = tuple(Segment(name, **_numbers(Segment, name, t)) for name, t in _tables(data, "segments"))
    return Network(
        **texts,
        **_numbers(Network, "network", _table(data, "network")),
        fluid=Fluid(**_numbers(Fluid, "fluid", _table(data, "fluid"))),
        inlet=_inlet(_table(data, "inlet")),
        segments=segments,
        junctions=tuple(map(_junction, _list(data, "junctions"))),
        outlets=tuple(_outlet(name, table) for name, table in _tables(data, "outlets")),
        sites=_sites(data) if "sites" in data else tuple(Site(s.name, s.name) for s in segments),
        channels=tuple(_channel(name, table) for name, table in _tables(data, "channels")),
    )


def _inlet(table: Mapping[str, Any]) -> Inlet:
    causality = _text({"causality": "flow", **table}, "causality", "inlet")
    numbers = _numbers(Inlet, "inlet", table, ("segment", "causality"))
    return Inlet(_text(table, "segment", "inlet"), **numbers, causality=causality)


def _sites(data: Mapping[str, Any]) -> tuple[Site, ...]:
    return tuple(
        Site(name, _text({"segment": name, **t}, "segment", name), **_numbers(Site, f"site {name}", t, ("segment",)))
        for name, t in _tables(data, "sites")
    )


def _junction(entry: Any) -> Junction:
    if not isinstance(entry, dict):
        raise ValueError('junctions: must be sections [[junctions]] with in = ["A"] and out = ["B", "C"].')
    for key in ("in", "out"):
        names = entry.get(key)
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ValueError(f'junction {entry}: the key {key} must list segment names; write {key} = ["AA"].')
    inflow, outflow = tuple(entry["in"]), tuple(entry["out"])
    name = Junction(inflow, outflow).name
    return Junction(inflow, outflow, **_numbers(Junction, f"junction {name}", entry, ("in", "out")))


def _outlet(segment: str, table: Mapping[str, Any]) -> Outlet:
    """The outlet whose own keys are in the table: R_t, or R1 C R2, or R, or none but P_venous."""
    where = f"{segment}.outlet"
    own = {kind: [key for key in quantities(kind) if key not in quantities(Outlet)] for kind in OUTLETS}
    check_keys(where, table, [*dict.fromkeys(key for kind in OUTLETS for key in quantities(kind)), *terms_of("outlet")])
    found = [kind for kind in OUTLETS if any(key in table for key in own[kind])]
    choices = " or ".join(", ".join(keys) or "P_venous alone" for keys in own.values())
    if len(found) > 1:
        raise ValueError(
            f"{where}: an outlet with two conditions ({' and '.join(kind.__name__ for kind in found)}: "
            f"{', '.join(table)}); keep one of {choices}."
        )
    if not found and not table:
        raise ValueError(f"{where}: it has no condition; give one of {choices}.")
    kind = found[0] if found else Pressure
    return kind(segment, **_numbers(kind, where, table))


def _channel(name: str, table: Mapping[str, Any]) -> Channel:
    """The terms of a channel; its unit is known only if it ends in a signal, which Network checks."""
    if name.rpartition(".")[1:] not in {(".", signal) for signal in "PQR"}:
        raise ValueError(
            f"channels.{name}: not the name of an output; write it in quotes and with its signal, such as "
            '[channels."CA.P"].'
        )
    known = Channel(name).quantities()
    check_keys(f"channel {name}", table, known)
    given = {key: q.unit for key, q in known.items() if key in table}
    return Channel(name, {key: parse_quantity(table[key], unit, f"{name}.{key}") for key, unit in given.items()})


def _numbers(kind: Any, where: str, table: Mapping[str, Any], others: Iterable[str] = ()) -> dict[str, Any]:
    """The quantities of ``kind`` in a section, in SI, with its terms of effects; ``others`` are no numbers."""
    own, held = quantities(kind), terms_of(getattr(kind, "OWNER", ""))
    check_keys(where, table, (*own, *held, *others))
    for f in fields(kind):
        if f.name in own and f.default is MISSING and f.name not in table:
            wanted = own[f.name]
            raise ValueError(
                f"{where}: the key {f.name} ({wanted.description}) is missing; "
                f'add it, such as {f.name} = "{_example(wanted.display or wanted.unit)}".'
            )

    def read(known: Mapping[str, Quantity]) -> dict[str, Any]:
        return {key: parse_quantity(table[key], q.unit, f"{where}.{key}") for key, q in known.items() if key in table}

    return {**read(own), **({"terms": read(held)} if held else {})}


def _texts_out(owner: Any, *keys: str) -> list[str]:
    return [f"{key} = {_quoted(getattr(owner, key))}" for key in keys]


def _numbers_out(owner: Any) -> list[str]:
    known = quantities_of(owner)
    return _lines({key: value_of(owner, key) for key in known}, known)


def _lines(values: Mapping[str, float], known: Mapping[str, Quantity]) -> list[str]:
    """One line per number; repr is the shortest text that reads back to the same float."""
    shown = {key: (repr(float(value)), known[key].unit) for key, value in values.items()}
    return [
        f"{key} = {number}" if unit == "1" else f'{key} = "{number} {_pint_spelling(unit)}"'
        for key, (number, unit) in shown.items()
    ]


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    if key not in table:
        raise ValueError(f'{where}: the key {key} is missing; add {key} = "...".')
    if not isinstance(table[key], str):
        raise ValueError(f"{where}: {key} = {table[key]!r} must be text; put it in quotes.")
    return table[key]


def _table(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise ValueError(f"{key} = {table!r}: must be a section; write [{key}] with its keys below.")
    return table


def _tables(data: Mapping[str, Any], key: str) -> list[tuple[str, dict[str, Any]]]:
    section = _table(data, key)
    for name, table in section.items():
        if not isinstance(table, dict):
            raise ValueError(f"{key}.{name} = {table!r}: must be a section; write [{key}.{name}] with its keys below.")
    return list(section.items())


def _list(data: Mapping[str, Any], key: str) -> list[Any]:
    entries = data.get(key, [])
    if not isinstance(entries, list):
        raise ValueError(f"{key}: must be a list of sections; write [[{key}]] with double brackets.")
    return entries


def check_keys(where: str, table: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError that names the first key of ``table`` that is not among the known ones."""
    known = list(known)
    for key in table:
        if key not in known:
            raise ValueError(f"{where}: unknown key {key!r}; use one of {', '.join(known)}{did_you_mean(key, known)}.")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """ " (did you mean E?)" for the known name nearest to ``name``; nothing if none is near."""
    folded = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), folded, n=1, cutoff=0.5)
    return f" (did you mean {folded[close[0]]}?)" if close else ""


def _quoted(text: str | Iterable[str]) -> str:
    """A TOML string, or array of them: as JSON writes it, and DEL, which TOML wants escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
