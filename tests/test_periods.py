"""The period of all channels together: never a part of a beat, nor several, without a note."""

from __future__ import annotations

import numpy as np
import pytest
from pulses import record

from benchmarks.periods import make, measure
from fitting.records.alignment.align import align
from fitting.records.alignment.period import usual_period
from fitting.records.read.record import Record

DT = 1.0 / 200.0


def second_harmonic(part: float, seed: int, rate: float = 0.0) -> Record:
    """20 beats of 0.5 s, 40 dB: a half-sine at the inlet, and a flow of the second harmonic with ``part`` of it in the
    first; beats longer and shorter by ``rate``, independently."""
    rng = np.random.default_rng(seed)
    begin = np.concatenate([[0.0], np.cumsum(0.5 * (1.0 + rate * rng.standard_normal(22).clip(-2.5, 2.5)))])
    time = np.arange(2000) * DT
    phase = np.interp(time, begin, np.arange(len(begin)))
    Q = {
        "inlet.Q": 1e-4 * np.maximum(np.sin(2.0 * np.pi * phase), 0.0),
        "BT.Q": 5e-6 + 1e-6 * (np.cos(4.0 * np.pi * phase + 1.0) + part * np.cos(2.0 * np.pi * phase)),
    }
    noisy = {name: x + 0.01 * x.std() * rng.standard_normal(len(x)) for name, x in Q.items()}
    return Record("two.csv", "0" * 64, time, noisy)


@pytest.mark.parametrize("part", [0.0, 0.005, 0.01, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_a_channel_of_the_second_harmonic_halves_no_beat(part: float, seed: int) -> None:
    """The flow repeats every 0.25 s to its noise, the inflow every 0.5 s: that is the period, to a thousandth, of 20
    whole beats without a note, found or given; half of it, given, is refused."""
    made = second_harmonic(part, seed)
    for period in (None, 0.5):
        beats = align(made, period)
        assert beats.T == pytest.approx(0.5, rel=1e-3) and beats.n_beats == 20 and beats.warnings == ()
    with pytest.raises(ValueError, match=r"the record repeats every 0\.5 s; give that, or leave it out\.$"):
        align(made, 0.25)


@pytest.mark.parametrize("seed", range(3))
def test_nor_where_beats_vary(seed: int) -> None:
    """The same with intervals of 4 %: the mean of the beats that are used, to a sample, found or given."""
    made = second_harmonic(0.02, seed, 0.04)
    for period in (None, 0.5):
        beats = align(made, period)
        assert beats.variable is not None and beats.T == pytest.approx(0.5, rel=0.03)
        assert not any("may be" in text for text in beats.warnings)


def test_evenly_spaced_peaks_are_doubtful_and_a_given_period_is_obeyed() -> None:
    """One pressure of two peaks at half a beat, the second of 0.8 of the first, 1 s a beat: a heart that alternates
    every 0.5 s would look the same. So it is cut there, that is said, and the 1 s that the note proposes is obeyed."""
    time = np.arange(3000) * DT
    u = (time % 0.5) / 0.2
    P = np.where(u < 1.0, np.sin(np.pi * u), 0.0) * np.where(time % 1.0 < 0.5, 1.0, 0.8)
    made = record(time, P=1e4 + 4e3 * P + 20.0 * np.random.default_rng(0).standard_normal(len(time)))
    found, given = align(made), align(made, 1.0)
    assert found.T == pytest.approx(0.5, rel=1e-3) and "the period may be 1 s" in found.warnings[0]
    assert given.T == 1.0 and given.warnings == ()


def test_recordings_are_those_of_their_numbers() -> None:
    """The same number gives the same recording, bit for bit; another one another."""
    one, again, other = make(7), make(7), make(8)
    assert all(np.array_equal(x, again.channels[name]) for name, x in one.channels.items()) and one.T != other.T


@pytest.mark.parametrize(
    ("number", "beats", "sentence"),
    [
        (8268, 2.0, "the period may be 0.729 s"),
        (14232, 2.0, "the period may be 0.701 s"),
        (8226, 0.33, "579 beats a minute"),
        (28771, 0.5, "differ 1.9 times as much"),
        (98280, 0.5, "differ 1.7 times as much"),
        (37047, 0.5, "differ 11 times as much"),
        (54234, 2.0, "too few times to be sure"),
        (48744, 2.95, "the period may be 0.703 s"),
        (23265, 4.0, "the period may be 0.505 s"),
        (46151, 0.28, "from the fourth next"),
    ],
)
def test_a_wrong_period_is_doubted(number: int, beats: float, sentence: str) -> None:
    """Recordings of the benchmark, of two to three upstrokes, that cannot be told for certain: several beats where too
    few are there to show that one is not the period, or four are one breath; a half whose fellow differs by not much
    more than beats do; and a third, as short as no larger animal's."""
    made = make(number)
    found = usual_period(made.channels, made.dt, "synthetic")
    assert found.T / made.T == pytest.approx(beats, rel=0.02)
    assert len(found.said) == 1 and sentence in found.said[0]


def test_sixty_recordings() -> None:
    """The first sixty: none is wrong without a note, and at least 85 % are right."""
    rows = measure(0, 60)
    assert not [row.seed for row in rows if row.silent]
    assert sum(row.kind == "right" for row in rows) >= 51


@pytest.mark.endurance
def test_a_thousand_recordings() -> None:
    """None of a thousand others is wrong without a note; at least 88 % are right, at most 4 % of these with a note."""
    rows = measure(100_000, 1000)
    right = [row for row in rows if row.kind == "right"]
    assert not [row.seed for row in rows if row.silent]
    assert len(right) >= 880 and sum(row.noted for row in right) <= 0.04 * len(right)
