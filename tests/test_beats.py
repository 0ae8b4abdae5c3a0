"""Beats: the period to rounding, whole aligned beats, jitter taken out, and a covariance that says what noise does."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pulses import DT, noisy, pressure, pulse, radius, record

from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import Record

# --- period -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_beats", [2.1, 5.3, 15.0, 100.7])
@pytest.mark.parametrize("T", [0.4724, 0.5, 1.0 / 3.0])
def test_period_and_mean_beat_of_a_periodic_record_are_exact(T: float, n_beats: float) -> None:
    """Noise-free, band-limited: the period to rounding, the mean beat to 1e-12 of the pulse, no scatter, no shifts."""
    time = np.arange(round(n_beats * T / DT)) * DT
    beats = align(record(time, P=pressure(time / T), R=radius(time / T)))
    assert beats.T == pytest.approx(T, rel=2e-14)
    assert (beats.n_beats, beats.N) == (int(n_beats + 1e-9), round(T / DT))
    assert not beats.shifts.any()
    phase = np.arange(beats.N) / beats.N
    assert np.abs(beats.mean("AA.P") - pressure(phase)).max() < 1e-12 * np.ptp(pressure(phase)) * 20
    assert np.abs(beats.mean("AA.R") - radius(phase)).max() < 1e-12 * np.ptp(radius(phase)) * 20
    assert beats.noise("AA.P") < 1e-11 * 2e3
    np.testing.assert_allclose(beats.time, phase * T, rtol=1e-13)
    assert beats.omega == pytest.approx(2 * np.pi / T, rel=1e-13)


def test_period_in_noise_reaches_the_bound() -> None:
    """White noise: sd T ≈ √(12/n³) σ/rms(m') T (Cramér–Rao for many samples); 20 dB, 15 beats, 60 seeds."""
    T, n_beats = 0.4724, 15.2
    n = round(n_beats * T / DT)
    phase = np.linspace(0, 1, 4001)
    slope = np.gradient(pulse(phase), phase)
    sd = 0.1 * pulse(phase).std()
    bound = np.sqrt(12.0 / n) / n_beats * sd / slope.std()
    errors = []
    for seed in range(60):
        noise = sd * np.random.default_rng(seed).standard_normal(n)
        errors.append(align(record(np.arange(n) * DT, P=pulse(np.arange(n) * DT / T) + noise)).T / T - 1.0)
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) / bound < 1.35
    assert abs(np.mean(errors)) < 3.0 * bound / np.sqrt(60)


@pytest.mark.parametrize("T", [0.11, 0.31, 0.8, 3.2])
@pytest.mark.parametrize("n_beats", [2.2, 6.4, 40.3])
@pytest.mark.parametrize("strong", [1, 2, 3])
def test_neither_a_harmonic_nor_a_multiple_is_taken_for_the_period(T: float, n_beats: float, strong: int) -> None:
    """Waves whose 1st, 2nd or 3rd harmonic is the strongest, at heart rates of 0.3 to 9 Hz, 20 dB, drifting."""
    rng = np.random.default_rng(round(100 * T + strong))
    time = np.arange(round(n_beats * T / DT)) * DT
    amplitudes = np.where(np.arange(1, 5) == strong, 1.0, 0.4)
    wave = np.cos(2 * np.pi * np.multiply.outer(time / T, np.arange(1, 5)) + rng.uniform(0, 6, 4)) @ amplitudes
    drift = 0.5 * np.sin(2 * np.pi * time / (11 * T + 5))
    values = 1e4 + wave + drift + 0.1 * wave.std() * rng.standard_normal(len(time))
    assert align(record(time, P=values)).T == pytest.approx(T, rel=0.02 / n_beats)


def test_the_channel_that_repeats_best_gives_the_period() -> None:
    """Noise in one channel, half of another lost, a third at 16 dB: the third gives T = 1 s, to 1e-3."""
    time = np.arange(1500) * DT
    noise = np.random.default_rng(0).normal(size=(2, len(time)))
    lost = np.where(time < 4, np.nan, 1.0) * pulse(time)
    found = align(record(time, P=noise[0], R=lost, Q=pulse(time) + 0.1 * noise[1]))
    assert found.T == pytest.approx(1.0, rel=1e-3)


