"""Known filters of channels: part of what a model is compared with, undone in the inflow that drives it.

Records of three vessels, at 40 dB; the filters are laid over them here, by SciPy's Butterworth.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, N, T, exact, inflow, record
from judged import judge
from scipy.signal import butter, freqs

from discrepancy.workflow import discover
from fitting.calibrate.network_calibration import calibrate
from fitting.inference.hypothesis import candidates
from fitting.inference.models.bench import bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.channels.filters import with_filters
from fitting.records.channels.inflow import flowed
from fitting.records.read.record import Record, write_record
from fitting.records.virtual import jarvik_pressure, pressure_at, solve_radius, table_wall
from fitting.results.parameter_set import read_set
from solver import Settings, beat_harmonics, load, simulate
from solver.laws.sensors import LowPass
from solver.network.files import read_network, write_network

FILTERS = ("inlet.Q=lowpass 6 Hz order 2", "A.P=lowpass 15 Hz", "C.R=lowpass 12 Hz order 3")
STIFFER = NETWORK.with_parameters({"B.E": 1.2 * NETWORK.segment("B").E})
LAID = (("inlet.Q", 2, 6.0), ("A.P", 1, 15.0), ("C.R", 3, 12.0))
SHOWN = ("A.P", "B.P", "C.P", "C.Q", "C.R")


def butterworth(order: int, cutoff: float, f: np.ndarray) -> np.ndarray:
    return freqs(*butter(order, 2.0 * np.pi * cutoff, analog=True), 2.0 * np.pi * f)[1]


def filtered(waves: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Waves (N,) of the period T as the filters show them."""
    f, found = np.arange(N // 2 + 1) / T, dict(waves)
    for channel, order, cutoff in LAID:
        found[channel] = np.fft.irfft(np.fft.rfft(waves[channel]) * butterworth(order, cutoff, f), N)
    return found


def recorded(network: object = NETWORK, seed: int = 0) -> Beats:
    waves = exact(1.0, network)
    return record(filtered({n: waves[n] for n in ("inlet.Q", *SHOWN)}), 15, 0.01, seed)


@pytest.mark.parametrize(
    ("text", "proposed"), [("A.P=zero 4", "4 mmHg"), ("inlet.Q=zero 4", "4 mL/s"), ("A.P=lowpass 10", "10 Hz")]
)
def test_a_number_without_its_unit_is_refused(text: str, proposed: str) -> None:
    """As in every option: a zero of 4 was one of 4 Pa. A time is in seconds, 0 is 0."""
    with pytest.raises(ValueError, match=f'it has no unit; write one, such as "{proposed}"'):
        with_filters(NETWORK, [text])
    assert with_filters(NETWORK, ["A.P=delay 0.02"]) == with_filters(NETWORK, ["A.P=delay 20 ms"])


@pytest.mark.parametrize("order", range(1, 9))
def test_butterworth(order: int) -> None:
    """H of 10 Hz and every order against SciPy's analogue prototype, to 1e-12 of its size; 1/√2 at the cut-off."""
    f = np.linspace(0.0, 100.0, 101)
    H = LowPass().transfer({"low_pass": np.array(10.0), "low_pass_order": np.array(order)}, 2.0 * np.pi * f)
    np.testing.assert_allclose(H, butterworth(order, 10.0, f), rtol=1e-12)
    assert abs(H[10]) == pytest.approx(2.0**-0.5, rel=1e-12)


def test_a_known_delay() -> None:
    """inlet.Q that a meter shows 30 ms late, with the delay known, by option or file: the drive of the network is the
    true one to 1e-6 of its norm, and so is what a calibration of it sees; a delay of 0 is refused."""
    waves = exact(1.0, NETWORK)
    shown = {n: waves[n] for n in ("inlet.Q", *SHOWN)}
    shift = np.exp(-2j * np.pi * np.arange(len(shown["inlet.Q"]) // 2 + 1) * 0.03 / T)
    late = np.fft.irfft(np.fft.rfft(shown["inlet.Q"]) * shift, len(shown["inlet.Q"]))
    known = with_filters(NETWORK, ["inlet.Q=delay 30 ms"])
    assert known.channels == NETWORK.with_terms({"inlet.Q.delay": 0.03}).channels
    beats = record({**shown, "inlet.Q": late})
    assert np.linalg.norm(flowed(beats, known) - shown["inlet.Q"]) <= 1e-6 * np.linalg.norm(late)
    with pytest.raises(ValueError, match="its delay must not be 0 s"):
        with_filters(NETWORK, ["inlet.Q=delay 0 s"])


def test_filters_are_known_and_not_searched(tmp_path: Path) -> None:
    """They come from the option or from the network's file, which keeps them; no search has them among its terms."""
    network = with_filters(NETWORK, FILTERS)
    write_network(network, tmp_path / "fork.toml")
    assert 'low_pass = "6.0 Hz"' in (tmp_path / "fork.toml").read_text()
    assert read_network(tmp_path / "fork.toml").channels == network.channels
    assert "low_pass" not in {term.effect for term in candidates(network, ("inlet.Q", *SHOWN))}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("A.P", 'must be CHANNEL=lowpass FREQUENCY, such as "inlet.Q=lowpass 10 Hz"'),
        ("A.P=highpass 1 Hz", "must be CHANNEL=lowpass FREQUENCY"),
        ("X.P=lowpass 1 Hz", "network fork has no channel 'X.P'; use one of inlet.Q, "),
        ("A.P=lowpass 10 s", "the unit s does not convert to the expected Hz"),
        ("A.P=lowpass 0 Hz", "its frequency must be above 0 Hz"),
        ("A.P=lowpass 9 Hz order 9", "order n of that filter must lie in [1, 8]"),
    ],
)
def test_filters_that_are_none(text: str, expected: str) -> None:
    """One sentence with what is allowed."""
    with pytest.raises(ValueError, match=re.escape(expected)):
        with_filters(NETWORK, [text])


def test_an_order_is_a_whole_number() -> None:
    """One of 2.5 would amplify at half its cut-off: refused where a network is made."""
    with pytest.raises(ValueError, match="low_pass_order = 2.5 is not allowed.*must be a whole number"):
        NETWORK.with_terms({"A.P.low_pass": 10.0, "A.P.low_pass_order": 2.5})


def test_a_filtered_record_is_explained() -> None:
    """The true network under its filters: χ² within 95 % of chance, where without them it is 60 000 times as large. The
    inflow that all channels tell is the true one to 0.2 % of its norm, that of the meter to 0.4 %; as shown it is 54 %
    off."""
    beats = recorded()
    known, blind = (network_problem(beats, n, SHOWN) for n in (with_filters(NETWORK, FILTERS), NETWORK))
    (fit,), (other,) = known.refit([()]), blind.refit([()])
    assert fit is not None and other is not None and isinstance(known, NetworkProblem)
    n = len(fit.z)
    assert fit.chi2 < n + 2.0 * np.sqrt(2.0 * n) < 1e4 * n < other.chi2
    Q = exact()["inlet.Q"]
    size = np.linalg.norm(Q)
    assert np.linalg.norm(known.wave(beats, fit) - Q) < 0.002 * size
    assert np.linalg.norm(known.measured_wave(beats) - Q) < 0.004 * size
    assert np.linalg.norm(blind.measured_wave(beats) - Q) > 0.5 * size


def test_a_calibration_knows_the_filters() -> None:
    """E of one wall 1.2 times the file's: in its 95 % interval of 0.2 % with the filters, a fifth too low without."""
    beats, truth = recorded(STIFFER, 1), STIFFER.segment("B").E
    known = calibrate(beats, with_filters(NETWORK, FILTERS), ["B.E"], channels=SHOWN)
    assert known.ci95["B.E"][0] < truth < known.ci95["B.E"][1]
    assert known.chi2 < 1.3 * known.dof
    blind = calibrate(beats, NETWORK, ["B.E"], channels=SHOWN)
    assert blind.values["B.E"] < 0.8 * truth and blind.chi2 > 1e3 * blind.dof


@pytest.mark.parametrize("known", [True, False])
def test_beats_that_differ(known: bool) -> None:
    """Strokes that swing by 10 % over 5.3 beats, run in time: χ² of chance with the filters, 0.7 of the data as without
    any; 1000 times that where they are not known."""

    def drive(t: np.ndarray) -> np.ndarray:
        return (1.0 + 0.1 * np.sin(2.0 * np.pi * t / (5.3 * T))) * inflow(t)

    run = simulate(NETWORK, drive, 34 * T, settings=Settings(dt=T / 200))
    waves = {name: run[name][:6800] for name in SHOWN} | {"inlet.Q": drive(run.time[:6800])}
    for name, order, cutoff in LAID:
        X = np.fft.rfft(waves[name])
        waves[name] = np.fft.irfft(X * butterworth(order, cutoff, np.arange(len(X)) / (34 * T)), 6800)
    rng = np.random.default_rng(0)
    channels = {name: x[1200::4] + 0.01 * x.std() * rng.standard_normal(1400) for name, x in waves.items()}
    beats = align(Record("synthetic.csv", "", np.arange(1400) * T / N, channels))
    assert beats.variable is not None
    problem = network_problem(beats, with_filters(NETWORK, FILTERS) if known else NETWORK, SHOWN)
    (fit,) = problem.refit([()])
    assert fit is not None
    assert fit.chi2 < 1.3 * len(fit.z) if known else fit.chi2 > 100.0 * len(fit.z)


def test_harmonics_below_the_meter_noise_are_weighed_down() -> None:
    """A meter of 1.5 Hz and order 4 leaves 1e-4 of the third harmonic: what flowed there is not made of its noise, and
    the weights say that nobody knows."""
    waves = {n: exact()[n] for n in ("inlet.Q", *SHOWN)}
    H = butterworth(4, 1.5, np.arange(N // 2 + 1) / T)
    waves["inlet.Q"] = np.fft.irfft(np.fft.rfft(waves["inlet.Q"]) * H, N)
    problem = network_problem(record(waves, 15, 0.01), with_filters(NETWORK, ["inlet.Q=lowpass 1.5 Hz order 4"]), SHOWN)
    assert isinstance(problem, NetworkProblem)
    assert np.abs(problem.simulator.drive.X[4:]).max() < 1e-7  # m³/s, as shown
    (fit,) = problem.refit([()])
    assert fit is not None and fit.chi2 < 1.3 * len(fit.z)


def test_a_bench_knows_the_filters() -> None:
    """P of 20 Hz and order 2, R of 15 Hz: the wall of the same beats without filters, E and R0 to 1 % and χ² to 40 %;
    without the filters χ² is beyond ten times that."""
    sheep = read_set("sheep_table1").apply(load("sheep"))
    wave, t = jarvik_pressure(0.5), np.arange(200) * 0.5 / 200
    waves = {"AA.P": pressure_at(wave, 0.5, t), "AA.R": solve_radius(table_wall("AA"), wave, 0.5, 200)}
    f, slow = np.arange(101) / 0.5, dict[str, np.ndarray]()
    for name, order, cutoff in (("AA.P", 2, 20.0), ("AA.R", 1, 15.0)):
        slow[name] = np.fft.irfft(np.fft.rfft(waves[name]) * butterworth(order, cutoff, f), 200)
    known = with_filters(sheep, ["AA.P=lowpass 20 Hz order 2", "AA.R=lowpass 15 Hz"])
    law = [t for t in candidates(sheep, (), "AA") if t.effect == "nonlinear_wall_viscosity"]
    found = []
    for shown, network in ((waves, sheep), (slow, known), (slow, sheep)):
        (fit,) = bench(record(shown, 15, 0.01, 0, 0.5), network, "AA").refit([tuple(law)])
        assert fit is not None
        found.append((fit.chi2, *fit.x[:2]))
    np.testing.assert_allclose(found[1][1:], found[0][1:], atol=0.01)
    assert found[1][0] == pytest.approx(found[0][0], rel=0.4) and found[2][0] > 10.0 * found[1][0]


@pytest.mark.deep
def test_nothing_is_missing_behind_the_filters() -> None:
    """The verdict of the true network's record is `none`."""
    channels = {name: beats.ravel() for name, beats in recorded(NETWORK, 3).values.items()}
    shown = Record("synthetic.csv", "", np.arange(15 * N) * T / N, channels)
    _, naming = judge(shown, with_filters(NETWORK, FILTERS))
    assert naming.verdict == "none" and naming.base.explains


@pytest.mark.deep
@pytest.mark.usefixtures("one_process")
def test_discovery_knows_the_filters(tmp_path: Path) -> None:
    """A stenosis of K = 20 in A is named, with K in its interval; the new network has filters and stenosis, and its
    FMU's free run through the filters leaves noise."""
    write_network(NETWORK, tmp_path / "fork.toml")
    channels = {name: beats.ravel() for name, beats in recorded(NETWORK.with_terms({"A.K": 20.0}), 3).values.items()}
    write_record(tmp_path / "r.csv", np.arange(15 * N) * T / N, channels)
    out = tmp_path / "out"
    found = discover(tmp_path / "r.csv", tmp_path / "fork.toml", out, filters=FILTERS, as_measured=True)
    assert found.verdict == "effect" and found.gap_after[1] < 1.3 < found.gap_before[1]
    assert found.provenance["asked"]["filters"] == list(FILTERS)
    (parameter,) = found.effects[0].parameters.values()
    assert parameter.ci95[0] < 20.0 < parameter.ci95[1]
    assert read_network(out / "model.toml").channels == with_filters(NETWORK, FILTERS).channels


def test_no_filter_changes_nothing() -> None:
    """A cut-off of 0: the same numbers to the last bit."""
    plain = beat_harmonics(NETWORK, CHANNELS, 3, None, T)
    same = beat_harmonics(NETWORK.with_terms({"A.P.low_pass": 0.0}), CHANNELS, 3, None, T)
    np.testing.assert_array_equal(plain, same)
    beats = recorded()
    both = [network_problem(beats, n, SHOWN) for n in (NETWORK, NETWORK.with_terms({"A.P.low_pass": 0.0}))]
    np.testing.assert_array_equal(both[0].target.covariance, both[1].target.covariance)
