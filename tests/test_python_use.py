"""From Python: ``arterial_fmu`` is the whole public interface, its packages are the same modules under both names, and
what is read by a wrong name says which one was meant."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from test_toy import TissueSupport

import arterial_fmu
import solver
from arterial_fmu.packages import NEEDS
from build_fmu import build
from discrepancy import discover
from fitting.results.parameter_set import ParameterSet
from solver import load, simulate, simulate_periodic
from solver.laws import effects, outlets, wall_laws
from solver.network.description import from_dict, to_dict
from solver.network.files import dumps, loads
from solver.quantities.quantity import quantity

ROOT = Path(__file__).resolve().parents[1]


def python(code: str, folder: Path = ROOT, *options: str) -> subprocess.CompletedProcess[str]:
    """Code in a process of its own, whose path begins with a folder."""
    where = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    line = [sys.executable, *(options or ("-c", code))]
    return subprocess.run(line, cwd=folder, env=where, capture_output=True, text=True, check=False)


# --- the package -----------------------------------------------------------------------------------------------------


def test_import_brings_nothing_heavy() -> None:
    """The import and the version load none of what is behind the names."""
    heavy = {"numpy", "scipy", "matplotlib", "typer", "rich", "solver", "fitting", "polars", "fmpy"}
    done = python(f"import sys, arterial_fmu as a; print(a.__version__, sorted({heavy} & set(sys.modules)))")
    assert done.stdout.strip() == f"{arterial_fmu.__version__} []", done.stderr


def test_every_public_name_is_there() -> None:
    """__all__ is what type checkers are told, and each name is the object of its own module."""
    tree = ast.parse((ROOT / "arterial_fmu" / "__init__.py").read_text(encoding="utf-8"))
    told = {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and not node.level
        for alias in node.names
    } - {("__future__", "annotations"), ("typing", "TYPE_CHECKING"), ("typing", "Any"), ("solver", "*")}
    for module, name in told:
        assert getattr(arterial_fmu, name) is getattr(sys.modules[module], name)
    assert set(arterial_fmu.__all__) == {name for _, name in told} | set(solver.__all__)
    assert set(arterial_fmu.__all__) <= set(dir(arterial_fmu))
    assert arterial_fmu.simulate is simulate
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        _ = arterial_fmu.simulat


def test_packages_are_the_same_modules() -> None:
    """Under ``arterial_fmu.`` and by the plain name: one module, one class, in either order of the imports."""
    code = """
import {first}
import {second}
import sys, warnings
warnings.simplefilter("error")
import arterial_fmu.fitting.wall.site_fit, arterial_fmu.discrepancy, arterial_fmu.fmu_src.importer.run
import arterial_fmu as af, solver
import fitting.wall.site_fit
from arterial_fmu.solver import load
from arterial_fmu.solver.network.description import Network
assert isinstance(solver.load("sheep"), Network) and Network is solver.network.description.Network
assert load is solver.load
assert af.fitting.wall is fitting.wall and af.solver.network is sys.modules["solver.network"]
assert solver.network.description.__spec__.name == "solver.network.description" and solver.__spec__.name == "solver"
"""
    for first, second in (
        ("arterial_fmu.solver.network.description", "solver.network.description"),
        ("solver.network.description", "arterial_fmu.solver"),
    ):
        done = python(code.format(first=first, second=second))
        assert done.returncode == 0, done.stderr
    done = python("import arterial_fmu.solver.nothing")
    assert "No module named 'arterial_fmu.solver.nothing'" in done.stderr


@pytest.mark.parametrize(
    ("file", "code"),
    [
        ("solver.py", "import arterial_fmu"),
        ("fitting.py", "import arterial_fmu as a; a.load('sheep'); a.fit"),
        ("fitting.py", "import arterial_fmu.fitting"),
        ("fmu_src.py", "import arterial_fmu as a; a.load('sheep'); a.fit"),
        ("solver/__init__.py", "import arterial_fmu"),
    ],
)
def test_a_file_of_the_same_name(file: str, code: str, tmp_path: Path) -> None:
    """A user's file that hides a package is named, with what to do; the rest works beside it."""
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("")
    package = file.partition("/")[0].removesuffix(".py")
    said = f"{tmp_path / file} hides the package {package} of arterial-fmu, because Python finds it first; rename your"
    assert f"ImportError: {said}" in python(code, tmp_path).stderr
    command = python("", tmp_path, "-m", "arterial_fmu", "fit", "record.csv")
    assert command.returncode != 0 and said in command.stderr and len(command.stderr.strip().splitlines()[-1]) < 400


def test_a_command_says_it_too(tmp_path: Path) -> None:
    """Of a package that only some commands need, also where these import it late or run it in another process."""
    for file, commands in (
        ("fitting.py", ("fit x", "study sheep", "discover x")),
        ("build_fmu.py", ("build sheep", "discover x")),
    ):
        (tmp_path / file).write_text("")
        for command in commands:
            done = python("", tmp_path, "-m", "arterial_fmu", *command.split())
            assert done.stderr.startswith(f"Error: {tmp_path / file} hides the package"), done.stderr
            assert done.returncode == 2
        (tmp_path / file).unlink()


@pytest.mark.parametrize(
    "package", ["solver", "fmu_src", "fitting", "discrepancy", "build_fmu.py", "arterial_fmu/study"]
)
def test_what_packages_need(package: str) -> None:
    """Whatever of this project a package imports, wherever in a function, is looked at before it runs."""
    path = ROOT / package
    texts = [each.read_text(encoding="utf-8") for each in ([path] if path.is_file() else path.rglob("*.py"))]
    found = set(re.findall(rf"^ *(?:from|import) ({'|'.join(NEEDS)})\b", "\n".join(texts), flags=re.MULTILINE))
    name = package.partition("/")[0].removesuffix(".py")
    assert found - {name} <= set(NEEDS[name])


