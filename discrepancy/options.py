"""The options of a study, beside its record and its model."""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.first.options import FirstOptions
from solver.errors import InputError
from solver.network.description import Network
from solver.quantities.units import INFLOW
from solver.tracing.native import check_backend

if TYPE_CHECKING:
    from fitting.calibrate.calibration_prior import Prior
    from fitting.records.read.record import Record

COMMON, INDIVIDUAL = "common", "individual"  # walls
TIME_LIMIT = 300.0  # s


@dataclass(frozen=True)
class Asked:
    """period : of the beat [s], estimated by default. walls : "common" or "individual"; by default the more probable.
    prior : file of a calibration. time_limit : for naming and every later refit [s]. jobs : number of simulating
    processes. filters : known ones, by channel. further, hold_out : other recordings of the subject.
    varies : parameters that each recording has of its own. backend : of the FMUs that are built and run. first : of the
    first model, if no model is given."""

    period: float | None = None
    walls: str | None = None
    prior: str | os.PathLike[str] | None = None
    time_limit: float = TIME_LIMIT
    jobs: int = 1
    filters: tuple[str, ...] = ()
    further: tuple[str | os.PathLike[str], ...] = ()
    varies: tuple[str, ...] = ()
    hold_out: tuple[str | os.PathLike[str], ...] = ()
    backend: str = "auto"
    first: FirstOptions = FirstOptions()

    @property
    def others(self) -> tuple[str | os.PathLike[str], ...]:
        """The recordings beside the first: those fitted with it, then those held out."""
        return (*self.further, *self.hold_out)

    def check(self) -> None:
        """Raise ValueError, one sentence, for invalid options."""
        if self.walls not in (None, COMMON, INDIVIDUAL):
            raise InputError(f"walls {self.walls!r}: must be {COMMON} or {INDIVIDUAL}; or leave it out.")
        if not (math.isfinite(self.time_limit) and self.time_limit > 0.0):
            raise InputError(f'time limit {self.time_limit:g} s: must be above 0 s and finite, such as "5 min".')
        if not (isinstance(self.jobs, int) and self.jobs >= 1):
            raise InputError(f"jobs {self.jobs!r}: must be a whole number of processes, at least 1.")
        check_backend(self.backend)
        if self.varies and not self.further:
            raise InputError(f"--varies {self.varies[0]}: there is one recording; give others with --and.")
        if self.prior is not None and self.walls == COMMON:
            raise InputError(
                f"{os.fspath(self.prior)}: a calibration says how far each artery may differ, which walls {COMMON} "
                f"leave out; ask for one of the two."
            )

    def known(self, network: Network, record: Record | None) -> Prior | None:
        """The prior from the calibration. Raises ValueError, one sentence, if it does not apply.

        record : None if it cannot be used.
        """
        if self.prior is None:
            return None
        from fitting.calibrate.calibration_prior import read_prior  # takes half a second

        found = read_prior(self.prior, network)
        if record is not None and INFLOW not in record.channels:
            raise InputError(
                f"{os.fspath(self.prior)}: {record.path} has no {INFLOW} and is compared with one wall alone, whose "
                f"spread is its own; leave the calibration out."
            )
        return found

    @property
    def chosen(self) -> str | None:
        """The kind of walls to fit; a calibration implies individual walls."""
        return self.walls if self.prior is None else INDIVIDUAL

    @property
    def plain(self) -> dict[str, Any]:
        """The options that the answer depends on, as plain data; a calibration by file and hash.

        The number of processes and the backend are excluded: to the solver's resolution they do not change the answer.
        """
        walls, prior = self.walls or "by evidence", None
        if self.prior is not None:
            sha256 = hashlib.sha256(Path(self.prior).read_bytes()).hexdigest()
            walls, prior = INDIVIDUAL, {"file": os.fspath(self.prior), "sha256": sha256}
        given = {
            "filters": list(self.filters),
            "and": [os.fspath(each) for each in self.further],
            "varies": list(self.varies),
            "hold_out": [os.fspath(each) for each in self.hold_out],
            "prior": prior,
            "first": self.first.given,
        }
        return {
            "walls": walls,
            "period": "found" if self.period is None else {"value": self.period, "unit": "s"},
            "time_limit": {"value": self.time_limit, "unit": "s"},
            **{key: value for key, value in given.items() if value},
        }
