"""Three real recordings that come along, and what a calibration says of them: mmHg, and numbers not determined."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from forked import CHANNELS, NETWORK, SETTINGS, exact, record

from arterial_fmu.cli.tables.fits import calibration_table
from fitting.calibrate.network_calibration import calibrate
from fitting.first.model import first_model
from fitting.records.alignment.align import align
from fitting.records.read.columns import Reading
from fitting.records.read.record import read_record
from fitting.records.recordings import changes, sizes
from solver.quantities.legible import NOT_DETERMINED, endless
from solver.quantities.units import MMHG

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "data" / "mock-loop"
FILES = sorted(FOLDER.glob("*.csv"))
COLUMNS = {"1": "time [s]", "2": "inlet.Q [mL/s]", "3": "Ao.P [mmHg]", "4": "Pe.P [mmHg]"}


def test_where_they_are_from() -> None:
    """Three files, each named with the mean flow [mL/s] of its whole beats of 0.8 s, beside source and licence."""
    said = " ".join((FOLDER / "SOURCE.md").read_text(encoding="utf-8").split())
    for words in ("U.S. Food and Drug Administration", "RST24CV01.01", "CC0 1.0", "10 Hz", "55 Hz", "0.1 mmHg"):
        assert words in said
    flows = dict(re.findall(r"`(NV_step\d+_COresolution.csv)` \| (\d+) \|", said))
    assert set(flows) == {path.name for path in FILES} and len(flows) == 3
    for path in FILES:
        time, Q, *_ = np.loadtxt(path, delimiter=",").T
        assert (len(time), time[0], time[-1]) == (10000, 0.0, 9.999)
        assert Q[:9600].mean() == pytest.approx(float(flows[path.name]), abs=0.5)


@pytest.mark.parametrize(
    "path", [FILES[0], *(pytest.param(path, marks=pytest.mark.slow) for path in FILES[1:])], ids=lambda path: path.stem
)
def test_they_open_and_have_a_first_model(path: Path) -> None:
    """75 beats a minute to 0.1 %; the model has the mean at the root to 0.2 % and its pulse to 7.2 %. The second
    pressure rings: in two files a side branch rings, too, and leaves 2.4 and 2.6 mmHg, in one the tube leaves 4.2."""
    beats = align(read_record(path, Reading(names=COLUMNS)))
    assert beats.T == pytest.approx(0.8, rel=1e-3) and beats.n_beats >= 11
    root, other = first_model(beats).shown
    assert root.mean[1] == pytest.approx(root.mean[0], rel=2.5e-3)
    assert root.pulse[1] == pytest.approx(root.pulse[0], rel=0.08)
    assert 2.0 < other.rms / MMHG < 4.5


def test_what_is_left_is_said_in_mmHg() -> None:
    """The size of a residual: that of the simulated beat less the measured one, here of a pressure 3 mmHg too high."""
    waves = exact()
    name = next(each for each in CHANNELS if each.endswith(".P"))
    shifted = {**waves, name: waves[name] + 3.0 * MMHG}
    # the modulus barely moves what the other channels show, and they are as sure
    found = calibrate(record(shifted, 10, 0.01), NETWORK, ["all.E:1e-6"], settings=SETTINGS)
    assert found.rms[name] == pytest.approx(3.0 * MMHG, rel=0.05)
    (said,) = (text for text in found.report if "rms residual" in text)
    assert re.search(rf"rms residual: .*{number_of(found.rms[name])} mmHg of {re.escape(name)}", said)
    assert found.parameter_set().provenance["rms"][name] == {"value": found.rms[name], "unit": "Pa"}


def number_of(rms: float) -> str:
    return sizes({"A.P": rms}).partition(" ")[0]


def test_a_number_that_is_not_determined_is_said_to_be_none() -> None:
    """A prior's interval is not the data's: the value stands with three digits."""
    found = calibrate(record(exact(), 10, 0.01), NETWORK, ["all.E", "A.phiNL:1e-9"], settings=SETTINGS)
    assert found.undetermined == {"A.phiNL"}
    table = calibration_table(found)
    names, values, ends, _ = ([*column.cells] for column in table.columns)
    assert ends[names.index("A.phiNL")] == NOT_DETERMINED
    assert "…" in str(ends[names.index("A.E")]) and values[names.index("A.E")] != "0"


@pytest.mark.parametrize(
    ("value", "ends", "expected"),
    [
        (40.0, (1e-4, 7.5e6), True),  # was printed as 0, "0 … 7500000"
        (0.24, (0.0027, 20.5), True),
        (7.5, (2.7, 20.5), False),
        (0.0, (-3.0, 3.0), False),  # a shift, which is near 0
        (1.0, None, False),
    ],
)
def test_intervals_that_say_nothing(value: float, ends: tuple[float, float] | None, expected: bool) -> None:
    assert endless(value, ends) == expected


def test_sizes_of_channels() -> None:
    """By the unit of the channel, to two digits; the loudest four of many."""
    assert sizes({"Ao.P": 173.3, "CA.Q": 2.13e-6}) == "1.3 mmHg of Ao.P, 2.1 mL/s of CA.Q"
    assert changes({"Ao.P": 173.3}, {"Ao.P": 66.7}) == "Ao.P from 1.3 to 0.5 mmHg"
    assert changes({"Ao.P": 173.3}, {"Ao.P": 173.2}) == "Ao.P still 1.3 mmHg"
    many = {f"S{i}.P": 133.322 for i in range(6)}
    assert sizes(many, {name: float(i) for i, name in enumerate(many)}).endswith("1 mmHg of S5.P and 2 more")
