"""The packages behind ``arterial_fmu``: check that Python finds those of this project, and provide
``arterial_fmu.solver``.

They have plain names, which a user's file may also have; Python imports the one that it finds first.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

_HOME = Path(__file__).resolve().parents[1]
PACKAGES = ("solver", "fmu_src", "fitting", "discrepancy")
_PARENT = __name__.partition(".")[0]
# the packages that each of them imports, or runs in another process
NEEDS: dict[str, tuple[str, ...]] = {
    "solver": (),
    "fmu_src": ("solver",),
    "fitting": ("solver", "fmu_src"),
    "discrepancy": ("solver", "fmu_src", "fitting", "build_fmu"),
    "build_fmu": ("solver", "fmu_src"),
    "arterial_fmu": ("solver", "fmu_src", "fitting"),  # its study
}


def check_own(package: str) -> None:
    """Raise ImportError if a file from elsewhere hides a package of this project, or one that it needs."""
    for name in (*NEEDS.get(package, ()), package):
        found = sys.modules[name] if name in sys.modules else find_spec(name)
        place = getattr(found, "__file__", None) or getattr(found, "origin", None)
        if place and Path(place).resolve() not in (_HOME / f"{name}.py", _HOME / name / "__init__.py"):
            raise ImportError(
                f"{place} hides the package {name} of arterial-fmu, because Python finds it first; rename your file, "
                "or run Python in another folder.",
                name=name,
                path=place,
            )


def own(module: str) -> Any:
    """Import a module of this project by its plain name, "fitting.wall.site_fit". Raises ImportError as above."""
    check_own(module.partition(".")[0])
    return import_module(module)


class AsOwn(MetaPathFinder, Loader):
    """Find ``arterial_fmu.solver.network.description`` as the module ``solver.network.description``: one object under
    both names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module behind such a name, None for any other."""
        parent, _, plain = fullname.partition(".")
        package = plain.partition(".")[0]
        if parent != _PARENT or package not in PACKAGES:
            return None
        check_own(package)
        return ModuleSpec(fullname, self, loader_state=plain) if find_spec(plain) else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module under its plain name; keep its spec and loader, which the import is about to replace."""
        module: ModuleType = import_module(spec.loader_state)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """The module has already run: restore its own spec and loader."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state
