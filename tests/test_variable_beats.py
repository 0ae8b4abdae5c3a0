"""Beats that differ: rate, stroke, a ventilator's breath, alternans, odd beats, and the steps of a converter."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from pulses import pressure, pulse, record
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks, lfilter

from discrepancy.find.plausibility import check_record
from discrepancy.find.study import parts
from fitting.inference.models.loop import mean_loop
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats, rounded_harmonics, rounding
from fitting.records.channels.noise import seam_note
from fitting.records.channels.variability import BeatVariation
from fitting.records.read.record import Record
from fitting.records.read.sensors import converter_step
from solver import InputError
from solver.quantities.units import MMHG

DT = 1.0 / 125.0
STEP = MMHG / 16.0


def starts(rng: np.random.Generator, T: float, rate: float, seconds: float) -> np.ndarray:
    """Times at which beats begin: independent intervals about T."""
    n = int(seconds / T) + 12
    return np.cumsum(T * (1.0 + rate * rng.standard_normal(n).clip(-2.5, 2.5))) - 6.0 * T


def arterial(begin: np.ndarray, size: np.ndarray, time: np.ndarray, tau: float = 0.9) -> np.ndarray:
    """Pressure [Pa], (n,): a systole of fixed length a beat into a Windkessel, closed by a notch; 60 mmHg and more."""
    fine = np.arange(begin[0], time[-1] + 0.1, 1e-3)
    b = np.searchsorted(begin, fine, side="right") - 1
    phase = (fine - begin[b]) / 0.3
    flow = size[b] * (np.sin(np.pi * phase.clip(0.0, 1.0)) ** 1.5 - 0.5 * np.exp(-(((phase - 1.08) / 0.06) ** 2)))
    stored = lfilter([1e-3 / tau], [1.0, -(1.0 - 1e-3 / tau)], flow, zi=[flow.mean()])[0]
    return np.interp(time, fine, MMHG * (60.0 + 18.0 * flow + 160.0 * stored))


def ventilated(
    seed: int, seconds: float, T: float = 0.8, rate: float = 0.02, ectopic: bool = False, breath: float = 0.12
) -> Record:
    """Synthetic radial pressure, 125 Hz, steps of 1/16 mmHg: breath on pulse and baseline, a drift, an odd beat."""
    rng = np.random.default_rng(seed)
    begin = starts(rng, T, rate, seconds)
    if ectopic:  # half a beat early, and weak
        begin[len(begin) // 2] -= 0.35 * T
    size = 1.0 + breath * np.sin(2.0 * np.pi * begin / 4.3)
    size[len(begin) // 2] *= 0.5 if ectopic else 1.0
    time = np.arange(0.0, seconds, DT)
    P = arterial(begin, size, time) + MMHG * (2.0 * np.sin(2.0 * np.pi * time / 4.3) + 0.1 * time)
    P = P + 0.3 * MMHG * rng.standard_normal(len(time))
    return record(time, P=STEP * np.round(P / STEP))


def peaks(P: np.ndarray) -> float:
    """The median distance of the peaks [s]: an independent count."""
    at, _ = find_peaks(np.convolve(P, np.ones(9) / 9.0, "same"), distance=50, prominence=0.4 * np.ptp(P))
    return float(np.median(np.diff(at)) * DT)


@pytest.mark.parametrize("seconds", [15.0, 30.0])
@pytest.mark.parametrize("ectopic", [False, True])
def test_pressure_of_a_ventilated_patient(seconds: float, ectopic: bool) -> None:
    """12 records each, all cut at the rate that peaks tell (3 %); at least 8 beats are left, all but the odd one."""
    for seed in range(12):
        T = 0.6 + 0.05 * seed
        made = ventilated(seed, seconds, T, ectopic=ectopic)
        beats = align(made)
        assert beats.T == pytest.approx(peaks(made.channels["AA.P"]), rel=0.03)
        assert beats.n_beats >= max(8, int(seconds / T) - (6 if ectopic else 3))
        assert any(" left out, " in text for text in beats.warnings) == ectopic


def test_a_beat_begins_at_the_end_of_diastole() -> None:
    """Intervals of 3 %: the first sample of each beat is its lowest to 15 % of the pulse, and no upstroke ends it."""
    made = ventilated(3, 30.0, rate=0.03, breath=0.0)
    P = align(made).values["AA.P"]
    pulse = np.ptp(P.mean(axis=0))
    assert (np.abs(P[:, 0] - P.min(axis=1)) < 0.15 * pulse).all()
    assert (np.abs(P[:, -1] - P[:, -6]) < 0.1 * pulse).all()


@pytest.mark.parametrize(("weak", "T"), [(0.9, 0.5), (0.7, 0.5), (0.5, 1.0)])
def test_alternans_is_not_one_beat(weak: float, T: float) -> None:
    """Every other beat weaker by 10 to 30 %: the period is one beat, 0.5 s, not the two that repeat exactly, which is
    said; by 50 %, so that more than a tenth of its power differs, it is the two. Either is taken if it is given."""
    time = np.arange(0.0, 20.0, DT)
    begin = 0.5 * np.arange(-6, 50)
    size = np.where(np.arange(len(begin)) % 2, 1.0, weak)
    P = arterial(begin, size, time) + 0.3 * MMHG * np.random.default_rng(0).standard_normal(len(time))
    made = record(time, P=P)
    assert align(made).T == pytest.approx(T, rel=0.01)
    assert any("the period may be 1 s" in text for text in align(made).warnings) == (T == 0.5)
    for period in (0.5, 1.0):
        given = align(made, period)
        assert given.T == pytest.approx(period, rel=0.01) and not any("may be" in text for text in given.warnings)


def test_a_stretch_with_a_steady_rate_is_chosen() -> None:
    """20 s at 1.25 beats/s, then 10 s at 1.8: the first are used, and that is said."""
    begin = np.concatenate([0.8 * np.arange(-6, 25), 20.0 + 0.55 * np.arange(0, 30)])
    time = np.arange(0.0, 30.0, DT)
    rng = np.random.default_rng(1)
    beats = align(record(time, P=arterial(begin, np.ones(len(begin)), time) + 40.0 * rng.standard_normal(len(time))))
    assert beats.T == pytest.approx(0.8, rel=0.02) and 20 <= beats.n_beats <= 25
    assert any("the longest stretch with a steady heart rate" in text for text in beats.warnings)


def settling(until: float, seed: int = 0) -> tuple[Record, np.ndarray]:
    """30 s of pressure whose beats shorten from 0.84 to 0.69 s about a time [s], in some 4 s; and when they begin."""
    begin = [-6.0 * 0.84]
    while begin[-1] < 31.0:
        begin.append(begin[-1] + 0.69 + 0.15 / (1.0 + np.exp(begin[-1] - until)))
    time, rng = np.arange(0.0, 30.0, DT), np.random.default_rng(seed)
    P = arterial(np.array(begin), np.ones(len(begin)), time) + 0.3 * MMHG * rng.standard_normal(len(time))
    return record(time, P=P), np.array([t for t in begin if 0.0 <= t < 30.0])


@pytest.mark.parametrize("until", [4.0, 6.0, 8.0, 10.0, 12.0])
def test_a_rate_that_settles(until: float) -> None:
    """No strict period, of 0.79 to 0.83 s, is made of beats of 0.84 and then 0.69 s: those of 0.69 s are cut singly, to
    a sample, all after the change; that is said, and their length is taken if it is given."""
    made, begin = settling(until)
    beats = align(made)
    assert beats.variable is not None
    assert beats.T == pytest.approx(0.69, abs=DT)
    assert beats.n_beats >= np.count_nonzero(begin > until + 2.0) - 2
    assert any("the longest stretch with a steady heart rate" in text for text in beats.warnings)
    for period in (0.69, 0.7):
        assert same(align(made, period), beats)


def test_two_rates_with_a_common_period_are_single_beats() -> None:
    """5 beats of 0.545 s last as long as 4 of 0.68 s, 2.72 s: cut singly, at one of the two (1 %), and that is said."""
    begin = np.concatenate([0.68 * np.arange(-6, 23), 15.64 + 0.545 * np.arange(0, 30)])
    time, rng = np.arange(0.0, 30.0, DT), np.random.default_rng(0)
    P = arterial(begin, np.ones(len(begin)), time) + 0.1 * MMHG * rng.standard_normal(len(time))
    beats = align(record(time, P=P))
    assert min(abs(beats.T - 0.68) / 0.68, abs(beats.T - 0.545) / 0.545) < 0.01
    assert any("the longest stretch with a steady heart rate" in text for text in beats.warnings)


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_beat_of_two_upstrokes_is_one_beat(seed: int) -> None:
    """A reflection of 80 % comes 0.23 s after each upstroke of beats of 0.5 s and 2 %: the mean interval, to a sample,
    not the 0.24 s between upstrokes."""
    rng = np.random.default_rng(seed)
    begin, time = starts(rng, 0.5, 0.02, 30.0), np.arange(0.0, 30.0, DT)
    direct, late = (arterial(begin + shift, np.ones(len(begin)), time) for shift in (0.0, 0.23))
    P = direct + 0.8 * (late - 60.0 * MMHG) + 0.5 * MMHG * rng.standard_normal(len(time))
    mean = np.diff(begin[(begin >= 0.0) & (begin < 30.0)]).mean()
    assert align(record(time, P=P)).T == pytest.approx(mean, abs=DT)


def fibrillating(seed: int) -> tuple[Record, float]:
    """Flow and pressure of a heart with intervals of 0.7 s that vary by 22 %, and a stroke that grows with the interval
    before, some next to none; and the median interval [s]."""
    rng = np.random.default_rng(seed)
    lengths = (0.7 * (1.0 + 0.22 * rng.standard_normal(60))).clip(0.34, 1.4)
    begin, before = np.cumsum(lengths) - 4.0, np.concatenate([[0.7], lengths[:-1]])
    size, time = (1.2 - 1.2 * np.exp((0.36 - before) / 0.2)).clip(0.02), np.arange(0.0, 34.0, DT)
    P = arterial(begin, size, time) + 0.3 * MMHG * rng.standard_normal(len(time))
    b = np.searchsorted(begin, time, side="right") - 1
    Q = size[b] * np.sin(np.pi * ((time - begin[b]) / 0.3).clip(0.0, 1.0)) + 0.01 * rng.standard_normal(len(time))
    return replace(record(time, P=P), channels={"AA.P": P, "inlet.Q": 4e-4 * Q}), float(np.median(lengths))


@pytest.mark.parametrize("seed", [3, 4, 5, 7, 8, 9])
def test_a_fibrillating_heart(seed: int) -> None:
    """A beat is one interval, to 20 %, not two or three, whose longer lag fits as it may come early or late by more;
    and that is said."""
    made, T = fibrillating(seed)
    beats = align(replace(made, channels={"AA.P": made.channels["AA.P"]}))
    assert beats.T == pytest.approx(T, rel=0.2) and beats.n_beats >= 5
    (said,) = [text for text in beats.warnings if "the heart is irregular: beats about 0." in text]
    upstrokes, period = map(
        float, re.search(r"if (\d) upstrokes are one beat, of ([\d.]+) s, give that", said).groups()
    )
    assert upstrokes > 1.0 and period / upstrokes == pytest.approx(T, rel=0.2)


def test_too_few_beats_of_a_fibrillating_heart() -> None:
    """A study says why most of a long record does not count."""
    made, _ = fibrillating(3)
    beats = align(made)
    assert beats.variable is not None and "left out" in beats.variable.said[-1]
    with pytest.raises(ValueError, match=r"5 beats are too few; .* Note: .* left out"):
        parts(replace(beats, shifts=beats.shifts[:5]))


@pytest.mark.parametrize("seed", [17, 20, 27])
def test_channels_of_a_fibrillating_heart_are_of_one_clock(seed: int) -> None:
    """Flow and pressure, whose own periods differ by more than 2 %: no more than such intervals explain."""
    check_record(fibrillating(seed)[0])


def test_a_seam_beyond_the_noise_is_said() -> None:
    """A seam of 2 % of the pulse, known to 30 %, beside a noise of the mean beat of 0.1 % of it: 6 times; of 0.2 %: no
    sentence."""
    phase = 2.0 * np.pi * np.arange(50) / 50.0
    rng = np.random.default_rng(0)
    P = 1e4 + 2e3 * np.sin(phase) + 2e3 * np.sqrt(0.5) * 1e-3 * 5.0 * rng.standard_normal((25, 50))
    beats = Beats("made", "", 0.8, {"A.P": P}, np.zeros(25))
    size = 2e3 * np.sqrt(0.5) * np.sqrt(2.0) * np.sin(2.0 * phase)
    for part, said in ((0.02, True), (0.002, False)):
        found = seam_note(beats, ("A.P",), BeatVariation(np.zeros((1, 25, 50)), part * size[None], np.zeros((1, 50))))
        assert bool(found) == said
        if said:
            share, times = (float(x) for x in re.findall(r"[\d.]+(?= of its pulse| times)", found[0]))
            assert share == pytest.approx(0.006, rel=0.02) and times == pytest.approx(6.0, rel=0.15)
    assert seam_note(beats, ("A.P",), None) == ()


def test_times_are_those_of_the_record() -> None:
    """A record whose times begin at 50 s: fast beats, steady ones from 10 s, a weak and early one 10 beats later, and
    an artefact on the third after it. All times count from the first sample, to 0.1 s: the end of diastole."""
    begin = np.concatenate([0.55 * np.arange(-6, 19), 10.0 + 0.8 * np.arange(0, 40)])
    size = np.ones(len(begin))
    begin[35], size[35] = begin[35] - 0.28, 0.5
    time = np.arange(0.0, 36.0, DT)
    P = arterial(begin, size, time) + 40.0 * np.random.default_rng(1).standard_normal(len(time))
    P[(time > begin[38] + 0.3) & (time < begin[38] + 0.6)] += 5.0 * MMHG
    said = align(record(50.0 + time, P=P)).warnings
    odd, stretch, *unlike = ([float(x) for x in re.findall(r"\d+\.\d+", text)] for text in said)
    assert odd[:2] == pytest.approx([begin[34], begin[35]], abs=0.1) and stretch[0] == pytest.approx(10.0, abs=0.1)
    assert min(abs(at[0] - begin[38]) for at in unlike) < 0.1
    assert all("after the record's start" in text for text in said)


# --- a wall under pulses that differ ---------------------------------------------------------------------------------


def bench(seed: int, rate: float, stroke: float) -> tuple[Record, np.ndarray, np.ndarray]:
    """P and R of a Kelvin–Voigt wall, P = E ε + φ dε/dt, with 1 % noise; and the part of P that is not noise."""
    rng, T = np.random.default_rng(seed), 0.8
    begin = starts(rng, T, rate, 17.0)
    time = np.arange(0.0, 17.0, DT / 5.0)
    P = arterial(begin, 1.0 + stroke * rng.standard_normal(len(begin)), time)
    E, phi, h = 3e5, 5e3, DT / 5.0
    a = np.exp(-E / phi * h)
    strain = lfilter([(1.0 - a) / (2.0 * E)] * 2, [1.0, -a], P, zi=[(1.0 + a) / (2.0 * E) * P[0]])[0]
    x, y = P[::5], 5e-3 * (1.0 + strain[::5])
    noisy = [each + 0.01 * each.std() * rng.standard_normal(len(each)) for each in (x, y)]
    return record(time[::5], P=noisy[0], R=noisy[1]), x, y


@pytest.mark.parametrize(("rate", "stroke"), [(0.03, 0.05), (0.03, 0.15), (0.0, 0.1)])
def test_noise_of_a_wall_whose_beats_differ(rate: float, stroke: float) -> None:
    """Real variation is no noise: the standard deviations of P and R are those of the sensors, times 0.9 to 1.7
    (median over harmonics 1 to 20 of 8 records); by raw scatter they are 2 to 8 times too large at the lowest ones."""
    ratios, raw = [], []
    for seed in range(8):
        made, P, R = bench(seed, rate, stroke)
        beats = align(made)
        loop = mean_loop(beats, "AA")
        own = np.array([(0.01 * x.std()) ** 2 for x in (P, R)]) / (beats.N * beats.n_beats)
        ratios.append(np.einsum("kii->ki", loop.noise).real[1:21] / own)
        raw.append(np.einsum("kii->ki", beats.covariance(("AA.P", "AA.R"))).real[1:4] / own)
    assert 0.8 < np.sqrt(np.median(ratios)) < 1.8
    assert np.sqrt(np.mean(raw)) > 2.0


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_an_early_upstroke_is_no_spike(seed: int) -> None:
    """An aortic flow at rest between ejections that come 2 % early or late: the beats are cut singly, the next upstroke
    is in the last samples of a short beat, and none is a spike (three to seven were). One off by the peak is."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 4e-3)
    begin = np.cumsum(0.5 * (1.0 + 0.02 * rng.standard_normal(60).clip(-2.5, 2.5))) - 3.0
    phase = (time - begin[np.searchsorted(begin, time, side="right") - 1]) / 0.2
    Q = 1e-4 * (np.sin(np.pi * phase.clip(0.0, 1.0) ** 0.7) + 0.005 * rng.standard_normal(len(time)))
    beats = align(record(time, Q=Q))
    assert beats.variable is not None
    assert beats.spikes == {}
    Q[2500] += 1e-4
    assert align(record(time, Q=Q)).spikes == {"AA.Q": 1}


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_a_wall_whose_radius_follows_more_than_its_pressure(seed: int) -> None:
    """Strokes differ by 10 %, and the radius by half as much again, as with a breath around the artery: the covariance
    of the noise of P and R stays positive definite, with correlations below 0.99. It was not, and no fit converged."""
    made, _, R = bench(seed, 0.0, 0.1)
    pulse = R - R.mean()
    size = uniform_filter1d(pulse**2, round(0.8 / DT))
    breath = 0.5 * (size / size.mean() - 1.0) * pulse
    channels = made.channels
    loop = mean_loop(align(record(made.time, P=channels["AA.P"], R=channels["AA.R"] + breath)), "AA")
    sd = np.sqrt(np.einsum("kii->ki", loop.noise).real)
    assert np.abs(loop.noise[:, 0, 1] / (sd[:, 0] * sd[:, 1])).max() < 0.99


