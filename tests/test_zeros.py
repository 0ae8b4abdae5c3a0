"""Zeros of sensors: known, from the network's file or the option, or found by a calibration.

Records of three vessels, at 40 dB; C.P reads 4 mmHg too much.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from forked import NETWORK, exact, record

from fitting.calibrate.calibration_prior import read_prior
from fitting.calibrate.network_calibration import calibrate
from fitting.calibrate.network_indices import network_indices
from fitting.inference.hypothesis import candidates
from fitting.inference.models.network_record import network_problem
from fitting.inference.unknown_text import parse_unknown
from fitting.records.alignment.beats import Beats
from fitting.records.channels.filters import with_filters
from fitting.records.channels.inflow import inflow
from fitting.results.parameter_set import read_set, write_set
from solver import beat_harmonics
from solver.laws.catalogue import zero_of
from solver.network.files import read_network, write_network
from solver.quantities.units import MMHG

SHOWN = ("A.P", "B.P", "C.P", "C.Q")
KNOWN = with_filters(NETWORK, ["C.P=zero 4 mmHg"])


def shifted(seed: int = 0) -> Beats:
    waves = exact(1.0, NETWORK)
    zero = {"C.P": 4.0 * MMHG}
    return record({n: waves[n] + zero.get(n, 0.0) for n in ("inlet.Q", *SHOWN)}, 15, 0.01, seed)


def test_a_calibration_finds_a_zero_beside_a_wall() -> None:
    """4 mmHg and E of one wall within their 95 % intervals, at the noise; without it the means are missed by 4 mmHg."""
    beats = shifted(3)
    found = calibrate(beats, NETWORK, ["B.E", "C.P.zero"], channels=SHOWN)
    zero, (low, high) = found.zeros["C.P.zero"]
    assert low < 4.0 * MMHG < high and high - low < 0.1 * MMHG
    assert found.ci95["B.E"][0] < NETWORK.segment("B").E < found.ci95["B.E"][1]
    assert found.chi2 < 1.3 * found.dof and set(found.values) == {"B.E"}
    assert any(f"the zero of C.P is {zero / MMHG:.3g} mmHg" in text for text in found.report)
    blind = calibrate(beats, NETWORK, ["B.E"], channels=SHOWN)
    assert blind.rms["C.P"] > 3.0 * MMHG and blind.chi2 > 1e4 * blind.dof


def test_a_zero_may_be_all_that_is_free() -> None:
    """The same zero with nothing else; the indices of the arteries do not depend on it."""
    found = calibrate(shifted(3), NETWORK, ["C.P.zero"], channels=SHOWN)
    assert found.zeros["C.P.zero"][0] == pytest.approx(4.0 * MMHG, abs=0.05 * MMHG)
    without = dataclasses.replace(found, x=0.0 * found.x)
    indices, others = (network_indices(each, NETWORK, shifted(3))["C"] for each in (found, without))
    assert {n: e.value for n, e in indices.items()} == {n: e.value for n, e in others.items()}


def test_a_set_with_a_zero_is_a_set_of_the_fmu(tmp_path: Path) -> None:
    """The FMU has no sensors: values are its parameters alone, the zero stands in the provenance, and a prior of it is
    read."""
    found = calibrate(shifted(3), NETWORK, ["B.E", "C.P.zero"], channels=SHOWN)
    write_set(found.parameter_set(), tmp_path / "set.json")
    again = read_set(tmp_path / "set.json")
    assert set(again.start_values()) - set(again.texts) == {"B.E"}
    assert again.provenance["zeros"]["C.P.zero"]["value"] == pytest.approx(found.zeros["C.P.zero"][0])
    assert set(again.provenance["unknowns"]) == {"B.E"}
    assert read_prior(tmp_path / "set.json", NETWORK).network.segment("B").E == found.values["B.E"]


def test_a_known_zero_explains_the_record(tmp_path: Path) -> None:
    """By the network's file, which keeps it: χ² of the true model within 95 % of chance; no search has it."""
    write_network(KNOWN, tmp_path / "fork.toml")
    network = read_network(tmp_path / "fork.toml")
    assert network.channels == KNOWN.channels
    (fit,) = network_problem(shifted(), network, SHOWN).refit([()])
    assert fit is not None
    assert fit.chi2 < len(fit.z) + 2.0 * np.sqrt(2.0 * len(fit.z))
    assert "known_zero" not in {term.effect for term in candidates(network, ("inlet.Q", *SHOWN))}


