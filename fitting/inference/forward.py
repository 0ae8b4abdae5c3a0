"""The protocols of a forward model: a record with the model for comparison, on the bench or in a network; and of one
that is of a single recording, which an FMU can repeat.

Hypotheses are simulated with an explicit state: ``runs`` counts the simulations and sets their deadline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from solver.network.description import Network

from ..records.alignment.beats import Beats
from ..records.channels.noise import mean_beat
from .extended_network import frequency
from .fit import Array, Fit
from .gauss_newton import Point, Rules, Trial
from .hypothesis import PlacedEffect
from .jackknife import Rest
from .runs import Runs
from .unknown import Unknown


@dataclass(frozen=True)
class Drive:
    """How a wave drives an FMU.

    variable : the input. values : start values. imposed : the channel that equals the wave, if any. beats : number of
    beats; None: until they repeat.
    """

    variable: str
    values: Mapping[str, float] = field(default_factory=dict)
    imposed: str | None = None
    beats: int | None = None


class Forward(Protocol):
    """A record with the model for comparison.

    kind : "bench" or "network", the word of reports. site : the artery of a bench. signals : the compared channels.
    accuracy : the stated error of the model at every harmonic, as a fraction of a channel's pulsation. The methods with
    a body here are the defaults of an exact model with one weighting.
    """

    network: Network
    site: str | None
    signals: tuple[str, ...]
    accuracy: float = 0.0

    @property
    def kind(self) -> str:
        """The kind of model."""
        return self.first.kind

    @property
    def first(self) -> Single:
        """The problem of the recording, or of the first of several."""

    @property
    def dof_of_noise(self) -> float:
        """Degrees of freedom of the noise estimate."""

    def shows(self, fit: Fit) -> bool:
        """True if the record resolves the frequencies of the sensor faults of a hypothesis."""

    @property
    def rules(self) -> Rules:
        """The rules of its searches."""
        return self.first.rules

    @property
    def fine(self) -> Rules:
        """The rules of its refinements."""
        return self.first.fine

    @property
    def entries(self) -> tuple[Array, Array]:
        """(n,) harmonic and channel of every entry of the whitened residual."""

    def points(self, trials: Sequence[Trial], runs: Runs) -> list[Point | None]:
        """The whitened residual at every trial, with its derivatives; None where it has none."""

    def hypothesis(self, terms: Sequence[PlacedEffect]) -> tuple[Unknown, ...]:
        """Unknowns of a hypothesis: nuisances, then those of its terms."""

    def refit(
        self,
        hypotheses: Sequence[tuple[PlacedEffect, ...]],
        start: Fit | None = None,
        runs: Runs | None = None,
        columns: Mapping[str, Array] | None = None,
        known: float = math.inf,
    ) -> list[Fit | None]:
        """The most probable unknowns of every hypothesis; searches far above a ``known`` cost may end early."""

    def refine(self, fits: Sequence[Fit], runs: Runs | None = None) -> list[Fit | None]:
        """Continue every fit from its point with derivatives computed there, to the precision that intervals need."""
        return list(fits)

    def relaxed(self, fits: Sequence[Fit], runs: Runs | None = None, rough: bool = False) -> list[Fit | None]:
        """Continue every fit from its point with its stored Jacobian; parameters with equal bounds stay fixed. rough :
        to the precision that a comparison needs."""

    def sharpened(self, fit: Fit, runs: Runs | None = None) -> Self:
        """The same problem with the weights and the mesh that a fit requires."""
        return self

    def restated(self, fits: Sequence[Fit], before: Any) -> list[Fit]:
        """Fits with the weights of another model of this record, at the same points, with the present weights."""
        return list(fits)

    def columns(self, at: Fit, terms: Sequence[PlacedEffect], runs: Runs | None = None) -> Mapping[str, Array]:
        """Whitened columns (n, q) of every term that may be added to a fit, by label; without those that break down."""

    def rewhitened(self, columns: Mapping[str, Array], before: Any) -> Mapping[str, Array]:
        """Columns whitened for another model of this record, whitened for this one."""
        return columns

    @property
    def deviations(self) -> tuple[Unknown, ...]:
        """The individual deviations of arteries and outlets; none for common walls."""
        return ()

    def individual(self) -> Self:
        """The same problem with individual deviations of arteries and outlets; itself for a single artery."""
        return self

    # --- errors of the model --------------------------------------------------------------------------------------

    def widened(self, errors: Array) -> Self:
        """The same problem with model ``errors`` (:class:`~fitting.inference.model_discrepancy.Beside`) in the
        covariance."""

    def refined(self, fit: Fit, term: PlacedEffect) -> PlacedEffect | None:
        """A term that acts everywhere, with a separate size for every segment; None if it has no such form."""
        return None

    def held_out(self, beats: Beats, fitted: Beats) -> Forward:
        """Other beats of the same record, with the noise of the fitted beats."""

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        """χ² of this record with the parameters of fits to another record, and the number of data; NaN if a simulation
        fails."""

    def without_each(self, fit: Fit) -> list[Rest]:
        """The linear problems of a fit, each without one part of the data: a site, or on a bench a harmonic."""

    def left_out(self, fit: Fit) -> dict[str, float]:
        """Whitened RMS of each site, predicted from the other sites; empty for a single site."""
        return {}


class Single(Forward, Protocol):
    """A single recording with the model for comparison, and the FMU that stands for the model.

    K : the highest harmonic that is compared.
    """

    K: int

    @property
    def first(self) -> Single:
        return self

    @property
    def highest(self) -> float:
        """Half the sampling rate [Hz]: no sensor fault with a higher frequency is named."""

    def shows(self, fit: Fit) -> bool:
        return frequency(fit) <= self.highest

    def held_out(self, beats: Beats, fitted: Beats) -> Single: ...

    def part(self, network: Network) -> Network:
        """The part of a network in the FMU: all of it (the same object), or the artery on the bench."""
        return network

    def measured_wave(self, beats: Beats) -> Array:
        """(N,) the measured drive of the FMU."""

    def wave(self, beats: Beats, fit: Fit) -> Array:
        """(N,) the most probable drive of the FMU under a hypothesis, given the whole record."""

    def answer(self, wave: Array, fit: Fit) -> Array | None:
        """(K+1, m) sensor outputs of a hypothesis under a drive, simulated as in the inference, to compare with the
        FMU's; None if the model has no such drive or the simulation fails."""
        return None

    def repeated(self, beats: Beats, fitted: Beats, K: int) -> Array:
        """(K+1, m) coefficients of the mean of some beats; those of a network corrected to a periodic beat under the
        inflow of the fitted ones."""
        return mean_beat(beats, self.signals, K)

    def steady(self, beats: Beats, fitted: Beats) -> Beats:
        """The beats without the change from one to the next that follows the drive."""
        return beats

    def driven(self, wave: Array) -> Drive:
        """How a wave drives the FMU."""

    def noise(self, beats: Beats, fitted: Beats) -> Array:
        """(K+1, m, m) covariance of the mean of some beats about a free run, without errors of solver and model: the
        unit of gaps."""

    def covariance(self, beats: Beats) -> Array:
        """(n, m, m) covariance of the residual of a free run at harmonics 0 … n - 1, from all sources of noise."""
