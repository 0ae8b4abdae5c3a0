"""Multistart calibration, which shows whether a minimum is the lowest and the only one.

A search finds a local minimum. The first start is the network's own values, the others are points of a scrambled Sobol'
sequence, drawn from the priors with twice their width. The result is the lowest minimum; the report lists the others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.network.description import Network

from ..inference.unknown import Array, Unknown, starting_points
from ..inference.unknown_text import parse_unknowns, varied
from ..parallel.tasks import done
from ..records.alignment.beats import Beats
from ..records.recordings import labels_of
from .network_calibration import Calibration, Progress, calibrate

SAME = 0.1  # standard deviations of every unknown within which two ends are one minimum
MOST = 10_000  # starts
_ALIKE = 3.84  # largest insignificant difference of cost, -2 log likelihood: 95 % of χ²(1)
_SHOWN = 3  # other minima with a sentence
_SHOWN_VALUES = 4  # unknowns in such a sentence


@dataclass(frozen=True)
class Minimum:
    """A minimum: the calibration of the first start that ended there, and the numbers of these starts, from 0.

    settled : True if any of their searches converged there.
    """

    found: Calibration
    starts: tuple[int, ...]
    settled: bool

    def plain(self) -> dict[str, Any]:
        """As plain data; values in SI."""
        values = dict(self.found.values)
        own = {each.label: dict(each.values) for each in self.found.recordings if each.values}
        entry = {"cost": self.found.cost, "starts": list(self.starts), "settled": self.settled, "values": values}
        return {**entry, "recordings": own} if own else entry

    def value(self, i: int) -> str:
        """The first variable of an unknown, with its value in SI, and with its recording if it belongs to one only."""
        name = self.found.unknowns[i].variables[0]
        if name in self.found.values:
            return f"{name} {self.found.values[name]:.4g}"
        recording = next(each for each in self.found.recordings if i in each.which)
        return f"{name} of {recording.label} {recording.values[name]:.4g}"


@dataclass(frozen=True)
class Starts:
    """The result of a multistart. minima : lowest cost first. failures : sentences of failed starts, by number."""

    starts: int
    seed: int
    minima: tuple[Minimum, ...]
    failures: Mapping[int, str]

    @property
    def best(self) -> Calibration:
        """The lowest minimum; its report lists the others."""
        found = self.minima[0].found
        return replace(found, report=(*found.report, *self.report))

    @property
    def report(self) -> tuple[str, ...]:
        """The number of starts that ended in each minimum, one sentence each."""
        if self.starts == 1:
            return ()
        first, *others = self.minima
        n = len(first.starts)
        sentences = [
            f"{n} of {self.starts} starts ended in this minimum, within {SAME:g} standard deviations of every unknown"
        ]
        settled = [each for each in others if each.settled]
        sentences += [self._other(each) for each in settled[:_SHOWN]]
        if len(settled) > _SHOWN:
            sentences.append(f"{len(settled) - _SHOWN} further minima with higher cost are in the parameter set")
        lost = sum(len(each.starts) for each in others if not each.settled)
        if lost:
            sentences.append(f"{lost} of {self.starts} starts did not converge")
        if self.failures:
            (why, _), *_ = Counter(self.failures.values()).most_common(1)
            sentences.append(f"{len(self.failures)} of {self.starts} starts could not be simulated: {why.rstrip('.')}")
        return tuple(sentences)

    def _other(self, other: Minimum) -> str:
        sd = np.maximum(self.minima[0].found.sd, np.finfo(float).tiny)
        off = np.abs(other.found.x - self.minima[0].found.x) / sd
        values = ", ".join(dict.fromkeys(other.value(int(i)) for i in np.argsort(-off, kind="stable")[:_SHOWN_VALUES]))
        cost, lowest = other.found.cost, self.minima[0].found.cost
        return (
            f"{len(other.starts)} of {self.starts} starts ended in another minimum, with cost {cost:.4g} instead of "
            f"{lowest:.4g}: {values} (SI)"
            + ("; the record cannot distinguish the two" if cost - lowest < _ALIKE else "")
        )

    def plain(self) -> dict[str, Any]:
        """For the provenance of a parameter set."""
        minima = [each.plain() for each in self.minima]
        failures = {str(i): sentence for i, sentence in sorted(self.failures.items())}
        tried = {"starts": self.starts, "seed": self.seed, "same_within_sd": SAME}
        return {**tried, "minima": minima, "failures": failures}


def calibrate_from(
    beats: Beats | Sequence[Beats],
    network: Network,
    unknowns: Iterable[str | Unknown],
    starts: int,
    *,
    varies: Sequence[str] = (),
    seed: int = 1,
    settings: Settings | None = None,
    jobs: int | None = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Starts:
    """Calibrate from several starts, on processes of this computer or on a cluster; the numbers are the same.

    beats … settings : as in :func:`fitting.calibrate.network_calibration.calibrate`. jobs, scheduler : as in
    :func:`fitting.parallel.tasks.done`.
    seed : the same seed gives the same starts; more starts extend the sequence.
    Raises ValueError, one sentence, for invalid numbers, and as
    :func:`~fitting.calibrate.network_calibration.calibrate` if every start fails.
    """
    if not 1 <= starts <= MOST:
        raise InputError(f"--starts = {starts}: must be a whole number of starts from 1 to {MOST}.")
    if not 0 <= seed < 2**32:
        raise InputError(f"--seed = {seed}: must be a whole number from 0 to {2**32 - 1}.")
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs = {jobs}: must be a whole number of processes, at least 1.")
    recorded, found = [beats] if isinstance(beats, Beats) else list(beats), parse_unknowns(unknowns, network)
    everything = varied(found, varies, labels_of([each.source for each in recorded]))
    given: dict[str, Any] = {
        "beats": recorded, "network": network, "unknowns": found, "varies": tuple(varies), "settings": settings,
    }  # fmt: skip
    # None: the network's own values, and others if these fail
    points = [*starting_points(everything, starts, seed)] if starts > 1 else [None]
    ended: dict[int, Calibration] = {}
    failures: dict[int, str] = {}
    if starts == 1 and scheduler is None:
        return Starts(1, seed, minima({0: calibrate(**given, progress=progress)}), {})
    if progress:
        progress(0.0, f"0 of {starts} starts")
    for n, (i, each) in enumerate(done(partial(_calibrated, **given), points, jobs, scheduler), 1):
        if isinstance(each, str):
            failures[i] = each
        else:
            ended[i] = each
        if progress:
            progress(n / starts, f"{n} of {starts} starts")
    if not ended:
        raise InputError(failures[0])
    return Starts(starts, seed, minima(ended), failures)


def minima(ended: Mapping[int, Calibration]) -> tuple[Minimum, ...]:
    """Group the ends of searches, by number of their start, into minima; lowest cost first.

    Two ends are one minimum if no unknown differs by more than 0.1 of its standard deviation in the lower one. The
    first converged start represents a minimum, so more starts do not change its numbers.
    """
    groups: list[list[int]] = []
    for i in sorted(ended, key=lambda i: (ended[i].cost, i)):
        for group in groups:
            lowest = ended[group[0]]
            if np.all(np.abs(ended[i].x - lowest.x) <= SAME * lowest.sd):
                group.append(i)
                break
        else:
            groups.append([i])
    return tuple(
        Minimum(
            ended[min(group, key=lambda i: (not ended[i].converged, i))],
            tuple(sorted(group)),
            any(ended[i].converged for i in group),
        )
        for group in groups
    )


def _calibrated(x0: Array | None, **given: Any) -> Calibration | str:
    """The calibration from one start, or the sentence with the reason for its failure."""
    try:
        return calibrate(**given, x0=x0)
    except InputError as error:
        return str(error)
