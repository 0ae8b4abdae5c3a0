"""Pulse waves in viscoelastic arteries: the public names for scripts, imported on first use.

>>> import arterial_fmu as af
>>> sheep = af.load("sheep")
>>> af.simulate_periodic(sheep)["CA.P"].max()  # Pa
>>> af.build(sheep, "dist")  # dist/sheep.fmu

The packages behind it are the same modules as under their plain names: ``arterial_fmu.solver`` is ``solver``; likewise
fitting, discrepancy and fmu_src. The command line is in this package, which none of them imports.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from .packages import PACKAGES, AsOwn, check_own, own

if TYPE_CHECKING:  # "as" marks a name as public for type checkers
    from build_fmu import build as build
    from build_fmu import build_native as build_native
    from build_fmu import build_system as build_system
    from discrepancy import discover as discover
    from fitting.calibrate.network_calibration import calibrate as calibrate
    from fitting.check.fmu_check import check as check
    from fitting.first.model import first_model as first_model
    from fitting.records.alignment.align import align as align
    from fitting.records.read.record import Record as Record
    from fitting.records.read.record import read_record as read_record
    from fitting.records.read.record import write_record as write_record
    from fitting.results.parameter_set import ParameterSet as ParameterSet
    from fitting.results.parameter_set import read_set as read_set
    from fitting.results.parameter_set import write_set as write_set
    from fitting.wall.site_fit import fit as fit
    from fmu_src import __version__ as __version__
    from fmu_src.importer.run import FMUError as FMUError
    from fmu_src.importer.run import run_fmu as run_fmu
    from solver import *  # noqa: F403

# modules of the names that scripts use most; all other names are those of solver
_NAMES = {
    "solver": "load simulate simulate_periodic Waveforms Network",
    "build_fmu": "build build_native build_system",
    "fmu_src.importer.run": "run_fmu FMUError",
    "fitting.records.read.record": "read_record write_record Record",
    "fitting.records.alignment.align": "align",
    "fitting.wall.site_fit": "fit",
    "fitting.first.model": "first_model",
    "fitting.calibrate.network_calibration": "calibrate",
    "fitting.results.parameter_set": "read_set write_set ParameterSet",
    "fitting.check.fmu_check": "check",
    "discrepancy": "discover",
    "fmu_src": "__version__",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

check_own("solver")
if not any(isinstance(finder, AsOwn) for finder in sys.meta_path):
    sys.meta_path.insert(0, AsOwn())


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return list(dict.fromkeys([*_HOMES, *own("solver").__all__]))
    if name in PACKAGES:
        return own(f"{__name__}.{name}")
    if name in _HOMES:
        return getattr(own(_HOMES[name]), name)
    if not name.startswith("_") and name in own("solver").__all__:
        return getattr(own("solver"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__getattr__("__all__"), *PACKAGES})
