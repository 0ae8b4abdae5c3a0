"""Beats that are not alike: jitter, noise and its covariance, drifts, spikes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pulses import DT, noisy, pressure, radius, record

from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats

# --- timing -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("jitter", "error", "scatter"), [(1e-3, 1.3, 1.03), (4e-3, 3.0, 1.3)], ids=["1 ms", "4 ms"])
def test_jitter_is_measured_and_taken_out(jitter: float, error: float, scatter: float) -> None:
    """P and R at 34 dB: shifts to the sd of their estimate, σ_s⁻² = N Σ <m'²>/σ² over the channels, 0.066 ms.

    At 4 ms beats end visibly in the ones beside them; without the shifts the scatter is 4.5 times the noise.
    """
    T, errors, noise = 0.4724, [], []
    for seed in range(20):
        made, shifts = noisy(T, 15.2, 40.0, 2e-6, seed, jitter)
        beats = align(made)
        assert beats.shifts.any()
        index = np.arange(beats.n_beats) - (beats.n_beats - 1) / 2  # mean and slope are the period's
        difference = beats.shifts - shifts[: beats.n_beats]
        difference -= difference.mean() + index * (index @ difference) / (index @ index)
        errors.append(difference.std())
        noise.append(beats.noise("AA.P"))
    phase = np.arange(94) / 94
    slopes = [np.gradient(each(phase), phase).std() / T for each in (pressure, radius)]
    bound = 1.0 / np.sqrt(94 * ((slopes[0] / 40.0) ** 2 + (slopes[1] / 2e-6) ** 2))
    assert np.mean(errors) < error * bound
    assert np.mean(noise) < scatter * 40.0


@pytest.mark.parametrize(
    ("records", "most"),
    [pytest.param(100, 1, marks=pytest.mark.deep), pytest.param(300, 3, marks=pytest.mark.endurance)],
)
def test_without_jitter_nothing_moves(records: int, most: int) -> None:
    """Also where the baseline wanders by twice the noise of a beat's mean: at most 1 %, of probability 1e-3 each."""
    moved = 0
    for seed in range(records):
        made, _ = noisy(
            (0.5, 0.4724)[seed % 2], (3.2, 5.2, 15.2)[seed % 3], 40.0, 2e-6, seed, drift=float(seed % 4 > 1)
        )
        moved += bool(align(made).shifts.any())
    assert moved <= most


# --- what the scatter says ----------------------------------------------------------------------------------------


def white(n_beats: int, N: int, seed: int, sd: tuple[float, float] = (40.0, 2e-6)) -> Beats:
    rng = np.random.default_rng(seed)
    values = {"AA.P": rng.normal(0, sd[0], (n_beats, N)), "AA.R": rng.normal(0, sd[1], (n_beats, N))}
    return Beats("x", "", 0.5, values, np.zeros(n_beats))


