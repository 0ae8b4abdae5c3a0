"""Several files of one recording, written here: aligned by their stamps, at the slowest rate, over what all have."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from fitting.records.alignment.align import align
from fitting.records.read.columns import Reading
from fitting.records.read.record import Record, read_record
from solver.quantities.units import MMHG

T = 0.8
NOISE = 0.3  # mmHg


def pressure(t: np.ndarray) -> np.ndarray:
    phase = 2.0 * np.pi * t / T
    return 80.0 + 20.0 * np.sin(phase) + 5.0 * np.sin(4.0 * phase) + 1.0 * np.sin(20.0 * phase)  # to 25 Hz


def flow(t: np.ndarray) -> np.ndarray:
    return 70.0 * (1.0 + np.sin(2.0 * np.pi * t / T + 0.5))


def clock(t: float) -> str:
    return f"2024-05-01T10:{int(t) // 60:02d}:{t % 60:09.6f}"


def files(folder: Path, rates: tuple[float, float], starts: tuple[float, float] = (3.0, 5.0), header: bool = True):
    """P.csv and Q.csv, 16 s each, stamped by one clock; noise on P."""
    rng = np.random.default_rng(2)
    for name, title, wave, rate, start in zip("PQ", ("C.P [mmHg]", "inlet.Q [mL/s]"), (pressure, flow), rates, starts,
                                              strict=True):  # fmt: skip
        t = start + np.arange(round(16.0 * rate)) / rate
        x = wave(t) + (NOISE * rng.standard_normal(len(t)) if name == "P" else 0.0)
        lines = [f"{clock(a)},{b:.6f}" for a, b in zip(t, x, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join([f"time,{title}"] * header + lines))
    return folder / "P.csv", folder / "Q.csv"


def both(paths: tuple[Path, Path], *maps: str) -> Record:
    return read_record(paths[0], Reading.from_options(maps, None, [paths[1]]))


@pytest.mark.parametrize(
    ("rates", "rate", "noise"),
    [((200.0, 200.0), 200.0, 1.0), ((1000.0, 200.0), 200.0, 0.41), ((250.0, 1000.0), 250.0, 1.0)],
)
@pytest.mark.parametrize("late", [0.0, 1.7e-3])
def test_two_files_are_one_record(
    tmp_path: Path, rates: tuple[float, float], rate: float, noise: float, late: float
) -> None:
    """The overlap at the slowest rate: P as it was, with the part of its noise that lies below the cut-off, √(0.8/5)
    from 1000 to 200 Hz; Q to 1e-4 of its size. The files may begin between each other's samples."""
    record = both(files(tmp_path, rates, (3.0, 5.0 + late)))
    assert 1.0 / record.dt == pytest.approx(rate, rel=1e-7)
    t = record.time - record.time[0].round() + 5.0
    assert t[0] == pytest.approx(5.0, abs=1.1 / rate) and t[-1] == pytest.approx(19.0, abs=2.0 / rate)
    wrong = record.channels["C.P"] / MMHG - pressure(t)
    assert np.std(wrong) == pytest.approx(noise * NOISE, rel=0.1 if late == 0.0 else 0.2)
    assert (
        np.abs(np.fft.rfft(wrong[: round(8.0 * rate)], norm="forward")[10::10]).max() < 0.25 * NOISE
    )  # harmonics of 1/T
    np.testing.assert_allclose(record.channels["inlet.Q"], 1e-6 * flow(t), atol=1.4e-8)
    assert f"{rates[0]:g} Hz" in record.said[0] and f"at {rate:g} Hz, the rate of " in record.said[0]
    assert ("the slowest" in record.said[0]) == (rates[0] > rates[1])
    assert list(record.told["with"]) == [str(tmp_path / "Q.csv")]
    assert align(record).T == pytest.approx(T, rel=1e-4)


@pytest.mark.parametrize("between", ["held", "empty"])
def test_a_slower_channel_of_one_file(tmp_path: Path, between: str) -> None:
    """Q has a value in every fifth row of P, in the others the same or none: both at its rate, without its delay of two
    rows. A quantised P, which repeats values, stays as it is."""
    t = np.arange(10000) * 1e-3
    Q = [f"{x:.6f}" for x in flow(t)]
    rows = [i - (i - 2) % 5 for i in range(len(t))]
    slow = [Q[max(row, 0)] if between == "held" or row == i else "" for i, row in enumerate(rows)]
    lines = [f"{a:.3f},{5.0 * round(p / 5.0):.1f},{q}" for a, p, q in zip(t, pressure(t), slow, strict=True)]
    path = tmp_path / "both.csv"
    path.write_text("\n".join(["time [s],C.P [mmHg],inlet.Q [mL/s]", *lines]))
    record = read_record(path)
    assert record.dt == pytest.approx(5e-3) and record.time[0] == pytest.approx(2e-3)
    np.testing.assert_allclose(record.channels["inlet.Q"], 1e-6 * flow(record.time), atol=1e-12)
    assert "inlet.Q of " in record.said[0] and "one row in 5" in record.said[0] and "with" not in record.told


