"""Facts about an effect are stated in its class alone: nobody else in the product spells its name or its keys."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest
from test_layout import PRODUCT, ROOT, nodes

from solver.laws.effects import ALL
from solver.laws.outlets import OUTLETS
from solver.laws.wall import Wall

NAMES = {effect.name for effect in ALL}
KEYS = {key for effect in ALL for key in effect.terms}

# fields that every network has: named where they are defined and checked, in the law of one wall, and where that law
# is fitted and its numbers are shown; and what the law calls its own numbers
FIELDS = {key for effect in ALL if effect.always for key in effect.terms}
PHYSICS = (
    *(
        "solver/network/description.py",
        "solver/network/validation.py",
        "solver/laws/wall.py",
        "solver/network/aliases.py",
    ),
    *("solver/network/importers/openbf.py",),
    *(
        "fitting/wall/site_fit.py",
        "fitting/wall/wall_fit.py",
        "fitting/wall/wall_model.py",
        "fitting/wall/fit_diagnostics.py",
    ),
    *("fitting/wall/errors_in_variables.py", "fitting/wall/indices.py", "fitting/records/virtual.py"),
    *("fitting/cohort/", "fitting/pages/", "arterial_fmu/cli/tables/"),
)
OWN = {
    "solver/laws/wall.py": {f.name for f in fields(Wall)},
    "solver/network/coefficients.py": {"k"},  # of every junction: a coefficient of the scheme
    "solver/quantities/units.py": {"k"},  # kilo
    "solver/network/importers/openbf.py": {"P_ext"},  # its reference pressures, where vessels differ
    "fmu_src/contents/system.py": {"C", "R2"},  # of the outlets of one network, made for one heart
}


@cache
def classes_of_effects(path: Path) -> list[range]:
    """The lines of the classes in a file that belong to an effect of the catalogue or to a kind of outlet."""
    known = {kind for effect in ALL for kind in type(effect).__mro__[:-1]} | set(OUTLETS)
    kinds = {kind for kind in known if inspect.getsourcefile(kind) == str(path)}
    spans = [inspect.getsourcelines(kind) for kind in kinds]
    return [range(first, first + len(lines)) for lines, first in spans]


def literals(path: Path) -> Iterator[ast.Constant]:
    """Every text in the code, parts of f-strings included, docstrings not."""
    docs = {
        id(node.value) for node in nodes(path) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in nodes(path):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node


def words(text: str) -> set[str]:
    """What a text names: a variable's parts by their names and keys; a sentence effects by their full names alone."""
    if re.fullmatch(r"[\w.]+", text):
        return set(text.split(".")) & (NAMES | KEYS)
    return {word for word in re.findall(r"\w+", text) if "_" in word} & NAMES


def names(path: Path) -> list[str]:
    """Names and keys of the catalogue in texts of a file outside the classes of the effects."""
    inside, name = classes_of_effects(path), path.relative_to(ROOT).as_posix()
    allowed = (FIELDS if name.startswith(PHYSICS) else set()) | OWN.get(name, set())
    return [
        f"{name}:{node.lineno}: {word}"
        for node in literals(path)
        for word in sorted(words(node.value) - allowed)
        if not any(node.lineno in span for span in inside)
    ]


def kinds_asked(path: Path) -> list[str]:
    """Each ``isinstance`` of an effect or an outlet of one kind in a file, outside the classes of the effects."""
    kinds = {kind.__name__ for kind in (*OUTLETS, *map(type, ALL))}
    inside, name = classes_of_effects(path), path.relative_to(ROOT).as_posix()
    return [
        f"{name}:{call.lineno}: {sorted(asked)}"
        for call in nodes(path)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "isinstance"
        if (asked := {n.id for n in ast.walk(call.args[1]) if isinstance(n, ast.Name)} & kinds)
        if not any(call.lineno in span for span in inside)
    ]


@pytest.mark.parametrize("search", [names, kinds_asked])
def test_nobody_names_an_effect(search: Callable[[Path], list[str]]) -> None:
    """In no file of the product."""
    assert [offender for path in PRODUCT for offender in search(path)] == []