@pytest.mark.deep
def test_ten_thousand_beats_do_not_lose_count() -> None:
    """20 dB: the period to 1e-8, a ten-thousandth of a beat over the record."""
    T, n, dt = 0.4724, 236_200, 0.02
    values = pulse(np.arange(n) * dt / T) + 0.15 * np.random.default_rng(5).standard_normal(n)
    assert align(record(np.arange(n) * dt, P=values)).T == pytest.approx(T, rel=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_period(seed: int) -> None:
    """White noise, 5 s: one sentence with the range that was searched."""
    time = np.arange(1000) * DT
    values = np.random.default_rng(seed).normal(1e4, 1e3, len(time))
    with pytest.raises(ValueError, match=r"^bench\.csv: no periodicity found between 0\.1 and 3\.3 s in 5 s of record"):
        align(record(time, P=values))


def test_a_record_shorter_than_two_heart_beats() -> None:
    """Times in ms that hold seconds: 1000 samples in 5 ms. The time column is named, nothing is searched."""
    time = np.arange(1000) * DT
    with pytest.raises(ValueError, match=r"^bench\.csv: 0\.005 s of record cannot hold two beats .* unit of its time"):
        align(record(time / 1000.0, P=pressure(time / 0.8)))


def test_samples_too_far_apart_for_a_heart_beat() -> None:
    """Times in seconds that hold milliseconds: a sample a second. The time column is named, nothing is searched."""
    time = np.arange(20_000) * DT
    with pytest.raises(ValueError, match=r"^bench\.csv: a sample every 5 s is fewer than 8 .* unit of its time column"):
        align(record(time * 1000.0, P=pressure(time / 0.8)))


@pytest.mark.parametrize("n_beats", [1.4, 1.6, 1.9])
def test_one_beat_only(n_beats: float) -> None:
    """Fewer than two beats are told, or found to have no period; never fitted."""
    time = np.arange(round(n_beats * 0.8 / DT)) * DT
    with pytest.raises(
        ValueError,
        match=r"^bench\.csv: (one beat only: 1\.\d+ s|no periodicity .* in 1\.\d+ s).* two whole beats of 8 samples",
    ):
        align(record(time, P=pressure(time / 0.8)))


@pytest.mark.parametrize(
    ("period", "expected"),
    [
        (-0.5, "period = -0.5 s: must be a positive, finite number."),
        (np.nan, "period = nan s: must be a positive, finite number."),
        (3.0, "period = 3 s: longer than half of the 5 s of record; give a shorter one or record at least two whole"),
        (
            0.03,
            "6 samples in a period of 0.03 s are too few; sample 8 times a beat or more often, or check the unit of",
        ),
    ],
)
def test_periods_that_cannot_be(period: float, expected: str) -> None:
    """Negative, not a number, beyond half the record, below 8 samples: one sentence each."""
    time = np.arange(1000) * DT
    with pytest.raises(ValueError, match=re.escape(f"bench.csv: {expected}")):
        align(record(time, P=pressure(time)), period)


def test_a_given_period_is_taken() -> None:
    """T = 1 s given for a record of T = 0.5 s: five beats of 200 samples."""
    time = np.arange(1000) * DT
    beats = align(record(time, P=pressure(time / 0.5)), 1.0)
    assert (beats.T, beats.n_beats, beats.N) == (1.0, 5, 200)


# --- beats --------------------------------------------------------------------------------------------------------


def test_a_period_of_whole_samples_is_cut_without_a_change() -> None:
    """Reshaped, but for a straight line a beat: the slope of the drift. What is left has no curvature (round-off)."""
    P = noisy(0.5, 6.4, 40.0, 1e-6, 0)[0].channels["AA.P"]
    beats = align(record(np.arange(len(P)) * DT, P=P), 0.5)
    line = beats.values["AA.P"] - P[:600].reshape(6, 100)
    np.testing.assert_allclose(np.diff(line, 2, axis=1), 0.0, atol=1e-10)
    np.testing.assert_allclose(line.mean(axis=1), 0.0, atol=1e-10)


def test_the_slope_of_a_drift_is_not_in_the_mean_beat() -> None:
    """A drift of 100 Pa a beat on a pulse of 4 kPa: the mean beat is that without drift, but for its level (1e-9).

    Uncorrected, the ramp of 100 Pa would be in the mean beat with no scatter to show it.
    """
    time = np.arange(1500) * DT
    P = pressure(time / 0.5)
    steady, drifting = (align(record(time, P=x), 0.5).mean("AA.P") for x in (P, P + 200.0 * time))
    np.testing.assert_allclose(drifting - drifting.mean(), steady - steady.mean(), atol=1e-9 * np.ptp(P))


def slowing(change: float) -> Record:
    """10 s of beats that shorten evenly from 0.5 s, their rate by ``change`` higher at the end."""
    time = np.arange(2000) * DT
    return record(time, P=pressure(time / 0.5 * (1.0 + change * time / time[-1] / 2.0)))


def test_an_unsteady_rate_is_said() -> None:
    """20 beats that shorten evenly, by 12 % in all: a warning, 6 % from the mean."""
    assert any("heart rate was not steady" in text for text in align(slowing(0.13)).warnings)
    assert align(slowing(0.0)).warnings == ()


@pytest.mark.parametrize(("trend", "said"), [(0.05, False), (-0.15, True)])
def test_a_level_that_drifts_is_said(trend: float, said: bool) -> None:
    """The mean of P changes by 5 and 15 % of itself over the record, as under an occlusion."""
    time = np.arange(2000) * DT
    P = pressure(time / 0.5)
    P += P.mean() * trend * time / time[-1]
    notes = [text for text in align(record(time, P=P)).warnings if "goes from" in text]
    assert len(notes) == said and all(note.startswith("the mean of AA.P goes from ") for note in notes)


@pytest.mark.parametrize(("left", "said"), [(1.0, False), (0.9, False), (0.8, True)])
def test_a_pulse_that_changes_is_said(left: float, said: bool) -> None:
    """From the middle on the pulse is 0.9 or 0.8 about the same mean, as of a catheter that clots: the line through all
    beats changes by three halves of the difference."""
    time = np.arange(4000) * DT
    P = pressure(time / 0.5)
    P = P.mean() + (P - P.mean()) * np.where(time > 10.0, left, 1.0)
    notes = [text for text in align(record(time, P=P)).warnings if "goes from" in text]
    assert len(notes) == said and all(note.startswith("the pulse of AA.P goes from ") for note in notes)


@pytest.mark.parametrize("lost", ["the middle", "the extremes"])
def test_a_pulse_that_changes_beside_gaps(lost: str) -> None:
    """The second half lacks samples of middle level, or all others: the note says the change of the pulse that is there
    to a twentieth of it."""
    time = np.arange(4000) * DT
    P = pressure(time / 0.5)
    P = P.mean() + (P - P.mean()) * np.where(time > 10.0, 0.8, 1.0)
    (whole,) = (text for text in align(record(time, P=P)).warnings if "goes from" in text)
    off = np.abs(P - P.mean()) / np.ptp(P)
    P[(time > 10.0) & (time % 1.0 < 0.5) & ((off < 0.1) if lost == "the middle" else (off > 0.4))] = np.nan
    (gaps,) = (text for text in align(record(time, P=P)).warnings if "goes from" in text)
    first, last = (np.array([float(x) for x in re.findall(r"(?:from|to) ([0-9.]+)", text)]) for text in (whole, gaps))
    np.testing.assert_allclose(last, first, rtol=0.05)


@pytest.mark.parametrize(("change", "longest", "T"), [(0.2, 0.495, 0.455), (0.25, 0.495, 0.445), (0.3, 0.48, 0.43)])
def test_a_rate_that_drifts_is_not_taken_for_a_steady_one(change: float, longest: float, T: float) -> None:
    """Refinement ends up to 10 % from the usual beat, at 0.476 s for 0.3; cut singly, T is the mean of what is used, to
    a sample, and the longest beat that is named the first one used, of 0.5/(1 + change t/10 s) s."""
    beats = align(slowing(change))
    assert beats.variable is not None
    assert pytest.approx(T, abs=DT) == beats.T
    first = beats.variable.edges[0] * DT
    assert longest == pytest.approx(0.5 / (1.0 + change * (first + 0.25) / 10.0), abs=DT)
    assert f"to {longest:.3g} s; each was cut" in beats.warnings[0]


def test_an_unsteady_rate_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beats of 0.5 to 0.385 s whose upstrokes cannot be told: no period fits; nor does one that is given."""
    monkeypatch.setattr("fitting.records.alignment.align.cut_variable", lambda *_: None)
    for period in (None, 0.45):
        with pytest.raises(ValueError, match=r"not steady: if cut every 0\.43\d* s, .* steady rate\.$"):
            align(slowing(0.3), period)


def test_noise_must_not_cost_the_last_beat() -> None:
    """15 whole beats at 20 dB, the period found a little long in half of 20 seeds: 15 beats in all."""
    for seed in range(20):
        assert align(noisy(0.5, 15.0, 200.0, 1e-5, seed)[0]).n_beats == 15


def test_gaps_stay_gaps_and_the_rest_is_exact() -> None:
    """T no multiple of dt; gaps over other phases in three beats, one of them two thirds of a beat long."""
    T, n = 0.4724, 1500
    time = np.arange(n) * DT
    P = pressure(time / T)
    P[200:260] = P[500:520] = P[1003] = np.nan
    beats = align(record(time, P=P, R=radius(time / T)))
    assert np.isnan(beats.values["AA.P"]).sum() in (80, 81, 82)
    phase = np.arange(beats.N) / beats.N
    assert np.nanmax(np.abs(beats.values["AA.P"] - pressure(phase))) < 1e-9 * np.ptp(pressure(phase))
    assert np.abs(beats.mean("AA.P") - pressure(phase)).max() < 1e-9 * np.ptp(pressure(phase))
    assert np.isfinite(beats.covariance(["AA.P", "AA.R"])).all() and np.isfinite(beats.scatter("AA.P")).all()


@pytest.mark.parametrize("T", [0.5, 0.4724])
def test_a_phase_that_is_never_measured_is_refused(T: float) -> None:
    """A quarter of every beat lost: one sentence with channel and share."""
    time = np.arange(1500) * DT
    P = np.where((time / T) % 1 < 0.25, np.nan, pressure(time / T))
    with pytest.raises(
        ValueError, match=r"^bench\.csv: the gaps of AA\.P leave 2\d% of the beat without a single sample"
    ):
        align(record(time, P=P, R=radius(time / T)), T)


def test_select_takes_beats_and_moves_their_shifts() -> None:
    """Beats 2, 0, 0 of three: values and shifts in that order, the mean counts the repeated one twice."""
    beats = Beats("x", "", 0.5, {"AA.P": np.arange(12.0).reshape(3, 4)}, np.array([0.1, 0.2, -0.3]))
    some = beats.select([2, 0, 0])
    np.testing.assert_array_equal(some.values["AA.P"], beats.values["AA.P"][[2, 0, 0]])
    assert some.shifts.tolist() == [-0.3, 0.1, 0.1] and some.n_beats == 3
    np.testing.assert_allclose(some.mean("AA.P"), [8 / 3, 11 / 3, 14 / 3, 17 / 3], rtol=1e-15)


def test_mean_and_scatter_with_gaps() -> None:
    """As numpy's nanmean and nanstd."""
    values = np.array([[1.0, 2.0, np.nan, 4.0], [3.0, np.nan, 5.0, 8.0], [5.0, 3.0, 9.0, 0.0]])
    beats = Beats("x", "", 0.5, {"AA.P": values}, np.zeros(3))
    np.testing.assert_allclose(beats.mean("AA.P"), np.nanmean(values, axis=0))
    np.testing.assert_allclose(beats.scatter("AA.P"), np.nanstd(values, axis=0, ddof=1))


def test_what_is_missing_is_listed() -> None:
    """A missing channel in a sentence with what is there; a single beat has no scatter."""
    beats = Beats("bench.csv", "", 0.5, {"AA.P": np.ones((2, 4))}, np.zeros(2))
    for ask in (lambda: beats.mean("AA.R"), lambda: beats.site("AA"), lambda: beats.covariance(["AA.P", "AA.R"])):
        with pytest.raises(ValueError, match=r"^bench\.csv: the channel AA\.R is missing; it holds AA\.P: "):
            ask()
    with pytest.raises(ValueError, match=r"^bench\.csv: one beat has no scatter; give at least two beats\.$"):
        beats.select([0]).covariance(["AA.P"])