def test_gaps_stay_gaps(tmp_path: Path) -> None:
    """Ten empty fields of P at 1000 Hz are the two or three samples at 200 Hz that fall there."""
    paths = files(tmp_path, (1000.0, 200.0))
    lines = paths[0].read_text().splitlines()
    lines[8001:8011] = [f"{line.partition(',')[0]}," for line in lines[8001:8011]]
    paths[0].write_text("\n".join(lines))
    record = both(paths)
    assert np.flatnonzero(np.isnan(record.channels["C.P"])).tolist() == [1200, 1201]


def test_columns_of_several_files_by_number(tmp_path: Path) -> None:
    """Without headers: a number is of every file, or of one by its name."""
    paths = files(tmp_path, (200.0, 200.0), header=False)
    record = both(paths, "1=time [s]", "P.csv:2=C.P [mmHg]", "Q.csv:2=inlet.Q [mL/s]")
    assert set(record.channels) == {"C.P", "inlet.Q"}
    with pytest.raises(ValueError, match=r'Q\.csv: C\.P is in another file, too; leave one out, --map "Q\.csv:TITLE="'):
        both(paths, "1=time [s]", "2=C.P [mmHg]")
    with pytest.raises(ValueError, match=r'P\.csv: --map "Flow=inlet\.Q": no column has this title'):
        both(paths, "1=time [s]", "P.csv:2=C.P [mmHg]", "Flow=inlet.Q")


def test_files_of_two_times(tmp_path: Path) -> None:
    """Nothing in common: one sentence with both spans. The same file twice: names that differ."""
    paths = files(tmp_path, (200.0, 200.0), (3.0, 30.0))
    with pytest.raises(
        ValueError, match=r"P\.csv from 2024-05-01 10:\d\d:\d\d to 2024-.*: their times do not overlap; give files of"
    ):
        both(paths)
    with pytest.raises(ValueError, match="need names that differ, not P.csv, P.csv"):
        both((paths[0], paths[0]))


@pytest.mark.parametrize(("behind", "shift"), [(30.0, "30 s"), (30.0, "30000 ms"), (32.0, "start")])
def test_files_of_two_clocks(tmp_path: Path, behind: float, shift: str) -> None:
    """The clock of Q is behind, by the 2 s that it began later, too, where both are said to start together: with the
    shift both are one record."""
    wanted = both(files(tmp_path, (200.0, 200.0), (30.0, 30.0 if shift == "start" else 32.0)))
    P, Q = files(tmp_path, (200.0, 200.0), (30.0, 30.0 if shift == "start" else 32.0))
    Q.write_text("\n".join(_behind(line, behind) for line in Q.read_text().splitlines()))
    record = read_record(P, Reading.from_options((), None, [f"{Q}={shift}"]))
    np.testing.assert_allclose(record.channels["inlet.Q"], wanted.channels["inlet.Q"], rtol=1e-9)
    np.testing.assert_allclose(record.time, wanted.time, rtol=1e-15)
    assert record.told["shift"] == {str(Q): "start" if shift == "start" else 30.0}
    assert any(said == f"+{behind:g} s were added to the times of {Q}." for said in record.said)
    with pytest.raises(ValueError, match=r'--with .*Q\.csv = "3 m": the unit m does not convert'):
        Reading.from_options((), None, [f"{Q}=3 m"])


def _behind(line: str, seconds: float) -> str:
    """A line of Q whose clock is behind."""
    time, comma, rest = line.partition(",")
    if time == "time":
        return line
    minutes, own = time.removeprefix("2024-05-01T10:").split(":")
    own_time = 3600.0 + 60.0 * int(minutes) + float(own) - seconds
    return (
        f"2024-05-01T{9 + int(own_time // 3600):02d}:{int(own_time) // 60 % 60:02d}:{own_time % 60:09.6f}{comma}{rest}"
    )


def test_commands_take_further_files(tmp_path: Path) -> None:
    """--columns shows each file; with --json, too."""
    P, Q = files(tmp_path, (200.0, 200.0))
    done = CliRunner().invoke(app, ["calibrate", str(P), "--with", str(Q), "--columns", "--json"])
    assert done.exit_code == 0, done.output
    assert [each["columns"][1]["read_as"] for each in json.loads(done.stdout)["files"]] == [
        "C.P, a pressure",
        "inlet.Q, a flow",
    ]
