"""Who may import whom: the product never its tests, the independent generators nothing of it that computes."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = [ROOT / "build_fmu.py", *(p for d in ("solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu")
                                    for p in sorted((ROOT / d).rglob("*.py")))]  # fmt: skip
TRUTH = sorted((ROOT / "tests" / "truth").glob("*.py"))

# the numbers of a network, and the writer of record files
SHARED = {
    "solver": {"Network", "load"},
    "solver.network.description": {"Network"},
    "solver.laws.outlets": {"Pressure", "Reflection", "Resistance", "Windkessel"},
    "fitting.records.read.record": {"write_record"},
}


@cache
def nodes(path: Path) -> list[ast.AST]:
    """All nodes of a file's syntax tree."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def imports(path: Path) -> list[tuple[str, tuple[str, ...]]]:
    """Absolute module and names of every import in a file, those inside functions and under conditions included."""
    found = []
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found += [(alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).parent.parts
            base = package[: len(package) + 1 - node.level] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found.append((module, tuple(alias.name for alias in node.names)))
    return found


def test_the_product_imports_no_test() -> None:
    """Neither tests, with their generators, nor benchmarks, nor examples."""
    outside = {"tests", "truth", "benchmarks", "examples"}
    assert not [(path, name) for path in PRODUCT for name, _ in imports(path) if name.split(".")[0] in outside]


def test_the_generators_take_numbers_alone() -> None:
    """Of the product: the dataclasses of a network and the writer of record files; no solver, no law, no fit."""
    own = {"solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu", "build_fmu", "benchmarks"}
    taken = [(path.name, module, name) for path in TRUTH for module, names in imports(path)
             if module.split(".")[0] in own for name in names or ("*",)]  # fmt: skip
    assert taken
    assert [each for each in taken if each[2] not in SHARED.get(each[1], ())] == []
