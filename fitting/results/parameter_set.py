"""Parameter sets: the start values that a fit passes to an FMU, as JSON or as SSV 1.0.

A set contains values by FMU variable name ("AA.E", "CA.outlet.R_t"), in SI, with 95 % intervals and provenance.

**JSON** is this project's own format: complete, exact, readable and editable. **SSV 1.0** (System Structure and
Parameterization, Modelica Association) is the format that FMI tools apply to an FMU themselves: plain parameter names
and SI values, because importers set the number and ignore its unit. SSV has no fields for intervals and provenance. An
annotation of the file contains them, as the standard allows; other readers ignore it.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn
from xml.etree import ElementTree

from solver.errors import InputError
from solver.laws import outlets
from solver.laws.catalogue import terms_of
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.network.description import Fluid, Junction, Network, Segment
from solver.network.files import check_keys, did_you_mean, parse_quantity, read_text, write_whole
from solver.quantities.quantity import Quantity, quantities
from solver.quantities.units import base_units

_BUNDLED = Path(__file__).parents[1] / "parameter_sets"
_FORMAT = "arterial-fmu parameter set 1"
_KEYS = ("format", "name", "texts", "values", "provenance")
_VALUE_KEYS = ("value", "unit", "ci95")
_TEXTS: Mapping[str, Mapping[str, object]] = {"network.elastic_law": ELASTIC_LAWS, "network.viscous_law": VISCOUS_LAWS}

_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
_SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_ANNOTATION = "arterial-fmu.parameter-set"
_NAMES = {"ssv": _SSV, "ssc": _SSC}


@dataclass(frozen=True)
class Value:
    """A number in SI; unit : as :class:`solver.quantities.quantity.Quantity` spells it; ci95 : its 95 % interval, low
    and high."""

    value: float
    unit: str
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class ParameterSet:
    """Values and texts by FMU variable name, checked when the set is made.

    texts : the wall laws the values were fitted with ("network.elastic_law", "network.viscous_law").
    provenance : origin of the values (record and its hash, law, γ, software), JSON-ready.
    The network or the FMU checks the allowed range of a value, which a fit may exceed.
    Raises ValueError, one sentence, for an unknown name, another unit or a number that is not finite.
    """

    name: str
    values: Mapping[str, Value]
    texts: Mapping[str, str] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise InputError(f"parameter set name {self.name!r}: must be one printable line; rename it.")
        values = {name: _checked(name, value) for name, value in self.values.items()}
        for name, text in self.texts.items():
            if name not in _TEXTS:
                raise InputError(f"{name}: not a text of a parameter set; use one of {', '.join(_TEXTS)}.")
            if text not in _TEXTS[name]:
                raise InputError(f"{name} = {text!r}: must be one of {', '.join(_TEXTS[name])}.")
        try:  # so that a set equals what is read back: tuples become lists, keys text
            provenance = json.loads(json.dumps(dict(self.provenance), allow_nan=False))
        except (TypeError, ValueError) as error:
            raise InputError(f"provenance: cannot be written as JSON ({error}); keep to texts and numbers.") from None
        for key, checked in (("values", values), ("texts", dict(self.texts)), ("provenance", provenance)):
            object.__setattr__(self, key, checked)

    def start_values(self) -> dict[str, float | str]:
        """Values [SI] and texts by FMU variable name: the FMU's start values."""
        return {**{name: value.value for name, value in self.values.items()}, **self.texts}

    def apply(self, network: Network) -> Network:
        """The network with these values and laws. Raises ValueError for a name or value that it does not allow."""
        laws: dict[str, Any] = {name.removeprefix("network."): text for name, text in self.texts.items()}
        return replace(network.with_parameters({name: v.value for name, v in self.values.items()}), **laws)


def unit_of(name: str) -> str:
    """The SI unit of an FMU parameter by its name: "CA.phi0" -> "Pa.s". Raises ValueError as :func:`quantity_of`."""
    return quantity_of(name).unit


