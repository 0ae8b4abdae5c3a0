"""Running a network: results, periodicity, inflows, files, command line."""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import in_process
from compare import relative_error

from arterial_fmu.cli.solve import main
from solver import (
    Network,
    NonPhysicalState,
    NotPeriodic,
    Settings,
    Waveforms,
    Windkessel,
    repeating_beat,
    sampled_inflow,
    simulate,
    simulate_periodic,
)

QUICK = Settings(dt=5e-3)


def test_periodic_beat_repeats(sheep: Network) -> None:
    """The stated change is true: one more beat differs by no more, and the beats are counted (5 at 1e-5)."""
    beat = simulate_periodic(sheep)
    assert beat.beats == 5
    assert beat.change <= 1e-5
    longer = simulate(sheep, duration=3.0)
    last = slice(-501, None)
    assert max(relative_error(name, beat[name], longer[name][last]) for name in beat) <= 2e-5


@pytest.mark.parametrize(
    ("viscous", "beats", "error"), [pytest.param(True, 1.25, 5e-6, marks=pytest.mark.slow), (False, 2.75, 8e-6)]
)
def test_repeating_beat_is_the_periodic_one(sheep: Network, viscous: bool, beats: float, error: float) -> None:
    """A batch of two moduli against beats that repeat to 1e-9: relative L2 error of every output <= the tolerance, 1e-5
    (measured 1e-6 with viscous walls, 2e-6 with elastic ones), in fewer beats than :func:`simulate_periodic`."""
    network = sheep if viscous else sheep.with_parameters({f"{s.name}.phi0": 0.0 for s in sheep.segments})
    moduli, settings = {"CA.E": 5e5 * np.array([1.0, 1.2])}, Settings(dt=2.5e-3)
    beat = repeating_beat(network, parameters=moduli, settings=settings)
    exact = simulate_periodic(network, parameters=moduli, settings=settings, tolerance=1e-9)
    assert beat.beats <= beats
    assert beat.change <= 1e-5
    each = [(name, i) for name in beat if name != "inlet.Q" for i in range(2)]
    assert max(relative_error(name, beat[name][i], exact[name][i]) for name, i in each) <= error


def test_repeating_beat_without_a_steady_state(sheep: Network) -> None:
    """Under a mean inflow that no wall can carry there is no state to start near; from rest it breaks down."""
    with pytest.raises(NonPhysicalState):
        repeating_beat(sheep, lambda t: 5e-3 + 0.0 * t, settings=QUICK)
    with pytest.raises(NotPeriodic, match="after 2 beats"):
        repeating_beat(sheep, settings=QUICK, tolerance=1e-14, max_beats=2)


def test_windkessel_network_reaches_its_mean_pressure(sheep: Network) -> None:
    """The mean flow through each Windkessel is (mean P - P_venous)/(R1 + R2): to 2e-5 (measured 1e-5)."""
    outlets = tuple(Windkessel(o.segment, 1e7, 1e-9, 9e8, P_venous=500.0) for o in sheep.outlets)
    beat = simulate_periodic(replace(sheep, outlets=outlets, P_0=10e3, P_ref=10e3), settings=QUICK, tolerance=1e-7)
    for outlet in outlets:
        P, Q = (beat[f"{outlet.segment}.outlet.{kind}"][:-1].mean() for kind in "PQ")
        assert Q == pytest.approx((P - 500.0) / 9.1e8, rel=2e-5)
    # the mean of the half-sine is Q_max/π
    outflow = sum(beat[f"{outlet.segment}.outlet.Q"][:-1].mean() for outlet in outlets)
    assert outflow == pytest.approx(55e-6 / np.pi, rel=5e-6)


def test_steady_inflow_is_periodic(sheep: Network) -> None:
    """A constant inflow has no pulse to compare with: it counts as periodic, and the flow that enters leaves."""
    beat = simulate_periodic(sheep, lambda t: 1e-5 + 0.0 * t, settings=QUICK)
    outflow = sum(beat[f"{outlet.segment}.outlet.Q"][-1] for outlet in sheep.outlets)
    assert outflow == pytest.approx(1e-5, rel=1e-6)


