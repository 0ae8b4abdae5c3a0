"""Record files: SI and exact round trips, and one clear sentence for every file or channel that cannot be used."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fitting.records.beats import align
from fitting.records.record import Record, read_record, write_record

T, DT, N = 0.5, 0.005, 1000
TIME = np.arange(N) * DT
WAVE = np.sin(2 * np.pi * TIME / T) + 0.3 * np.sin(4 * np.pi * TIME / T + 1.0)
MMHG = 101325.0 / 760.0  # conventional to 1e-7: 133.322387415 in pint
P_MMHG = 85.0 + 15.0 * WAVE
R_MM = 9.0 + 0.3 * WAVE


def text(columns: dict[str, np.ndarray], decimals: int = 9) -> str:
    """CSV of the columns, NaN as an empty field."""
    table = np.column_stack(list(columns.values()))
    rows = [",".join("" if np.isnan(v) else f"{v:.{decimals}f}" for v in row) for row in table]
    return "\n".join([",".join(columns), *rows]) + "\n"


def bench(**changes: np.ndarray) -> dict[str, np.ndarray]:
    """A bench record of AA; the keys P and R are its columns."""
    columns = {"time [s]": TIME, "AA.P [mmHg]": P_MMHG, "AA.R [mm]": R_MM}
    names = {"time": "time [s]", "P": "AA.P [mmHg]", "R": "AA.R [mm]"}
    return columns | {names[key]: value for key, value in changes.items()}


def save(folder: Path, content: str | bytes) -> Path:
    path = folder / "record.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# --- what is read -------------------------------------------------------------------------------------------------


def test_values_come_in_si_with_hash_and_time_step(tmp_path: Path) -> None:
    """mmHg and mm with nine decimals: Pa to 2e-11, m to 1e-10; times to rounding; the SHA-256 of the bytes."""
    path = save(tmp_path, text(bench()))
    record = read_record(path)
    assert record.path == str(path) and record.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert record.dt == pytest.approx(DT, rel=1e-14)
    np.testing.assert_allclose(record.time, TIME, atol=2e-15)
    np.testing.assert_allclose(record.channels["AA.P"], P_MMHG * 133.322387415, rtol=2e-11)  # nine decimals
    np.testing.assert_allclose(record.channels["AA.R"], R_MM * 1e-3, rtol=1e-10)


def test_a_diameter_is_halved_and_a_missing_unit_is_si(tmp_path: Path) -> None:
    """D in cm gives R in m under the name R; `AA.P` and `inlet.Q []` are in Pa and m³/s; 1e-13."""
    columns = {"time": TIME, "AA.P": 11e3 + 2e3 * WAVE, "AA.D [cm]": 1.8 + 0.06 * WAVE, "inlet.Q []": 1e-5 * WAVE}
    record = read_record(save(tmp_path, text(columns, 15)))
    assert list(record.channels) == ["AA.P", "AA.R", "inlet.Q"]
    np.testing.assert_allclose(record.channels["AA.R"], 9e-3 + 3e-4 * WAVE, rtol=1e-13)
    np.testing.assert_allclose(record.channels["inlet.Q"], 1e-5 * WAVE, atol=1e-15)


def test_time_in_milliseconds(tmp_path: Path) -> None:
    """dt in s to rounding."""
    columns = {"time [ms]": 1e3 * TIME, **{k: v for k, v in bench().items() if k != "time [s]"}}
    assert read_record(save(tmp_path, text(columns))).dt == pytest.approx(DT, rel=1e-14)


@pytest.mark.parametrize(
    "change",
    [
        lambda s: "\ufeff" + s,
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace("\n", "\r"),
        lambda s: s + "\n\n",
        lambda s: s.rstrip("\n"),
        lambda s: s.replace("time [s],AA.P [mmHg],", ' time[s] , "AA.P  [ mmHg ]",'),
        lambda s: re.sub(r"(?m)^([0-9.]+),", r'"\1", ', s),
        lambda s: s.replace(",", " ,  ").replace("\n", " \n"),
    ],
    ids=["BOM", "CRLF", "CR", "blank lines at the end", "no newline at the end", "header", "quotes", "spaces"],
)
def test_spellings_of_csv_that_make_no_difference(tmp_path: Path, change: Callable[[str], str]) -> None:
    """Bit for bit the values of the plain file."""
    plain = read_record(save(tmp_path, text(bench())))
    other = read_record(save(tmp_path, change(text(bench()))))
    assert list(plain.channels) == list(other.channels)
    for name, values in plain.channels.items():
        np.testing.assert_array_equal(values, other.channels[name])


@pytest.mark.parametrize("gap", ["", "NaN", "nan"])
@pytest.mark.parametrize("quoted", [False, True])
def test_gaps(tmp_path: Path, gap: str, quoted: bool) -> None:
    """Empty fields and NaN, on the fast and on the slow path: NaN in their places, the last sample included."""
    lines = text(bench()).splitlines()
    for i in (3, 4, N):
        time, P, _ = lines[i].split(",")
        lines[i] = f"{time},{P},{gap}" + (" " if quoted else "")  # a space sends it through the slow path
    R = read_record(save(tmp_path, "\n".join(lines))).channels["AA.R"]
    assert np.flatnonzero(np.isnan(R)).tolist() == [2, 3, N - 1]


@pytest.mark.parametrize("decimals", [3, 4, 6])
def test_printed_time_may_be_rounded(tmp_path: Path, decimals: int) -> None:
    """300 Hz: dt to twice what rounding does to the slope of a line through N points."""
    dt = 1.0 / 300.0  # at three decimals, steps of 3 and 4 ms
    lines = ["time [s],AA.P [mmHg]", *(f"{i * dt:.{decimals}f},{p:.6f}" for i, p in enumerate(P_MMHG))]
    record = read_record(save(tmp_path, "\n".join(lines)))
    assert record.dt == pytest.approx(dt, rel=10.0**-decimals / dt / N**1.5 * 2)  # slope of a line through N points


@pytest.mark.parametrize("shortest", [False, True], ids=["all digits", "shortest"])
def test_time_in_single_precision(tmp_path: Path, shortest: bool) -> None:
    """Steps of 5 ms at 700 s, in units of 61 µs, printed exactly or as NumPy does: dt to 1e-6, no lost sample."""
    time = (700.0 + TIME).astype(np.float32)
    lines = [f"{t if shortest else float(t)!s},{p:.6f}" for t, p in zip(time, P_MMHG, strict=True)]
    header = "time [s],AA.P [mmHg]"
    assert read_record(save(tmp_path, "\n".join([header, *lines]))).dt == pytest.approx(DT, rel=1e-6)
    del lines[400]
    assert "line 402, column 'time [s]': the sampling is not uniform: a step of 0.0" in refusal(
        tmp_path, "\n".join([header, *lines])
    )


@pytest.mark.parametrize("lost", [(), (1,), (500,), (N - 2,), tuple(range(300, 400))], ids=lambda lost: f"{len(lost)}")
@pytest.mark.parametrize("decimals", [3, 6, None])
@pytest.mark.parametrize("start", [0.0, 1e5, 1.7e9])
def test_late_times_hide_no_lost_sample(
    tmp_path: Path, start: float, decimals: int | None, lost: tuple[int, ...]
) -> None:
    """Seconds since midnight or since 1970, printed with 3 or 6 decimals or all digits: dt to the rounding of doubles.

    A sample lost anywhere, or 100, is named with its line; a tolerance that grows with the time would let it pass.
    """
    times = [f"{t:.{decimals}f}" if decimals else repr(float(t)) for t in start + TIME]
    lines = [f"{t},{p:.6f}" for i, (t, p) in enumerate(zip(times, P_MMHG, strict=True)) if i not in lost]
    content = "\n".join(["time [s],AA.P [mmHg]", *lines])
    if lost:
        assert f"line {lost[0] + 2}, column 'time [s]': the sampling is not uniform" in refusal(tmp_path, content)
    else:
        rounding = float(np.spacing(start + 5.0)) / 5.0
        assert read_record(save(tmp_path, content)).dt == pytest.approx(DT, rel=rounding)


def test_a_rate_that_the_printed_time_cannot_show(tmp_path: Path) -> None:
    """700 Hz at three decimals looks like 1000 Hz with lost samples: refused, and told to print more decimals."""
    lines = ["time [s],AA.P [mmHg]", *(f"{i / 700:.3f},{p:.6f}" for i, p in enumerate(P_MMHG))]
    assert "print the time with more decimals, resample" in refusal(tmp_path, "\n".join(lines))


@settings(max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(8, 60),
    unit_P=st.sampled_from(["Pa", "mmHg", "kPa", "cmH2O"]),
    unit_Q=st.sampled_from(["m^3/s", "mL/s", "L/min"]),
    unit_R=st.sampled_from(["m", "mm", "cm", "um"]),
    gaps=st.sets(st.integers(1, 59), max_size=40),
)
def test_what_is_written_reads_back(seed: int, n: int, unit_P: str, unit_Q: str, unit_R: str, gaps: set[int]) -> None:
    """Any values, units and gaps: to 5e-16, two units in the last place."""
    rng = np.random.default_rng(seed)
    channels = {
        "AA.P": rng.uniform(-9e4, 9e5, n),
        "inlet.Q": rng.normal(size=n) * 10.0 ** rng.uniform(-12, -2, n),
        "AA.R": 10.0 ** rng.uniform(-4.9, -1.6, n),
    }
    for values in channels.values():
        values[[i for i in gaps if i < n - 1]] = np.nan
    time = rng.uniform(-5, 5) + np.arange(n) * 10.0 ** rng.uniform(-4, -1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        write_record(path, time, channels, {"AA.P": unit_P, "inlet.Q": unit_Q, "AA.R": unit_R})
        record = read_record(path)
    assert np.abs(record.time - time).max() <= 1e-14 * np.abs(time).max()
    for name, values in channels.items():
        np.testing.assert_allclose(record.channels[name], values, rtol=5e-16)  # NaN where NaN


@settings(max_examples=150)
@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(lambda s: s.encode("utf-8", "replace"))))
@example(b"\x00")
@example(b"\xff\xfet\x00i\x00m\x00e\x00")
@example(b"time,A.P\n" + b"1e308,1e308\n-1e308,-1e308\n" * 8)
@example(b"time [9**9**9**9],A.P [Pa]\n0,1\n")
@example(b'time,"A.P\n0,1\n1,2\n')
@example(b"time,A.P\n0,1\n\n1,2\n")
@example(b"time,A.P\n" + b'"0\n1",2\n' * 9)
def test_any_other_bytes_give_a_value_error(content: bytes) -> None:
    """Any bytes that are no record: a ValueError that begins with the file, nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder), content)
        with pytest.raises(ValueError, match=r"record\.csv: "):
            read_record(path)


