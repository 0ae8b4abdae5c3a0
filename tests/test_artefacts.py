"""Lines that are flushed, zeroed or calibrated, and codes for no value: gaps, and said so; beats stay as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fitting.records.alignment.align import align
from fitting.records.read.record import read_record, write_record
from fitting.records.read.sensors import UnusableRecord, without_codes, without_hum, without_still
from fitting.records.read.table import Place
from solver.quantities.units import MMHG

DT, T = 0.004, 0.8
TIME = DT * np.arange(10000)  # 50 beats
PLACE = Place("made.csv")
Array = np.ndarray


def pressure(time: Array = TIME, period: float = T) -> Array:
    """Synthetic [Pa]: an upstroke of 100 ms to 120 mmHg and a decay to 80 mmHg, with noise of 0.1 mmHg."""
    t = time % period
    shape = np.where(t < 0.1, 0.5 - 0.5 * np.cos(np.pi * t / 0.1), np.exp(-(t - 0.1) / 0.25))
    return (80.0 + 40.0 * shape + 0.1 * np.random.default_rng(1).normal(size=len(t))) * MMHG


def at_levels(x: Array, levels: dict[tuple[int, int], float], noise: float) -> Array:
    """With the line at some levels [mmHg] between samples."""
    x, rng = x.copy(), np.random.default_rng(2)
    for (start, stop), level in levels.items():
        x[start:stop] = (level + noise * rng.normal(size=stop - start)) * MMHG
    return x


@pytest.mark.parametrize("noise", [0.0, 0.2], ids=["exact", "with noise"])
@pytest.mark.parametrize(
    "levels",
    [
        {(5000, 5600): 290.0},
        {(0, 1000): 0.0},
        {(0, 500): 0.0, (500, 1000): 100.0, (1000, 1500): 200.0},
        {(9300, 10000): 300.0},
    ],
    ids=["flushed", "zeroed", "calibrated in steps, one of them among the beats", "flushed till the end"],
)
def test_a_line_that_stands_still(levels: dict[tuple[int, int], float], noise: float, tmp_path: Path) -> None:
    """All of it is a gap, and no more than a second beside; the mean beat is that without, to 0.1 mmHg."""
    P = pressure()
    found, (said,) = without_still(at_levels(P, levels, noise), "AA.P", DT, PLACE)
    mine = np.zeros(len(P), bool)
    for start, stop in levels:
        mine[start:stop] = True
    assert np.isnan(found[mine]).all() and np.isnan(found).sum() <= mine.sum() + round(1.0 / DT)
    assert said.startswith("AA.P stands still at ") and "taken for gaps" in said
    Q = np.maximum(np.sin(2.0 * np.pi * TIME / T), 0.0) * 400e-6
    path = tmp_path / "flushed.csv"
    write_record(path, TIME, {"inlet.Q": Q, "AA.P": at_levels(P, levels, noise)}, {"AA.P": "mmHg"})
    beats = align(read_record(path))
    assert said in beats.warnings and beats.T == pytest.approx(T, rel=1e-4)
    usual = P[: 50 * 200].reshape(50, 200).mean(axis=0)
    assert np.nanmean(beats.values["AA.P"], axis=0).mean() == pytest.approx(usual.mean(), abs=0.1 * MMHG)


def test_a_flush_of_a_monitor_that_rounds() -> None:
    """To 1 mmHg, two steps of which are more than a twentieth of a pulse of 30: a flush is a gap, beats are none."""
    P = at_levels(70.0 * MMHG + 0.75 * (pressure() - 80.0 * MMHG), {(5000, 5600): 290.0}, 0.5)
    found, (said,) = without_still(np.round(P / MMHG) * MMHG, "AA.P", DT, PLACE)
    assert np.isnan(found[5000:5600]).all() and np.isnan(found).sum() <= 600 + round(1.0 / DT)
    assert said.startswith("AA.P stands still at 290 mmHg for ")


def test_beats_stay_as_they_are() -> None:
    """A radius in ten steps of its converter, a slow heart with a flat diastole of 1.4 s, a flow that rests, a record
    of one second: nothing is taken."""
    slow = pressure(period=2.0)
    coarse = 1e-2 + 1e-4 * np.round((pressure() / MMHG - 80.0) / 4.0)
    flow = np.maximum(np.sin(2.0 * np.pi * TIME / T), 0.0)
    for name, x in (("AA.P", slow), ("AA.R", coarse), ("AA.Q", flow), ("AA.P", pressure()[:250])):
        found, said = without_still(x, name, DT, PLACE)
        assert said == () and found is x


def test_a_dead_sensor_among_the_levels_of_beats() -> None:
    """A pressure that holds its last value, and a flow of nothing while the meter is zeroed, longer than any beat."""
    P, Q = pressure(), np.maximum(np.sin(2.0 * np.pi * TIME / T), 0.0)
    P[5000:8000], Q[:1000] = P[5000], 0.0
    for name, x, dead in (("AA.P", P, slice(5000, 8000)), ("AA.Q", Q, slice(0, 1000))):
        found, (said,) = without_still(x, name, DT, PLACE)
        gaps = np.isnan(found)
        assert gaps[dead].all() and gaps.sum() <= dead.stop - dead.start + round(1.0 / DT) and "stands still at" in said
    P[3500:] = P[3500]
    with pytest.raises(UnusableRecord, match="most of the record"):
        without_still(P, "AA.P", DT, PLACE)


def test_a_record_that_mostly_stands_still() -> None:
    """No mean beat of what is left: refused, with how long and where."""
    x = at_levels(pressure(), {(0, 4200): 0.0, (9000, 10000): 0.0}, 0.2)
    with pytest.raises(UnusableRecord, match=r"made.csv: AA.P stands still at .* mmHg for 20.* s, most of the record"):
        without_still(x, "AA.P", DT, PLACE)


def test_codes() -> None:
    """-999 mmHg at 100 samples is a gap; two impossible numbers, or one sample, are a fault to be told."""
    P = pressure()
    coded = P.copy()
    coded[::100] = -999.0 * MMHG
    found, (said,) = without_codes(coded, "AA.P", MMHG)
    assert np.flatnonzero(np.isnan(found)).tolist() == list(range(0, 10000, 100))
    assert said == "AA.P: 100 samples are -999, which no artery has; they were taken for gaps."
    for others in ((-999.0, -998.0), (-999.0,)):
        wrong = P.copy()
        wrong[: len(others)] = np.array(others) * MMHG
        assert without_codes(wrong, "AA.P", MMHG) == (wrong, ())


@pytest.mark.parametrize(("f", "amplitude"), [(50.0, 2.0), (60.1, 5.0), (49.8, 0.5), (100.0, 2.0)])
def test_hum_is_subtracted(f: float, amplitude: float) -> None:
    """Beats of one length and of others, with a gap: what is left of it is a twentieth at most, and the rest is as it
    was. At 250 Hz, near the fastest line that it can show, too."""
    for wander in (0.0, 0.02):
        P = pressure(TIME + wander * np.sin(2.0 * np.pi * TIME / 4.3))
        P[4000:5000] = np.nan
        found, said = without_hum(P + amplitude * MMHG * np.sin(2.0 * np.pi * f * TIME + 0.4), "AA.P", DT)
        assert np.nanstd(found - P) < 0.05 * amplitude * MMHG and (np.isnan(found) == np.isnan(P)).all()
        assert said[0].startswith(f"AA.P has hum of the mains, {amplitude:.2g} mmHg at ")


@pytest.mark.parametrize("period", [0.8, 0.1, 0.5, 1.7, 0.73])
def test_a_beat_is_no_hum(period: float) -> None:
    """Of beats of one length a harmonic may be at 50 or 60 Hz: the record stays as it is, bit by bit."""
    for x in (pressure(period=period), pressure(period=period) + 0.5 * MMHG):
        found, said = without_hum(x, "AA.P", DT)
        assert found is x and said == ()


def test_hum_is_no_catheter_that_rings(tmp_path: Path) -> None:
    """The mean beat of a file with hum in every channel is that of the file without."""
    t = TIME + 0.02 * np.sin(2.0 * np.pi * TIME / 4.3)
    channels = {"inlet.Q": np.maximum(np.sin(2.0 * np.pi * t / T), 0.0) * 400e-6, "AA.P": pressure(t)}
    hum = np.sin(100.0 * np.pi * TIME + 0.4)
    means = []
    for size in (0.0, 0.1):
        write_record(tmp_path / "hum.csv", TIME, {n: x + size * np.ptp(x) * hum for n, x in channels.items()})
        means.append(align(read_record(tmp_path / "hum.csv")).mean("AA.P"))
    assert len(means[0]) == len(means[1]) and np.std(means[1] - means[0]) < 0.1 * MMHG