def test_a_zero_beside_a_known_one_is_the_whole() -> None:
    """3 mmHg known, and freed: 4 in all."""
    network = with_filters(NETWORK, ["C.P=zero 3 mmHg"])
    found = calibrate(shifted(3), network, ["B.E", "C.P.zero"], channels=SHOWN)
    assert found.zeros["C.P.zero"][0] == pytest.approx(4.0 * MMHG, abs=0.05 * MMHG)


def test_a_flow_meter_with_a_zero() -> None:
    """What drives a model is less than what the meter shows, by its zero; the rest is bit for bit the same."""
    beats, network = shifted(), with_filters(NETWORK, ["inlet.Q=zero 2 mL/s"])
    shown, true = inflow(beats, 1e-3, NETWORK), inflow(beats, 1e-3, network)
    assert true.X[0] == shown.X[0] - 2e-6
    assert (true.X[1:] == shown.X[1:]).all()


def test_a_zero_is_not_in_the_simulation() -> None:
    """A network with a known zero has the beats of one without, bit for bit."""
    assert (beat_harmonics(KNOWN, ("C.P",), 8) == beat_harmonics(NETWORK, ("C.P",), 8)).all()


def test_the_sentence_of_a_zero_is_a_command() -> None:
    """What a calibration says to make a zero known does, below 0, too; of one that the data do not determine it says
    nothing; and a known zero of 0 is none."""
    waves = exact(1.0, NETWORK)
    beats = record({n: waves[n] - (4.0 * MMHG if n == "C.P" else 0.0) for n in ("inlet.Q", *SHOWN)}, 15, 0.01, 3)
    found = calibrate(beats, NETWORK, ["B.E", "C.P.zero:5 mmHg", "A.R.zero"], channels=SHOWN)
    (said,) = (text for text in found.report if "--filter" in text)
    (option,) = re.findall('--filter "(.*?)"', said)
    known = with_filters(NETWORK, [option])
    assert zero_of(known, "C.P") == pytest.approx(found.zeros["C.P.zero"][0], rel=1e-3)
    assert found.zeros["C.P.zero"][0] == pytest.approx(-4.0 * MMHG, abs=0.1 * MMHG)
    assert zero_of(with_filters(NETWORK, ["C.P=zero 0 mmHg"]), "C.P") == 0.0


def test_priors_of_zeros_have_units(tmp_path: Path) -> None:
    """5 mmHg is 667 Pa; the hint of a wrong one has a unit. A set of zeros alone is no prior; the sentence says so."""
    assert parse_unknown("C.P.zero:5 mmHg", NETWORK).prior_sd == pytest.approx(5.0 * MMHG)
    with pytest.raises(ValueError, match=r'prior \'5 s\' must be .*, as in "C.P.zero:700 Pa"'):
        parse_unknown("C.P.zero:5 s", NETWORK)
    write_set(calibrate(shifted(3), NETWORK, ["C.P.zero"], channels=SHOWN).parameter_set(), tmp_path / "set.json")
    with pytest.raises(ValueError, match="only zeros of sensors were calibrated; make these known by --filter"):
        read_prior(tmp_path / "set.json", NETWORK)


def test_a_zero_does_not_vary() -> None:
    with pytest.raises(ValueError, match="all recordings have a sensor's zero in common"):
        calibrate([shifted(), shifted(1)], NETWORK, ["B.E", "C.P.zero"], varies=["C.P.zero"], channels=SHOWN)