_CELL = st.one_of(
    st.sampled_from(["", "0", "1", "nan", "inf", "-1e308", "1e400", '"', "a", " 2 ", "1,2", ";"]), st.text(max_size=3)
)


@settings(max_examples=150)
@given(st.lists(st.lists(_CELL, min_size=1, max_size=3), max_size=12))
def test_any_cells_give_a_record_or_a_value_error(rows: list[list[str]]) -> None:
    """Any cells below a good header: a ValueError that begins with the file."""
    content = "\n".join(["time [s],AA.P [Pa],AA.Q [mL/s]", *(",".join(row) for row in rows)])
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder), content.encode("utf-8", "replace"))
        with pytest.raises(ValueError, match=r"record\.csv: "):
            read_record(path)  # at most twelve rows of such cells are no record


# --- what is refused ----------------------------------------------------------------------------------------------


def refusal(folder: Path, content: str | bytes) -> str:
    path = save(folder, content)
    with pytest.raises(ValueError) as caught:
        read_record(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ") and sentence.endswith(".") and "\n" not in sentence
    return sentence.removeprefix(f"{path}: ")


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

    With one sample lost the same file is refused.
    """
    time = np.arange(1200) / 60.0
    rows = [f"{t:.6g},{85.0 + 10.0 * np.sin(7.0 * t):.4f}" for t in time]
    found = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *rows])))
    assert found.dt == pytest.approx(1 / 60, rel=1e-6)
    del rows[700]
    assert "sampling is not uniform" in refusal(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *rows]))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "the file is empty"),
        ("time [s],AA.P [mmHg]\n", "line 2: there are no samples below the header"),
        ("time [s],AA.P [mmHg]", "line 2: there are no samples below the header"),
        ("time [s],AA.P [mmHg]\n0,1\n1,2\n", "2 samples are too few"),
        ("time [s]\n0\n1\n", "line 1: there is no channel beside the time"),
        ("time [s],AA.P [µ]\n".encode("latin-1"), "not UTF-8 text (byte 15)"),
        (b"PK\x03\x04\x14\x00\xff\xfe", "not a recording but an FMU or another archive; give a CSV file."),
        ("time [s];AA.P [mmHg]\n0,0;1,5\n", "line 1: the fields are separated by semicolons"),
        ("time [s]\tAA.P [mmHg]\n0\t1\n", "line 1: the fields are separated by tabs"),
        ("0,1\n1,2\n", "line 1, column '0': the first column must be the time"),
        ("time [s],AA.X [mm]\n0,1\n", "line 1, column 'AA.X [mm]': no such channel; allowed are <site>.P"),
        ("time [s],P [Pa]\n0,1\n", "line 1, column 'P [Pa]': no such channel"),
        ("time [s],AA.P,AA.P [Pa]\n0,1,1\n", "line 1, column 'AA.P [Pa]': a name twice"),
        ("time [s],AA.D,AA.D\n0,1,1\n", "line 1, column 'AA.D': a name twice"),
        ("time [s],AA.R,AA.D\n0,1,1\n", "line 1, column 'AA.D': R and D of one site"),
        ("time [s],AA.P [mmHgg]\n0,1\n", "column 'AA.P [mmHgg]': the unit mmHgg is not known or of another kind"),
        ("time [s],AA.P [kg]\n0,1\n", "the unit kg is not known or of another kind and does not fit a pressure"),
        (
            "time [s],AA.P [mm]\n0,1\n",
            "the unit mm is that of a radius and does not fit a pressure; write a unit of pre",
        ),
        ("time [s],AA.P [mm],AA.R [mm]\n0,1,1\n", "the unit mm is that of a radius and does not fit a pressure; write"),
        ("time [s],AA.P [mm],AA.R [kPa]\n0,1,1\n", "P and R of the site seem swapped"),
        ("time [s],AA.P [mm],AA.D [kPa]\n0,1,1\n", "P and R of the site seem swapped"),
        ("time [m],AA.P\n0,1\n", "line 1, column 'time [m]': the unit m is that of a radius and does not fit a time"),
        ('time [s],"AA.P\n0,1\n', "line 1: not a CSV header"),
        (lines_with(7, "0.025,85.0,x9.1"), "line 7, column 'AA.R [mm]': 'x9.1' is not a number; write a number"),
        (lines_with(7, '0.025,"85,5",9.1'), "line 7, column 'AA.P [mmHg]': '85,5' is not a number; write the decimal"),
        (lines_with(7, "0.025,85.0"), "line 7: 2 fields where the header has 3"),
        (lines_with(N + 1, "4.995,85.0"), f"line {N + 1}: 2 fields where the header has 3"),
        (lines_with(2, "0,85.0"), "line 2: 2 fields where the header has 3"),
        (lines_with(7, "0.025,85.0,9.1,"), "line 7: 4 fields where the header has 3"),
        (lines_with(7, ""), "line 7: 0 fields where the header has 3"),
        (lines_with(7, '0.025,"85.0,9.1'), "not CSV (unexpected end of data)"),
        (lines_with(7, "0.025,inf,9.1"), "line 7, column 'AA.P [mmHg]': the value is infinite"),
        (lines_with(7, "0.025,1e999,9.1"), "line 7, column 'AA.P [mmHg]': the value is infinite"),
        (lines_with(7, ",85.0,9.1"), "line 7, column 'time [s]': the time is missing or not finite"),
        (lines_with(7, "NaN,85.0,9.1"), "line 7, column 'time [s]': the time is missing or not finite"),
        (lines_with(7, "0.020,85.0,9.1"), "line 7, column 'time [s]': the time does not increase (0.02 to 0.02)"),
        (lines_with(7, "0.026,85.0,9.1"), "line 7, column 'time [s]': the sampling is not uniform: a step of 0.006"),
        (lines_with(7, "0.025,8500,9.1"), "line 7, column 'AA.P [mmHg]': 1.133e+06 Pa is outside -100000 to 1e+06 Pa"),
        (lines_with(7, "0.025,85,0.001"), "line 7, column 'AA.R [mm]': 1e-06 m is outside 1e-05 to 0.2 m; the unit"),
    ],
)
def test_bad_files(tmp_path: Path, content: str | bytes, expected: str) -> None:
    """One sentence with file, and line and column where there is one."""
    assert expected in refusal(tmp_path, content)


def test_a_lost_sample_is_named_where_it_is_lost(tmp_path: Path) -> None:
    """Line 501 of the file, nine decimals."""
    lines = text(bench()).splitlines()
    del lines[500]
    assert "line 501, column 'time [s]': the sampling is not uniform: a step of 0.01" in refusal(
        tmp_path, "\n".join(lines)
    )


def test_a_clock_that_drifts_is_not_uniform(tmp_path: Path) -> None:
    """A clock that gains 1e-3 a second, 0.5 % over the record: refused."""
    assert "the sampling is not uniform" in refusal(tmp_path, text(bench(time=TIME * (1 + 1e-3 * TIME))))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"R": np.full(N, 9.0)}, "column 'AA.R [mm]': the channel is constant (0.009 m), it does not pulsate"),
        ({"R": np.where(TIME < 1, np.nan, 9.0)}, "column 'AA.R [mm]': the channel is constant (0.009 m)"),
        ({"R": np.full(N, np.nan)}, "column 'AA.R [mm]': it holds gaps only"),
        ({"P": np.minimum(P_MMHG, 97.0)}, "column 'AA.P [mmHg]': the channel is clipped: it rests at its highest val"),
        ({"P": np.maximum(P_MMHG, 72.0)}, "column 'AA.P [mmHg]': the channel is clipped: it rests at its lowest valu"),
        (
            {"P": P_MMHG * MMHG},
            "line 2, column 'AA.P [mmHg]': 1.578e+06 Pa is outside -100000 to 1e+06 Pa; the unit is probably wrong",
        ),
        ({"R": R_MM * 1e-3}, "the unit is probably wrong"),
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
    [{"time [s]": TIME, "AA.P [mmHg]": P_MMHG, "inlet.Q [mL/s]": 0.0 * TIME}, {"time [s]": TIME, "CA.Q": 0.0 * TIME}],
    ids=["inflow", "nothing else"],
)
def test_flows_that_must_pulsate(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    """The inflow, which drives a network, and the only channel of a record: refused if constant."""
    assert "the channel is constant (0 m^3/s), it does not pulsate" in refusal(tmp_path, text(columns))


def test_a_flow_may_rest_at_zero(tmp_path: Path) -> None:
    """Half of every beat at 0, a closed valve: no clipped sensor."""
    columns = {"time [s]": TIME, "inlet.Q [mL/s]": 55.0 * np.maximum(0.0, np.sin(2 * np.pi * TIME / T))}
    assert read_record(save(tmp_path, text(columns))).channels["inlet.Q"].min() == 0.0


def test_what_is_asked_for_and_missing_is_listed() -> None:
    """A missing P or R, in a sentence with what is there; else the arrays themselves."""
    record = Record("bench.csv", "", TIME, {"AA.P": P_MMHG, "BT.R": R_MM})
    with pytest.raises(ValueError, match=r"^bench\.csv: the channel AA\.R is missing; it holds AA\.P, BT\.R: "):
        record.site("AA")
    with pytest.raises(ValueError, match=r"the channel BT\.P is missing"):
        record.site("BT")
    P, R = Record("bench.csv", "", TIME, {"AA.P": P_MMHG, "AA.R": R_MM}).site("AA")
    assert P is P_MMHG and R is R_MM


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
