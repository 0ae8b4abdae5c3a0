"""Records that no study can use: the verdict says why in a sentence, and nothing else is written."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from forked import NETWORK, SETTINGS, N, T, inflow
from judged import judge, value_of
from truth.hide import Effect
from truth.records import Case, Made, make, write

from discrepancy import workflow
from discrepancy.find.plausibility import check_beats, check_record, check_waves
from discrepancy.find.study import Unusable, bench_site, channels, check_scatter, prepare
from discrepancy.workflow import discover
from fitting.first.options import REFERENCE
from fitting.records.read.record import Record, write_record
from solver import load, simulate_periodic
from solver.network.files import write_network

pytestmark = pytest.mark.usefixtures("one_process")

DT = T / N
NAMES = ("inlet.Q", "A.P", "B.P", "C.Q")
UNITS = {"A.P": "mmHg", "B.P": "mmHg", "C.Q": "mL/s", "inlet.Q": "mL/s"}
Waves = dict[str, np.ndarray]


@cache
def beat() -> Mapping[str, np.ndarray]:
    """One beat of the small network, N samples."""
    wave = simulate_periodic(NETWORK, inflow, T, settings=SETTINGS, tolerance=1e-6)
    return {name: wave[name][:-1] for name in NAMES}


def healthy(beats: int = 20) -> Waves:
    """A healthy record with 40 dB noise."""
    rng = np.random.default_rng(3)
    return {n: np.tile(x, beats) + 0.01 * x.std() * rng.normal(size=beats * N) for n, x in beat().items()}


@pytest.fixture(scope="module")
def model(fast_fmu: Callable[..., Path]) -> Path:
    """The FMU of the small network, which carries its file."""
    return fast_fmu(NETWORK, None)


def refused(waves: Waves, model: Path, folder: Path) -> str:
    """The reason of an unusable record; there is no model of it, and nothing is left half done."""
    write_record(folder / "record.csv", DT * np.arange(len(next(iter(waves.values())))), waves,
                 {n: UNITS[n] for n in waves if n in UNITS})  # fmt: skip
    outcome = discover(folder / "record.csv", model, folder / "out")
    assert outcome.verdict == "unusable" and outcome.reason
    written = json.loads((folder / "out" / "verdict.json").read_text(encoding="utf-8"))
    assert (written["verdict"], written["reason"], written["effects"]) == ("unusable", outcome.reason, [])
    assert {p.name for p in (folder / "out").iterdir()} <= {"verdict.json", "report.html", "figures"}
    return outcome.reason


def test_too_short(model: Path, tmp_path: Path) -> None:
    """Six beats leave no scatter once some are kept apart."""
    assert "6 beats are too few; record at least 8" in refused(healthy(6), model, tmp_path)


def test_one_channel_on_another_clock(model: Path, tmp_path: Path) -> None:
    """B.P shifted by 150 ms against the others: named, with its delay (± 20 ms) and its side."""
    waves = healthy()
    waves["B.P"] = np.roll(waves["B.P"], round(0.15 / DT))
    reason = refused(waves, model, tmp_path)
    assert "B.P comes" in reason and "ms too late" in reason and "not synchronised" in reason
    assert float(reason.split("B.P comes ")[1].split(" ms")[0]) == pytest.approx(150.0, abs=20.0)


def test_one_channel_with_another_heart_rate(model: Path, tmp_path: Path) -> None:
    """C.Q repeats every 0.46 s, the others every 0.4 s."""
    waves, t = healthy(), DT * np.arange(20 * N)
    waves["C.Q"] = np.interp(t % 0.46, np.linspace(0.0, 0.46, N, endpoint=False), beat()["C.Q"], period=0.46)
    assert "channel C.Q repeats every 0.46 s, the others every 0.4 s" in refused(waves, model, tmp_path)


@pytest.mark.parametrize("names", [("inlet.Q", "A.P", "B.P", "C.Q"), ("inlet.Q", "B.P")])
@pytest.mark.parametrize("upstrokes", [3, 3.7])
def test_a_channel_that_rings_has_the_same_heart_rate(names: tuple[str, ...], upstrokes: float) -> None:
    """B.P rings at 3 or 3.7 times the rate of the heart, from each upstroke on: by itself it repeats after a part of a
    beat, but after a beat as well. The same oscillation without the beat has a period of its own."""
    waves, t = healthy(), DT * np.arange(20 * N)
    ringing = 3e3 * np.cos(2.0 * np.pi * upstrokes * t / T)
    ring = np.cos(2.0 * np.pi * upstrokes * (t % T) / T)
    waves["B.P"] = waves["B.P"].mean() + 3e3 * ring + 0.3 * (waves["B.P"] - waves["B.P"].mean())
    check_record(as_record({name: waves[name] for name in names}))
    if upstrokes % 1.0:
        with pytest.raises(Unusable, match=r"B\.P repeats every|inlet\.Q repeats every"):
            check_record(as_record({name: waves[name] for name in names} | {"B.P": 1e4 + ringing}))


@pytest.mark.parametrize("name", ["A.P", "inlet.Q"])
def test_dead_for_a_part(model: Path, tmp_path: Path, name: str) -> None:
    """A channel is flat in twice four of twenty beats, each for less than the 2 s that become gaps; of these those at
    the ends may count as drifting."""
    waves = healthy()
    for start in (3 * N, 11 * N):
        waves[name][start : start + 4 * N] = waves[name][start]
    assert re.search(rf"channel {name} is flat in [4-8] of 20 beats", refused(waves, model, tmp_path))


def test_dead_all_the_time(model: Path, tmp_path: Path) -> None:
    """A pressure that is constant: the sentence names the column."""
    waves = healthy() | {"B.P": np.full(20 * N, 1.2e4)}
    assert "column 'B.P [mmHg]': the channel is constant" in refused(waves, model, tmp_path)


def test_wrong_unit(model: Path, tmp_path: Path) -> None:
    """C.Q in L/s under a title in mL/s: a pulse of a thousandth of the model's."""
    waves = healthy()
    waves["C.Q"] = waves["C.Q"] / 1000.0
    reason = refused(waves, model, tmp_path)
    assert "the pulse of C.Q is 0.001" in reason.replace("0.00100", "0.001") and "a wrong unit" in reason


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1000.0, "inlet.Q: its peak is 96.4 m/s over the area at R0, and no artery's is beyond 5 m/s"),  # µL/s
        (40.0, "the pulse of A.P is 0.0374 times that of the model: a wrong unit"),
    ],
)
def test_an_inflow_that_no_artery_carries(model: Path, tmp_path: Path, factor: float, said: str) -> None:
    """inlet.Q in another unit than its title's, mL/s, under which nothing can be simulated."""
    waves = healthy()
    waves["inlet.Q"] = factor * waves["inlet.Q"]
    assert said in refused(waves, model, tmp_path)