def test_not_periodic(sheep: Network) -> None:
    """Too few beats end in a sentence that says how far they got and what to do."""
    with pytest.raises(NotPeriodic, match=r"after 2 beats the last differs by .* allow more beats"):
        simulate_periodic(sheep, settings=QUICK, max_beats=2)


def test_sampled_inflow_equals_the_function(sheep: Network) -> None:
    """Samples 0.1 ms apart, linear between: (ω Δt)²/8 = 2e-7 of the function's answer, within 1e-6 at the outlets."""
    t = np.linspace(0.0, 0.5, 5001)
    sampled = simulate(sheep, sampled_inflow(t, sheep.inlet.Q(t), period=0.5))
    exact = simulate(sheep)
    assert max(relative_error(name, sampled[name], exact[name]) for name in exact if "inlet" not in name) <= 1e-6


def _short(network: Network) -> Waveforms:
    """The end of two steps."""
    return simulate(network, duration=2e-3, settings=QUICK)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda n: simulate("sheep"), r"network = 'sheep': must be a Network; load\(\) makes one"),
        (lambda n: simulate_periodic("sheep"), "network = 'sheep': must be a Network"),
        (
            lambda n: sampled_inflow(np.arange(3), np.zeros(3), period=1.0),
            "period = 1.0 s must be finite and no shorter",
        ),
        (lambda n: simulate_periodic(n, max_beats=1), "max_beats = 1 must be a whole number of at least 2"),
        (lambda n: simulate_periodic(n, max_beats=3.5), "max_beats = 3.5 must be a whole number"),
        (lambda n: simulate(n, duration=-1.0), "duration = -1.0 s: must be a positive"),
        (lambda n: simulate(n, duration=float("nan")), "duration = nan"),
        (lambda n: simulate(n, duration=1e9), r"1e\+09 s in steps of 0.001 s: the outputs would take"),
        (
            lambda n: simulate(n, parameters={"VA1.L": 10.0, "VA2.L": 10.0}, settings=Settings(element_length=1e-4)),
            "cuts network sheep into 20[0-9]{4} elements",
        ),
        (lambda n: simulate(n, lambda t: np.nan * t), r"inflow inlet.Q: nan at t = 0 s; all values must be finite"),
        (lambda n: simulate(n, lambda t: np.zeros(3)), "it must give one value per time"),
        (lambda n: simulate(n, parameters={"CA.phi": 1.0}), r"CA\.phi: not a parameter .* \(did you mean CA\.phi0\?\)"),
        (lambda n: simulate(n, parameters={"CA.E": np.array([1e6, -1.0])}), r"CA\.E = -1 Pa is not allowed"),
        (lambda n: simulate(n, parameters={"CA.E": np.ones((2, 2)) * 1e6}), r"CA\.E: batch of shape"),
        (
            lambda n: simulate(n, parameters={"CA.E": np.full(2, 1e6), "CA.h": np.full(3, 1e-3)}),
            r"CA\.h: batch of shape \(3,\) does not fit CA\.E of shape \(2,\)",
        ),
        (lambda n: simulate_periodic(n, tolerance=0.0), "tolerance = 0.0 must be a positive number"),
        (lambda n: simulate_periodic(n, tolerance="a"), "tolerance = 'a' must be a positive number"),
        (lambda n: simulate(n, start=_short(n)), "an earlier result is a start of simulate_periodic"),
        (lambda n: simulate(n, scheme="muscl", start="anywhere"), "must be 'rest' or 'periodic'"),
        (lambda n: simulate_periodic(n, start=_short(n), scheme="muscl"), "another mesh"),
        (lambda n: simulate_periodic(n, period=1e-5), "period = 1e-05 s: must be a finite number of at least one"),
        (lambda n: sampled_inflow(np.arange(3), np.zeros(2)), "of one length"),
        (lambda n: sampled_inflow(np.array([0, 0, 1]), np.zeros(3)), "t must increase"),
    ],
)
def test_bad_input(sheep: Network, call: Callable[[Network], object], words: str) -> None:
    """Every bad value ends in a ValueError of one sentence."""
    with pytest.raises(ValueError, match=words):
        call(sheep)


