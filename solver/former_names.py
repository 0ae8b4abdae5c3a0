"""Modules that the pages and examples of version 0.1 import: each leads to the module of today, with a
DeprecationWarning, until 0.3.

No FMU holds this file.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import InspectLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

MOVED = {
    "discrepancy.__main__": "arterial_fmu.cli.discover",
    "discrepancy.command_tables": "arterial_fmu.cli.tables.study",
    "fitting.__main__": "arterial_fmu.cli.fit",
    "fitting.bench": "fitting.inference.models.bench_network",
    "fitting.calibrate": "fitting.calibrate.network_calibration",
    "fitting.check": "fitting.check.fmu_check",
    "fitting.held_out": "fitting.calibrate.held_out",
    "fitting.parameter_set": "fitting.results.parameter_set",
    "fitting.records.align": "fitting.records.alignment.align",
    "fitting.records.columns": "fitting.records.read.columns",
    "fitting.records.filters": "fitting.records.channels.filters",
    "fitting.records.record": "fitting.records.read.record",
    "fitting.wall": "fitting.wall.site_fit",
    "fmu_src.models": "fmu_src.contents.models",
    "fmu_src.ports": "fmu_src.cosimulation.ports",
    "fmu_src.run": "fmu_src.importer.run",
    "fmu_src.system": "fmu_src.contents.system",
    "fmu_src.unpacking": "fmu_src.importer.unpacking",
    "solver.__main__": "arterial_fmu.cli.solve",
    "solver.catalogue": "solver.laws.catalogue",
    "solver.console": "arterial_fmu.cli.terminal.console",
    "solver.effect": "solver.laws.effect",
    "solver.effects": "solver.laws.effects",
    "solver.files": "solver.network.files",
    "solver.laws": "solver.laws.wall_laws",
    "solver.outlets": "solver.laws.outlets",
    "solver.progress": "arterial_fmu.cli.terminal.progress",
    "solver.quantity": "solver.quantities.quantity",
    "solver.units": "solver.quantities.units",
    "solver.wall": "solver.laws.wall",
}
# the command with which the words after ``python -m`` begin, where their first is none
COMMANDS = {"discrepancy.__main__": "discover", "fmu_src.run": "run", "solver.__main__": "solve"}
_RUN = """import sys; from arterial_fmu.__main__ import main; from arterial_fmu.cli.commands import COMMANDS
words = sys.argv[1:]
main(words if words and words[0] in COMMANDS else [*{first}, *words])
"""


def _warn(former: str, now: str, level: int = 3) -> None:
    text = f"{former} is {now} now; the former name goes with version 0.3."
    warnings.warn(text, DeprecationWarning, stacklevel=level)


def former(package: str, name: str) -> Any:
    """A name of the former module that a package is called as today. Raises AttributeError if there is none."""
    if not name.startswith("__") and find_spec(f"{package}.{name}") is None:
        module = import_module(MOVED[package])
        if hasattr(module, name):
            _warn(f"{package}.{name}", f"{MOVED[package]}.{name}", 4)
            return getattr(module, name)
    raise AttributeError(f"module {package!r} has no attribute {name!r}")


class FormerNames(MetaPathFinder, InspectLoader):
    """Finds a module by its former name, if nothing else does: one object under both names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module of today behind a former name, None for any other."""
        return ModuleSpec(fullname, self) if fullname in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module of today; keep its spec, which the import is about to replace."""
        _warn(spec.name, MOVED[spec.name])
        module = import_module(MOVED[spec.name])
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """The module has already run: restore its own spec."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state

    def get_source(self, fullname: str) -> str | None:
        """None: the code is that of the module of today."""
        return None

    def get_code(self, fullname: str) -> CodeType | None:
        """The code that ``python -m`` runs."""
        first = COMMANDS.get(fullname, "").split()
        _warn(f"python -m {fullname.removesuffix('.__main__')}", " ".join(["arterial-fmu", *first]))
        code: CodeType = compile(_RUN.format(first=first), fullname, "exec")
        return code


FINDER = FormerNames()
sys.meta_path.append(FINDER)