def test_saturated(model: Path, tmp_path: Path) -> None:
    """A.P cut off at 70 % of its pulse in every beat: the sentence says clipped."""
    waves = healthy()
    x = waves["A.P"]
    waves["A.P"] = np.minimum(x, x.min() + 0.7 * np.ptp(x))
    assert "clipped" in refused(waves, model, tmp_path)


def test_channels_of_another_network(model: Path, tmp_path: Path) -> None:
    """A site that the network has not: the sentence tells those that it has."""
    waves = healthy()
    waves["FA.P"] = waves.pop("B.P")
    assert "its channel FA.P is no output of network fork (sites A, B, C)" in refused(waves, model, tmp_path)


def test_waves_of_another_network(model: Path, tmp_path: Path) -> None:
    """The right names, but every wave is made of harmonics 3 to 5: none resembles the model's."""
    rng, phase = np.random.default_rng(1), 2.0 * np.pi * np.arange(20 * N) / N
    waves = healthy()
    for name in ("A.P", "B.P", "C.Q"):
        wave = sum(np.cos(k * phase - rng.uniform(0.0, 6.0)) for k in (3, 4, 5))
        waves[name] = waves[name].mean() + waves[name].std() * (wave + 0.01 * rng.normal(size=20 * N))
    assert "its waves do not resemble those of network fork" in refused(waves, model, tmp_path)


def test_waves_upside_down(model: Path, tmp_path: Path) -> None:
    """Waves of the right harmonics, but upside down and 9/50 of a beat late: no wave of this network either."""
    waves = healthy()
    for name in ("A.P", "B.P", "C.Q"):
        waves[name] = np.roll(2.0 * waves[name].mean() - waves[name], 9)
    reason = refused(waves, model, tmp_path)
    assert "do not resemble" in reason or "not synchronised" in reason


def test_what_is_no_verdict(model: Path, tmp_path: Path) -> None:
    """A record or model that is not there is an error of the caller, and makes no verdict."""
    with pytest.raises(ValueError, match="nowhere.csv"):
        discover(tmp_path / "nowhere.csv", model, tmp_path / "out")
    with pytest.raises(ValueError, match="nothing.toml"):
        discover(tmp_path / "record.csv", tmp_path / "nothing.toml", tmp_path / "out")
    assert not (tmp_path / "out" / "verdict.json").exists()


# --- the checks by themselves ----------------------------------------------------------------------------------------


def as_record(waves: Waves) -> Record:
    return Record("made.csv", "", DT * np.arange(len(next(iter(waves.values())))), waves)


