"""What free runs of FMUs leave of a name, what gaps count, and whether the FMU is the model that inference compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, N, clean, record
from small_network import NAMES, term

from discrepancy.assemble import sentence
from discrepancy.find.study import Study
from discrepancy.findings.map_marks import label_text
from discrepancy.findings.outcome import NamedEffect
from discrepancy.findings.recorded import Recorded
from discrepancy.name import confirmation
from discrepancy.name.confirmation import _closed_above
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from discrepancy.report.verdict_text import late_drive, low_passed
from discrepancy.show.fmu_validation import Gap, Run, agreement, change, changed, compared, fall, left
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import sensor_effects
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown import absent
from fitting.records.channels.spectral import scaled
from fitting.results.estimate import Estimate

E = "B.E"
NOTHING = Fit((), (), np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0, int), np.zeros(0, int))


def study(noise: float = 0.01, seed: int = 0) -> Study:
    """Fifteen beats of the network as it is, to be fitted, and five kept apart."""
    beats = record(clean(), 20, noise, seed)
    fitted, kept = beats.select(range(15)), beats.select(range(15, 20))
    problem = network_problem(fitted, NETWORK, NAMES)
    return Study(NETWORK, fitted, kept, problem, (term("wall_stiffness", "B"),))


def stiffer(s: Study, x: float) -> Run:
    """The network with B's modulus changed by exp(0.3 x), as harmonic balance has it."""
    t = term("wall_stiffness", "B")
    unknowns = s.problem.hypothesis((t,))
    at = absent(unknowns)
    at[-1] = x
    X = s.problem.answer(s.problem.measured_wave(s.fitted), replace(NOTHING, terms=(t,), unknowns=unknowns, x=at))
    assert X is not None
    return compared(s, NOTHING, X)


@cache
def named(verdict: str = "effect") -> Naming:
    """A name that was found, whatever the record."""
    s = study()
    found = name(s.problem, s.terms, walls="common")
    return replace(found, verdict=verdict, ranked=found.ranked or (found.base,), confidence=0.9)


def confirmed(
    s: Study, naming: Naming, before: Run, after: Run | None, losses: Sequence[Mapping[str, float]] = ()
) -> Naming:
    """What two free runs leave of a name, of one recording."""
    each = Recorded("A", "A.csv", "", 20, s.fitted.T, True, before.gap.total, {})
    if after is not None:
        fallen, sd = fall(s, before.X, after.X)
        each = replace(each, fallen=fallen, sd=sd)
    return confirmation.confirmed(naming, [each], before.gap, after and after.gap, losses)


# --- the gap must fall ------------------------------------------------------------------------------------------------


def test_the_fall_is_that_of_the_gaps() -> None:
    """χ² = gap² m (2K + 1) of m channels and K harmonics, before less after: to 1e-9."""
    s = study()
    before, after = stiffer(s, 0.1), stiffer(s, 0.01)
    size = before.X.shape[1] * (2 * len(before.X) - 1)
    expected = size * (before.gap.total[1] ** 2 - after.gap.total[1] ** 2)
    assert fall(s, before.X, after.X)[0] == pytest.approx(expected, rel=1e-9)


def test_a_part_that_leaves_most_of_the_gap_is_no_name() -> None:
    """A partial answer whose gap to held-out beats falls to 0.9 of itself is unknown, with the numbers; one whose gap
    falls to 0.3 stands."""
    s = study()
    before = stiffer(s, 1.0)
    kept = confirmed(s, named("partial"), before, stiffer(s, 0.9))
    assert kept.verdict == "unknown" and kept.reason is not None and "most of it remains" in kept.reason
    assert confirmed(s, named("partial"), before, stiffer(s, 0.3)).verdict == "partial"


@pytest.mark.parametrize(("left", "verdict"), [(1.0, "unknown"), (0.0, "none")])
def test_a_model_that_fits_but_does_not_run(left: float, verdict: str) -> None:
    """Nothing was found missing with walls with which the FMU does not run: the gap is that of the file as it is, and
    the verdict is none only if that gap is noise."""
    s = study()
    run = stiffer(s, left)
    each = [Recorded("A", "A.csv", "", 20, s.fitted.T, True, run.gap.total, {}, failed="the FMU does not run.")]
    found = confirmation.confirmed(named("none"), each, run.gap, None)
    assert found.verdict == verdict
    assert verdict == "none" or (found.reason or "").endswith("cannot be judged: the FMU does not run.")


