"""benchmarks/real_pressure.py, on synthetic pressure: the measured one does not come along."""

from __future__ import annotations

import json
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
import typer
from test_variable_beats import ventilated

from benchmarks.hidden.counts import share
from benchmarks.real_pressure import Window, count_upstrokes, cut_again, groups, main, windows
from fitting.records.alignment.align import align
from fitting.records.read.record import write_record

T = 0.8


def written(path: Path, seconds: float, dead_from: float = np.inf) -> Path:
    """A ventilated patient's pressure (synthetic) as a file; the sensor holds its value from ``dead_from`` [s]."""
    made = ventilated(3, seconds, T)
    P = np.where(made.time < dead_from, made.channels["AA.P"], 1e4)
    write_record(path, made.time, {"AA.P": P}, {"AA.P": "mmHg"})
    return path


@pytest.mark.parametrize("T", [0.4, 0.7, 1.3])
def test_upstrokes_are_counted(T: float) -> None:
    """Under a breath, a drift, noise, a gap and two seconds of a shaken line: their median distance to 3 %."""
    made = ventilated(1, 30.0, T)
    P = made.channels["AA.P"].copy()
    P[500:600] = np.nan
    P[1000:1250] += 1e3 * np.random.default_rng(0).standard_normal(250)
    assert count_upstrokes(made.time, P) == pytest.approx(T, rel=0.03)


def test_nothing_is_counted_where_nothing_rises() -> None:
    time = np.arange(1000) / 125.0
    assert np.isnan(count_upstrokes(time, -time)) and np.isnan(count_upstrokes(time, 0.0 * time))


def test_windows_of_a_synthetic_patient(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """45 s: three windows of 15 s and one of 30 s, usable, at the right rate, the same with their period given."""
    path = written(tmp_path / "patient.csv", 45.0)
    with pytest.raises(typer.Exit) as ended:
        main(tmp_path, json_file=tmp_path / "windows.json")
    assert ended.value.exit_code == 0
    found = [Window(**line) for line in json.loads((tmp_path / "windows.json").read_text(encoding="utf-8"))]
    assert [(each.seconds, each.begin) for each in found] == [(15.0, 0.0), (15.0, 15.0), (15.0, 30.0), (30.0, 0.0)]
    assert all(each.usable and each.agrees and each.same and each.beats >= 15 for each in found)
    assert [each.period for each in found] == pytest.approx([T] * 4, rel=0.03)
    assert "100.0 % (3/3; 29.2–100.0)" in capsys.readouterr().out
    assert [each.begin for each in windows(path, 15.0, 10.0)] == [0.0, 10.0, 20.0, 30.0]


def test_a_window_that_is_refused_counts_against_every_share(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two files; in one the sensor is dead from 15 s on."""
    written(tmp_path / "whole.csv", 30.0)
    path = written(tmp_path / "dead.csv", 30.0, dead_from=15.0)
    found = list(windows(path, 15.0, 15.0))
    assert "the channel is constant" in found[1].refused and str(tmp_path) not in found[1].refused
    shares = [share(found, attrgetter(what)) for what in ("usable", "agrees", "same")]
    assert [(each.hits, each.n) for each in shares] == [(1, 2)] * 3
    with pytest.raises(typer.Exit) as ended:
        main(tmp_path)
    assert ended.value.exit_code == 1
    said = capsys.readouterr().out
    assert (
        "refused: dead, 15 s from 15 s: column 'AA.P [mmHg]': the channel is constant" in said and "75.0 % (3/4" in said
    )


def test_what_is_missed_is_counted() -> None:
    """A period 6 % off the upstrokes does not agree, one 4 % off does; groups are those of a file, then of all."""
    off, near = (Window("a", 0.0, 15.0, counted, 0.8, 18, True) for counted in (0.8 * 1.06, 0.8 * 1.04))
    assert (off.agrees, near.agrees) == (False, True)
    assert list(groups([off, near])) == [("a", 15.0)]
    other = Window("b", 0.0, 30.0, 0.8, refused="no periodicity")
    assert list(groups([off, other])) == [("a", 15.0), ("b", 30.0), ("all", 15.0), ("all", 30.0)]


def test_other_beats_with_the_period_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beats that come out otherwise, or not at all, are not the same."""
    made = ventilated(3, 15.0, T)
    found = align(made)
    assert cut_again(made, found)
    assert not cut_again(ventilated(4, 15.0, T), found)

    def refuse(*_: object) -> None:
        raise ValueError("the record repeats otherwise")

    monkeypatch.setattr("benchmarks.real_pressure.align", refuse)
    assert not cut_again(made, found)


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "no CSV file with 15 s of pressure; "), ("time [s],AA.P [mmHg],AA.R [mm]\n", "one pressure, AA.P")],
)
def test_without_records(text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One sentence and exit code 2."""
    if text:
        (tmp_path / "other.csv").write_text(text, encoding="utf-8")
    with pytest.raises(typer.Exit) as ended:
        main(tmp_path)
    assert ended.value.exit_code == 2
    assert said in (sentence := capsys.readouterr().err) and sentence.count("\n") == 1