def test_the_seam_of_variable_beats_is_taken_out() -> None:
    """Rate 3 %, stroke 10 %: the law on the mean loop, E ε + φ dε/dt, misses P by noise (χ² a number 1 ± 0.4)."""
    misfits = []
    for seed in range(12):
        beats = align(bench(seed, 0.03, 0.1)[0])
        loop = mean_loop(beats, "AA")
        k = np.arange(1, 21)
        A = (3e5 + 5e3 * 2j * np.pi * k / loop.T) / 5e-3
        X, Y = (np.fft.rfft(x, norm="forward")[1:21] for x in (loop.P, loop.R))
        S = loop.noise[1:21]
        variance = S[:, 0, 0].real + np.abs(A) ** 2 * S[:, 1, 1].real - 2.0 * (A * S[:, 1, 0]).real
        misfits.append(np.mean(np.abs(X - A * Y) ** 2 / variance))
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize(("T", "begin", "end"), [(0.3, 21.0, 33.0), (0.33, 21.0, 33.0), (0.33, 18.0, 42.0)])
def test_an_intervention_in_the_middle_that_slows_the_heart(T: float, begin: float, end: float) -> None:
    """60 s of beats of 0.25 s, of T from begin to end, as when a nerve is stimulated: the longest stretch at one rate
    gives the period, 0.25 s to 4 %, and no sentence doubts it. It was 0.5 s for T = 0.33 s, and 0.9 s, three beats of
    the stimulated heart, was named as the possible period of the others."""
    time = np.arange(0.0, 60.0, 4e-3)
    rate = np.where((time > begin) & (time < end), 1.0 / T, 4.0) * (1.0 + 0.01 * np.sin(2.0 * np.pi * time / 1.6))
    P = pressure(np.cumsum(rate) * 4e-3) + np.random.default_rng(0).normal(0.0, 20.0, len(time))
    beats = align(record(time, P=P))
    assert beats.T == pytest.approx(0.25, rel=0.04)
    assert not any("the period may be" in text for text in beats.warnings)