def test_a_network_may_have_no_sites(sheep: Network) -> None:
    """Its outlets are what they are with sites, bit by bit."""
    found, expected = (simulate(n, duration=0.005) for n in (replace(sheep, sites=()), sheep))
    assert np.array_equal(found["CA.outlet.P"], expected["CA.outlet.P"]) and "CA.P" not in found.columns


def test_csv_round_trip(sheep: Network, tmp_path: Path) -> None:
    """Columns are named as the FMU's variables with SI units; values survive to 1e-11."""
    beat = simulate(sheep, duration=0.1, settings=QUICK)
    beat.to_csv(tmp_path / "beat.csv")
    with (tmp_path / "beat.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0][:5] == ["time [s]", "inlet.Q [m^3/s]", "inlet.P [Pa]", "AA.P [Pa]", "AA.Q [m^3/s]"]
    table = np.array(rows[1:], float)
    np.testing.assert_allclose(table[:, rows[0].index("CA.R [m]")], beat["CA.R"], rtol=1e-11)
    np.testing.assert_allclose(table[:, 0], beat.time, atol=1e-12)


def test_csv_is_whole_or_absent(sheep: Network, tmp_path: Path) -> None:
    """A batch is refused, a missing directory too; nothing is left behind."""
    batch = simulate(sheep, duration=0.01, settings=QUICK, parameters={"CA.E": np.array([4e6, 5e6])})
    with pytest.raises(ValueError, match=r"member\(i\)\.to_csv"):
        batch.to_csv(tmp_path / "batch.csv")
    with pytest.raises(ValueError, match="cannot be written"):
        batch.member(0).to_csv(tmp_path / "nowhere" / "beat.csv")
    assert list(tmp_path.iterdir()) == []


# --- command line -------------------------------------------------------------------------------------------------


def test_command_line(tmp_path: Path) -> None:
    """Runs the bundled network with a changed parameter, prints a table, writes the CSV."""
    out = tmp_path / "beat.csv"
    command = [
        sys.executable,
        "-m",
        "arterial_fmu",
        "solve",
        "sheep",
        "--dt",
        "5 ms",
        "--set",
        "CA.phi0=0 kPa*s",
        "--out",
        str(out),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "CA" in done.stdout
    assert "beats" in done.stdout
    assert out.read_text().startswith("time [s],inlet.Q [m^3/s],inlet.P [Pa]")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.toml"], "nowhere.toml: neither a file nor a bundled network"),
        (["sheep", "--set", "CA.phi0=-1 kPa*s"], "CA.phi0 = -1000 Pa.s is not allowed"),
        (["sheep", "--set", "CA.phi=1"], "CA.phi: not a parameter"),
        (["sheep", "--set", "CA.phi0"], "must look like NAME=VALUE"),
        (["sheep", "--dt", "1 mm"], "does not convert"),
        (["sheep", "--cell", "2cm"], "--cell belongs to --scheme muscl; select that scheme"),
        (["sheep", "--scheme", "muscl", "--element-length", "2cm"], "--element-length belongs to --scheme staggered"),
        (["sheep", "--duration", "soon"], "--duration"),
        (["sheep", "--max-beats", "2", "--dt", "5 ms"], "allow more beats"),
        (["sheep", "--dt", "5 ms", "--duration", "0.1 s", "--out", "/nowhere/beat.csv"], "cannot be written"),
    ],
)
def test_command_line_refuses(arguments: list[str], words: str) -> None:
    """Exit code 2 and one sentence, never a traceback."""
    done = in_process(main, arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    message = " ".join(done.stderr.split())
    assert words in message
    assert "Traceback" not in message
