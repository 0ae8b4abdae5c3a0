"""Common parts of the HTML pages of all reports: the template environment, and provenance in words."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from solver.quantities.legible import number
from solver.quantities.units import readable

_PARTS = Path(__file__).parent / "templates"  # of all pages
_LONGEST = 400  # characters of an entry; longer ones are only in the JSON file


@cache
def environment(folder: Path) -> Environment:
    """The templates of a folder, each compiled once; text is escaped, and an undefined name is an error."""
    templates = Environment(
        loader=FileSystemLoader((folder, _PARTS)),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["paragraphs"] = paragraphs
    return templates


def paragraphs(text: str) -> list[tuple[bool, list[str]]]:
    """Runs of lines, each with whether it is a list, whose lines begin with "- "; without that mark."""
    parts = groupby(text.split("\n"), lambda line: line.startswith("- "))
    return [(listed, [line.removeprefix("- ") for line in lines]) for listed, lines in parts]


def words(value: Any, literal: bool = False) -> str:
    """Provenance in words. literal : the keys come from outside, such as titles of columns, and stay as they are."""
    if isinstance(value, Mapping) and set(value) == {"value", "unit"}:
        unit, factor = ("s", 1.0) if value["unit"] == "s" else readable(value["unit"])  # of runs and records, not walls
        return f"{number(factor * value['value'], 4)} {unit}".rstrip()
    if isinstance(value, Mapping):
        return "; ".join(f"{_spaced(str(key), literal)}: {words(each, key == 'map')}" for key, each in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(words, value))
    return number(value, 4) if isinstance(value, float) else str(value)


def _spaced(key: str, literal: bool) -> str:
    """A key with spaces for underscores. Names of constants, of variables and from outside stay as they are."""
    return key if literal or not (key.isidentifier() and key.islower()) else key.replace("_", " ")


def in_words(entries: Mapping[str, Any]) -> tuple[dict[str, str], list[str]]:
    """Provenance entry by entry, and the names of entries for programs: tables of numbers, and long ones.

    Empty entries are omitted.
    """
    named = {key.replace("_", " "): words(value) for key, value in entries.items() if value not in ([], {})}
    nested = {key.replace("_", " ") for key, value in entries.items() if _depth(value) > 1}
    data = [key for key, text in named.items() if key in nested or len(text) > _LONGEST]
    return {key: text for key, text in named.items() if key not in data}, data


def _depth(value: Any) -> int:
    """The nesting depth of lists and mappings; a number with its unit has depth 0."""
    if isinstance(value, Mapping) and set(value) != {"value", "unit"}:
        return 1 + max(map(_depth, value.values()), default=0)
    return 1 + max(map(_depth, value), default=0) if isinstance(value, list | tuple) else 0
