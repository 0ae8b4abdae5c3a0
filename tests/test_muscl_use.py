"""The finite volumes as a scheme among others: names, settings, batches, restarts, and what they do not have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compare import relative_error
from tubes import artery, tube
from typer import Typer
from typer.testing import CliRunner

from arterial_fmu.cli.solve import main
from solver import (
    MusclSettings,
    Network,
    NonPhysicalState,
    Reflection,
    Settings,
    Windkessel,
    simulate,
    simulate_periodic,
)

COARSE = MusclSettings(cell=0.02)


def test_a_batch_is_its_members(sheep: Network) -> None:
    """Two parameter sets in one run, against each alone: the same to 1e-11 (the steps are those of the faster wave)."""
    E = np.array([1.5e6, 1.539e6])
    both = simulate(sheep, duration=0.05, parameters={"AA.E": E}, settings=COARSE, scheme="muscl")
    one = simulate(sheep, duration=0.05, parameters={"AA.E": E[1]}, settings=COARSE, scheme="muscl")
    assert max(relative_error(name, both.member(1)[name], one[name]) for name in one) <= 1e-11


def test_a_batch_of_equal_members_is_the_single_run(sheep: Network) -> None:
    """Each of three equal members: the run of one, to 1e-13 (the steps of a batch are those of its fastest member)."""
    E = sheep.segment("AA").E
    batch = simulate(sheep, duration=0.05, parameters={"AA.E": np.full(3, E)}, settings=COARSE, scheme="muscl")
    one = simulate(sheep, duration=0.05, settings=COARSE, scheme="muscl")
    assert max(relative_error(name, batch.member(i)[name], one[name]) for i in range(3) for name in one) <= 1e-13


@pytest.mark.slow
def test_beats_until_they_repeat() -> None:
    """Periodic beats, and a start where the last run ended, which takes two."""
    network = tube(artery(phi0=1e4), Reflection("A", 0.3))
    beat = simulate_periodic(network, settings=COARSE, scheme="muscl", tolerance=1e-4)
    again = simulate_periodic(network, settings=COARSE, scheme="muscl", tolerance=1e-4, start=beat)
    assert again.beats == 2
    expected = simulate_periodic(network)
    assert max(relative_error(name, again[name], expected[name]) for name in again) <= 3e-3


def test_periodic_start() -> None:
    """The default scheme's state near the periodic beat, on cells: two of its beats for a batch of two tubes with
    Windkessels that fill with a time constant of 3 s, a beat being 0.5 s."""
    network = replace(tube(artery(phi0=1e4), Windkessel("A", 2e7, 1e-8, 3e8)), P_0=1e3)
    options: dict[str, Any] = {"parameters": {"A.E": np.array([1e6, 9e5])}, "tolerance": 1e-2}
    beat = simulate_periodic(network, start="periodic", settings=COARSE, scheme="muscl", **options)
    assert beat.beats == 2
    expected = simulate_periodic(network, **options)
    assert max(relative_error(name, beat[name], expected[name]) for name in beat) <= 1e-2


def test_periodic_start_without_stored_pressures(sheep: Network) -> None:
    """Ends that only reflect: from there the first beat is the periodic one to 1 %, as in the default scheme."""
    run = simulate(sheep, start="periodic", settings=COARSE, scheme="muscl")
    expected = simulate_periodic(sheep)
    assert max(relative_error(name, run[name], expected[name]) for name in ("MD.P", "CA.P", "CA.Q")) <= 0.01


def test_pressure_inlet() -> None:
    """The pressure that a flow made drives the same flow, to 1e-3."""
    network = tube(artery(phi0=1e4), Reflection("A", 0.3))
    by_flow = simulate(network, lambda t: 5e-5 * np.sin(2.0 * np.pi * t / 0.5) ** 4, 0.2)
    driven = replace(network, inlet=replace(network.inlet, causality="pressure"))
    P = by_flow["inlet.P"]
    result = simulate(
        driven, lambda t: np.interp(t, by_flow.time, P), 0.2, settings=MusclSettings(cell=5e-3), scheme="muscl"
    )
    assert relative_error("inlet.Q", result["inlet.Q"], by_flow["inlet.Q"]) <= 1e-3


@pytest.mark.parametrize(
    ("terms", "name"),
    [
        ({"CA.K": 10.0}, "stenosis"),
        ({"CA.leak": 1e-10}, "side_branch"),
        ({"CA.tau": 0.01}, "stress_relaxation"),
        ({"fluid.unsteady_scale": 1.0}, "unsteady_friction"),
        ({"CA.phiNL": 10.0}, "nonlinear_wall_viscosity"),
    ],
)
def test_what_is_lacking_is_named(sheep: Network, terms: dict[str, float], name: str) -> None:
    """One sentence names the effect that this scheme does not have."""
    with pytest.raises(ValueError, match=f"scheme 'muscl' does not support the effect {name}"):
        simulate(sheep.with_terms(terms), scheme="muscl")


def test_refused(sheep: Network) -> None:
    """Unknown schemes, settings of another, and what the settings do not allow."""
    with pytest.raises(ValueError, match="scheme = 'fem': must be 'staggered' or 'muscl'"):
        simulate(sheep, scheme="fem")
    with pytest.raises(ValueError, match="takes MusclSettings, not Settings"):
        simulate(sheep, settings=Settings(), scheme="muscl")
    with pytest.raises(ValueError, match="cfl = 0.9 .* is not allowed"):
        MusclSettings(cfl=0.9)
    with pytest.raises(ValueError, match="ends = 'open' must be 'coupled' or 'neumann'"):
        MusclSettings(ends="open")
    with pytest.raises(ValueError, match="slopes = 'superbee' must be 'van Albada' or 'minmod' or 'monotonized"):
        MusclSettings(slopes="superbee")
    with pytest.raises(ValueError, match="use longer cells"):
        simulate(sheep, settings=MusclSettings(cell=1e-5), scheme="muscl")


def test_breakdown_is_located(sheep: Network) -> None:
    """Too much inflow ends with segment, place and time."""
    with pytest.raises(NonPhysicalState, match="segment AA at x = "):
        simulate(sheep, lambda t: 5e-3 + 0.0 * t, 0.1, settings=COARSE, scheme="muscl")


def test_command_line(tmp_path: Path) -> None:
    """--scheme muscl --cell --ends --slopes; others of these are refused, and --slopes of the default scheme."""
    app = Typer()
    app.command()(main)
    options = ["sheep", "--scheme", "muscl", "--cell", "2cm", "--duration", "10 ms", "--out", str(tmp_path / "out.csv")]
    assert CliRunner().invoke(app, options).exit_code == 0
    assert len((tmp_path / "out.csv").read_text().splitlines()) == 12
    assert CliRunner().invoke(app, [*options, "--slopes", "central", "--ends", "neumann"]).exit_code == 0
    for wrong in (["--ends", "open"], ["--slopes", "steep"], ["--scheme", "staggered", "--slopes", "central"]):
        assert CliRunner().invoke(app, [*options, *wrong]).exit_code != 0
