"""Modules by their names in version 0.1: each leads to the module of today, with a DeprecationWarning, until 0.3.

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

# the package of today, the former one, and the modules that moved, with their names of today where these changed
_ROWS = """
arterial_fmu solver notebook
arterial_fmu.cli arterial_fmu apart commands
arterial_fmu.cli discrepancy __main__>discover
arterial_fmu.cli fitting __main__>fit calibrate_command>calibrate
arterial_fmu.cli fitting.first command>first
arterial_fmu.cli solver __main__>solve commands>networks
arterial_fmu.cli.tables discrepancy command_tables>study
arterial_fmu.cli.tables fitting.pages recordings_table>recordings tables>fits
arterial_fmu.cli.terminal fitting record_options
arterial_fmu.cli.terminal solver console options progress
arterial_fmu.notebook discrepancy notebook>study
arterial_fmu.notebook fitting notebook>wall
arterial_fmu.notebook solver.notebook frames tables waveforms
discrepancy discrepancy asked>options journal>checkpoint summary>assemble
discrepancy.add discrepancy described learning
discrepancy.find discrepancy find>balances source>model_source study usable>plausibility
discrepancy.findings discrepancy isolability learned_law>outcome outcome places>map_marks recorded shown_map
discrepancy.name discrepancy animal>individual_walls at_places intervals law_starts name>model_selection
discrepancy.name discrepancy nearest>model_selection rivals>at_places scoring together>joint_selection verdict
discrepancy.name fitting.inference from_afar>model_selection
discrepancy.plan discrepancy second_state sensor_plan
discrepancy.report discrepancy figures learned_text>verdict_text map_figure>figures
discrepancy.report discrepancy map_text>verdict_text report>page tables wording>verdict_text
discrepancy.show discrepancy show>fmu_validation
fitting.calibrate fitting calibrate>network_calibration calibrated first_search held_out network_indices
fitting.calibrate fitting prior>calibration_prior starts>multistart
fitting.check fitting agreement check>fmu_check fmu_run
fitting.inference fitting.inference added>extended_network asked>unknown_text misfit>model_discrepancy terms>hypothesis
fitting.inference.intervals fitting.inference identify profile selection
fitting.inference.models fitting bench>bench_network
fitting.inference.joint fitting.inference calibration several>joint_record
fitting.inference.models fitting.inference batches bench loop network network_record
fitting.inference.models fitting.inference observation>bench_observation simulator
fitting.inference.source_maps fitting.inference beside place_model source_evidence source_map
fitting.pages solver.notebook style panels>channel_panels network>network_drawing
fitting.parallel fitting cluster tasks threads workers
fitting.records fitting.records tables>read
fitting.records.alignment fitting.records align beats harmonic_model period rounding unequal>variable_beats upstrokes
fitting.records.channels fitting.records amounts felt>inflow_variability filters inflow noise spectral
fitting.records.read fitting.records artefacts columns preview record sensors time_axis
fitting.records.read fitting.records.tables binary clock kinds layout numbers table text titles
fitting.results fitting estimate parameter_set provenance result_files
fitting.wall fitting doubts>fit_diagnostics elastic_law indices wall>site_fit wall_fit wall_model
fitting.wall fitting weighing>law_selection
fitting.wall fitting.inference errors_in_variables
fmu_src.contents fmu_src models system
fmu_src.cosimulation fmu_src cosimulation>arteries drive ports stretch
fmu_src.documents fmu_src document drawing lumped_document
fmu_src.importer fmu_src doctor instances interpreter run trial unpacking
fmu_src.native fmu_src binaries native_description native_doctor native_fmu resource
fmu_src.slaves fmu_src base body_slave heart_slave refusal saving slave>arteries_slave
fmu_src.variables fmu_src description lumped>lumped_variables variable variables>arteries_variables
solver.io solver exit_codes host_died interrupts saved tables writing
solver.laws solver catalogue effect effects laws>wall_laws learned memory>maxwell outlets partial>localised sensors
solver.laws solver springpot wall
solver.lumped fmu_src body component heart heart_parts heart_step species
solver.mesh solver sources
solver.mesh solver.scheme element elimination mesh tables>source_tables
solver.network solver branching coefficients curve files importers inflow inlet inlet_curves network>description
solver.network solver spellings>aliases table_source validation
solver.network.importers solver.importers openbf sections sheet
solver.periodic solver balance>harmonic_balance mixing>anderson native_balance small_waves start
solver.periodic solver.tracing balance>balance_program
solver.quantities solver coordinate legible quantity text units
solver.scheme solver outputs
solver.tracing solver native
"""
MOVED = {
    f"{home}.{name.partition('>')[0]}": f"{room}.{name.rpartition('>')[2]}"
    for room, home, *names in (row.split() for row in _ROWS.strip().splitlines())
    for name in names
}
# what ``python -m`` runs where the command line has moved out of the module
RUN = {"fmu_src.run": "arterial_fmu.cli.run", "fmu_src.doctor": "arterial_fmu.cli.doctor"}


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
        now = RUN.get(fullname, MOVED[fullname])
        _warn(f"python -m {fullname.removesuffix('.__main__')}", f"python -m {now}")
        code: CodeType = compile(f"import runpy; runpy.run_module({now!r}, None, '__main__', True)", now, "exec")
        return code


FINDER = FormerNames()
sys.meta_path.append(FINDER)
