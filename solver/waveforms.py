"""The result of a run: waveforms of every output."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .displays import Shown
from .errors import InputError
from .quantities.text import did_you_mean
from .scheme.step import State

if TYPE_CHECKING:
    from .muscl.step import State as CellState

Array = np.ndarray


@dataclass(frozen=True)
class End:
    """The end of a run: its last state, with its mesh and step [s]."""

    state: State | CellState
    mesh: Any
    dt: float


@dataclass(frozen=True)
class Waveforms(Shown, Mapping[str, Array]):
    """A result: ``time`` : (n,) [s] and one array per variable, (n,) or (B, n), named as the FMU's variables.

    units : SI unit per variable. beats : number of beats in the run. change : largest relative change from the beat
    before (NaN for :func:`simulate`). end : the end of the run, a start for :func:`simulate_periodic`. halved : number
    of steps that did not converge and were halved. backend : the backend of the steps, "numpy" or "native", and the
    reason if it is not the requested one.
    """

    time: Array
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    beats: float
    change: float = math.nan
    end: End | None = field(default=None, compare=False, repr=False)
    halved: int = 0
    backend: str = "numpy"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the run, in sentences; usually none."""
        if not self.halved:
            return ()
        return (f"steps that did not converge were halved ({self.halved} times); a smaller dt avoids this.",)

    def __getitem__(self, name: str) -> Array:
        try:
            return self.columns[name]
        except KeyError:
            raise KeyError(f"{name}: no variable of this result{did_you_mean(str(name), self.columns)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def heading(self, name: str) -> str:
        """The name of a variable with its SI unit, as a column heading: "CA.P [Pa]"."""
        return f"{name} [{self.units[name]}]"

    def member(self, i: int) -> Waveforms:
        """One parameter set of a batch."""
        values = {name: value[i] if value.ndim == 2 else value for name, value in self.columns.items()}
        end = self.end
        if end is not None and len(end.state.y) > 1:
            end = replace(end, state=end.state.members(slice(i, i + 1 or None)))
        return replace(self, columns=values, end=end)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write ``time [s]`` and one column ``name [unit]`` per variable, in SI, whole or not at all.

        Raises ValueError for a batch (write its members) or when the file cannot be written.
        """
        if any(value.ndim != 1 for value in self.columns.values()):
            raise InputError("a batch does not fit one table; write member(i).to_csv(...) for each parameter set.")
        from .network.files import write_whole

        header = ",".join(["time [s]", *map(self.heading, self.columns)])
        table = np.column_stack([self.time, *self.columns.values()])
        rows = "\n".join(",".join(f"{value:.12g}" for value in row) for row in table)
        write_whole(path, f"{header}\n{rows}\n")

    # --- in a notebook --------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<Waveforms of {len(self)} variables at {len(self.time)} times>"

    def plot(self, *names: str) -> Any:
        """A figure with a panel for each variable. names : variables ("CA.P") or places ("CA") with all their
        variables.

        Default: P and Q of inlets and sites, for the first twelve places. Raises ValueError for an unknown name.
        """
        return self._figure(*names)
