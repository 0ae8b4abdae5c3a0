"""Network files: read and write TOML. Units are read here, once; all other code uses SI.

A value is text with a unit (``L = "4 cm"``) or a bare number in SI. The keys are the quantities of
:mod:`solver.network.description`, so a new quantity needs no change here. Reading is exact: the magnitude times the
exact rational factor of the unit, rounded once, so "4 cm" is 0.04 and a written network reads back bit for bit.
"""

from __future__ import annotations

import os
import re
import tomllib
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.writing import write_whole
from ..laws import outlets
from ..laws.catalogue import quantities_of, terms_of
from ..laws.effect import value_of
from ..laws.outlets import Outlet, Pressure
from ..quantities.quantity import Quantity, quantities
from ..quantities.text import check_keys, did_you_mean, example, parse_quantity, pint_spelling, quoted, read_text
from . import aliases, inlet_curves, table_source
from .description import Channel, Fluid, Junction, Network, Segment, Site
from .inlet import CAUSALITY, Inlet

Sections = dict[str, Any]

_NETWORKS = Path(__file__).parents[1] / "networks"
_TEXTS = ("name", "species", "reference", "elastic_law", "viscous_law")
_ETA = next(f.default for f in fields(Network) if f.name == "eta")
_SECTIONS = ("network", "fluid", "inlet", "inlets", "segments", "junctions", "outlets", "sites", "channels",
             "sources")  # fmt: skip


def read_network(path: str | os.PathLike[str]) -> Network:
    """The network in a TOML file, or in an FMU, which contains its own.

    Raises ValueError: one sentence that starts with the file name and gives the place, the error and the remedy.
    """
    if Path(path).suffix.lower() == ".fmu" or zipfile.is_zipfile(path):
        return loads(_carried(path), f"{path}: network.toml")
    return loads(read_text(path), str(path), Path(path).parent)


def _carried(fmu: str | os.PathLike[str]) -> str:
    """The network file inside an FMU."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            return archive.read("resources/network.toml").decode("utf-8")
    except KeyError:
        raise InputError(f"{fmu}: it contains no network of arteries; give the FMU of one or a network file.") from None
    except OSError as error:
        raise InputError(f"{fmu}: cannot be read ({error.strerror}); check the path.") from None
    except (zipfile.BadZipFile, zlib.error, UnicodeDecodeError):
        raise InputError(f"{fmu}: not an FMU, or damaged; build one with arterial-fmu build.") from None


def loads(text: str, name: str, folder: Path | None = None) -> Network:
    """The network in TOML text. Raises ValueError as :func:`read_network`; ``name`` starts the sentence.

    folder : that of the files named in the text; without a folder the text may not name any.
    """
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an integer of thousands of digits
        if text.lstrip("\ufeff").startswith("time"):
            raise InputError(
                f"{name}: not a network file but a recording (CSV); give the network of this recording."
            ) from None
        if not isinstance(error, tomllib.TOMLDecodeError):
            raise InputError(f"{name}: not valid TOML: an integer of thousands of digits; correct it.") from None
        reason = str(error).replace("at end of document", f"at line {text.count(chr(10)) + 1}, the end of the file")
        raise InputError(
            f'{name}: not valid TOML: {reason}; correct that line (a value with a unit stands in quotes: "4 cm").'
        ) from None
    except RecursionError:
        raise InputError(f"{name}: not a network file: its lists are nested too deeply; correct it.") from None
    try:
        return from_sections(data, folder)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def write_network(network: Network, path: str | os.PathLike[str]) -> None:
    """Write ``dumps(network)`` to a file, whole or not at all. Raises ValueError if it cannot be written."""
    write_whole(path, dumps(network))


def dumps(network: Network) -> str:
    """The network as TOML text in SI with units; :func:`loads` gives an equal network, bit for bit."""
    return toml(to_sections(network))


def bundled_names() -> list[str]:
    """The names of the included networks."""
    return sorted(path.stem for path in _NETWORKS.glob("*.toml"))


def bundled(name: str) -> Path:
    """The file of an included network ("sheep"). Raises ValueError that lists them."""
    names = bundled_names()
    if name not in names:
        raise InputError(
            f"{name}: neither a file nor a bundled network; "
            f"give a path or one of {', '.join(names)}{did_you_mean(name, names)}."
        )
    return _NETWORKS / f"{name}.toml"


def find_network(name_or_path: str | os.PathLike[str]) -> Path:
    """An existing file, or otherwise the included network of that name. Raises ValueError that lists their names."""
    path = Path(name_or_path)
    if path.is_dir() and os.fspath(name_or_path) not in bundled_names():
        raise InputError(f"{os.fspath(name_or_path)}: is a folder, not a network; give a network file or an FMU.")
    return path if path.is_file() else bundled(os.fspath(name_or_path))


# --- writing the sections -----------------------------------------------------------------------------------------


def to_sections(network: Network) -> Sections:
    """The sections of a network's file, of which :func:`from_sections` makes an equal network."""
    further = {i.segment: {"causality": i.causality, **_inlet_out(i)} for i in network.further_inlets}
    channels = {c.name: _with_units(c.terms, c.quantities()) for c in network.channels}
    found = {
        **{key: getattr(network, key) for key in _TEXTS},
        "network": _numbers_out(network),
        "fluid": _numbers_out(network.fluid),
        "inlet": {"segment": network.inlet.segment, "causality": network.inlet.causality, **_inlet_out(network.inlet)},
        "inlets": further,
        "segments": {s.name: _numbers_out(s) for s in network.segments},
        "junctions": [{"in": [*j.inflow], "out": [*j.outflow], **_numbers_out(j)} for j in network.junctions],
        "outlets": {o.segment: _numbers_out(o) for o in network.outlets},
        "sites": {s.name: {"segment": s.segment, **_numbers_out(s)} for s in network.sites},
        "channels": channels,
        "sources": [table_source.section(source) for source in network.sources],
    }
    # no sites are written, too: without the section there would be one per segment
    return {key: each for key, each in found.items() if each or key in (*_TEXTS, "sites")}