def test_a_model_that_does_not_run_before_any_effect_was_compared() -> None:
    """The time was over before the first effect: nothing comes nearest, and the sentence has a subject. The run of the
    file stands in for that of the fit, and so is not compared with the fit."""
    s = study()
    run = stiffer(s, 1.0)
    each = [Recorded("A", "A.csv", "", 20, s.fitted.T, True, run.gap.total, {}, failed="the FMU does not run.")]
    naming = replace(named("unknown"), ranked=(named().base,), complete=False)
    assert naming.best.label == ""
    found = confirmation.confirmed(naming, each, run.gap, None)
    assert found.reason == "no effect can be judged: the FMU does not run."
    wave = s.problem.measured_wave(s.fitted)
    assert agreement(s, NOTHING, wave, replace(run, stands_in="the file as it is")) is None
    assert agreement(s, NOTHING, wave, run) is not None


@pytest.mark.deep
@pytest.mark.parametrize("strokes", [0.0, 0.05])
def test_how_often_a_fall_is_chance(strokes: float) -> None:
    """Two models as far from the truth on either side: χ² falls by nothing on average.

    Over 200 records the fall over its standard deviation has mean 0 and standard deviation 1 within 4 standard errors,
    and is above 1.645 in 5 %, at most 10 %; likewise if strokes differ by 5 %, and all channels follow.
    """
    s = study()
    before, after = stiffer(s, 0.02), stiffer(s, -0.02)
    truth = s.problem.answer(s.problem.measured_wave(s.fitted), NOTHING)
    assert truth is not None
    before, after = (
        replace(run, X=truth + sign * (before.X - after.X)) for run, sign in ((before, 0.5), (after, -0.5))
    )
    rng, found = np.random.default_rng(1), []
    waves = clean()
    for _ in range(200):
        more = strokes * rng.normal(size=(20, 1)) * waves["inlet.Q"]
        values = {"inlet.Q": waves["inlet.Q"] + more}
        for n in CHANNELS:
            values[n] = waves[n] + 0.01 * waves[n].std() * rng.normal(size=(20, N))
        for n, H in zip(s.problem.signals, s.problem.response.T, strict=True):
            values[n] += scaled(more - more.mean(axis=1, keepdims=True), H)
        beats = replace(s.fitted, values=values, shifts=np.zeros(20))
        other = replace(s, fitted=beats.select(range(15)), held_out=beats.select(range(15, 20)))
        H = s.problem.response
        flow = np.fft.rfft(more[:15].mean(axis=0), norm="forward")[: len(H), None]
        flow[0] = 0.0
        value, sd = fall(other, *(run.X + H * flow for run in (before, after)))
        found.append(value / sd)
    assert np.mean(found) == pytest.approx(0.0, abs=4.0 / np.sqrt(200))
    assert np.std(found) == pytest.approx(1.0, abs=4.0 / np.sqrt(400))
    assert np.mean(np.array(found) > 1.645) <= 0.1


def test_a_name_that_closes_the_gap_stays() -> None:
    s = study()
    before, after = stiffer(s, 0.3), stiffer(s, 0.0)
    assert confirmed(s, named(), before, after) is named()


def test_a_name_with_which_the_gap_grows_is_none() -> None:
    """The verdict was an effect that "falls from 7.95 to 9.67": it is `unknown`, no surer than not, and says what the
    numbers do."""
    s = study()
    before, after = stiffer(s, 0.1), stiffer(s, 0.15)
    found = confirmed(s, named(), before, after)
    assert (found.verdict, found.members) == ("unknown", ())
    assert found.confidence == pytest.approx(0.1)
    assert (
        found.reason is not None and f"rises from {before.gap.total[1]:.3g} to {after.gap.total[1]:.3g}" in found.reason
    )