def test_a_healthy_record_passes() -> None:
    """The model's own waves with noise: every check is silent, also with one channel half or twice as large."""
    study = prepare(as_record(healthy()), NETWORK)
    check_record(as_record(healthy()))
    check_beats(study)
    simulated = {n: np.interp(study.fitted.time, DT * np.arange(N), beat()[n], period=T) for n in NAMES}
    check_waves(study, simulated)
    check_waves(study, simulated | {"A.P": 2.0 * simulated["A.P"], "C.Q": 0.5 * simulated["C.Q"]})


def test_held_out_beats_are_the_last_quarter() -> None:
    """20 beats: 15 are fitted, the last 5 kept."""
    study = prepare(as_record(healthy()), NETWORK)
    assert (study.problem.kind, study.site, study.fitted.n_beats, study.held_out.n_beats) == ("network", None, 15, 5)
    assert set(study.problem.signals) == set(NAMES) - {"inlet.Q"}


def test_what_a_bench_is() -> None:
    """P and R of one segment alone; anything else without inflow is refused in a sentence."""
    sheep = load("sheep")
    x = np.zeros(8)
    assert bench_site(as_record({"CA.P": x, "CA.R": x}), sheep) == "CA"
    for names, said in (
        (
            ("CA.P", "CA.Q"),
            "it has CA.P, CA.Q, but no inlet.Q; add inlet.Q to compare it with the network, or add CA.R to compare",
        ),
        (("CA.P", "CA.R", "FA.P"), "or give P and R of one site alone to compare one artery with its wall"),
        (("ZZ.P", "ZZ.R"), "has no segment ZZ"),
    ):
        with pytest.raises(Unusable, match=said):
            bench_site(as_record(dict.fromkeys(names, x)), sheep)
    with pytest.raises(Unusable, match="it has no channel but inlet.Q"):
        channels(as_record({"inlet.Q": x}), sheep)


@pytest.mark.parametrize(
    ("channel", "factor", "said"),
    [
        ("CA.R", 0.1, "its numbers fit the unit cm"),  # cm under a title in mm
        ("CA.R", 2.0, "a diameter"),
        ("CA.P", 0.133322, "its numbers fit the unit kPa"),  # under a title in mmHg
        ("CA.P", 1.0 / 0.133322, "its mean is 663 mmHg"),  # the reverse
    ],
)
def test_a_bench_in_the_wrong_unit(tmp_path: Path, channel: str, factor: float, said: str) -> None:
    """A bench whose column has another unit than its title: said before anything is named."""
    made = make(Case("bench", "CA", 40.0), 3)
    wrong = replace(made, channels=dict(made.channels) | {channel: made.channels[channel] * factor})
    write(wrong, tmp_path / "record.csv")
    write_network(made.base, tmp_path / "sheep.toml")
    outcome = discover(tmp_path / "record.csv", tmp_path / "sheep.toml", tmp_path / "out")
    assert (outcome.verdict, outcome.kind) == ("unusable", "bench")
    assert outcome.reason is not None and said in outcome.reason
    assert not (tmp_path / "out" / "model.fmu").exists()


# --- gaps ------------------------------------------------------------------------------------------------------------


def bench_record(gap: float) -> tuple[Made, Made]:
    """A bench record with a hidden E_NL of 4 E, whole and with the last part of CA.R missing."""
    made = make(Case("bench", "CA", 40.0, (Effect("nonlinear_elasticity", ("CA",), 4.0),)), 5)
    R = made.channels["CA.R"].copy()
    R[round((1.0 - gap) * len(R)) :] = np.nan
    return made, replace(made, channels=dict(made.channels) | {"CA.R": R})