def _inlet_out(inlet: Inlet) -> Sections:
    """Its numbers, or its drive; a flow that a given pressure replaces is not written."""
    curve = inlet.curve
    drives = curve is not None and CAUSALITY[curve.signal] == inlet.causality
    return inlet_curves.section(curve) if curve is not None and drives else _numbers_out(inlet)


def _numbers_out(owner: Any) -> Sections:
    known = quantities_of(owner)
    return _with_units({key: value_of(owner, key) for key in known}, known)


def _with_units(values: Mapping[str, float], known: Mapping[str, Quantity]) -> Sections:
    """repr is the shortest text that reads back to the same float."""
    units = {key: pint_spelling(known[key].unit) for key in values}
    return {key: f"{float(x)!r} {units[key]}" if units[key] else float(x) for key, x in values.items()}


def toml(sections: Sections) -> str:
    """Sections as TOML."""
    blocks = [[f"{key} = {toml_value(v)}" for key, v in sections.items() if not isinstance(v, dict | list)]]
    for key, section in sections.items():
        if isinstance(section, list):
            blocks += [[f"[[{key}]]", *_lines(entry)] for entry in section]
        elif isinstance(section, dict) and any(isinstance(v, dict) for v in section.values()):
            # a network has this line with sites, too, as without any
            blocks += [["[sites]"]] if key == "sites" else []
            blocks += [[f"[{key}.{_key(name)}]", *_lines(entry)] for name, entry in section.items()]
        elif isinstance(section, dict):
            blocks.append([f"[{key}]", *_lines(section)])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def toml_value(v: Any) -> str:
    """A value as TOML on one line."""
    if isinstance(v, Mapping):
        return f"{{ {', '.join(f'{_key(key)} = {toml_value(each)}' for key, each in v.items())} }}"
    if isinstance(v, list):
        return f"[{', '.join(map(toml_value, v))}]"
    return quoted(v) if isinstance(v, str) else repr(v)