# --- a given period --------------------------------------------------------------------------------------------------


def varying(seed: int) -> Record:
    """A bench of 17 s whose intervals, of 0.8 s, vary by 3 % and whose strokes by 5 %."""
    return bench(seed, 0.03, 0.05)[0]


def same(a: Beats, b: Beats) -> bool:
    """Whether two cuts are the same, bit for bit, but for what is said of them."""
    return a.T == b.T and all(np.array_equal(a.values[name], x) for name, x in b.values.items())


@pytest.mark.parametrize("seed", range(4))
def test_the_own_period_of_varying_beats(seed: int) -> None:
    """The period that was found, given, and 4 % more or less: the beats and sentences that are found without it."""
    made = varying(seed)
    found = align(made)
    assert found.variable is not None
    for period in (found.T, 1.04 * found.T, 0.96 * found.T):
        given = align(made, period)
        assert same(given, found) and given.warnings == found.warnings


def test_the_own_period_of_equal_beats() -> None:
    """Given as it was found it changes nothing: beats are cut at one strict period, 4 % more is refused."""
    made = bench(0, 0.0, 0.0)[0]
    found = align(made)
    assert found.variable is None and same(align(made, found.T), found)
    with pytest.raises(ValueError, match=r"the record repeats every 0\.8\d* s; give that, or leave it out\.$"):
        align(made, 1.04 * found.T)


