"""Calibrations of several recordings of one animal: what is in common, what each has of its own, and what was held out.

A fork of three vessels (tests/forked.py) under three inflows, with an outlet that differs: E and phi0 in common.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from forked import NETWORK, SETTINGS, exact, record
from forked import T as PERIOD
from refused import refused
from typer.testing import CliRunner

import arterial_fmu.__main__
from fitting.calibrate.calibration_prior import read_prior
from fitting.calibrate.held_out import judge
from fitting.calibrate.multistart import Minimum, Starts, calibrate_from
from fitting.calibrate.network_calibration import calibrate
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import write_record
from fitting.records.recordings import labels_of
from fitting.results.parameter_set import read_set
from solver.network.files import write_network

UNKNOWNS = ("all.E", "all.phi0", "C.outlet.R_t")
START = NETWORK.with_parameters(
    {f"{s.name}.E": 1.2 * s.E for s in NETWORK.segments} | {f"{s.name}.phi0": 0.8 * s.phi0 for s in NETWORK.segments}
)
ENDS = {"a": (1.0, 0.2), "b": (0.6, 0.3), "c": (1.3, 0.05)}  # size of the inflow, R_t of C
VARIES = ("*.R_t",)


@cache
def recording(name: str, noise: float = 0.0) -> Beats:
    size, R_t = ENDS[name]
    waves = exact(size, NETWORK.with_parameters({"C.outlet.R_t": R_t}))
    return replace(record(waves, 8, noise, seed=ord(name)), source=f"dogs/{name}.csv", sha256=name * 64)


def test_in_common_and_of_its_own() -> None:
    """Noise-free, two recordings: E and phi0 in common and R_t of each, to 1e-7; names say whose."""
    found = calibrate([recording("a"), recording("b")], START, UNKNOWNS, varies=VARIES, settings=SETTINGS)
    assert [u.name for u in found.unknowns] == ["all.E", "all.phi0", "C.outlet.R_t of a", "C.outlet.R_t of b"]
    for name, value in found.values.items():
        assert value == pytest.approx(NETWORK.parameters()[name], rel=1e-7)
    assert [each.values["C.outlet.R_t"] for each in found.recordings] == pytest.approx([0.2, 0.3], abs=1e-7)
    assert (
        found.converged
        and all(each.values for each in found.recordings)
        and "C.outlet.R_t" not in {**found.values, **found.others}
    )
    assert sum(each.chi2 for each in found.recordings) == pytest.approx(found.chi2)
    pulse = recording("a").mean("A.P").std()
    assert all(each.rms["A.P"] < 1e-5 * pulse for each in found.recordings)


def test_all_in_common() -> None:
    """With one R_t for both, each recording shows what it does not explain, in Pa; noise is that of the mean beats."""
    found = calibrate([recording("a", 0.01), recording("b", 0.01)], START, UNKNOWNS, settings=SETTINGS)
    assert not any(each.values for each in found.recordings) and 0.2 < found.values["C.outlet.R_t"] < 0.3
    apart = calibrate([recording("a", 0.01), recording("b", 0.01)], START, UNKNOWNS, varies=VARIES, settings=SETTINGS)
    assert apart.chi2 / apart.dof == pytest.approx(1.0, abs=0.3) and apart.report == ()
    for one, other in zip(found.recordings, apart.recordings, strict=True):
        assert one.chi2 > 100.0 * other.chi2 and one.rms["C.P"] > 3.0 * other.rms["C.P"]
    assert sum(each.dof for each in apart.recordings) == pytest.approx(apart.dof)
    assert "worst in " in found.report[0] and (" of a (" in found.report[0] or " of b (" in found.report[0])


def test_more_recordings_tell_more() -> None:
    """Two recordings of one state halve the variance of one, to 25 %; values agree with those of one to 3 sd."""
    same = [replace(recording("a", 0.01)), replace(record(exact(), 8, 0.01, seed=5), source="a again.csv")]
    one, both = (calibrate(beats, START, UNKNOWNS, settings=SETTINGS) for beats in (same[0], same))
    assert both.sd / one.sd == pytest.approx(np.full(3, np.sqrt(0.5)), rel=0.25)
    assert np.all(np.abs(both.x - one.x) < 3.0 * one.sd)


def test_one_is_one_of_several() -> None:
    """A list of one recording gives every number of that recording, bit by bit; with it nothing can vary."""
    alone = calibrate(recording("a", 0.01), START, UNKNOWNS, settings=SETTINGS)
    listed = calibrate([recording("a", 0.01)], START, UNKNOWNS, settings=SETTINGS)
    with pytest.raises(ValueError, match=f"--varies {re.escape(VARIES[0])}: there is one recording to fit"):
        calibrate([recording("a", 0.01)], START, UNKNOWNS, varies=VARIES, settings=SETTINGS)
    assert listed.x.tolist() == alone.x.tolist() and listed.ci95 == alone.ci95
    assert listed.parameter_set() == alone.parameter_set() == alone.of(0).parameter_set()


def test_held_out() -> None:
    """c, R_t 0.05: with the mean R_t of a and b it is missed; with its own R_t nothing is left, and R_t is found."""
    found = calibrate([recording("a"), recording("b")], START, UNKNOWNS, varies=VARIES, settings=SETTINGS)
    held = judge(found, recording("c"), START, settings=SETTINGS)
    pulse = recording("c").mean("C.P").std()
    assert held.rms["C.P"] > 0.05 * pulse and held.refitted["C.P"] < 1e-4 * pulse
    assert held.values == {"C.outlet.R_t": pytest.approx(0.05, abs=1e-5)}
    common = calibrate([recording("a"), recording("b")], START, UNKNOWNS[:2], settings=SETTINGS)
    assert judge(common, recording("c"), START, settings=SETTINGS).refitted == {}


def test_starts() -> None:
    """Many starts of several recordings: each recording's own unknowns begin elsewhere, too; all end in one minimum."""
    tried = calibrate_from([recording("a", 0.01), recording("b", 0.01)], START, UNKNOWNS, 3, varies=VARIES,
                           settings=SETTINGS)  # fmt: skip
    assert [each.starts for each in tried.minima] == [(0, 1, 2)]
    assert len(tried.best.x) == 4