def quantity_of(name: str) -> Quantity:
    """The quantity of an FMU parameter, by its name: "CA.phi0".

    Raises ValueError if no segment, outlet, junction, fluid or network has such a parameter.
    """
    prefix, dot, key = name.rpartition(".")
    last = prefix.rpartition(".")[2]
    owner = prefix if prefix in ("network", "fluid") else last if last in ("outlet", "junction") else "segment"
    known = _quantities(owner)
    if not dot or not prefix or key not in known:
        raise InputError(
            f"{name}: no {owner} has a parameter {key!r}; use one of {', '.join(known)}{did_you_mean(key, known)}."
        )
    return known[key]


def read_set(path: str | os.PathLike[str]) -> ParameterSet:
    """The parameter set in a .json or .ssv file, or the bundled one of that name ("sheep_table1").

    Units are converted to the variable's own. JSON must give every unit; in SSV a missing one means the variable's.
    Raises ValueError: one sentence that starts with the file name and gives the place, the error and the remedy.
    """
    path = _find(path)
    reader = _from_json if set_format(path) == ".json" else _from_ssv
    text = read_text(path)
    try:
        return reader(text)
    except RecursionError:
        raise InputError(f"{path}: its lists are nested too deeply; correct it.") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_set(parameters: ParameterSet, path: str | os.PathLike[str]) -> None:
    """Write a set as .json or .ssv, whole or not at all; :func:`read_set` gives an equal set, bit for bit.

    Raises ValueError for another suffix or if the file cannot be written.
    """
    write_whole(path, set_content(parameters, path))


def set_content(parameters: ParameterSet, path: str | os.PathLike[str]) -> str | bytes:
    """The content of a file of that name. Raises ValueError for a suffix other than .json or .ssv."""
    return set_json(parameters) if set_format(Path(path)) == ".json" else _to_ssv(parameters)


def _find(path: str | os.PathLike[str]) -> Path:
    """An existing file, or else the bundled set of that name."""
    names = sorted(file.stem for file in _BUNDLED.glob("*.json"))
    if not Path(path).is_file() and os.fspath(path) in names:
        return _BUNDLED / f"{os.fspath(path)}.json"
    if not Path(path).exists():
        raise InputError(
            f"{os.fspath(path)}: neither a file nor a bundled parameter set; give a path or one of {', '.join(names)}."
        )
    return Path(path)


def set_format(path: Path) -> str:
    """ ".json" or ".ssv". Raises ValueError for a file that is neither."""
    suffix = path.suffix.lower()
    if suffix not in (".json", ".ssv"):
        raise InputError(f"{path}: a parameter set is a .json or an .ssv file; give one whose name ends so.")
    return suffix


# --- checks -------------------------------------------------------------------------------------------------------


_OWNERS: Mapping[str, type] = {"network": Network, "fluid": Fluid, "segment": Segment, "junction": Junction}


def _quantities(owner: str) -> dict[str, Quantity]:
    """Quantities of an owner by key, from the solver: a new one needs no change here."""
    kinds = outlets.OUTLETS if owner == "outlet" else (_OWNERS[owner],)
    return {key: q for kind in kinds for key, q in (quantities(kind) | terms_of(owner)).items()}


def _checked(name: str, value: Value) -> Value:
    unit = unit_of(name)
    if value.unit != unit:
        raise InputError(f"{name}: the unit {value.unit} must be {unit}, that of the FMU variable; convert the value.")
    number = _finite(name, value.value)
    if value.ci95 is None:
        return Value(number, unit)
    if len(value.ci95) != 2:
        raise InputError(f"{name}: ci95 = {value.ci95!r} must be two numbers, low and high.")
    low, high = (_finite(f"{name} ci95", end) for end in value.ci95)
    if low > high:
        raise InputError(f"{name}: ci95 = [{low:g}, {high:g}] {unit} must be low before high; swap them.")
    return Value(number, unit, (low, high))


