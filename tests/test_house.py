"""The house: imports run one way and never in a circle, files are short, and nothing stands twice."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from graphlib import TopologicalSorter

import pytest
from test_layout import PRODUCT, ROOT
from test_layout import imports as imports_of

MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in PRODUCT}
MAY_IMPORT = {
    "solver": {"solver", "numpy", "scipy", "pint", "typer", "rich", "yaml"},
    "fmu_src": {"fmu_src", "solver", "numpy", "typer", "rich", "pythonfmu", "fmpy", "matplotlib"},
    "fitting": {"fitting", "solver", "numpy", "scipy", "polars", "threadpoolctl", "fmpy", "typer", "rich", "matplotlib",
                "jinja2", "pyedflib", "distributed"},
    "discrepancy": {"discrepancy", "fitting", "solver", "numpy", "scipy", "typer", "rich", "matplotlib", "jinja2"},
    "arterial_fmu": {"arterial_fmu", "build_fmu", "discrepancy", "fitting", "fmu_src", "solver", "typer", "rich",
                     "numpy", "pandas", "polars", "matplotlib", "SALib", "fmpy"},
}  # fmt: skip
IN_NOTEBOOKS = {"matplotlib", "polars", "pandas"}  # imported when a result is first displayed
LONGEST = 400  # lines of a file
RUN = 6  # lines that may not stand twice


def imports(module: str) -> set[str]:
    """Every module that a module imports: at the top, inside functions, and for types alone."""
    found = set()
    for name, names in imports_of(MODULES[module]):
        inside = {f"{name}.{each}" for each in names} & MODULES.keys()
        found |= inside or {name}
    return found - {module}


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_run_one_way(package: str) -> None:
    """solver <- fmu_src; solver <- fitting <- discrepancy; all <- arterial_fmu; of others what it is made with."""
    allowed = MAY_IMPORT[package] | sys.stdlib_module_names
    own = [module for module in MODULES if module.split(".")[0] == package]
    found = {(m, name) for m in own for name in imports(m) if name.split(".")[0] not in allowed}
    assert found == set()


def test_no_file_runs_code() -> None:
    """Pickles go between our own processes alone, and nothing else of what runs code as it reads is there."""
    readers = {"pickle", "shelve", "marshal", "dill", "cloudpickle", "joblib", "distributed"}
    taken = {(module, name) for module in MODULES for name, _ in imports_of(MODULES[module]) if name in readers}
    assert taken == {("fitting.workers", "pickle"), ("fitting.cluster", "distributed")}
    trees = {module: ast.parse(path.read_text(encoding="utf-8")) for module, path in MODULES.items()}
    nodes = [(module, node) for module, tree in trees.items() for node in ast.walk(tree)]
    calls = {(module, ast.unparse(node.func)) for module, node in nodes if isinstance(node, ast.Call)}
    assert {each for each in calls if each[1] in {"eval", "exec", "np.load", "yaml.unsafe_load"}} == set()


def test_no_circle() -> None:
    """No module imports itself through others, not even inside a function."""
    graph = {m: imports(m) & MODULES.keys() for m in MODULES}
    TopologicalSorter(graph).prepare()  # CycleError names the circle


@pytest.mark.parametrize(
    ("modules", "late"),
    [("solver", IN_NOTEBOOKS), ("fitting.wall_fit, discrepancy.outcome", {"matplotlib", "pandas"})],
)
def test_results_do_not_wait_for_figures(modules: str, late: set[str]) -> None:
    """What runs a network, fits a wall or names an effect starts without what only its figures need."""
    code = f"import sys, {modules}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert late & set(done.stdout.split()) == set()


@pytest.mark.parametrize("module", MODULES)
def test_files_are_short(module: str) -> None:
    """A file is read in one sitting."""
    assert len(MODULES[module].read_text(encoding="utf-8").splitlines()) <= LONGEST


def test_nothing_stands_twice() -> None:
    """No six lines of code, blank ones and indentation aside, stand in two places of the product."""
    places = defaultdict(list)
    for module, path in MODULES.items():
        lines = [(i, line.strip()) for i, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)]
        lines = [(i, line) for i, line in lines if len(line) > 1 and not line.startswith(("#", "from ", "import "))]
        for at in range(len(lines) - RUN + 1):
            places["\n".join(line for _, line in lines[at : at + RUN])].append(f"{module}:{lines[at][0]}")
    assert [where for where in places.values() if len(where) > 1] == []
