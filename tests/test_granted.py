"""The error of a calibration's model: its size by evidence, and what it does to numbers and intervals."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, SETTINGS, exact, record
from test_calibrate import START, TRUTH, UNKNOWNS

from fitting.calibrate.network_calibration import calibrate
from fitting.inference.joint.model_error import MEANS
from fitting.inference.unknown_text import parse_unknowns
from fitting.records.alignment.beats import Beats

Array = np.ndarray

ONE = record(exact(), 15, 0.01, 1)
SOFT = NETWORK.with_parameters({f"{s.name}.E": 0.5 * s.E for s in NETWORK.segments})
LACKING = 0.03  # of each channel's pulse, the standard deviation of every harmonic


def lacking(seed: int, size: float = LACKING) -> Beats:
    """Noisy beats of the fork, the same error of the model in each: independent in all harmonics, Gaussian."""
    rng, noisy = np.random.default_rng([5, seed]), record(exact(), 15, 0.01, seed)
    values = dict(noisy.values)
    for name in CHANNELS:
        wave = noisy.mean(name)
        harmonics = rng.normal(size=(2, len(wave) // 2 + 1)) * size * wave.std()
        error = (harmonics[0] + 1j * harmonics[1]) / np.sqrt(2.0)
        error[0] = harmonics[0, 0]
        values[name] = values[name] + np.fft.irfft(error, len(wave), norm="forward")
    return replace(noisy, values=values)


def shifted(beats: Beats, by: Mapping[str, float]) -> Beats:
    """Channels shifted by parts of their pulsation (rms)."""
    values = {name: x + by.get(name, 0.0) * beats.mean(name).std() for name, x in beats.values.items()}
    return replace(beats, values=values)


def test_what_a_model_lacks_is_its_error() -> None:
    """Of six records with 3 % the error of all harmonics is found to a fifth, and Σ z² of the three unknowns is below
    the 99.5 % of χ²(18), 37.2; above a third of its mean. By the noise alone it would be some ten times as much: χ²/dof
    is 8 to 12."""
    squares = 0.0
    for seed in range(6):
        found = calibrate(lacking(seed), START, UNKNOWNS, settings=SETTINGS)
        means, rest = found.model_errors
        assert rest == pytest.approx(LACKING, rel=0.2) and means < 3.0 * LACKING
        assert found.chi2 / found.dof > 8.0
        squares += float(np.sum(((found.x - TRUTH) / found.sd) ** 2))
    assert 6.0 < squares < 37.2, squares


def test_of_which_recording_the_rms_is() -> None:
    """Of several recordings the sentence has the RMS of the worst, and says so."""
    found = calibrate([lacking(0), lacking(1)], START, UNKNOWNS, settings=SETTINGS)
    (said,) = (each for each in found.report if "chi2/dof" in each)
    worst = max(found.recordings, key=lambda each: max(each.channels.values()))
    assert f"of {worst.label} (" in said and "rms residual there: " in said


@pytest.mark.parametrize("seed", range(4))
def test_a_right_model_has_none(seed: int) -> None:
    """Noise alone is left: no error, by the four standard deviations of χ² that are granted to chance."""
    assert calibrate(record(exact(), 15, 0.01, seed), START, UNKNOWNS, settings=SETTINGS).model_errors == (0.0, 0.0)


@pytest.mark.parametrize("channel", ["A.P", "C.P"])
def test_one_mean_has_no_error_of_its_own(channel: str) -> None:
    """Walls of half the stiffness, and R_t alone to fit one pressure: it meets the mean, too. With an error of that one
    mean it would give it up for the harmonics, and leave 7 to 12 % more (rms over the beat)."""
    (R_t,) = parse_unknowns(["all.outlet.R_t:1"], SOFT)
    found = calibrate(ONE, SOFT, [R_t], channels=[channel], settings=SETTINGS)
    assert found.model_errors[0] == found.model_errors[1] > 0.05
    assert found.rms[channel] < 0.3 * ONE.mean(channel).std()


def test_what_is_held_takes_up_nothing() -> None:
    """An unknown that may not move leaves the errors as they are without it: so held-out recordings are judged."""
    free, held = parse_unknowns(["all.outlet.R_t:1", "all.E:1"], SOFT)
    channels = ["A.P", "A.Q"]
    without, beside = (
        calibrate(ONE, SOFT, some, channels=channels, settings=SETTINGS).model_errors
        for some in ([free], [free, replace(held, low=0.0, high=0.0)])
    )
    assert beside == pytest.approx(without, rel=1e-3)


def test_means_are_not_given_up() -> None:
    """Pressures of one recording, a third of its channels, are shifted by half of their pulsation (rms): over all means
    that is √(1/3)/2, and the error of means is as much below a tenth as this is above. Beside another recording it is
    less than a tenth, too. The report names the zero."""
    one = shifted(ONE, {name: 0.5 for name in CHANNELS if name.endswith(".P")})
    lone = calibrate(one, NETWORK, ["all.E"], settings=SETTINGS)
    both = calibrate([one, lacking(1)], NETWORK, ["all.E"], settings=SETTINGS)
    assert lone.model_errors[0] == pytest.approx(MEANS**2 / (0.5 / 3**0.5), rel=2e-3)
    assert both.model_errors[1] < both.model_errors[0] < MEANS
    named = r"mmHg below the record's: if its zero or height is off, free it \(--free [ABC]\.P\.zero\)"
    assert all(re.search(named, " ".join(each.report)) for each in (lone, both))


@pytest.mark.parametrize(("by", "size", "named"), [
    ({"A.Q": 3.0, "A.P": 0.15}, 0.0, "A.Q"),  # in parts of the pulsation, not in SI
    ({"A.P": 0.5, "B.P": 0.55, "C.P": 0.5}, 0.06, "B.P"),  # also where the errors of means and harmonics are equal
])  # fmt: skip
def test_the_mean_that_is_farthest_off_is_named(by: Mapping[str, float], size: float, named: str) -> None:
    found = calibrate(shifted(lacking(2, size), by), NETWORK, ["all.E"], settings=SETTINGS)
    assert any(f"free it (--free {named}.zero)" in text for text in found.report)