@pytest.mark.parametrize("verdict", ["effect", "several", "partial", "unknown"])
def test_nothing_is_missing_below_the_noise(verdict: str) -> None:
    """A model that leaves 0.77 times the noise lacks nothing, whatever leaves 0.59."""
    s = study()
    run = stiffer(s, 0.0)
    before, after = (replace(run, gap=Gap((left, left), {})) for left in (0.77, 0.59))
    found = confirmed(s, named(verdict), before, None if verdict == "unknown" else after)
    assert (found.verdict, found.members) == ("none", ()) and found.confidence <= 0.5
    assert found.reason is not None and "0.77 times the noise" in found.reason


@pytest.mark.parametrize(("in_error", "verdict"), [(None, "effect"), ((0.9, 0.9), "none")])
def test_a_fall_counts_in_a_gap_of_noise(in_error: tuple[float, float] | None, verdict: str) -> None:
    """χ² falls by 75 ± 17 (d' of 15) in a gap of 0.99 of the noise: the name stands, but not in a stated error."""
    before, after = (replace(Gap((left, left), {}), in_error=in_error) for left in (0.99, 0.95))
    each = [Recorded("A", "A.csv", "", 20, 1.0, True, before.total, {}, fallen=75.0, sd=17.0, gap_after=after.total)]
    found = confirmation.confirmed(named(), each, before, after)
    assert found.verdict == verdict


@pytest.mark.parametrize(("error", "verdict"), [(0.005, "none"), (0.002, "effect")])
def test_nothing_is_named_within_the_stated_error(error: float, verdict: str) -> None:
    """A network that leaves 3.9 times the noise lacks nothing that held-out beats show if that is 0.78 times what noise
    and a stated error of 0.5 % of the pulsation leave together; with 0.2 % it is 1.63 times."""
    s = study()
    own = replace(s, problem=replace(s.problem, accuracy=error))
    before, after = stiffer(own, 0.1), stiffer(own, 0.0)
    assert before.gap.total[1] == pytest.approx(3.91, rel=0.01)
    found = confirmed(own, named(), before, after)
    assert found.verdict == verdict
    words = "is 3.91 times the noise, 0.777 times noise and stated error of the model together"
    assert verdict == "effect" or (found.reason or "").endswith(words)


def test_the_stated_error_adds_to_the_chance_of_a_fall() -> None:
    """χ² of one difference D in units of noise n and stated error e falls by D²/(n² + e²) with the standard deviation
    2 D/√(n² + e²), whatever e: for e far above n the ratio of both is √χ²/2 (measured here for 2 and 5 %)."""
    s = study()
    for error in (0.02, 0.05):
        own = replace(s, problem=replace(s.problem, accuracy=error))
        value, sd = fall(own, stiffer(own, 0.1).X, stiffer(own, 0.0).X)
        assert value / sd == pytest.approx(0.5 * np.sqrt(value), rel=0.03)


def test_the_stated_error_is_of_every_harmonic() -> None:
    """Without noise, with a stated error of 0.5 % of a channel's pulsation at every harmonic, its gap is
    √(Σ w |ΔX|²/(0.005 s)² / ((2K + 1) m)) of m channels with pulsations s, w = 1 at the mean, else 2: to 1e-6."""
    s = study(noise=1e-9)
    own = replace(s, problem=replace(s.problem, accuracy=0.005))
    run = stiffer(own, 0.3)
    part = own.held_out
    X = np.stack([np.fft.rfft(part.mean(n), norm="forward")[: len(run.X)] for n in NAMES], axis=1)
    size = np.array([s.fitted.mean(n).std() for n in NAMES])
    w = np.where(np.arange(len(X)) == 0, 1.0, 2.0)[:, None]
    expected = np.sqrt((w * np.abs(run.X - X) ** 2 / (0.005 * size) ** 2).sum() / w.sum() / len(size))
    assert run.gap.in_error is not None and run.gap.in_error[1] == pytest.approx(expected, rel=1e-6)
    assert stiffer(s, 0.3).gap.in_error is None


