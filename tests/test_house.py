"""The house: imports run one way and never in a circle, files are short, and nothing stands twice."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter

import pytest
from test_layout import PRODUCT, ROOT, nodes
from test_layout import imports as imports_of

MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in PRODUCT}
MAY_IMPORT = {
    "solver": {"solver", "numpy", "scipy", "pint", "yaml"},
    "fmu_src": {"fmu_src", "solver", "numpy", "pythonfmu", "fmpy", "matplotlib", "PIL"},
    "fitting": {"fitting", "solver", "numpy", "scipy", "polars", "threadpoolctl", "fmpy", "matplotlib",
                "jinja2", "pyedflib", "distributed"},
    "discrepancy": {"discrepancy", "fitting", "solver", "numpy", "scipy", "matplotlib", "jinja2"},
    "arterial_fmu": {"arterial_fmu", "build_fmu", "discrepancy", "fitting", "fmu_src", "solver", "typer", "rich",
                     "numpy", "pandas", "polars", "matplotlib", "SALib", "fmpy"},
}  # fmt: skip
IN_NOTEBOOKS = {"matplotlib", "polars", "pandas"}  # imported when a result is first displayed
LONGEST = 400  # lines of a file
MOST = 15  # files of a folder
RUN = 6  # lines that may not stand twice
AT_START = 100  # modules of the product that a command imports before it runs
# of the same package, what a room may import; the others may import any that does not import them
ROOMS = {
    "solver.scheme": {"solver.errors", "solver.quantities", "solver.laws", "solver.network", "solver.mesh"},
    "fitting.inference": {"fitting.inference", "fitting.records", "fitting.results", "fitting.parallel"},
}


@cache
def imports(module: str) -> set[str]:
    """Every module that a module imports: at the top, inside functions, and for types alone."""
    found = set()
    for name, names in imports_of(MODULES[module]):
        inside = {f"{name}.{each}" for each in names} & MODULES.keys()
        found |= inside or {name}
    return found - {module}


@cache
def called(module: str) -> set[str]:
    """The names of all functions that a module calls."""
    return {ast.unparse(node.func) for node in nodes(MODULES[module]) if isinstance(node, ast.Call)}


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
    assert taken == {("fitting.parallel.workers", "pickle"), ("fitting.parallel.cluster", "distributed")}
    calls = {(module, name) for module in MODULES for name in called(module)}
    assert {each for each in calls if each[1] in {"eval", "exec", "np.load", "yaml.unsafe_load"}} == set()


def test_no_circle() -> None:
    """No module imports itself through others, not even inside a function."""
    graph = {m: imports(m) & MODULES.keys() for m in MODULES}
    assert set(TopologicalSorter(graph).static_order()) == MODULES.keys()  # CycleError names the circle


@cache
def room(module: str) -> str:
    """The folder of a module; the module itself if it imports nothing of its package, so that all may import it."""
    own = {name for name in imports(module) & MODULES.keys() if name.split(".")[0] == module.split(".")[0]}
    alone = not own and MODULES[module].name != "__init__.py"
    return module if alone else ".".join(MODULES[module].relative_to(ROOT).parent.parts) or module


def test_no_circle_of_folders() -> None:
    """No folder imports itself through others, not even inside a function."""
    graph: dict[str, set[str]] = defaultdict(set)
    for module in MODULES:
        graph[room(module)] |= {room(name) for name in imports(module) & MODULES.keys()} - {room(module)}
    assert set(TopologicalSorter(graph).static_order()) == set(graph)  # CycleError names the circle


@pytest.mark.parametrize("folder", ROOMS)
def test_a_room_imports_what_is_below_it(folder: str) -> None:
    """The scheme knows no caller, and the inference core nothing of the fits that use it."""
    package = folder.split(".")[0]
    inside = [module for module in MODULES if f"{module}.".startswith(f"{folder}.")]
    found = {(m, name) for m in inside for name in imports(m) & MODULES.keys() if name.split(".")[0] == package}
    allowed = tuple(f"{name}." for name in {folder, *ROOMS[folder]})
    assert {(m, name) for m, name in found if not f"{name}.".startswith(allowed)} == set()


def test_nothing_is_imported_by_text() -> None:
    """No import hides from these tests in a text: what results are shown by, and modules under a former name, alone."""
    calls = {"import_module", "importlib.import_module", "__import__", "runpy.run_module"}
    found = {module for module in MODULES if called(module) & calls}
    assert {module for module in found if not module.startswith("arterial_fmu")} == {
        "build_fmu",  # its command line, as a script
        "fitting.parallel.workers",  # the module of a task
        "solver.displays",
        "solver.former_names",
    }


def test_folders_are_small() -> None:
    """A folder is seen at once."""
    folders = {path.parent for path in PRODUCT} - {ROOT}
    assert [folder for folder in folders if len(list(folder.glob("*.py"))) > MOST] == []


@pytest.mark.parametrize(
    ("modules", "late"),
    [("solver", IN_NOTEBOOKS), ("fitting.wall.wall_fit, discrepancy.findings.outcome", {"matplotlib", "pandas"})],
)
def test_results_do_not_wait_for_figures(modules: str, late: set[str]) -> None:
    """What runs a network, fits a wall or names an effect starts without what only its figures need."""
    code = f"import sys, {modules}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert late & set(done.stdout.split()) == set()


def test_the_largest_command_starts_with_few_modules() -> None:
    """``discover`` imports the others when it runs, the finite volumes when they are used."""
    code = "import sys, arterial_fmu.cli.discover; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert len(set(done.stdout.split()) & MODULES.keys()) <= AT_START


def test_files_are_short() -> None:
    """A file is read in one sitting."""
    lines = {module: len(path.read_text(encoding="utf-8").splitlines()) for module, path in MODULES.items()}
    assert {module: n for module, n in lines.items() if n > LONGEST} == {}


def test_nothing_stands_twice() -> None:
    """No six lines of code, blank ones, imports and indentation aside, stand in two places of the product."""
    places = defaultdict(list)
    for module, path in MODULES.items():
        text = path.read_text(encoding="utf-8")
        tree = [node for node in nodes(path) if isinstance(node, ast.Import | ast.ImportFrom)]
        aside = {i for node in tree for i in range(node.lineno, (node.end_lineno or 0) + 1)}
        lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1) if i not in aside]
        lines = [(i, line) for i, line in lines if len(line) > 1 and not line.startswith("#")]
        for at in range(len(lines) - RUN + 1):
            places["\n".join(line for _, line in lines[at : at + RUN])].append(f"{module}:{lines[at][0]}")
    assert [where for where in places.values() if len(where) > 1] == []