# --- what is read by name --------------------------------------------------------------------------------------------


def test_parts_of_a_network_by_name() -> None:
    """By name or position; KeyError with the name that was meant; still tuples."""
    sheep = load("sheep")
    assert sheep.segments["CA"] is sheep.segment("CA") is sheep.segments[5]
    assert sheep.outlets["CA"].segment == "CA" and sheep.sites["FA"].name == "FA"
    assert sheep.junctions["AA"].inflow == ("AA",)
    assert isinstance(sheep.segments, tuple) and sheep.segments[:2] == tuple(sheep.segments)[:2]
    for asked in (lambda: sheep.segments["Ca"], lambda: sheep.segment("Ca")):
        with pytest.raises(KeyError, match="Ca: not among AA, PD, .* .did you mean CA"):
            asked()
    with pytest.raises(KeyError, match="not among none"):
        replace(sheep, sites=()).sites["CA"]


def test_a_variable_by_a_wrong_name() -> None:
    """The nearest variable of the result is suggested; ``in`` and ``get`` are as those of any mapping."""
    run = simulate(load("sheep"), duration=2e-3)
    with pytest.raises(KeyError, match=r"CA\.p: no variable of this result \(did you mean CA\.P\?\)"):
        run["CA.p"]
    assert "CA.p" not in run and run.get("CA.p") is None and 3 not in run


def test_batches_say_their_shapes() -> None:
    """An array that is no batch, two of different length, and a start of another batch."""
    sheep, three = (
        load("sheep"),
        simulate_periodic(load("cca"), parameters={"common_carotid_artery.E": np.full(3, 7e5)}, tolerance=0.1),
    )
    with pytest.raises(ValueError, match=r"CA\.E: batch of shape \(2, 1\), where that of B parameter sets is \(B,\)"):
        simulate(sheep, parameters={"CA.E": np.full((2, 1), 1e6)})
    with pytest.raises(ValueError, match=r"CA\.h: batch of shape \(3,\) does not fit CA\.E of shape \(2,\)"):
        simulate(sheep, parameters={"CA.E": np.full(2, 1e6), "CA.h": np.full(3, 1e-3)})
    with pytest.raises(ValueError, match=r"CA\.E = \[\[.*must be a number in Pa, or an array \(B,\) of them"):
        simulate(sheep, parameters={"CA.E": [[1e6, 2e6], [1e6]]})
    with pytest.raises(ValueError, match=r"its state is of 3 parameter sets, not 1; start from member\(i\) of it"):
        simulate_periodic(load("cca"), start=three)


# --- physics of a script ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Leaky(outlets.Resistance):
    """An outlet of a script."""


class Stiff(wall_laws.Beta):
    """A law of a script."""


@dataclass(frozen=True)
class Orifice(outlets.Pressure):
    """An outlet with a key of its own."""

    b: float = quantity(None, "Pa.s^2/m^6", "resistance b of the jet", 1.0, 1e25, nominal=1e14)


def test_an_outlet_and_a_law_of_a_script_are_in_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Network files recognise the outlet by its key, parameter sets the law by its name; a journal's dicts, too."""
    monkeypatch.setattr(outlets, "OUTLETS", (*outlets.OUTLETS, Orifice))
    monkeypatch.setitem(wall_laws.ELASTIC_LAWS, "mine", replace(wall_laws.ELASTIC_LAWS["beta"], name="mine"))  # type: ignore[type-var]
    sheep = load("sheep")
    ends = tuple(Orifice(o.segment, b=2e14) if o.segment == "CA" else o for o in sheep.outlets)
    mine = replace(sheep, outlets=ends, elastic_law="mine")
    assert loads(dumps(mine), "mine") == mine and from_dict(to_dict(mine)) == mine
    assert ParameterSet("mine", {}, {"network.elastic_law": "mine"}).texts == {"network.elastic_law": "mine"}
    with pytest.raises(ValueError, match="must be one of beta, regression, mine"):
        ParameterSet("mine", {}, {"network.elastic_law": "yours"})


def test_an_effect_of_a_script_is_refused_by_the_build(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The FMU carries the solver's code alone: what else a network needs is named; what it does not use, is not."""
    sheep = load("sheep")
    before = fmus["sheep"].read_bytes()
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, TissueSupport()))
    assert build(sheep, tmp_path / "after").read_bytes() == before
    held = sheep.with_terms({"CA.k_near": 5e6})
    with pytest.raises(
        ValueError, match=r"CA\.k_near: its class TissueSupport is in test_toy, .* solver/laws/effects\.py, .* native"
    ):
        build(held, tmp_path)
    leaky = sheep.with_outlet(Leaky("CA", R=1e9))
    with pytest.raises(
        ValueError, match=r"CA\.outlet: its class Leaky is in test_python_use, .* solver/laws/outlets\.py"
    ):
        build(leaky, tmp_path)
    monkeypatch.setitem(wall_laws.ELASTIC_LAWS, "beta", Stiff())
    with pytest.raises(ValueError, match=r"network\.elastic_law: its class Stiff .* solver/laws/wall_laws\.py"):
        build(sheep, tmp_path)
    assert not list(tmp_path.glob("*.fmu"))


def test_an_effect_of_a_script_is_refused_by_discover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The processes that build the FMUs do not know it: said before the search, not after it, and the record is not
    even read."""
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, TissueSupport()))
    with pytest.raises(
        ValueError, match=r"effect tissue_support: its class TissueSupport is in test_toy, .* solver/laws/effects\.py"
    ):
        discover(tmp_path / "none.csv", "sheep", tmp_path / "out")
    assert not list(tmp_path.iterdir())