def test_a_record_that_an_improbable_animal_meets() -> None:
    """All moduli 2.97 times the file's, 5.4 stated spreads: the verdict was `none`, "nothing is missing"."""
    s, run = study(), stiffer(study(), 0.0)
    base = named("none").base
    x = np.array([math.log(2.97) / 0.2 if u.name == "all.E" else 0.0 for u in base.fit.unknowns])
    far = replace(named("none"), base=replace(base, fit=replace(base.fit, x=x), misfit=0.0))
    found = confirmed(s, far, run, None)
    assert (found.verdict, found.members) == ("unknown", ()) and found.confidence <= 0.5
    assert found.reason == "the model fits the record only with all.E 5.4 stated spreads above the file's"
    assert sentence(found, (), run.gap, None).startswith("The model fits the record only with all.E 5.4 stated spreads")
    near = replace(far, base=replace(base, fit=replace(base.fit, x=0.7 * x)))
    assert confirmed(s, near, run, None) is near
    assert sentence(near, (), run.gap, None).startswith("Nothing is missing: ")
    blind = sentence(near, (), run.gap, None, invisible=("stenosis", "channel_lag"))  # a record that would show neither
    assert blind.startswith("Nothing that this record would show is missing: ")
    assert blind.endswith(" Too small to show at typical size: stenosis, channel lag.")


def test_means_that_wander_are_left_out_of_a_change() -> None:
    """The gap falls, and the pulsation from 200 to 100 Pa, where the RMS with means rises: the pulsation is said."""
    before = Gap((9.0, 9.0), {"A.P": (9.0, 9.0)}, {"A.P": (300.0, 370.0)}, {"A.P": (200.0, 200.0)})
    after = Gap((4.0, 4.0), {"A.P": (4.0, 4.0)}, {"A.P": (500.0, 730.0)}, {"A.P": (100.0, 100.0)})
    assert (
        changed(before, after) == "falls from 9 to 4 times the noise (rms without the means: A.P from 1.5 to 0.75 mmHg)"
    )


def test_an_effect_of_high_harmonics_is_told() -> None:
    """The gap falls by a third, but from harmonic 8 on to a seventh: said; by less than half everywhere: nothing."""
    before = Gap((18.0, 10.5), {}, above={4: (9.0, 9.0), 8: (17.0, 17.0)})
    after = Gap((12.0, 7.5), {}, above={4: (8.0, 7.0), 8: (3.0, 2.4)})
    assert _closed_above(before, after) == ", but from harmonic 8 on it falls from 17 to 2.4 times the noise"
    assert _closed_above(before, replace(after, above={4: (8.0, 7.0), 8: (3.0, 9.4)})) == ""
    quiet = replace(before, above={8: (1.0, 0.9)})
    assert _closed_above(quiet, replace(after, above={8: (0.2, 0.2)})) == ""


def test_words_follow_the_numbers() -> None:
    low, high = Gap((1.0, 1.1), {}), Gap((1.0, 9.67), {})
    assert change(high, low) == "falls from 9.67 to 1.1"
    assert change(low, high) == "rises from 1.1 to 9.67"
    assert change(low, Gap((1.0, 1.1004), {})) == "stays at 1.1"


def test_a_gap_is_said_in_mmHg_and_mL_s_too() -> None:
    """Of held-out beats, by the unit of the channel, the loudest four of many; without sizes, the noise alone."""
    pair = {"A.P": (1.0, 173.3), "A.Q": (1.0, 2.1e-6)}
    gap = Gap((9.0, 9.67), {"A.P": (9.0, 9.0), "A.Q": (9.0, 9.0)}, pair)
    less = replace(gap, total=(1.0, 1.1), rms={"A.P": (1.0, 26.7), "A.Q": (1.0, 1e-7)})
    assert left(gap) == "9.67 times the noise (1.3 mmHg of A.P, 2.1 mL/s of A.Q)"
    assert left(replace(gap, pulsation={"A.P": (1.0, 150.0), "A.Q": (1.0, 2e-6)})) == left(gap)
    apart = replace(gap, pulsation={"A.P": (1.0, 66.7), "A.Q": (1.0, 2e-6)})
    assert left(apart).endswith("2.1 mL/s of A.Q; without the means 0.5 mmHg of A.P, 2 mL/s of A.Q)")
    assert changed(gap, less) == (
        "falls from 9.67 to 1.1 times the noise (A.P from 1.3 to 0.2 mmHg, A.Q from 2.1 to 0.1 mL/s)"
    )
    assert changed(less, gap).startswith("rises from 1.1 to 9.67 times")
    assert left(Gap((9.0, 9.67), {})) == "9.67 times the noise"
    many = {f"S{i}.P": (1.0, 133.322) for i in range(6)}
    said = left(Gap((9.0, 9.67), {name: (1.0, float(i)) for i, name in enumerate(many)}, many))
    assert said.endswith("(1 mmHg of S2.P, 1 mmHg of S3.P, 1 mmHg of S4.P, 1 mmHg of S5.P and 2 more)")