@pytest.mark.deep
@pytest.mark.parametrize(("gap", "whole"), [(0.3, 14)])
def test_a_channel_that_ends_early(tmp_path: Path, gap: float, whole: int) -> None:
    """CA.R lacks the last 15 or 30 %: beats without it are left out, and said so; no number of the verdict is missing,
    and the value is that of the whole record within its interval."""
    made, cut = bench_record(gap)
    write(cut, tmp_path / "record.csv")
    write_network(made.base, tmp_path / "sheep.toml")
    outcome = discover(tmp_path / "record.csv", tmp_path / "sheep.toml", tmp_path / "out")
    assert outcome.verdict == "effect" and outcome.effects[0].name == "nonlinear_elasticity"
    assert outcome.provenance["beats"] == {"fitted": whole - whole // 4, "held_out": whole // 4}
    assert f"{20 - whole} of 20 beats were left out for the gaps of CA.R." in outcome.warnings
    text = (tmp_path / "out" / "verdict.json").read_text(encoding="utf-8")
    written = json.loads(text)
    (low, high), (_, naming) = outcome.effects[0].parameters["CA.ENL"].ci95, judge(as_made(made), made.base)
    assert low < value_of(naming.best.fit.terms[0].unknowns[0], float(naming.best.fit.x[-1])).value < high
    assert all(np.isfinite(list(gap.values())).all() for gap in (written["gap"]["before"], written["gap"]["after"]))
    assert 0.5 < written["gap"]["after"]["held_out"] < 2.0
    assert not (tmp_path / "out" / ".state").exists()


def test_a_channel_that_is_hardly_there() -> None:
    """CA.R lacks 65 %: seven beats have both channels; the sentence names it, how much is missing and what to do."""
    made, cut = bench_record(0.65)
    with pytest.raises(Unusable, match=r"CA\.R lacks 65% of its samples, and only 7 of 20 beats .* leave the channel"):
        judge(as_made(cut), made.base)


def test_a_phase_that_the_held_out_beats_lack() -> None:
    """A fifth of every one of the last five beats of B.P is missing: said, as nothing can be judged there."""
    waves = healthy()
    waves["B.P"].reshape(20, N)[15:, : N // 5] = np.nan
    said = r"B\.P lacks 5% of its samples, and the 5 beats that are kept apart to judge by have none of it over 20%"
    with pytest.raises(Unusable, match=said):
        prepare(as_record(waves), NETWORK)


def test_gaps_here_and_there_cost_nothing() -> None:
    """A tenth of all samples of B.P is missing at random: all beats serve."""
    waves = healthy()
    waves["B.P"][np.random.default_rng(2).random(20 * N) < 0.1] = np.nan
    study = prepare(as_record(waves), NETWORK)
    assert (study.fitted.n_beats, study.held_out.n_beats) == (15, 5)


def test_a_first_model_does_not_hide_a_zero_that_is_off() -> None:
    """B.P 20 mmHg above A.P at the root, against the flow: a first model gets the doubt that `first` has, as its
    radii may take it up; another model does not."""
    waves = healthy()
    rise = waves["A.P"].mean() - waves["B.P"].mean() + 20.0 * 133.322
    waves["B.P"] = waves["B.P"] + rise
    sites = tuple(replace(s, position=0.0) if s.segment == NETWORK.inlet.segment else s for s in NETWORK.sites)
    other = replace(NETWORK, sites=sites)
    first = replace(other, reference=f"{REFERENCE}made up")
    (doubt,) = (said for said in prepare(as_record(waves), first).warnings if "against the flow" in said)
    assert doubt.startswith("the mean of B.P is 20 mmHg above that of A.P")
    assert not any("against the flow" in said for said in prepare(as_record(waves), other).warnings)


# --- no noise, and two clocks ----------------------------------------------------------------------------------------


def test_beats_that_are_all_the_same() -> None:
    """A simulated beat repeated: no scatter says what a disagreement is. The inflow alone may be without noise."""
    waves = {name: np.tile(x, 20) for name, x in beat().items()}
    with pytest.raises(Unusable, match=r"the beats of A\.P are all the same to .* give the record as it was measured"):
        prepare(as_record(waves), NETWORK)
    assert prepare(as_record(healthy() | {"inlet.Q": waves["inlet.Q"]}), NETWORK).fitted.n_beats == 15


@pytest.mark.parametrize(("noise", "step"), [(1e-5, 1e-5), (3e-4, 1e-3)])
def test_beats_that_are_nearly_the_same(noise: float, step: float) -> None:
    """Noise of 100 or 70 dB below the steps of a converter of 17 or 10 bits: used."""
    rng, waves = np.random.default_rng(6), {}
    for name, x in beat().items():
        noisy = np.tile(x, 20) + noise * x.std() * rng.normal(size=20 * N)
        waves[name] = step * np.ptp(x) * np.round(noisy / (step * np.ptp(x)))
    check_scatter(prepare(as_record(waves), NETWORK).fitted)


@pytest.mark.parametrize("part", [-0.3, 0.107, 0.5])
def test_a_bench_of_two_clocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: float) -> None:
    """CA.R rolled by a tenth to half of a beat: refused before anything is named, with the delay (± 20 ms)."""
    monkeypatch.setattr(workflow, "name", pytest.fail)
    made, _ = bench_record(0.0)
    shift = round(part * made.base.inlet.T / (made.time[1] - made.time[0]))
    rolled = replace(made, channels=dict(made.channels) | {"CA.R": np.roll(made.channels["CA.R"], shift)})
    write(rolled, tmp_path / "record.csv")
    write_network(made.base, tmp_path / "sheep.toml")
    reason = discover(tmp_path / "record.csv", tmp_path / "sheep.toml", tmp_path / "out").reason or ""
    assert f"ms too {'late' if part > 0 else 'early'}" in reason and "not synchronised" in reason
    delay = float(reason.split("CA.R comes ")[1].split(" ms")[0])
    assert delay == pytest.approx(abs(part) * 1e3 * made.base.inlet.T, abs=20.0)


def as_made(made: Made) -> Record:
    return Record("made", "", made.time, made.channels, {})