def test_several_varying_beats_given() -> None:
    """Twice and three times the period: single beats, and a sentence; of equal beats the given period is taken."""
    made = varying(1)
    found = align(made)
    for count in (2, 3):
        given = align(made, count * found.T)
        assert same(given, found) and given.warnings[1:] == found.warnings
        assert f"holds {count} beats; they vary, so that each was cut by itself" in given.warnings[0]
    equal = bench(0, 0.0, 0.0)[0]
    assert align(equal, 1.6).T == 1.6 and align(equal, 1.6).warnings == ()


@pytest.mark.parametrize("part", [0.5, 0.7, 0.88, 1.12, 1.5, 1.8])
def test_a_wrong_period_of_varying_beats(part: float) -> None:
    """Refused with the sentence, and what that says to give is taken."""
    made = varying(2)
    found = align(made)
    with pytest.raises(ValueError, match=r"the record repeats every .* s; give that, or leave it out\.$") as refused:
        align(made, part * found.T)
    told = float(re.findall(r"repeats every ([\d.]+) s", str(refused.value))[0])
    assert told == pytest.approx(found.T, rel=0.01) and same(align(made, told), found)


def test_a_given_period_where_none_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beats that resemble one another too little to tell a period: the given one finds them."""
    made = varying(3)
    found = align(made)

    def none(*_: object) -> None:
        raise InputError("no periodicity found")

    monkeypatch.setattr("fitting.records.alignment.align.usual_period", none)
    with pytest.raises(ValueError, match="no periodicity"):
        align(made)
    assert same(align(made, 0.8), found)


# --- steps of a converter --------------------------------------------------------------------------------------------


def test_the_step_of_a_converter_is_found() -> None:
    """Steps of 0.5 to 10 % of the pulse are found to 1e-3, with gaps and a unit; an analogue channel has none."""
    rng = np.random.default_rng(0)
    x = np.sin(np.arange(3000) / 7.0) + 0.01 * rng.standard_normal(3000)
    for step in (0.01, 0.0123, 0.1, 0.2):
        rounded = step * np.round(x / step)
        rounded[500:600] = np.nan
        assert converter_step(rounded * 133.3) == pytest.approx(step * 133.3, rel=1e-3)
    assert converter_step(x) == 0.0


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.5, 1.0])
def test_what_rounding_leaves_in_a_mean_beat(noise: float) -> None:
    """b² = q²/(2π²) Σ e^{-4π²m²σ²/q²}/m² of 15 beats of noise σ/q: as measured over 200 beats' phases, to 0.03 q."""
    rng = np.random.default_rng(5)
    clean = rng.uniform(0.0, 30.0, 200)
    beats = np.round(clean + noise * rng.standard_normal((15, 200)))
    many = np.round(clean + noise * rng.standard_normal((20000, 200))).mean(axis=0)  # what no number of beats lowers
    assert rounding(beats, 1.0) == pytest.approx(np.sqrt(np.mean((many - clean) ** 2)), abs=0.03)


