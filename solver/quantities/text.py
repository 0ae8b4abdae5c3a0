"""Text of files: numbers with units, keys and the sentences about them.

Units are read here, once: those of the project's own table without pint, which takes half a second to start, all others
by pint. Reading is exact: the magnitude times the exact rational factor of the unit, rounded once, so "4 cm" is 0.04.
"""

from __future__ import annotations

import difflib
import json
import math
import os
import re
import tokenize
import zipfile
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import InputError
from .units import display_units, exact_factor


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a file in UTF-8. Raises ValueError if it is none or cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        if zipfile.is_zipfile(path):
            raise InputError(f"{path}: an FMU or another archive, where text was expected; give a text file.") from None
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    except ValueError:  # a path with a zero character
        raise InputError(f"{str(path)!r}: cannot be read (no name of a file); check the path.") from None


# --- numbers and units --------------------------------------------------------------------------------------------

_NUMBER = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|[+-]?(?:nan|inf)\b)\s*(.*)")


def parse_quantity(value: str | float, unit: str, name: str) -> float:
    """The value in ``unit`` of a number in that unit or of text with its own unit: ("4 cm", "m", "AA.L") -> 0.04.

    value : a number, or text with a number and optionally a unit as pint spells it ("1 mmHg*s/mL"). unit : as in
    :class:`solver.network.description.Quantity` ("Pa.s", "1"). name : the meaning of the number, for the error. Raises
    ValueError, one sentence, if it is not a finite number or the unit is unknown or of another kind.
    """
    assignment = f"{name} = {json.dumps(value, ensure_ascii=False, default=str)}"
    wanted = "a number without unit" if unit == "1" else f"a number in {pint_spelling(unit)}"
    numeric = isinstance(value, str | float | int) and not isinstance(value, bool)
    match = _NUMBER.fullmatch(str(value).strip()) if numeric else None
    if match is None:
        raise InputError(
            f'{assignment}: must be {wanted}; write it bare or with a unit in quotes, such as "{example(unit)}".'
        )
    magnitude = float(match[1])
    if magnitude == 0.0:
        _factor(match[2], unit, assignment)
        return magnitude  # keeps the sign of -0.0
    try:
        result = (
            float(Fraction(match[1]) * _factor(match[2], unit, assignment)) if math.isfinite(magnitude) else magnitude
        )
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise InputError(f"{assignment}: must be {wanted} that is finite; check the value.")
    return result


def typed_quantity(text: str, unit: str, name: str, display: str | None = None) -> float:
    """As :func:`parse_quantity`, for command-line arguments: a number must have a unit.

    Exceptions are 0 and times, which are then in seconds. display : the display unit, if it is not the usual one.
    Raises ValueError also for a number without its unit.
    """
    match = _NUMBER.fullmatch(text.strip())
    if match and not match[2] and unit not in ("1", "s") and float(match[1]) != 0.0:
        proposed = f'"{text.strip()} {typed_unit(unit, display)}"'
        raise InputError(f"{name} = {text}: it has no unit; write one, such as {proposed}.")
    return parse_quantity(text, unit, name)


def typed_unit(unit: str, display: str | None = None) -> str:
    """The display unit of a number, as typed: "Pa.s" -> "kPa*s"."""
    return pint_spelling(display or next(iter(display_units(unit)), unit))


def assignments(texts: Iterable[str], units: Mapping[str, tuple[str, str | None]]) -> dict[str, float | str]:
    """{"CA.phi0": 0.0} from ["CA.phi0=0 kPa*s"], the arguments of the option --set.

    units : SI and display units of numbers by name; the value of any other name stays a text.
    Raises ValueError, one sentence.
    """
    found: dict[str, float | str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError(f'--set {text}: must look like NAME=VALUE, for example "CA.phi0=0 kPa*s".')
        if name in units:
            unit, display = units[name]
            found[name] = typed_quantity(value, unit, f"--set {name}", display)
        else:
            found[name] = value
    return found


# a number of three digits, a power of a power, or an exponent that is not a number of two digits at most: 9**9**9**9
# would block exact arithmetic indefinitely
_ENDLESS = re.compile(
    r"\d{3}|(\*\*|\^)[^*^/]*\d\s*\)*\s*(\*\*|\^)|(\*\*|\^)(?!\s*[+-]?\d{1,2}(?![\d.])|\s*\(\s*[+-]?\d{1,2}\s*\))"
)


def _factor(text: str, unit: str, assignment: str) -> Fraction:
    """The exact factor from the unit in ``text`` to ``unit``; no text means that unit itself."""
    wanted = pint_spelling(unit)
    known = exact_factor(pint_spelling(text).replace("*", "."), unit) if text else Fraction(1)
    if known is not None:
        return known
    registry = _registry()
    try:
        if _ENDLESS.search(text):
            raise ValueError
        given = registry.parse_units(pint_spelling(text))
        dimension = given.dimensionality
        one = registry.Quantity(Fraction(1), given).to_root_units()  # a logarithmic unit, such as dB, has no factor
    # the parser of pint lets all of these through for text that is not a unit
    except (tokenize.TokenError, AssertionError, AttributeError, ValueError, TypeError, ArithmeticError, LookupError):
        raise InputError(
            f'{assignment}: the unit {text} is not known; expected {wanted or "no unit"}, such as "{example(unit)}".'
        ) from None
    target = registry.parse_units(wanted)
    # pint counts angles as numbers: rpm and rad/s would be Hz without the factor of 2 pi
    if dimension != target.dimensionality or "radian" in dict(one.unit_items()):
        raise InputError(
            f"{assignment}: the unit {text} does not convert to the expected {wanted or 'number without unit'}; "
            f'correct the unit or the key, such as "{example(unit)}".'
        )
    return registry.convert(Fraction(1), given, target)


@cache
def _registry() -> Any:
    """pint's units with exact rational factors, created on first use, which takes half a second."""
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


def pint_spelling(unit: str) -> str:
    """ "Pa.s" and "Pa·s", as FMI and people write them, in pint's spelling "Pa*s"; "1" as ""."""
    return "" if unit == "1" else re.sub(r"(?<=\w)\s*[.·⋅]\s*(?=[^\W\d])", "*", unit)


def example(unit: str) -> str:
    return f"1 {pint_spelling(unit)}".strip()


# --- keys ---------------------------------------------------------------------------------------------------------


def check_keys(where: str, table: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError that names the first key of ``table`` that is not among the known ones."""
    known = list(known)
    for key in table:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; use one of {', '.join(known)}{did_you_mean(key, known)}.")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """ " (did you mean E?)" for the known name nearest to ``name``; nothing if none is near."""
    folded = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), folded, n=1, cutoff=0.5)
    return f" (did you mean {folded[close[0]]}?)" if close else ""


def quoted(text: str | Iterable[str]) -> str:
    """A TOML string, or array of them: as JSON writes it, and DEL, which TOML wants escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