@pytest.mark.parametrize("N", [48, 49])
@pytest.mark.parametrize("n_beats", [2, 3, 15])
def test_covariance_of_white_noise(n_beats: int, N: int) -> None:
    """E C_k = diag(σ²)/(N n) for every k > 0, the highest included; the mean over 400 seeds, within its own error."""
    sd = np.array([40.0, 2e-6])
    C = np.array([white(n_beats, N, seed).covariance(["AA.P", "AA.R"]) for seed in range(400)])
    C = C / np.outer(sd, sd) * (N * n_beats)
    assert C.shape == (400, N // 2 + 1, 2, 2)
    np.testing.assert_allclose(C, C.conj().swapaxes(-1, -2), atol=1e-12)
    assert np.linalg.eigvalsh(C).min() > -1e-12
    scores = (C.mean(axis=0) - np.eye(2)).real / (C.real.std(axis=0) / 20.0)
    assert np.sqrt(np.mean(scores[1:] ** 2)) < 1.6  # neighbours are correlated: few independent ones
    assert np.abs(scores[1:]).max() < 4.0
    assert np.abs(C[:, 1:].mean(axis=(0, 1)) - np.eye(2)).max() < 3.0 / np.sqrt(400 * (n_beats - 1) * N / 2)
    assert not C[:, 0].imag.any() and (N % 2 or not C[:, -1].imag.any())


def test_who_asks_again_gets_the_same_covariance() -> None:
    """Also after someone has changed the one that was given."""
    beats = white(4, 48, 0)
    first = beats.covariance(("AA.P",))
    kept = first.copy()
    first += 1.0
    np.testing.assert_array_equal(beats.covariance(["AA.P"]), kept)


def test_noise_is_the_standard_deviation_of_a_sample() -> None:
    """White noise on beats whose means differ by ten times as much: 2 % from 15 beats of 94 samples."""
    beats = white(15, 94, 0)
    level = np.random.default_rng(1).normal(0, 400.0, (15, 1))
    beats = Beats("x", "", 0.5, {"AA.P": beats.values["AA.P"] + level}, np.zeros(15))
    assert beats.noise("AA.P") == pytest.approx(40.0, rel=3.0 / np.sqrt(2 * 14 * 93))


def test_covariance_with_gaps_is_that_of_the_mean_of_what_was_measured() -> None:
    """A third of the samples missing at random: Var X_k = σ²/N² Σ_j 1/n_j; 300 seeds."""
    ratio = []
    for seed in range(300):
        beats = white(6, 48, seed)
        values = np.where(np.random.default_rng(10_000 + seed).random((6, 48)) < 0.33, np.nan, beats.values["AA.P"])
        values[0] = beats.values["AA.P"][0]
        holed = Beats("x", "", 0.5, {"AA.P": values}, np.zeros(6))
        expected = 40.0**2 / 48**2 * (1.0 / (~np.isnan(values)).sum(axis=0)).sum()
        ratio.append(holed.covariance(["AA.P"])[1:, 0, 0].real.mean() / expected)
    assert np.mean(ratio) == pytest.approx(1.0, abs=3.0 * np.std(ratio) / np.sqrt(300))


def test_cross_terms_show_what_beats_have_in_common() -> None:
    """Each beat has its own amplitude of one wave in P and a lagged one in R: C_PR/√(C_PP C_RR) → e^{-2πik lag}."""
    rng = np.random.default_rng(3)
    n_beats, N, lag = 40, 64, 0.05
    phase = np.arange(N) / N
    wave = rng.normal(size=(n_beats, 1)) * np.cos(2 * np.pi * 5 * phase)
    late = np.fft.irfft(np.fft.rfft(wave, axis=1) * np.exp(-2j * np.pi * np.arange(33) * lag), N, axis=1)
    beats = Beats("x", "", 0.5, {"AA.P": 300.0 * wave, "AA.R": 2e-5 * late}, np.zeros(n_beats))
    C = beats.covariance(["AA.P", "AA.R"])[5]
    coherence = C[0, 1] / np.sqrt(C[0, 0].real * C[1, 1].real)
    assert coherence == pytest.approx(np.exp(2j * np.pi * 5 * lag), abs=1e-12)


def test_serial_correlation_widens_the_mean() -> None:
    """Beat means as an AR(1) series, r = 0.6: the variance of their mean is (1 + r)/(1 - r) = 4 times s²/n."""
    n_beats, r, ratio = 200, 0.6, []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        level = np.zeros(n_beats)
        for b in range(1, n_beats):
            level[b] = r * level[b - 1] + rng.normal()
        beats = Beats("x", "", 0.5, {"AA.P": level[:, None] + 1e-3 * rng.normal(size=(n_beats, 8))}, np.zeros(n_beats))
        ratio.append(beats.covariance(["AA.P"])[0, 0, 0].real / (level.var(ddof=1) / n_beats))
    assert np.mean(ratio) == pytest.approx(4.0, rel=0.1)  # r itself is estimated low by 3/n: 6 % here


def test_a_given_period_that_the_record_contradicts() -> None:
    """0.9 s for beats of 0.5 s is refused; 0.5 s, two beats of it, and 0.5005 s are taken."""
    time = np.arange(1500) * DT
    beating = record(time, P=pressure(time / 0.5))
    for wrong in (0.9, 0.505):
        with pytest.raises(ValueError, match=r"the record repeats every 0.5 s; give that, or leave it out"):
            align(beating, wrong)
    for period in (0.5, 1.0, 0.5005):
        assert align(beating, period).T == period


def test_a_beat_unlike_the_others_is_named() -> None:
    """Beat 9 of 12 has 0.95 of the pulse: it is named, and not taken for spikes; an even record gives no warning. With
    half the pulse it is left out, its period given or not."""
    time = np.arange(1200) * DT
    P = pressure(time / 0.5) + np.random.default_rng(0).normal(0.0, 5.0, time.size)
    weak = P[800:900] - P[800:900].mean()
    assert align(record(time, P=P), 0.5).warnings == ()
    P[800:900] -= 0.05 * weak
    texts = align(record(time, P=P), 0.5).warnings
    assert [text.split(" (")[0] for text in texts] == ["beat 9"]
    assert "unlike the others in AA.P" in texts[0]
    P[800:900] -= 0.45 * weak
    given, found = (align(record(time, P=P), period).warnings for period in (0.5, None))
    left_out = r"1 beat left out, unlike the others in shape; at 4\.\d+ s "
    assert given == found and any(re.match(left_out, text) for text in found)


def test_many_beats_of_another_state_are_counted() -> None:
    """Beats 10 to 19 of 40 have 0.95 of the pulse, as behind a balloon that is inflated: one sentence with their number
    and times, not three of them."""
    time = np.arange(4000) * DT
    P = pressure(time / 0.5) + np.random.default_rng(0).normal(0.0, 5.0, time.size)
    P[900:1900] -= 0.05 * (P[900:1900] - P[900:1900].mean())
    (text,) = align(record(time, P=P), 0.5).warnings
    assert re.match(r"10 of (39|40) beats, from 4\.\d+ to 9(\.\d+)? s after .* are unlike the others in AA.P", text)
    assert "the part of one state with --part" in text


def test_spikes_are_left_out_and_counted() -> None:
    """15 beats at 40 dB; 1 to 20 samples 5 to 1000 standard deviations off: all are found, none of a clean record.

    The mean beat is then that of the clean record within 3 times its own noise.
    """
    time = np.arange(1501) * DT
    for seed, (count, size) in enumerate([(0, 0.0), (1, 5.0), (20, 5.0), (3, 30.0), (3, 1000.0)]):
        rng = np.random.default_rng(seed)
        clean = pressure(time / 0.5)
        P = clean + rng.normal(0.0, 0.01 * clean.std(), time.size)
        where = rng.choice(np.arange(5, 1495), count, replace=False)
        P[where] += size * clean.std() * rng.choice([-1.0, 1.0], count)
        beats = align(record(time, P=P))
        assert beats.spikes.get("AA.P", 0) == count
        assert any("spikes" in text for text in beats.warnings) == (count > 0)
        off = beats.mean("AA.P") - align(record(time, P=clean)).mean("AA.P")
        assert np.sqrt(np.mean(off**2)) < 3.0 * 0.01 * clean.std() / np.sqrt(15.0)


def test_a_gap_over_a_whole_beat_costs_that_beat_alone() -> None:
    """Beat 5 of 12 is empty and beat 9 has 0.95 of the pulse: ten are whole, beat 9 is named, nothing warns."""
    time = np.arange(1200) * DT
    P = pressure(time / 0.5) + np.random.default_rng(1).normal(0.0, 5.0, time.size)
    P[400:500] = np.nan
    P[800:900] = P[800:900].mean() + 0.95 * (P[800:900] - P[800:900].mean())
    beats = align(record(time, P=P), 0.5)
    assert np.isnan(beats.values["AA.P"]).sum(axis=1).tolist() == [0] * 4 + [100] + [0] * 7
    assert [text.split(" (")[0] for text in beats.warnings] == ["beat 9"]


def test_a_smooth_artefact_is_no_spike() -> None:
    """A beat with a sine of 19 samples a period on it is a beat unlike the others; none of its samples is a spike."""
    time = np.arange(1500) * DT
    P = pressure(time / 0.5) + np.random.default_rng(2).normal(0.0, 5.0, time.size)
    P[700:800] += 100.0 * np.sin(2.0 * np.pi * np.arange(100) / 19.0)
    beats = align(record(time, P=P), 0.5)
    assert beats.spikes == {}
    assert any(text.startswith("beat 8") for text in beats.warnings)
