"""What a forward model is: a record and the model that it is compared with, on the bench or in a network.

Hypotheses are simulated with an explicit state: ``runs`` is what was simulated before, to start from and to count on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from solver.network.description import Network

from ..records.alignment.beats import Beats
from ..records.channels.noise import mean_beat
from .extended_network import frequency
from .fit import Fit
from .gauss_newton import Point, Rules, Trial
from .hypothesis import Term
from .jackknife import Rest
from .runs import Runs
from .unknown import Unknown

Array = np.ndarray


@dataclass(frozen=True)
class Drive:
    """How a wave drives an FMU.

    variable : the input. first : the sample at which a run from rest begins. values : start values. imposed : the
    channel that the wave itself is, if any. beats : that are run; None: until they repeat.
    """

    variable: str
    first: int = 0
    values: Mapping[str, float] = field(default_factory=dict)
    imposed: str | None = None
    beats: int | None = None


class Forward(Protocol):
    """A record and the model that it is compared with.

    kind : "bench" or "network", as reports say it. site : the only artery that is compared, if it is one. signals :
    the channels, and K : the highest harmonic that are compared. What has a body here is right where the model is exact
    and has one weighting, or is that of the first of several recordings.
    """

    network: Network
    site: str | None
    signals: tuple[str, ...]
    K: int

    @property
    def kind(self) -> str:
        """What it is."""
        return self.first.kind

    @property
    def first(self) -> Forward:
        """The problem of the recording, or of the first of several."""
        return self

    @property
    def dof_of_noise(self) -> float:
        """Degrees of freedom that the noise is known from."""

    @property
    def highest(self) -> float:
        """Half the sampling rate [Hz]: no sensor is named by a frequency above it."""

    def shows(self, fit: Fit) -> bool:
        """Whether the record can show a hypothesis: the frequencies that its sensors are named by."""
        return frequency(fit) <= self.highest

    @property
    def rules(self) -> Rules:
        """Of its searches."""
        return self.first.rules

    @property
    def entries(self) -> tuple[Array, Array]:
        """(n,) harmonic and channel of every entry of the whitened residual."""

    def points(self, trials: Sequence[Trial], runs: Runs) -> list[Point | None]:
        """The whitened residual at every trial, with its derivatives; None where it has none."""

    def hypothesis(self, terms: Sequence[Term]) -> tuple[Unknown, ...]:
        """Unknowns of a hypothesis: nuisances, then those of its terms."""

    def refit(
        self,
        hypotheses: Sequence[tuple[Term, ...]],
        start: Fit | None = None,
        runs: Runs | None = None,
        columns: Mapping[str, Array] | None = None,
        known: float = math.inf,
    ) -> list[Fit | None]:
        """The most probable unknowns of every hypothesis; those that stay far above a ``known`` cost need not be."""

    def refine(self, fits: Sequence[Fit], runs: Runs | None = None) -> list[Fit | None]:
        """Every fit searched on from where it is, with fresh derivatives, fit for intervals."""
        return list(fits)

    def relaxed(self, fits: Sequence[Fit], runs: Runs | None = None) -> list[Fit | None]:
        """Every fit searched on from where it is, with the derivatives that it has; what may have one value is held."""

    def sharpened(self, fit: Fit, runs: Runs | None = None) -> Forward:
        """The same record weighted and simulated as a fit needs it."""
        return self

    def restated(self, fits: Sequence[Fit], before: Any) -> list[Fit]:
        """Fits under the weights of another model of this record, where they are, under these."""
        return list(fits)

    @property
    def weights(self) -> Any:
        """What :meth:`restored` makes a problem of this record of, weighted as this one is: plain data."""
        return ()

    def restored(self, weights: Any) -> Forward:
        """The problem with given weights."""
        return self

    def columns(self, at: Fit, terms: Sequence[Term], runs: Runs | None = None) -> Mapping[str, Array]:
        """Whitened columns (n, q) of every term that may be added to a fit, by label; without those that break down."""

    def rewhitened(self, columns: Mapping[str, Array], before: Any) -> Mapping[str, Array]:
        """Columns that were whitened for another model of this record, for this one."""
        return columns

    @property
    def deviations(self) -> tuple[Unknown, ...]:
        """What every artery and outlet has of its own; nothing where all have it in common."""
        return ()

    def individual(self) -> Forward:
        """The same with deviations of every artery and outlet; itself where there is but one."""
        return self

    # --- errors of the model --------------------------------------------------------------------------------------

    def widened(self, errors: Array) -> Forward:
        """The same record with ``errors`` of the model (:class:`~fitting.inference.model_discrepancy.Beside`) allowed
        for."""

    def refined(self, fit: Fit, term: Term) -> Term | None:
        """A term that acts everywhere, with a size of its own for every segment; None if there is no such thing."""
        return None

    def held_out(self, beats: Beats, fitted: Beats) -> Forward:
        """Other beats of the same record, with the noise that the fitted ones showed."""

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        """χ² of this record under the parameters of fits to another, and how many data; NaN if one breaks down."""

    def without_each(self, fit: Fit) -> list[Rest]:
        """The linear problem of a fit without one part of the data, each in turn: a site, or on a bench a harmonic."""

    def left_out(self, fit: Fit) -> dict[str, float]:
        """Whitened RMS of each site, predicted from the others; of none where there are no others."""
        return {}

    # --- the FMU that stands for the model ----------------------------------------------------------------------------

    def part(self, network: Network) -> Network:
        """What of a network the FMU holds: all of it (the same object), or the artery on the bench."""
        return network

    def measured_wave(self, beats: Beats) -> Array:
        """(N,) what drives the FMU, as it was measured."""
        return self.first.measured_wave(beats)

    def wave(self, beats: Beats, fit: Fit) -> Array:
        """(N,) what drives the FMU, as the whole record says that it most probably was under a hypothesis."""

    def answer(self, wave: Array, fit: Fit) -> Array | None:
        """(K+1, m) what inference holds that the sensors of a hypothesis show under a wave that drives it, to compare
        with the FMU's; None where a wave drives nothing there, or the simulation breaks down."""
        return None

    def repeated(self, beats: Beats, fitted: Beats, K: int) -> Array:
        """(K+1, m) coefficients of the mean of some beats, as a beat that repeats has them."""
        return mean_beat(beats, self.signals, K)

    def driven(self, wave: Array) -> Drive:
        """How a wave drives the FMU."""
        return self.first.driven(wave)

    @property
    def noise(self) -> Array:
        """(K+1, m) variance of the mean beats by the sensors alone, which gaps are counted in."""
        return self.first.noise

    def covariance(self, beats: Beats) -> Array:
        """(n, m, m) of what a free run leaves of the signals at harmonic 0 … n - 1, by all that is noise."""
        return self.first.covariance(beats)
