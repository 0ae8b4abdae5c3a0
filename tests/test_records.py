"""Record files: SI and exact round trips, and one clear sentence for every file or channel that cannot be used."""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from record_files import DT, P_MMHG, R_MM, TIME, WAVE, N, T, bench, save, text

from fitting.records.alignment.align import align
from fitting.records.read import numbers
from fitting.records.read.record import read_record, write_record
from solver.quantities.units import MMHG

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


def test_a_diameter_is_halved(tmp_path: Path) -> None:
    """D in cm gives R in m under the name R; 1e-13."""
    columns = {"time [s]": TIME, "AA.P [Pa]": 11e3 + 2e3 * WAVE, "AA.D [cm]": 1.8 + 0.06 * WAVE}
    columns["inlet.Q [m^3/s]"] = 1e-5 * WAVE
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


@pytest.mark.parametrize("rate", [200.0, 250.0, 300.0, 400.0])
@pytest.mark.parametrize("start", [0.0, 0.0123456])
def test_printed_time_may_be_cut_off(tmp_path: Path, rate: float, start: float) -> None:
    """Milliseconds cut off, not rounded: 1.010 s as a product of doubles may become 1.009 s. dt as above; a sample lost
    at a third is a gap; with another rate after two thirds (1 %) the samples are moved, to 5e-3 of the pulse."""
    time = np.floor((start + np.arange(N) / rate) * 1e3) / 1e3
    lines = ["time [s],AA.P [mmHg]", *(f"{t:.3f},{p:.6f}" for t, p in zip(time, P_MMHG, strict=True))]
    slope = 1e-3 * rate / N**1.5 * 2
    assert read_record(save(tmp_path, "\n".join(lines))).dt == pytest.approx(1.0 / rate, rel=slope)
    record = read_record(save(tmp_path, "\n".join(lines[: N // 3] + lines[N // 3 + 1 :])))
    assert record.dt == pytest.approx(1.0 / rate, rel=slope)
    assert np.flatnonzero(np.isnan(record.channels["AA.P"])).tolist() == [N // 3 - 1]
    slower = start + np.cumsum(np.where(np.arange(N) < 2 * N // 3, 1.0, 1.01)) / rate
    pulse = np.sin(2.0 * np.pi * slower)
    lines[1:] = [f"{np.floor(t * 1e3) / 1e3:.3f},{85.0 + 15.0 * p:.6f}" for t, p in zip(slower, pulse, strict=True)]
    record = read_record(save(tmp_path, "\n".join(lines)))
    assert "the channels were resampled once" in record.said[0]
    error = record.channels["AA.P"] / MMHG - 85.0 - 15.0 * np.sin(2.0 * np.pi * (record.time + 5e-4))  # cut off
    assert np.nanmax(np.abs(error)) < 5e-3 * 30.0


@pytest.mark.parametrize("shortest", [False, True], ids=["all digits", "shortest"])
def test_time_in_single_precision(tmp_path: Path, shortest: bool) -> None:
    """Steps of 5 ms at 700 s, in units of 61 µs, printed exactly or as NumPy does: dt to 1e-6, a lost sample a gap."""
    time = (700.0 + TIME).astype(np.float32)
    lines = [f"{t if shortest else float(t)!s},{p:.6f}" for t, p in zip(time, P_MMHG, strict=True)]
    header = "time [s],AA.P [mmHg]"
    assert read_record(save(tmp_path, "\n".join([header, *lines]))).dt == pytest.approx(DT, rel=1e-6)
    del lines[400]
    record = read_record(save(tmp_path, "\n".join([header, *lines])))
    assert np.flatnonzero(np.isnan(record.channels["AA.P"])).tolist() == [400]


@pytest.mark.parametrize("lost", [(), (1,), (500,), (N - 2,), tuple(range(300, 400))], ids=lambda lost: f"{len(lost)}")
@pytest.mark.parametrize("decimals", [3, 6, None])
@pytest.mark.parametrize("start", [0.0, 1e5, 1.7e9])
def test_late_times_hide_no_lost_sample(
    tmp_path: Path, start: float, decimals: int | None, lost: tuple[int, ...]
) -> None:
    """Seconds since midnight or since 1970, printed with 3 or 6 decimals or all digits: dt to the rounding of doubles.

    A sample lost anywhere, or 100, are gaps where they are; a tolerance that grows with the time would not see them.
    """
    times = [f"{t:.{decimals}f}" if decimals else repr(float(t)) for t in start + TIME]
    lines = [f"{t},{p:.6f}" for i, (t, p) in enumerate(zip(times, P_MMHG, strict=True)) if i not in lost]
    record = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *lines])))
    assert record.dt == pytest.approx(DT, rel=float(np.spacing(start + 5.0)) / 5.0)
    assert tuple(np.flatnonzero(np.isnan(record.channels["AA.P"]))) == lost
    assert record.told == ({"sampling": ANY} if lost else {})
    assert not lost or f"of {N} samples {len(lost)} lost, which became gaps" in record.said[0]


@pytest.mark.parametrize(("rate", "clock"), [(700.0, 1e-3), (1000.0, 1e-3), (200.0, 1.0)])
def test_stamps_coarser_than_the_samples(tmp_path: Path, rate: float, clock: float) -> None:
    """700 Hz in milliseconds has steps of 1 and 2 ms, 1 kHz cut off there some of 0 and 2 ms, as i/1000 is rounded
    before, and 200 Hz in seconds repeats its stamps: the line gives the rate, to the bound 1.5 q/T that is said, and
    nothing is moved. Over five such steps that is too vague."""
    n = round(40.0 * rate)
    time, P = np.floor(np.arange(n) / rate / clock) * clock, np.resize(P_MMHG, n)
    lines = ["time [s],AA.P [mmHg]", *(f"{t:.3f},{p:.6f}" for t, p in zip(time, P, strict=True))]
    record = read_record(save(tmp_path, "\n".join(lines)))
    assert record.dt == pytest.approx(1.0 / rate, rel=1.5 * clock / 40.0)
    np.testing.assert_allclose(record.channels["AA.P"], P * MMHG, rtol=1e-7)
    assert "a lost sample would not be seen" in record.said[0]
    if clock == 1.0:
        with pytest.raises(ValueError, match="over 4 s leave the rate open by 38%, and 10% is allowed"):
            read_record(save(tmp_path, "\n".join(lines[: 1 + round(5.0 * rate)])))


def test_a_stamp_for_each_packet(tmp_path: Path) -> None:
    """200 Hz, ten samples at a time with one stamp of a microsecond: the line gives the rate, to 1.5 packets of 5 s."""
    time = np.repeat(TIME[::10] + 1.234567, 10)
    record = read_record(save(tmp_path, text(bench(time=time), 6)))
    assert record.dt == pytest.approx(DT, rel=1.5 * 0.05 / 5.0)
    np.testing.assert_allclose(record.channels["AA.P"], P_MMHG * MMHG, rtol=1e-7)
    assert "in steps of 0.05 s" in record.said[0]


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("decimals", [3, 6])
def test_jitter_is_resampled_once(tmp_path: Path, decimals: int, lost: bool) -> None:
    """200 Hz, stamps 0.5 ms rms off in steps of 4, 5 and 6 ms, with 1 % of the samples lost or none: dt to 1e-6,
    jitter as it is to 15 %, the pulse to what rounding of the stamps does to it, 0.3 ms rms of its slope."""
    rng = np.random.default_rng(3)
    time = TIME + 5e-4 * rng.standard_normal(N)
    P = 85.0 + 15.0 * (np.sin(2 * np.pi * time / T) + 0.3 * np.sin(4 * np.pi * time / T + 1.0))
    kept = np.sort(rng.permutation(np.arange(1, N - 1))[: N - 12]) if lost else np.arange(N)
    lines = [f"{time[i]:.{decimals}f},{P[i]:.6f}" for i in kept]
    record = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *lines])))
    found, there = record.channels["AA.P"] / MMHG, ~np.isnan(record.channels["AA.P"])
    assert record.dt == pytest.approx(DT, rel=2e-5)
    assert kept[0] + np.flatnonzero(there) == pytest.approx(kept)
    assert record.told["sampling"]["jitter_rms"]["value"] == pytest.approx(5e-4, rel=0.2)
    at = record.time[there]
    wave = np.sin(2 * np.pi * at / T) + 0.3 * np.sin(4 * np.pi * at / T + 1.0)
    assert np.std(found[there] - 85.0 - 15.0 * wave) < (0.08 if decimals == 3 else 0.01)