def _finite(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, str | bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {value!r}: must be a finite number; correct it or leave the parameter out.")
    return number


# --- JSON ---------------------------------------------------------------------------------------------------------


def set_json(parameters: ParameterSet) -> str:
    """The text of a .json file."""
    values = {
        name: {key: entry for key, entry in asdict(value).items() if entry is not None}
        for name, value in parameters.values.items()
    }
    data = {
        "format": _FORMAT,
        "name": parameters.name,
        "texts": parameters.texts,
        "values": values,
        "provenance": parameters.provenance,
    }
    text = json.dumps(data, indent=2, ensure_ascii=False)
    # one parameter a line: {"value": 1539000.0, "unit": "Pa"}
    short = re.sub(r'\{\s+("value": [^{}"]+,)\s+("unit": "[^"]*")\s+\}', r"{\1 \2}", text)
    interval = r'\{\s+("value": [^{}"]+,)\s+("unit": "[^"]*",)\s+("ci95":) \[\s+([^\s,]+,)\s+([^\s\]]+)\s+\]\s+\}'
    return re.sub(interval, r"{\1 \2 \3 [\4 \5]}", short) + "\n"


def _from_json(text: str) -> ParameterSet:
    data = _json(text)
    if not isinstance(data, dict) or data.get("format") != _FORMAT:
        raise InputError(f'not a parameter set: it must be a JSON object with "format": "{_FORMAT}".')
    check_keys("top level", data, _KEYS)
    for key in ("texts", "values", "provenance"):
        if not isinstance(data.get(key, {}), dict):
            raise InputError(f"{key}: must be a JSON object, such as {{}}.")
    if "values" not in data or "name" not in data:
        raise InputError(f"the key {'name' if 'name' not in data else 'values'} is missing; add it.")
    values = {name: _value(name, entry) for name, entry in data["values"].items()}
    return ParameterSet(data["name"], values, data.get("texts", {}), data.get("provenance", {}))


def _json(text: str) -> Any:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [key for key, _ in pairs]
            twice = next(key for key in names if names.count(key) > 1)
            raise InputError(f"the key {twice!r} occurs twice; keep one.")
        return table

    def refuse(constant: str) -> NoReturn:
        raise InputError(f"{constant} is not a finite number; correct it or leave the parameter out.")

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise InputError(f"not valid JSON: {error.msg} in line {error.lineno}; correct that line.") from None


def _value(name: str, entry: Any) -> Value:
    unit = unit_of(name)
    if not isinstance(entry, dict) or "value" not in entry:
        raise InputError(f'{name}: must be an object such as {{"value": 1, "unit": "{unit}"}}.')
    check_keys(name, entry, _VALUE_KEYS)
    if not isinstance(entry.get("unit"), str):
        raise InputError(f'{name}: its unit is missing; add "unit": "{unit}" or the one the value is in.')
    interval = entry.get("ci95")
    if interval is not None and not (isinstance(interval, list) and len(interval) == 2):
        raise InputError(f"{name}: ci95 = {json.dumps(interval)} must be two numbers, low and high.")
    number = _in_unit(name, entry["value"], entry["unit"], unit)
    ends = [_in_unit(f"{name} ci95", end, entry["unit"], unit) for end in interval or ()]
    return Value(number, unit, (ends[0], ends[1]) if ends else None)


def _in_unit(name: str, value: Any, given: str, unit: str) -> float:
    number = _finite(name, value)
    return number if given == unit else parse_quantity(f"{number!r} {given}", unit, name)


# --- SSV 1.0 ------------------------------------------------------------------------------------------------------


def _to_ssv(parameters: ParameterSet) -> bytes:
    """The document, by ElementTree: pyssp_standard would leave out the annotation, and may leave half a file."""
    for prefix, space in _NAMES.items():
        ElementTree.register_namespace(prefix, space)
    root = ElementTree.Element(f"{{{_SSV}}}ParameterSet", version="1.0", name=parameters.name)
    entries = ElementTree.SubElement(root, f"{{{_SSV}}}Parameters")
    for name, value in parameters.values.items():
        entry = ElementTree.SubElement(entries, f"{{{_SSV}}}Parameter", name=name)
        ElementTree.SubElement(entry, f"{{{_SSV}}}Real", value=repr(value.value), unit=value.unit)
    for name, text in parameters.texts.items():
        entry = ElementTree.SubElement(entries, f"{{{_SSV}}}Parameter", name=name)
        number = str(list(_TEXTS[name]).index(text) + 1)  # of the FMU's Enumeration; by name few clients take it
        ElementTree.SubElement(entry, f"{{{_SSV}}}Integer", value=number)
    used = sorted({value.unit for value in parameters.values.values()})
    if used:
        units = ElementTree.SubElement(root, f"{{{_SSV}}}Units")
        for unit in used:
            definition = ElementTree.SubElement(units, f"{{{_SSC}}}Unit", name=unit)
            powers = {base: str(power) for base, power in base_units(unit).items()}
            ElementTree.SubElement(definition, f"{{{_SSC}}}BaseUnit", powers)
    annotations = ElementTree.SubElement(root, f"{{{_SSV}}}Annotations")
    annotation = ElementTree.SubElement(annotations, f"{{{_SSC}}}Annotation", type=_ANNOTATION)
    intervals = {name: [v.value, *v.ci95] for name, v in parameters.values.items() if v.ci95 is not None}
    extra = {"value_and_ci95": intervals, "provenance": parameters.provenance}
    ElementTree.SubElement(annotation, "json").text = json.dumps(extra)  # ASCII: XML has no control characters
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _from_ssv(text: str) -> ParameterSet:
    try:
        root = ElementTree.fromstring(text.encode("utf-8"))
    except ElementTree.ParseError as error:
        raise InputError(f"not valid XML: {error}; correct that line.") from None
    if root.tag != f"{{{_SSV}}}ParameterSet" or not root.get("version", "").startswith("1."):
        raise InputError(f"not a parameter set of SSV 1: its root must be ParameterSet of {_SSV}, version 1.")
    values: dict[str, Value] = {}
    texts: dict[str, str] = {}
    for entry in root.iterfind("ssv:Parameters/ssv:Parameter", _NAMES):
        name = entry.get("name", "")
        if name in values or name in texts:
            raise InputError(f"the parameter {name!r} occurs twice; keep one.")
        real, integer, *named = (
            entry.find(f"ssv:{kind}", _NAMES) for kind in ("Real", "Integer", "Enumeration", "String")
        )
        given = next((node.get("value", "") for node in named if node is not None), None)
        if integer is not None:
            texts[name] = _numbered(name, integer.get("value", ""))
        elif given is not None:
            texts[name] = given
        elif real is not None:
            unit = unit_of(name)
            number = parse_quantity(f"{real.get('value', '')} {real.get('unit') or unit}", unit, name)
            values[name] = Value(number, unit)
        else:
            raise InputError(
                f"{name}: must be a Real, or an Integer or a name for a law; there are no other parameters."
            )
    extra = _annotation(root)
    return ParameterSet(root.get("name", ""), _with_intervals(values, extra), texts, extra.get("provenance", {}))


def _numbered(name: str, number: str) -> str:
    """The law with a number of the FMU's Enumeration. Raises ValueError if there is none."""
    laws = dict(enumerate(_TEXTS.get(name, ()), start=1))
    if not number.isdecimal() or int(number) not in laws:
        known = " or ".join(f"{i} ({law})" for i, law in laws.items()) or "a Real"
        raise InputError(f"{name} = {number!r}: must be {known}.")
    return laws[int(number)]


def _annotation(root: ElementTree.Element) -> dict[str, Any]:
    for annotation in root.iterfind("ssv:Annotations/ssc:Annotation", _NAMES):
        if annotation.get("type") == _ANNOTATION:
            extra = _json("".join(annotation.itertext()))
            intervals = extra.get("value_and_ci95", {}) if isinstance(extra, dict) else None
            whole = isinstance(intervals, dict) and all(isinstance(e, list) and len(e) == 3 for e in intervals.values())
            if not whole or not isinstance(extra.get("provenance", {}), dict):
                raise InputError(f"its annotation {_ANNOTATION} is damaged; remove it or write the file anew.")
            return extra
    return {}


def _with_intervals(values: Mapping[str, Value], extra: Mapping[str, Any]) -> dict[str, Value]:
    """Values with their intervals; a value changed by another tool has none."""
    result = dict(values)
    for name, entry in extra.get("value_and_ci95", {}).items():
        if name in result and entry[0] == result[name].value:
            result[name] = replace(result[name], ci95=(entry[1], entry[2]))
    return result