def test_the_step_of_a_pulse_of_few_steps_is_found() -> None:
    """20 beats of 2 to 4 steps at 40 dB, which change at under 200 samples; 20 to 1000 analogue values have none."""
    for steps in (2.0, 3.0, 4.0):
        assert converter_step(rounded(steps, 0.003 * steps, 0.3, n=20).ravel()) == pytest.approx(1.0)
    for n in (20, 60, 200, 1000):
        for seed in range(100):
            assert converter_step(np.random.default_rng(seed).standard_normal(n)) == 0.0


def wave(steps: float) -> np.ndarray:
    """A pulse of that many steps, 110 samples."""
    x = pulse(np.arange(110) / 110.0, slope=2.0)
    return steps * (x - x.min()) / np.ptp(x)


def rounded(steps: float, noise: float, offset: float, n: int = 15, seed: int = 0) -> np.ndarray:
    """Beats of the pulse ``offset`` steps off the levels, with noise [steps] before rounding."""
    return np.round(wave(steps) + offset + noise * np.random.default_rng(seed).standard_normal((n, 110)))


def error_by_harmonic(steps: float, noise: float) -> tuple[np.ndarray, ...]:
    """Variance of the mean beat's X_k over 100 offsets, what the covariance says, and what it says without the law,
    as if white; mean over harmonics 1-3, 4-7, 8-15, 16-31, 32-55."""
    bands, found = (1, 4, 8, 16, 32), np.zeros((3, 56))
    for i, offset in enumerate((np.arange(100) + 0.5) / 100.0):
        x = rounded(steps, noise, offset, seed=i)
        found[0] += np.abs(np.fft.rfft(x.mean(axis=0) - wave(steps) - offset) / 110.0) ** 2
        plain, known = (Beats("", "", 0.5, {"R": x}, np.zeros(15), steps=s) for s in ({}, {"R": 1.0}))
        found[1] += known.covariance(("R",))[:, 0, 0].real
        found[2] += plain.covariance(("R",))[:, 0, 0].real + rounding(x, 1.0) ** 2 / 110.0
    return tuple(np.add.reduceat(found, bands, axis=1) / np.diff((*bands, 56)))