def test_the_sizes_of_a_gap_are_those_of_the_beats() -> None:
    """Parseval: the rms of the run's beat less the mean beat, up to what the harmonics leave out: to 1e-3."""
    s = study(noise=1e-9)
    run = stiffer(s, 0.3)
    for channel, (fitted, _) in run.gap.rms.items():
        expected = float(np.sqrt(np.mean((run.beats[channel] - s.fitted.mean(channel)) ** 2)))
        assert fitted == pytest.approx(expected, rel=1e-3)


# --- a drive that is late ---------------------------------------------------------------------------------------------


def lag(channel: str, value: float, half: float = 1e-3) -> NamedEffect:
    return NamedEffect(
        "channel_lag", (channel,), {f"{channel}.lag": Estimate(value, "s", (value - half, value + half))}, 0.9
    )


def test_pressures_that_are_early_mean_a_flow_that_is_late() -> None:
    """The only pressure, or all of them alike; not a late one, one of two, delays that differ, or a radius in time."""
    early = lag("A.P", -21.8e-3)
    assert late_drive([early], ["A.P"]) == "inlet.Q is 21.8 ms late"
    assert late_drive([early], ["A.P", "B.Q"]) == "inlet.Q and B.Q are 21.8 ms late"
    assert late_drive([early, lag("B.P", -20.8e-3)], ["A.P", "B.P"]) == "inlet.Q is 21.3 ms late"
    assert not late_drive([early, lag("B.P", -2e-3)], ["A.P", "B.P"])
    assert not late_drive([early], ["A.P", "B.P"]) and not late_drive([early], ["A.P", "A.R"])
    assert late_drive([lag("inlet.Q", 21.1e-3)], ["A.P", "B.P"]) == "inlet.Q is 21.1 ms late"
    assert not late_drive([lag("inlet.Q", -4e-3)], ["A.P"])
    assert not late_drive([lag("inlet.Q", 5e-3), lag("A.P", 10e-3)], ["A.P"])
    assert not late_drive([lag("A.P", 5e-3)], ["A.P"]) and not late_drive([], ["A.P"])
    gain = NamedEffect("channel_gain", ("A.P",), {"A.P.gain": Estimate(0.9, "1", (0.8, 1.0))}, 0.9)
    assert not late_drive([gain], ["A.P"])
    found = named()
    gap = Gap((9.0, 9.0), {})
    said = sentence(found, (early,), gap, gap, reading="inlet.Q is 21.8 ms late")
    assert said.endswith(" The simplest reading: inlet.Q is 21.8 ms late.") and "channel lag at A.P" in said


def test_names_keep_their_underscores() -> None:
    """Of effects they are words, of places they are names."""
    assert (
        label_text("wall_viscosity at Ao_2 + channel_lag at C_1.P") == "wall viscosity at Ao_2 + channel lag at C_1.P"
    )
    assert label_text("wall_viscosity at all") == "wall viscosity at all places"


# --- one model --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", [None, "channel_gain", "channel_lag", "channel_offset"])
def test_the_inflow_drives_inference_as_it_drives_the_fmu(effect: str | None) -> None:
    """The wave is what flows, also where the flow meter is a term: the same channels, to 1e-9 of the pulse."""
    s = study()
    fit = NOTHING
    if effect:
        (t,) = (t for t in sensor_effects(NETWORK, "inlet.Q") if t.effect == effect)
        unknowns = s.problem.hypothesis((t,))
        x = absent(unknowns)
        x[-len(t.unknowns) :] = 0.7
        fit = replace(NOTHING, terms=(t,), unknowns=unknowns, x=x)
    wave = s.problem.measured_wave(s.fitted)
    X, plain = s.problem.answer(wave, fit), s.problem.answer(wave, NOTHING)
    assert X is not None and plain is not None
    np.testing.assert_allclose(X, plain, atol=1e-9 * np.abs(plain[1:]).max())


