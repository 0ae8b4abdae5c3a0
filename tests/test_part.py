"""A part of a recording: ``--part``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from commands import in_process
from record_files import DT, P_MMHG, R_MM, TIME, bench, save, text

from arterial_fmu.cli.fit import fit_command
from fitting.records.read.columns import Reading
from fitting.records.read.record import Record, read_record
from solver.errors import InputError


def part(path: Path, *texts: str, beside: tuple[str, ...] = ()) -> Record:
    return read_record(path, Reading.from_options([], None, beside, texts))


@pytest.mark.parametrize(
    ("asked", "first", "samples"),
    [
        ("1..3 s", 1.0, 400),
        ("1..3", 1.0, 400),
        ("1 s..3", 1.0, 400),
        ("0.02 min..", 1.2, 760),
        ("..500 ms", 0.0, 100),
        ("4..60 s", 4.0, 200),
        ("record.csv=1..3 s", 1.0, 400),
        ("other.csv=1..3 s", 0.0, 1000),
    ],
)
def test_only_a_part_is_read(tmp_path: Path, asked: str, first: float, samples: int) -> None:
    """Times count from the first sample, wherever the stamps begin; a part of another file is none of this one."""
    for start in (0.0, 37220.5):
        record = part(save(tmp_path, text(bench(time=TIME + start))), asked)
        assert len(record.time) == samples
        np.testing.assert_allclose(record.time[0], start + first, atol=1e-9)
        at = round(first / DT)
        np.testing.assert_allclose(record.channels["AA.R"], 1e-3 * R_MM[at : at + samples], rtol=1e-9)


def test_what_lies_outside_a_part_rejects_nothing(tmp_path: Path) -> None:
    """A pause of most of the record, a sensor that is clipped, a missing time: all before 2 s. The result says so."""
    P = np.where(TIME < 1.5, np.minimum(P_MMHG, 90.0), P_MMHG)
    time = np.where(TIME < 2.0, TIME, TIME + 100.0)
    time[7] = np.nan
    path = save(tmp_path, text(bench(time=time, P=P)))
    with pytest.raises(InputError):
        read_record(path)
    record = part(path, "102..104 s")
    assert len(record.time) == 400 and record.told["part"] == {"": "102..104 s"}
    assert f"{path}: only 102..104 s of the record was read; times in notes count from there." in record.said


def test_a_line_is_named_by_its_place_in_the_file(tmp_path: Path) -> None:
    P = P_MMHG.copy()
    P[500] = np.inf
    path = save(tmp_path, text(bench(P=P)))
    with pytest.raises(ValueError, match="line 502"):
        part(path, "2..4 s")


@pytest.mark.parametrize(
    ("asked", "first", "samples"), [("..2 s", 0, 400), ("2 s..", 400, 600), ("0.5..1.5 s", 100, 200)]
)
def test_a_block_is_read_whose_times_begin_anew(tmp_path: Path, asked: str, first: int, samples: int) -> None:
    """The times of a part go on from one block to the next."""
    time = np.where(TIME < 2.0, TIME, TIME - 2.0)
    record = part(save(tmp_path, text(bench(time=time))), asked)
    np.testing.assert_allclose(record.channels["AA.R"], 1e-3 * R_MM[first : first + samples], rtol=1e-9)


@pytest.mark.parametrize("shift", ["", "=start", "=0.25 s"])
def test_the_same_part_of_several_files(tmp_path: Path, shift: str) -> None:
    """Of the first file's times. The files stay aligned as they are without a part."""
    at = 0.25 + 0.0075 * np.arange(500)  # another rate, and it begins later
    path, other = save(tmp_path, text({"time [s]": TIME, "AA.P [mmHg]": P_MMHG})), tmp_path / "R.csv"
    other.write_text(text({"time [s]": at, "AA.R [mm]": np.interp(at, TIME, R_MM)}))
    whole = part(path, beside=(f"{other}{shift}",))
    some = part(path, "1..3 s", beside=(f"{other}{shift}",))
    assert 1.0 - 1e-9 <= some.time[0] < 1.0 + 0.0075 + 1e-9 and 2.98 < some.time[-1] < 3.0
    there = np.searchsorted(whole.time, some.time - 1e-6)
    np.testing.assert_allclose(whole.time[there], some.time, atol=1e-9)
    np.testing.assert_allclose(some.channels["AA.R"], whole.channels["AA.R"][there], rtol=1e-9)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ("7..9 s", "--part \"7..9 s\": its samples are from 0 to 4.995 s after the first; give a part of these"),
        ("3..1 s", "must begin at 0 or later and end after that"),
        ("-1..1 s", "must begin at 0 or later and end after that"),
        ("a minute", "must be FROM..TO"),
        ("..", "must be FROM..TO"),
        ("1..2 mm", "the unit mm does not convert to the expected s"),
    ],
)  # fmt: skip
def test_no_part_is_refused(tmp_path: Path, asked: str, sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        part(save(tmp_path, text(bench())), asked)


def test_a_part_is_given_once() -> None:
    with pytest.raises(InputError, match=r'--part "3..4 s": a part of all files is given twice; keep one'):
        Reading.from_options(None, None, parts=["1..2 s", "3..4 s"])


def test_the_option_of_the_commands(tmp_path: Path) -> None:
    """The note and the provenance have it; a name of no recording is refused."""
    path = save(tmp_path, text(bench(R=9.0 + 0.3 * np.roll(P_MMHG - 85.0, 2) / 15.0)))
    asked = [str(path), "--site", "AA", "--h", "1 mm", "--bootstrap", "0"]
    found = in_process(fit_command, [*asked, "--part", "1..4 s", "--out", str(tmp_path / "set.json")])
    assert found.returncode == 0 and "only 1..4 s of the record was read" in " ".join(found.stdout.split())
    assert '"1..4 s"' in (tmp_path / "set.json").read_text()
    wrong = in_process(fit_command, [*asked, "--part", "typo.csv=1..4 s"])
    assert wrong.returncode == 2 and "no recording has this name; they are record.csv" in wrong.stderr