@pytest.mark.parametrize(
    ("steps", "noise", "ratio", "white"),
    [
        (3.0, 0.01, [1.09, 0.84, 1.03, 1.08, 1.17], [4.71, 2.88, 2.19, 0.45, 0.16]),
        (6.0, 0.02, [1.06, 0.89, 0.97, 0.98, 1.07], [2.85, 1.60, 1.70, 1.07, 0.32]),
        (6.0, 0.1, [0.89, 0.72, 0.84, 0.82, 0.84], [2.65, 1.38, 1.58, 0.91, 0.16]),
        (6.0, 0.3, [0.57, 0.68, 0.72, 0.79, 0.98], [1.01, 0.88, 0.91, 0.80, 0.72]),
        (6.0, 1.0, [0.97, 1.02, 0.96, 1.01, 0.99], [0.97, 1.02, 0.96, 1.01, 0.99]),
        (20.0, 0.02, [0.95, 1.57, 1.26, 1.00, 0.92], [0.93, 1.39, 1.07, 0.94, 1.02]),
        (200.0, 0.02, [0.95, 1.17, 1.21, 1.05, 1.03], [0.76, 0.91, 1.00, 1.00, 1.08]),
    ],
)
def test_rounding_by_harmonic(steps: float, noise: float, ratio: list[float], white: list[float]) -> None:
    """Measured over stated variance of the mean beat by band of harmonics: few steps are not white noise."""
    measured, stated, flat = error_by_harmonic(steps, noise)
    assert measured / stated == pytest.approx(ratio, abs=0.05)
    assert measured / flat == pytest.approx(white, abs=0.05)


def test_fine_steps_leave_the_covariance_as_it_is() -> None:
    """12 bits over 1.5 pulses, noise of 40 dB: the covariance to 1e-6 of that without steps; V_k adds up to b²."""
    x = rounded(2730.0, 9.0, 0.0)
    plain, known = (Beats("", "", 0.5, {"R": x}, np.zeros(15), steps=s).covariance(("R",)) for s in ({}, {"R": 1.0}))
    assert known == pytest.approx(plain, rel=1e-6)
    x = rounded(6.0, 0.02, 0.0)
    weights = np.r_[1.0, np.full(54, 2.0), 1.0]
    assert weights @ rounded_harmonics(x, 1.0) == pytest.approx(rounding(x, 1.0) ** 2, rel=1e-3)