@pytest.mark.parametrize(("sd", "decimals", "lost"), [(4e-3, 6, 0), (4e-3, 6, 20), (1e-2, 3, 0), (5e-3, 2, 0)])
def test_stamps_that_go_back(tmp_path: Path, sd: float, decimals: int, lost: int) -> None:
    """200 Hz, stamps off by 0.8 and 2 intervals, and rounded to 2: a converter takes its samples in order, so they stay
    in it and are not moved; dt to what the jitter does to the slope of the line. Of 20 lost samples, gaps where they
    are, at most two are miscounted."""
    rng = np.random.default_rng(5)
    kept = np.r_[: N // 2, N // 2 + lost : N]
    time = 7.0 + TIME[kept] + sd * rng.standard_normal(N - lost)
    lines = [f"{t:.{decimals}f},{P_MMHG[i]:.6f}" for i, t in zip(kept, time, strict=True)]
    record = read_record(save(tmp_path, "\n".join(["time [s],AA.P [mmHg]", *lines])))
    assert record.dt == pytest.approx(DT, rel=3.0 / N if lost else 4.0 * sd / DT * 12**0.5 / N**1.5)
    there = ~np.isnan(record.channels["AA.P"])
    assert there.sum() == N - lost and (~there).sum() == pytest.approx(lost, abs=2 if lost else 0)
    assert not lost or np.flatnonzero(~there)[0] == pytest.approx(N // 2, abs=2)
    np.testing.assert_allclose(record.channels["AA.P"][there], P_MMHG[kept] * MMHG, rtol=1e-7)
    assert "go back" in record.said[0]


def test_what_beats_say_of_the_stamps(tmp_path: Path) -> None:
    """The sentence comes with the beats, and so with every result; what was done is plain beside the map."""
    lines = text(bench()).splitlines()
    del lines[500]
    beats = align(read_record(save(tmp_path, "\n".join(lines))))
    assert beats.T == pytest.approx(T, rel=1e-9)
    assert "is uneven: 200 Hz; of 1000 samples 1 lost" in beats.warnings[0]
    assert "no sample was moved" in beats.warnings[0]
    assert beats.told["sampling"]["lost"] == 1 and not beats.told["sampling"]["resampled"]


@settings(max_examples=40)
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


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_numpy_reads_what_polars_reads(separator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A number in every cell: the same bits by both. Anything else is left to polars, and of it to a look at cells."""
    rng = np.random.default_rng(5)
    rows = [[f"{x:.17g}", f"{y:.5e}", "-.5", "+7", "nan"] for x, y in 10.0 ** rng.uniform(-20, 20, (50, 2))]
    lines = [b"a header", *(separator.join(row).encode() for row in rows)]
    plain = b"\n".join(lines)
    for end in (b"", b"\n"):
        mine = numbers.quickly(plain + end, 1, 5, separator, ".")
        with monkeypatch.context() as without:
            without.setattr(numbers, "_SMALL", 0)
            np.testing.assert_array_equal(mine, numbers.quickly(plain + end, 1, 5, separator, "."))
    for odd in (b"", b"1", separator.join("12345").encode() + b"6" + separator.encode(), separator.encode() * 4):
        assert numbers._of_plain_cells(b"\n".join([*lines, odd, lines[-1]]), 1, 5, separator) is None


@pytest.mark.parametrize("separator", [";", "\t"])
def test_numpy_reads_no_file_with_decimal_commas(separator: str) -> None:
    """1.234 is a thousand and more there, and 1.5 a fault: a look at every cell tells, and not NumPy."""
    for cell in ("1.234", "1.5"):
        data = "\n".join(separator.join((str(i), cell)) for i in range(5)).encode()
        assert numbers.quickly(data, 0, 2, separator, ",") is None
        assert numbers.quickly(data, 0, 2, separator, ".") is not None


@settings(max_examples=60)
@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(lambda s: s.encode("utf-8", "replace"))))
@example(b"dB\x89\t")
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


@settings(max_examples=60)
@given(st.lists(st.lists(_CELL, min_size=1, max_size=3), max_size=12))
def test_any_cells_give_a_record_or_a_value_error(rows: list[list[str]]) -> None:
    """Any cells below a good header: a ValueError that begins with the file."""
    content = "\n".join(["time [s],AA.P [Pa],AA.Q [mL/s]", *(",".join(row) for row in rows)])
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder), content.encode("utf-8", "replace"))
        with pytest.raises(ValueError, match=r"record\.csv: "):
            read_record(path)  # at most twelve rows of such cells are no record
