"""Record files that are refused, each in one sentence, and what is written."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from record_files import DT, P_MMHG, R_MM, TIME, WAVE, N, T, bench, refusal, save, text

from fitting.records.alignment.align import align
from fitting.records.read.record import Record, read_record, write_record

MMHG = 101325.0 / 760.0  # conventional to 1e-7: 133.322387415 in pint


def test_missing_file_and_directory(tmp_path: Path) -> None:
    """One sentence each."""
    with pytest.raises(ValueError, match=r"nowhere\.csv: cannot be read \(No such file"):
        read_record(tmp_path / "nowhere.csv")
    with pytest.raises(ValueError, match="not a regular file"):
        read_record(tmp_path)


def lines_with(line: int, cells: str) -> str:
    """The bench record with one line, counted from 1 as editors do, replaced."""
    lines = text(bench()).splitlines()
    lines[line - 1] = cells
    return "\n".join(lines)


def test_times_printed_with_significant_digits(tmp_path: Path) -> None:
    """60 Hz with %.6g, as numpy and others print: steps of 0.0166667 become 0.01667 after 10 s; dt to 1e-6.

    With one sample lost the same file has a gap there.
    """
    time = np.arange(1200) / 60.0
    rows = [f"{t:.6g},{85.0 + 10.0 * np.sin(7.0 * t):.4f}" for t in time]
    found = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *rows])))
    assert found.dt == pytest.approx(1 / 60, rel=1e-6)
    del rows[700]
    found = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *rows])))
    assert np.flatnonzero(np.isnan(found.channels["AA.P"])).tolist() == [700]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "the file is empty"),
        ("time [s],AA.P [mmHg]\n", "line 2: there are no samples below the header"),
        ("time [s],AA.P [mmHg]", "line 2: there are no samples below the header"),
        ("time [s],AA.P [mmHg]\n0,1\n1,2\n", "2 samples are too few"),
        ("time [s]\n0\n1\n", "line 1: there is no channel beside the time"),
        ("time [s],AA.P [µ]\n".encode("latin-1"), "line 2: there are no samples below the header"),
        (
            b"PK\x03\x04\x14\x00\xff\xfe",
            "an FMU or another archive, which is not read; give the recording, such as a CSV file.",
        ),
        ("time [s];AA.P [mmHg]\n0,0;1,5\n", "1 samples are too few"),
        ("time [s]\tAA.P [mmHg]\n0\t1\n", "1 samples are too few"),
        (
            "0,1\n1,2\n",
            'it has no header, and its first row is 0, 1; say which column is which, such as --map "1=time [s]"',
        ),
        (
            "AA.P [mmHg],AA.R [mm]\n0,1\n1,2\n",
            'no column is a time, and every sample needs one; add a column "time [s]", say',
        ),
        ("AA.P [mmHg],n\n0,1\n1,2\n", 'counts the samples, give the time between them: --map "n=time [1 ms]"'),
        ("AA.P [mmHg],n,clock [ms]\n0,1,3\n1,1,4\n", 'if it is this one, say so: --map "clock [ms]=time".'),
        (
            "AA.P [mmHg],X\n0,1\n1,3\n",
            "line 1, column 'X': no column is named time; if it is this one, say so: --map \"X=time",
        ),
        ("time,AA.P [Pa]\n0,1\n", "column 'time': it has no unit; say which: --map \"time=time [s]\", or write it"),
        ("time [s],AA.P\n0,1\n", "column 'AA.P': it has no unit; say which: --map \"AA.P=AA.P [mmHg]\", or write it"),
        ("time [s],inlet.Q []\n0,1\n", 'it has no unit; say which: --map "inlet.Q []=inlet.Q [mL/s]"'),
        ("time [s],AA.X [mm]\n0,1\n", "line 1, column 'AA.X [mm]': no such channel; allowed are <site>.P"),
        ("time [s],P [Pa]\n0,1\n", "line 1, column 'P [Pa]': no such channel"),
        ("time [s],AA.P [kPa],AA.P [Pa]\n0,1,1\n", "line 1, column 'AA.P [Pa]': a name twice"),
        ("time [s],AA.D [m],AA.D [m]\n0,1,1\n", "line 1, column 'AA.D [m]': a name twice"),
        ("time [s],AA.R [m],AA.D [m]\n0,1,1\n", "line 1, column 'AA.D [m]': R and D of one site"),
        ("time [s],AA.P [mmHgg]\n0,1\n", "column 'AA.P [mmHgg]': the unit mmHgg is not known or of another kind"),
        ("time [s],AA.P [kg]\n0,1\n", "the unit kg is not known or of another kind and does not fit a pressure"),
        (
            "time [s],AA.P [mm]\n0,1\n",
            "the unit mm is that of a radius and does not fit a pressure; write a unit of pre",
        ),
        ("time [s],AA.P [mm],AA.R [mm]\n0,1,1\n", "the unit mm is that of a radius and does not fit a pressure; write"),
        ("time [s],AA.P [mm],AA.R [kPa]\n0,1,1\n", "P and R of the site seem swapped"),
        ("time [s],AA.P [mm],AA.D [kPa]\n0,1,1\n", "P and R of the site seem swapped"),
        (
            "time [m],AA.P [Pa]\n0,1\n",
            "line 1, column 'time [m]': the unit m is that of a radius and does not fit a time",
        ),
        ('time [s],"AA.P\n0,1\n', "line 1: not a CSV header"),
        (lines_with(7, "0.025,85.0,x9.1"), "line 7, column 'AA.R [mm]': 'x9.1' is not a number; write a number"),
        (
            lines_with(7, '0.025,"85,5",9.1'),
            "line 7, column 'AA.P [mmHg]': '85,5' is not a number; the decimal mark is",
        ),
        (lines_with(7, "0.025,85.0"), "line 7: 2 fields where the header has 3"),
        (lines_with(N + 1, "4.995,85.0"), f"line {N + 1}: 2 fields where the header has 3"),
        (lines_with(2, "0,85.0"), "line 2: 2 fields where the header has 3"),
        (lines_with(7, "0.025,85.0,9.1,"), "line 7: 4 fields where the header has 3"),
        (lines_with(7, '0.025,"85.0,9.1'), "not CSV (unexpected end of data)"),
        (lines_with(7, "0.025,inf,9.1"), "line 7, column 'AA.P [mmHg]': the value is infinite"),
        (lines_with(7, "0.025,1e999,9.1"), "line 7, column 'AA.P [mmHg]': the value is infinite"),
        (lines_with(7, ",85.0,9.1"), "line 7, column 'time [s]': the time is missing or not finite"),
        (lines_with(7, "NaN,85.0,9.1"), "line 7, column 'time [s]': the time is missing or not finite"),
        (lines_with(7, "0.020,85.0,9.1"), "line 7, column 'time [s]': the time does not increase (0.02 to 0.02)"),
        (
            lines_with(7, "0.025,8500,9.1"),
            "column 'AA.P [mmHg]': a pressure of 8500 mmHg is outside -750.1 to 7501 mmHg",
        ),
        (
            lines_with(7, "0.025,85,-9.1"),
            "a radius of -9.1 mm is outside 0.01 to 200 mm, where those of all arteries lie",
        ),
        (lines_with(7, "0.025,85,0.001"), "line 7, column 'AA.R [mm]': a radius of 0.001 mm is outside 0.01 to 200 mm"),
    ],
)
def test_bad_files(tmp_path: Path, content: str | bytes, expected: str) -> None:
    """One sentence with file, and line and column where there is one."""
    assert expected in refusal(tmp_path, content)


def test_stamps_without_a_rate(tmp_path: Path) -> None:
    """Steps drawn from an exponential, and 2000 lost samples of 3000, none of them beside a block: one sentence each,
    with what is allowed."""
    rng = np.random.default_rng(1)
    said = refusal(tmp_path, text(bench(time=np.cumsum(rng.exponential(DT, N)))))
    assert "the sampling is not uniform: " in said and "such as " in said and "and 10% can be resampled" in said
    said = refusal(tmp_path, text(bench(time=TIME + 500 * DT * np.minimum(np.arange(N) // 200, 4))))
    assert "line 802, column 'time [s]': 2000 samples are missing and 1000 are there" in said
    assert "read the part on one side of the pause with --part" in said


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"R": np.full(N, 9.0)}, "column 'AA.R [mm]': the channel is constant (9 mm), it does not pulsate"),
        ({"R": np.where(TIME < 1, np.nan, 9.0)}, "column 'AA.R [mm]': the channel is constant (9 mm)"),
        ({"R": np.full(N, np.nan)}, "column 'AA.R [mm]': it holds gaps only"),
        ({"P": np.minimum(P_MMHG, 97.0)}, "column 'AA.P [mmHg]': the channel is clipped: it rests at its highest val"),
        ({"P": np.maximum(P_MMHG, 72.0)}, "column 'AA.P [mmHg]': the channel is clipped: it rests at its lowest valu"),
        (
            {"P": P_MMHG * MMHG},
            "line 2, column 'AA.P [mmHg]': a pressure of 1.184e+04 mmHg is outside -750.1 to 7501 mmHg, where",
        ),
        ({"R": R_MM * 1e-3}, "check the unit, or leave the field empty where the sensor failed"),
        ({"P": R_MM, "R": P_MMHG}, "P and R of AA seem swapped"),
        ({"P": R_MM * 1e-3 / MMHG, "R": P_MMHG * MMHG}, "P and R of AA seem swapped"),
    ],
    ids=[
        "dead",
        "dead after a gap",
        "gaps",
        "clipped high",
        "clipped low",
        "unit of P",
        "unit of R",
        "swapped",
        "swapped SI",
    ],
)
def test_channels_that_cannot_be_used(tmp_path: Path, change: dict[str, np.ndarray], expected: str) -> None:
    """Dead, empty, clipped, in a wrong unit, swapped: one sentence that says which."""
    assert expected in refusal(tmp_path, text(bench(**change), 12))


@pytest.mark.parametrize("rate", [50, 200, 1000])
@pytest.mark.parametrize("bits", [5, 8, 12, 16])
@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
def test_rounding_and_noise_are_not_clipping(tmp_path: Path, rate: int, bits: int, noise: float) -> None:
    """A smooth pulse of 1 s, digitised over its range, with noise in quanta: plateaus of up to 200 samples."""
    rng = np.random.default_rng(bits)
    time = np.arange(5 * rate) / rate
    quanta = 2.0**bits * (np.sin(2 * np.pi * time) + 0.3 * np.sin(4 * np.pi * time + 1.0) + 1.5) / 3.0
    P = 70.0 + 40.0 * np.round(quanta + noise * rng.standard_normal(len(time))) / 2.0**bits
    record = read_record(save(tmp_path, text({"time [s]": time, "AA.P [mmHg]": P})))
    assert list(record.channels) == ["AA.P"]


@pytest.mark.parametrize("bits", [10, 16, 40])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_clipping_is_found_in_digitised_and_noisy_signals(tmp_path: Path, bits: int, noise: float) -> None:
    """The same pulse, saturated at 90 % of its range."""
    pulse = (WAVE - WAVE.min()) / np.ptp(WAVE) + noise * np.random.default_rng(bits).standard_normal(N)
    P = 70.0 + 40.0 * np.round(np.minimum(pulse, 0.9) * 2.0**bits) / 2.0**bits
    assert "the channel is clipped: it rests at its highest value, 106" in refusal(tmp_path, text(bench(P=P)))


def test_a_sensor_that_is_saturated_for_a_while(tmp_path: Path) -> None:
    """A flush of 0.2 s at 300 mmHg in 15 s: a gap with 0.3 s on either side, and said."""
    time = np.arange(3000) * DT
    P = np.interp(time % 4.5, TIME, P_MMHG)
    P[1000:1040] = 300.0
    record = read_record(save(tmp_path, text({"time [s]": time, "AA.P [mmHg]": P})))
    assert np.flatnonzero(np.isnan(record.channels["AA.P"])).tolist() == list(range(940, 1100))
    assert "was saturated for a while, it rests at its highest value, 300 mmHg" in record.said[0]


@pytest.mark.parametrize("flow", [0.0, 2.5])
def test_a_flow_that_does_not_pulsate_is_no_channel(tmp_path: Path, flow: float) -> None:
    """Q = 0 or 2.5 mL/s with a gap, as at a closed outlet: the record is read without it, its beats too."""
    constant = np.where((TIME > 1) & (TIME < 1.1), np.nan, flow)
    record = read_record(save(tmp_path, text(bench() | {"CA.outlet.Q [mL/s]": constant})))
    assert list(record.channels) == ["AA.P", "AA.R"]
    assert record.resting == {"CA.outlet.Q": pytest.approx(flow * 1e-6, rel=1e-14)}
    beats = align(record)
    assert beats.T == pytest.approx(T, rel=1e-9) and list(beats.values) == ["AA.P", "AA.R"]
    with pytest.raises(ValueError, match=r"CA\.outlet\.Q is constant \(.* m\^3/s\), it does not pulsate; leave it out"):
        record.require(["AA.P", "CA.outlet.Q"])


@pytest.mark.parametrize(
    "columns",
    [
        {"time [s]": TIME, "AA.P [mmHg]": P_MMHG, "inlet.Q [mL/s]": 0.0 * TIME},
        {"time [s]": TIME, "CA.Q [m^3/s]": 0.0 * TIME},
    ],
    ids=["inflow", "nothing else"],
)
def test_flows_that_must_pulsate(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    """The inflow, which drives a network, and the only channel of a record: refused if constant."""
    assert "the channel is constant (0 mL/s), it does not pulsate" in refusal(tmp_path, text(columns))


def test_a_flow_may_rest_at_zero(tmp_path: Path) -> None:
    """Half of every beat at 0, a closed valve: no clipped sensor."""
    columns = {"time [s]": TIME, "inlet.Q [mL/s]": 55.0 * np.maximum(0.0, np.sin(2 * np.pi * TIME / T))}
    assert read_record(save(tmp_path, text(columns))).channels["inlet.Q"].min() == 0.0


def test_what_is_asked_for_and_missing_is_listed() -> None:
    """A missing P or R, in a sentence with what is there."""
    record = Record("bench.csv", "", TIME, {"AA.P": P_MMHG, "BT.R": R_MM})
    with pytest.raises(ValueError, match=r"^bench\.csv: the channel AA\.R is missing; it holds AA\.P, BT\.R: "):
        record.require(["AA.P", "AA.R"])
    with pytest.raises(ValueError, match=r"the channel BT\.P is missing"):
        record.require(["BT.P", "BT.R"])
    with pytest.raises(ValueError, match=r"the channels BT\.P and CA\.R are missing; .*: record them or ask"):
        record.require(["BT.P", "CA.R"])


# --- writing ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channels", "units", "expected"),
    [
        ({"AA.X": R_MM}, {}, "no such channel"),
        ({"AA.P": P_MMHG}, {"AA.P": "mm"}, "the unit mm is that of a radius"),
        ({"AA.P": P_MMHG}, {"AA.R": "mm"}, "a unit is given for AA.R, which is not written"),
        ({"AA.P": P_MMHG[:-1]}, {}, "must be 1000 numbers, one per time, finite or NaN; it has the shape (999,)"),
        ({"AA.P": np.where(TIME > 1, np.inf, P_MMHG)}, {}, "must be 1000 numbers, one per time, finite or NaN"),
        ({}, {}, "there is no channel"),
    ],
)
def test_nothing_is_written_for_bad_arguments(
    tmp_path: Path, channels: dict[str, np.ndarray], units: dict[str, str], expected: str
) -> None:
    """A bad name, unit or shape, an infinite value, no channel: one sentence and no file."""
    path = tmp_path / "record.csv"
    with pytest.raises(ValueError, match=re.escape(expected)):
        write_record(path, TIME, channels, units)
    assert not list(tmp_path.iterdir())
