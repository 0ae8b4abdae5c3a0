"""Laplace's evidence of hypotheses against nested sampling, with the same likelihood and priors, on ten records.

Eight benches, and two of a tube with a Windkessel by harmonic balance. Nested sampling (J. U. Lange, Mon. Not. R.
Astron. Soc. 525, 2023, 3181) integrates over the whole of the priors, wherever the search for the maximum ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from forked import T as PERIOD
from forked import inflow
from nested import log_evidence, log_likelihood, resolution
from truth.anatomy import anatomy
from truth.animal import Nuisance
from truth.beat import Beat
from truth.hide import Effect
from truth.records import Case, truth_channels
from truth.shapes import arterial_pressure

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.hierarchy import score
from fitting.inference.hypothesis import candidates
from fitting.inference.models.bench import bench
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown import bounds
from fitting.records.alignment.beats import Beats
from solver import Inlet, Network, Segment, Site, Windkessel, beat_harmonics

Array = np.ndarray

SITE, SEED, BEATS = "CA", 1, 10
ANIMAL = Nuisance(1.1, 0.95, R0=1.004)  # an animal that is not quite the network's
BEAT = Beat(0.5, 40, 128)
SOFT = 4.0  # harmonics of the pressure that a bench gives: few samples then hold the beat
SAMPLES = 21
TUBE = Network(
    "tube",
    segments=(Segment("A", 0.05, 9e-3, 0.9e-3, 8e5, 12e3),),
    inlet=Inlet("A", 30e-6, PERIOD),
    outlets=(Windkessel("A", R1=1.2e7, C=5e-9, R2=1.2e8),),
    sites=(Site("A", "A"),),
)


@dataclass(frozen=True)
class Bench:
    """dB : of the noise. hidden : what acts. others : what is held beside that and nothing."""

    dB: float
    hidden: tuple[Effect, ...]
    hypotheses: tuple[str, ...]
    base: str = "sheep"

    def problem(self) -> Forward:
        case, rng = Case("bench", SITE, self.dB, self.hidden, self.base), np.random.default_rng(SEED)
        drive = arterial_pressure(rng, BEAT)
        drive = drive * np.exp(-0.5 * (np.arange(len(drive)) / SOFT) ** 2)
        clean, _ = truth_channels(case, anatomy(case.network()), ANIMAL, drive, BEAT)
        values = {}
        for name in case.names:
            X = np.fft.rfft(BEAT.values(clean[name]), norm="forward")[: SAMPLES // 2 + 1]
            wave = np.fft.irfft(X, SAMPLES, norm="forward")
            values[name] = noisy(wave, 10.0 ** (-self.dB / 20.0), rng)
        return bench(Beats("made", "0" * 64, BEAT.T, values, np.zeros(BEATS)), case.network(), SITE)


@dataclass(frozen=True)
class Tube:
    """noise : relative to the pulses. changes : what acts. lag : of the pressure [s]."""

    noise: float
    hypotheses: tuple[str, ...]
    leak: float = 0.0
    lag: float = 0.0

    def problem(self) -> Forward:
        n, names, rng = 50, ("A.P", "A.Q"), np.random.default_rng(SEED)
        true = TUBE.with_terms({"A.E": 9e5} | ({"A.leak": self.leak} if self.leak else {}))
        X = beat_harmonics(true, names, n // 2 - 1, inflow, PERIOD, tolerance=1e-9, more=n)[0]
        X[:, 0] *= np.exp(-2j * np.pi * np.arange(len(X)) * self.lag / PERIOD)
        waves = dict(zip(names, np.fft.irfft(X, n, axis=0, norm="forward").T, strict=True))
        waves["inlet.Q"] = inflow(np.arange(n) * PERIOD / n)
        values = {name: noisy(wave, self.noise, rng) for name, wave in waves.items()}
        return network_problem(Beats("made", "0" * 64, PERIOD, values, np.zeros(BEATS)), TUBE, names)


def noisy(wave: Array, noise: float, rng: np.random.Generator) -> Array:
    return wave + noise * wave.std() * rng.normal(size=(BEATS, len(wave)))


RECORDS = {
    "nothing": Bench(30.0, (), ("channel_lag at CA.P", "channel_lag at CA.R")),
    "stress relaxation": Bench(
        30.0, (Effect("stress_relaxation", (SITE,), 0.01),), ("stress_relaxation at CA", "channel_lag at CA.P")
    ),
    "late pressure": Bench(
        30.0, (Effect("channel_lag", ("CA.P",), 3e-3),), ("channel_lag at CA.P", "stress_relaxation at CA")
    ),
    "late radius": Bench(
        30.0, (Effect("channel_lag", ("CA.R",), 3e-3),), ("channel_lag at CA.R", "channel_lag at CA.P")
    ),
    "bent viscosity": Bench(
        60.0, (Effect("nonlinear_wall_viscosity", (SITE,), -0.5),),
        ("nonlinear_wall_viscosity at CA", "channel_lag at CA.R"),
    ),
    "viscosity": Bench(
        30.0, (Effect("wall_viscosity", (SITE,), 0.002),), ("wall_viscosity at CA", "channel_lag at CA.P"), "elastic"
    ),
    "catheter": Bench(
        30.0, (Effect("catheter_resonance", ("CA.P",), 0.05, 0.2),),
        ("catheter_resonance at CA.P", "channel_lag at CA.P"),
    ),
    # its own hypothesis has a valley so curved that more than 40 000 likelihoods do not sample it
    "springpot": Bench(
        40.0, (Effect("fractional_viscosity", (SITE,), 0.3, 0.4),),
        ("stress_relaxation at CA", "channel_lag at CA.P"),
    ),
    "tube, late pressure": Tube(0.05, ("channel_lag at A.P", "side_branch at A"), lag=1e-3),
    "tube, leak": Tube(0.05, ("side_branch at A", "channel_lag at A.Q"), leak=2e-9),
}  # fmt: skip


def fits_of(record: Bench | Tube) -> tuple[Forward, list[Fit]]:
    """The problem of a record and its hypotheses, fitted: nothing first."""
    problem = record.problem()
    known = {t.label: t for t in candidates(problem.network, problem.signals, problem.site)}
    (none,) = problem.refit([()])
    found = [none, *problem.refit([(known[label],) for label in record.hypotheses], none)]
    assert all(f is not None for f in found)
    return problem, [f for f in found if f is not None]


@pytest.mark.parametrize("name", ["stress relaxation", "catheter", "springpot"])
def test_likelihood_of_many_walls_is_that_of_the_bench(name: str) -> None:
    """-½ (|z|² + ln det V) at ten points about a fit, by differences of the law and by its derivative: to 1e-4."""
    problem, fits = fits_of(RECORDS[name])
    for fit in fits:
        rng = np.random.default_rng(0)
        x = np.clip(fit.x + 2.0 * resolution(fit) * rng.normal(size=(10, len(fit.x))), *bounds(fit.unknowns))
        settled = problem.restated([replace(fit, x=each) for each in x], problem)
        exact = [-0.5 * (f.chi2 + f.log_volume) for f in settled]
        np.testing.assert_allclose(log_likelihood(problem, fit, x), exact, atol=1e-4)


def off(record: Bench | Tube) -> Array:
    """ln Z by Laplace less that by nested sampling (0.03 to 0.04 its standard error), of every hypothesis."""
    problem, fits = fits_of(record)
    return np.array([-0.5 * score(f) - log_evidence(problem, f)[0] for f in fits])


# of a bench whose valley is curved and of harmonic balance one each; the others by hand
SLOW = ("catheter", "tube, leak")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.deep if n in SLOW else pytest.mark.endurance) for n in RECORDS]
)
def test_evidence_by_laplace_is_that_by_nested_sampling(name: str) -> None:
    """ln Z of nothing, of what acts and of something else: to 0.4 (0.36 measured), of which 0.16 is Student's t of
    three nuisances, counted as Gaussians; its differences to that of nothing: to 0.25 (0.20 measured)."""
    found = off(RECORDS[name])
    assert np.abs(found).max() < 0.4
    assert np.abs(found[1:] - found[0]).max() < 0.25


@pytest.mark.endurance
@pytest.mark.xfail(
    reason="a nuisance at the end of its range pays its prior, not how narrow it is held there", strict=True
)
def test_evidence_of_a_wall_that_is_hardly_one() -> None:
    """A pressure 3 ms late, without that effect: φ0 stands at the end of its range, ten spreads off, and ln Z by
    Laplace is 2.2 too large (measured). No verdict has such a wall without saying so."""
    assert np.abs(off(Tube(0.05, (), lag=3e-3))).max() < 1.0
