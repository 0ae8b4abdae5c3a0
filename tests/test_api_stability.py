"""docs/api-stability.md lists the public names: all of them, where they are, and nothing else."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import arterial_fmu
import discrepancy
import solver
from fmu_src import __version__
from solver.former_names import MOVED

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "api-stability.md").read_text(encoding="utf-8")


def listed() -> dict[str, str]:
    """The package of each name in the table of the section on Python."""
    rows = re.findall(r"^\| (`.*`) \| `(\w+)` \|$", PAGE, flags=re.MULTILINE)
    pairs = [(name, package) for names, package in rows for name in re.findall(r"`(\w+)`", names)]
    assert len(pairs) == len(dict(pairs))  # none twice
    return dict(pairs)


def test_the_page_lists_the_public_names() -> None:
    """Those of ``__all__`` of each package; each from the package that the table says."""
    assert sorted(listed()) == sorted(arterial_fmu.__all__)
    assert {name for name, package in listed().items() if package == "solver"} == set(solver.__all__)
    assert {name for name, package in listed().items() if package == "discrepancy"} == set(discrepancy.__all__)


def test_each_is_where_the_page_says() -> None:
    for name, package in listed().items():
        found = getattr(arterial_fmu, name)
        module = getattr(found, "__module__", "fmu_src")  # __version__ is a text
        assert module.partition(".")[0] == package, name
        importlib.import_module(package)


def test_the_page_lists_what_is_deprecated() -> None:
    """Every module by a former name and its module of today, and nothing else."""
    section = PAGE.partition("## Deprecated")[2].partition("\n## ")[0]
    rows = dict(re.findall(r"^\| `([\w.]+)` \| `([\w.]+)` \|$", section, flags=re.MULTILINE))
    assert rows == {old: new for old, new in MOVED.items() if not old.endswith("__main__")}


def test_one_version() -> None:
    """The package, the citation and the newest section of the changelog have one version."""
    citation = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), flags=re.MULTILINE)
    changes = re.search(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert citation and changes
    assert {citation[1], changes[1]} == {__version__}


def test_every_package_is_typed() -> None:
    packages = {path.parent for path in ROOT.glob("*/__init__.py")}
    assert {path.name for path in packages} >= {"solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu"}
    assert [path.name for path in packages if not (path / "py.typed").is_file()] == []
