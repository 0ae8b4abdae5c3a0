"""Numbers with a unit on the pages of check, fit and discover: each as it is by hand, not only against one another."""

from __future__ import annotations

import numpy as np
import pytest

from arterial_fmu.cli.tables.fits import SHOWN
from discrepancy.findings.outcome import ChannelBeats
from discrepancy.report.tables import estimate_text, pulse_text
from fitting.check.agreement import Agreement, LoopArea
from fitting.pages.check_page import _loop_row, _row
from fitting.results.estimate import Estimate
from fitting.wall.indices import OF_LAW, read_in

MMHG = 101325.0 / 760.0  # Pa


@pytest.mark.parametrize(
    ("channel", "pulse", "unit", "shown"),
    [("CA.P", 40.0 * MMHG, "mmHg", "40"), ("CA.Q", 5e-6, "mL/s", "5"), ("CA.R", 0.12e-3, "mm", "0.12")],
)
def test_channels(channel: str, pulse: float, unit: str, shown: str) -> None:
    """A pulse of 40 mmHg, 5 mL/s or 0.12 mm, and errors of a quarter of it, on the pages of check and discover."""
    quarter = pulse / 4.0
    row = _row(Agreement(channel, "", quarter, 0.01, 0.25, quarter, pulse, quarter))
    assert (row["unit"], row["pulse"], row["pulse_error"], row["largest"]) == (unit, shown, "+25", "25")
    assert float(row["rmse"]) == float(row["mean_error"]) == pytest.approx(float(shown) / 4.0, rel=0.05)
    beat = np.array([0.0, pulse, 0.0])
    there = ChannelBeats(channel, beat, beat, beat, None, (1.0, 1.0), None)
    assert pulse_text(there) == f"{shown} {unit}"


def test_energy_lost() -> None:
    """25.6 mJ/m is 0.0256 J/m."""
    row = _loop_row(LoopArea("CA", 0.0256, 0.0128))
    assert (row["measured"], row["simulated"], row["change"]) == ("25.6", "12.8", "−50")


def test_walls_and_indices() -> None:
    """The columns of a fit, and what a physiologist reads: each label with the factor of its unit."""
    assert {label: 1.0 / factor for label, factor in SHOWN.values()} == pytest.approx(
        {"E, MPa": 1e6, "R0, mm": 1e-3, "φ0, kPa·s": 1e3, "φNL, kPa·s²": 1e3, "ENL, MPa": 1e6}
    )
    by_hand = {
        "E_inc": ("MPa", 1e6),
        "distensibility": ("10⁻³/mmHg", 1e-3 / MMHG),
        "compliance": ("mm²/mmHg", 1e-6 / MMHG),
        "wave_velocity": ("m/s", 1.0),
        "loss": ("mJ/m", 1e-3),
        "loss_ratio": ("", 1.0),
        "relaxation_time": ("ms", 1e-3),
    }
    for name, SI in OF_LAW:
        unit, factor = read_in(SI)
        assert (unit, 1.0 / factor) == (by_hand[name][0], pytest.approx(by_hand[name][1], rel=1e-6)), name


@pytest.mark.parametrize(
    ("name", "value", "SI", "shown"),
    [
        ("CA.phi0", 25e3, "Pa.s", "25.00 kPa·s"),
        ("CA.outlet.R2", 0.9e6 * MMHG, "Pa.s/m^3", "0.9000 mmHg·s/mL"),
        ("CA.outlet.C", 1.3e-6 / MMHG, "m^3/Pa", "1.300 mL/mmHg"),
        ("CA.tau", 24e-3, "s", "24.00 ms"),
        ("CA.R0", 9.48e-3, "m", "9.480 mm"),
    ],
)
def test_parameters_of_effects(name: str, value: float, SI: str, shown: str) -> None:
    """The value in the unit that people read, to the digits of an interval of ± 1 %."""
    assert estimate_text(name, Estimate(value, SI, (0.99 * value, 1.01 * value)))[0] == shown