def _lines(section: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {toml_value(v)}" for key, v in section.items()]


def _key(name: str) -> str:
    return name if re.fullmatch(r"\w+", name, flags=re.ASCII) else quoted(name)


# --- reading the sections -----------------------------------------------------------------------------------------


def from_sections(data: Mapping[str, Any], folder: Path | None = None) -> Network:
    """The network of a file's TOML sections. Raises ValueError as :func:`loads`, without the file name."""
    check_keys("top level", data, (*_TEXTS, *_SECTIONS))
    texts: dict[str, Any] = {key: _text(data, key, "top level") for key in _TEXTS if key in data or key == "name"}
    whole = _numbers(Network, "network", _table(data, "network"))
    fluid = _fluid(_table(data, "fluid"))
    eta = whole.get("eta", _ETA)
    segments = tuple(_segment(name, table, eta, fluid.rho) for name, table in _tables(data, "segments"))
    inlet = _inlet(_table(data, "inlet"), folder)
    return Network(
        **texts,
        **whole,
        fluid=fluid,
        inlet=inlet,
        segments=segments,
        junctions=tuple(map(_junction, _list(data, "junctions"))),
        outlets=tuple(_outlet(name, table) for name, table in _tables(data, "outlets")),
        sites=_sites(data) if "sites" in data else tuple(Site(s.name, s.name) for s in segments),
        channels=tuple(_channel(name, table) for name, table in _tables(data, "channels")),
        further_inlets=tuple(_further_inlet(name, t, folder, inlet.T) for name, t in _tables(data, "inlets")),
        sources=tuple(table_source.read(t, folder) for t in _list(data, "sources")),
    )


def _fluid(table: Mapping[str, Any]) -> Fluid:
    check_keys("fluid", table, (*quantities(Fluid), *terms_of("fluid"), *aliases.FLUID))
    own = {key: value for key, value in table.items() if key not in aliases.FLUID}
    rho = _numbers(Fluid, "fluid", own).get("rho", Fluid().rho)
    quantities(Fluid)["rho"].check("fluid.rho", rho)
    return Fluid(**_numbers(Fluid, "fluid", aliases.fluid(table, rho)))


def _segment(name: str, table: Mapping[str, Any], eta: float, rho: float) -> Segment:
    known = quantities(Segment)
    check_keys(name, table, (*known, *terms_of("segment"), *aliases.SEGMENT))
    return Segment(name, **_numbers(Segment, name, aliases.segment(name, table, known, eta, rho)))


def _further_inlet(segment: str, table: Mapping[str, Any], folder: Path | None, T: float) -> Inlet:
    """A further inlet, which shares the period T [s] of the first one."""
    where = f"{segment}.inlet"
    if "segment" in table:
        raise InputError(f"{where}.segment: the name of the section defines it; omit it.")
    period = {} if inlet_curves.signals(table) else {"T": T}
    return _inlet({**period, **table, "segment": segment}, folder, where)


def _inlet(table: Mapping[str, Any], folder: Path | None, where: str = "inlet") -> Inlet:
    """An inlet, with a curve where Q or P is a table or a series."""
    check_keys(where, table, ("segment", "causality", *quantities(Inlet), *inlet_curves.KEYS))
    numbers = _numbers(Inlet, where, {key: table[key] for key in quantities(Inlet) if key in table})
    segment, signals = _text(table, "segment", where), inlet_curves.signals(table)
    for other in (*signals[1:], *(["Q_max"] if signals and "Q_max" in table else [])):
        raise InputError(f"{where}: {signals[0]} and {other} both prescribe the inlet; keep one of them.")
    curve = inlet_curves.read(table, where, folder, numbers.get("T"))
    given = "flow" if curve is None else CAUSALITY[curve.signal]
    causality = _text({"causality": given, **table}, "causality", where)
    if curve is not None and causality != given:
        raise InputError(
            f'{where}.causality = "{causality}": {curve.signal} is given, which is a {given}; leave causality out, or '
            "give the other one."
        )
    return Inlet(segment, causality=causality, curve=curve, **({} if curve else numbers))


def _sites(data: Mapping[str, Any]) -> tuple[Site, ...]:
    return tuple(
        Site(name, _text({"segment": name, **t}, "segment", name), **_numbers(Site, f"site {name}", t, ("segment",)))
        for name, t in _tables(data, "sites")
    )


def _junction(entry: Any) -> Junction:
    if not isinstance(entry, dict):
        raise InputError('junctions: must be sections [[junctions]] with in = ["A"] and out = ["B", "C"].')
    for key in ("in", "out"):
        names = entry.get(key)
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(f'junction {entry}: the key {key} must list segment names; write {key} = ["AA"].')
    inflow, outflow = tuple(entry["in"]), tuple(entry["out"])
    name = Junction(inflow, outflow).name
    return Junction(inflow, outflow, **_numbers(Junction, f"junction {name}", entry, ("in", "out")))


def _outlet(segment: str, table: Mapping[str, Any]) -> Outlet:
    """The outlet that has all keys of the table for its own: R_t, or R1 C R2, or R, or none but P_venous; the one with
    fewest keys where several do."""
    where = f"{segment}.outlet"
    kinds = outlets.OUTLETS
    own = {kind: [key for key in quantities(kind) if key not in quantities(Outlet)] for kind in kinds}
    check_keys(where, table, [*dict.fromkeys(key for kind in kinds for key in quantities(kind)), *terms_of("outlet")])
    table = aliases.outlet(table, {key for keys in own.values() for key in keys if key in table})
    given = {key for keys in own.values() for key in keys if key in table}
    found = sorted((kind for kind in kinds if given <= {*own[kind]}), key=lambda kind: len(own[kind]))
    choices = " or ".join(", ".join(keys) or "P_venous alone" for keys in own.values())
    if not found:
        mixed = [kind.__name__ for kind in kinds if given & {*own[kind]}]
        raise InputError(
            f"{where}: an outlet with two conditions ({' and '.join(mixed)}: "
            f"{', '.join(key for key in table if key in given)}); keep one of {choices}."
        )
    if not table:
        raise InputError(f"{where}: it has no condition; give one of {choices}.")
    kind = found[0] if given else Pressure
    return kind(segment, **_numbers(kind, where, table))


def _channel(name: str, table: Mapping[str, Any]) -> Channel:
    """The terms of a channel; its unit is known only if it ends in a signal, which Network checks."""
    if name.rpartition(".")[1:] not in {(".", signal) for signal in "PQR"}:
        raise InputError(
            f"channels.{name}: not the name of an output; write it in quotes and with its signal, such as "
            '[channels."CA.P"].'
        )
    known = Channel(name).quantities()
    check_keys(f"channel {name}", table, known)
    given = {key: q.unit for key, q in known.items() if key in table}
    return Channel(name, {key: parse_quantity(table[key], unit, f"{name}.{key}") for key, unit in given.items()})


def _numbers(kind: Any, where: str, table: Mapping[str, Any], others: Iterable[str] = ()) -> dict[str, Any]:
    """The quantities of ``kind`` in a section, in SI, with its terms of effects; ``others`` are keys without
    numbers."""
    own, terms = quantities(kind), terms_of(getattr(kind, "OWNER", ""))
    check_keys(where, table, (*own, *terms, *others))
    for f in fields(kind):
        if f.name in own and f.default is MISSING and f.name not in table:
            wanted = own[f.name]
            raise InputError(
                f"{where}: the key {f.name} ({wanted.description}) is missing; "
                f'add it, such as {f.name} = "{example(wanted.display or wanted.unit)}".'
            )

    def read(known: Mapping[str, Quantity]) -> dict[str, Any]:
        return {key: parse_quantity(table[key], q.unit, f"{where}.{key}") for key, q in known.items() if key in table}

    return {**read(own), **({"terms": read(terms)} if terms else {})}


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    if key not in table:
        raise InputError(f'{where}: the key {key} is missing; add {key} = "...".')
    if not isinstance(table[key], str):
        raise InputError(f"{where}: {key} = {table[key]!r} must be text; put it in quotes.")
    return table[key]


def _table(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{key} = {table!r}: must be a section; write [{key}] with its keys below.")
    return table


def _tables(data: Mapping[str, Any], key: str) -> list[tuple[str, dict[str, Any]]]:
    section = _table(data, key)
    for name, table in section.items():
        if not isinstance(table, dict):
            raise InputError(f"{key}.{name} = {table!r}: must be a section; write [{key}.{name}] with its keys below.")
    return list(section.items())


def _list(data: Mapping[str, Any], key: str) -> list[Any]:
    entries = data.get(key, [])
    if not isinstance(entries, list):
        raise InputError(f"{key}: must be a list of sections; write [[{key}]] with double brackets.")
    return entries
