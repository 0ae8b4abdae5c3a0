"""Facts about an effect are stated in its class alone: nobody else in the product spells its name or its keys."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest
from test_layout import PRODUCT, ROOT

from solver.effects import ALL
from solver.network import Fluid, Segment

NAMES = {effect.name for effect in ALL}
KEYS = {key for effect in ALL for key in effect.terms}

# the symbols of the wall law and the fluid, fields that every network has, where they are what is computed with: the
# laws, the fits of one wall and what is said of them
FIELDS = {f.name for kind in (Segment, Fluid) for f in fields(kind)}
PHYSICS = ("solver/wall.py", "fitting/wall.py", "fitting/cohort/", "fitting/records/virtual.py", "fitting/indices.py")


def classes_of_effects(path: Path) -> list[range]:
    """The lines of the classes in a file that belong to an effect of the catalogue."""
    kinds = {kind for effect in ALL for kind in type(effect).__mro__[:-1] if inspect.getsourcefile(kind) == str(path)}
    spans = [inspect.getsourcelines(kind) for kind in kinds]
    return [range(first, first + len(lines)) for lines, first in spans]


def literals(path: Path) -> Iterator[ast.Constant]:
    """Every text in the code, parts of f-strings included, docstrings not."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node


def words(text: str) -> set[str]:
    """What a text names: its dotted parts; of a sentence only what has an underscore, as no plain word has."""
    found = re.findall(r"\w+", text)
    return {word for word in found if "_" in word} if re.search(r"\s", text.strip()) else set(found)


@pytest.mark.parametrize("path", PRODUCT, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_effect_is_named(path: Path) -> None:
    """No name and no key of the catalogue in a text of the code outside the classes of the effects."""
    inside, name = classes_of_effects(path), path.relative_to(ROOT).as_posix()
    allowed = FIELDS if name.startswith(PHYSICS) else set()
    offenders = [
        f"{name}:{node.lineno}: {word}"
        for node in literals(path)
        for word in sorted(words(node.value) & (NAMES | KEYS) - allowed)
        if not any(node.lineno in span for span in inside)
    ]
    assert not offenders, "\n".join(offenders)