def test_starts_that_end_elsewhere() -> None:
    """What varies is said with its recording: one sentence of the other end, and its values in plain data."""
    lowest = calibrate([recording("a", 0.01), recording("b", 0.01)], START, UNKNOWNS, varies=VARIES, settings=SETTINGS)
    other = replace(lowest, x=lowest.x + 100.0 * lowest.sd, history=(lowest.history[0], (lowest.cost + 50.0,)))
    tried = Starts(2, 1, (Minimum(lowest, (0,), True), Minimum(other, (1,), True)), {})
    said = next(sentence for sentence in tried.report if "ended in another minimum" in sentence)
    assert "C.outlet.R_t of a 0." in said and "C.outlet.R_t of b 0." in said and "A.E " in said
    assert set(tried.plain()["minima"][1]["recordings"]) == {"a", "b"}


def test_labels() -> None:
    assert labels_of(["x/a.csv", "y/a.csv", "b.txt", "a.csv"]) == ["a", "a-2", "b", "a-3"]
    assert labels_of(["a-2.csv", "a.csv", "b/a.csv"]) == ["a-2", "a", "a-3"]


def test_refused() -> None:
    """One sentence each: what varies is an unknown; of several recordings it is said which lacks something."""
    both = [recording("a"), recording("b")]
    refused(lambda: calibrate(both, START, UNKNOWNS, varies=["*.outlet.C"], settings=SETTINGS), "--varies *.outlet.C",
            ["names none of the unknowns all.E, all.phi0, C.outlet.R_t"])  # fmt: skip
    without = replace(recording("b"), values={n: v for n, v in recording("b").values.items() if n != "inlet.Q"})
    refused(lambda: calibrate([recording("a"), without], START, UNKNOWNS, settings=SETTINGS), "dogs/b.csv",
            ["has no inlet.Q"])  # fmt: skip


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    """--and, --varies and --hold-out: one set for what is in common, one for each recording with all of its values."""
    for name in ENDS:
        waves = {n: np.append(w.ravel(), w[0, 0]) for n, w in recording(name, 0.01).values.items()}
        write_record(tmp_path / f"{name}.csv", np.arange(len(waves["A.P"])) * SETTINGS.dt, waves)
    assert SETTINGS.dt * recording("a").N == pytest.approx(PERIOD)
    write_network(START, tmp_path / "fork.toml")
    line = ["calibrate", str(tmp_path / "a.csv"), str(tmp_path / "fork.toml"), "--and", str(tmp_path / "b.csv")]
    line += [word for each in UNKNOWNS for word in ("--free", each)]
    more = ["--varies", VARIES[0], "--hold-out", str(tmp_path / "c.csv"), "--out", str(tmp_path / "dog.json")]
    done = CliRunner(env={"COLUMNS": "160"}).invoke(arterial_fmu.__main__.app, [*line, *more])
    assert done.exit_code == 0, done.output
    assert "c, not fitted" in done.output and "varying values fitted" in done.output
    common, a, b = (read_set(tmp_path / f"dog{label}.json") for label in ("", ".a", ".b"))
    assert set(a.values) == set(b.values) == set(common.values) | {"C.outlet.R_t"}
    assert a.values["A.E"] == b.values["A.E"] == common.values["A.E"]
    assert b.values["C.outlet.R_t"].value == pytest.approx(0.3, abs=0.01)
    told = json.loads((tmp_path / "dog.json").read_text())["provenance"]
    assert set(told["recordings"]) == {"a", "b"} and told["held_out"][0]["record"].endswith("c.csv")
    assert read_prior(tmp_path / "dog.json", START).network.parameters()["C.outlet.R_t"] == 0.2
    assert read_prior(tmp_path / "dog.b.json", START).network.parameters()["C.outlet.R_t"] > 0.29
    done = CliRunner().invoke(arterial_fmu.__main__.app, [*line, "--with", str(tmp_path / "c.csv")])
    assert done.exit_code == 2 and "--with: adds files to one recording" in " ".join(done.output.split())
    free = [*line[:5], "--free", UNKNOWNS[2]]
    done = CliRunner(env={"COLUMNS": "160"}).invoke(arterial_fmu.__main__.app, [*free, "--varies", VARIES[0]])
    assert done.exit_code == 0 and "95 % interval" not in done.output  # no table of common values without any
    assert "RMS residual over the beat" in done.output
    alone = [line[0], line[1], line[2], *line[5:], "--varies", VARIES[0]]
    done = CliRunner().invoke(arterial_fmu.__main__.app, alone)
    assert done.exit_code == 2 and "there is one recording to fit" in " ".join(done.output.split())