def test_an_fmu_that_is_another_model_is_told() -> None:
    """A run of a wall 3 % stiffer: where it differs most, and both gaps."""
    s = study()
    wave, run = s.problem.measured_wave(s.fitted), stiffer(s, 0.1)
    told = agreement(s, NOTHING, wave, run)
    assert told is not None and told.difference > 1e-3 and told.fmu == run.gap.total != told.inferred
    same = agreement(s, NOTHING, wave, stiffer(s, 0.0))
    assert same is not None and same.difference < 1e-9 and same.fmu == pytest.approx(same.inferred)


def test_the_fmu_is_compared_with_equal_elements() -> None:
    """A search with a quarter of an FMU's elements differs from the FMU by their error, which is none of the program;
    the gap is the search's."""
    s = study()
    wave, run = s.problem.measured_wave(s.fitted), stiffer(s, 0.0)
    assert isinstance(s.problem, NetworkProblem)
    finer = replace(s, problem=replace(s.problem, simulator=s.problem.simulator.finer().finer()))
    told = agreement(finer, NOTHING, wave, run)
    assert told is not None and told.difference < 1e-9 and told.inferred != told.fmu


def test_gaps_count_the_sensors_alone() -> None:
    """The stroke of every beat differs by 10 %, which all channels follow; sensors have 1 %: a wall 3 % stiffer leaves
    what it leaves of equal beats, within 15 %. Counted in the scatter of the beats it was a seventh of that."""
    equal, rng = study(), np.random.default_rng(3)
    stroke = 1.0 + 0.1 * rng.normal(size=(20, 1))
    mean = stroke[:15].mean()
    beats = record(clean(), 20, 0.01)
    waves = clean()
    values = {n: x + (stroke / mean - 1.0) * (waves[n] - waves[n].mean()) for n, x in beats.values.items()}
    unlike = replace(beats, values=values)
    fitted, kept = unlike.select(range(15)), unlike.select(range(15, 20))
    other = replace(equal, fitted=fitted, held_out=kept, problem=network_problem(fitted, NETWORK, NAMES))
    gaps = [stiffer(s, 0.1).gap.total[0] for s in (equal, other)]
    assert gaps[1] == pytest.approx(gaps[0], rel=0.15)


def test_a_sensor_without_resonance_is_said_as_a_low_pass() -> None:
    """f_n = 40 Hz with ζ = 2 has poles at 40 (2 ∓ √3) Hz: a low-pass of 10.7 Hz. Not with ζ = 0.7, not beside another
    effect, not of another kind of sensor."""

    def catheter(f_n: float, zeta: float) -> NamedEffect:
        ends = {"f_n": Estimate(f_n, "Hz", (20.0, 830.0)), "zeta": Estimate(zeta, "1", (0.5, 50.0))}
        return NamedEffect("catheter_resonance", ("A.P",), {f"A.P.{key}": e for key, e in ends.items()}, 0.9)

    assert low_passed([catheter(40.0, 2.0)]) == "A.P passes through a low-pass of 10.7 Hz"
    assert not low_passed([catheter(40.0, 0.7)]) and not low_passed([lag("A.P", 5e-3)]) and not low_passed([])
    assert not low_passed([catheter(40.0, 2.0), lag("A.P", 5e-3)])


def test_a_first_model_that_needs_narrow_arteries() -> None:
    """A first model whose radii make up for a mean pressure that is lost: `unknown`, with both readings and the largest
    loss of several recordings."""
    s, run = study(), stiffer(study(), 0.0)
    found = confirmed(s, named("none"), run, None, [{"Fem.P": 1600.0}, {"Fem.P": 1733.0}])
    assert found.verdict == "unknown" and found.confidence <= 0.5
    assert sentence(found, (), run.gap, None) == (
        "The model fits the record only with arteries so narrow that the mean pressure falls by 13 mmHg on the way to "
        "Fem.P: the zero or the height of a sensor is off, or an artery is narrowed."
    )
    assert confirmed(s, named("none"), run, None, [{}]).verdict == "none"
