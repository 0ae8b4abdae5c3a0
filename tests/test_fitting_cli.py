"""The commands of the fits: what a physiologist types, what it prints and writes, and one sentence where it cannot."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import refused_in_one_sentence
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from build_fmu import build
from fitting.pages.figures import loop_figure
from fitting.records.channels.spectral import coefficients
from fitting.records.read.record import read_record, write_record
from fitting.records.virtual import jarvik_pressure, measured, pressure_at, solve_radius, table_wall
from fitting.results.parameter_set import read_set, write_set
from fitting.wall.site_fit import fit
from solver import load, read_network, simulate_periodic

pytestmark = pytest.mark.usefixtures("one_process")

T = 0.4724  # s, no whole number of samples
WALL = table_wall("AA")


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(each) for each in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual recording of AA at 200 Hz, 15 beats, 40 dB."""
    path = tmp_path_factory.mktemp("cli")
    p = jarvik_pressure(T)
    c = coefficients(solve_radius(WALL, p, T, 256))[:120]
    c[1:] *= 2.0
    t = np.arange(round(15.2 * T * 200)) / 200
    rng = np.random.default_rng(3)
    channels = {"AA.P": measured(pressure_at(p, T, t), rng, 40.0), "AA.R": measured(pressure_at(c, T, t), rng, 40.0)}
    write_record(path / "AA.csv", t, channels, {"AA.P": "mmHg", "AA.R": "mm"})
    return path


def test_fit_writes_set_figure_and_bench(folder: Path) -> None:
    """Exit 0; E within its interval in JSON; SSV with the same start values; a bench network; the tables."""
    done = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--bootstrap", 20,
               "--out", folder / "AA.json", "--figure", folder / "AA.png",
               "--bench", folder / "bench.toml")  # fmt: skip
    assert done.exit_code == 0, done.output
    for text in (
        "E_inc = 1.5",
        "elastic law regression: ln evidence leads by",
        "(a lead of 3 decides)",
        "regression (kept)",
        "χ²/dof",
        "1 ms late",
        "bootstrap",
        "wave velocity",
        "distensibility",
    ):
        assert text in done.output
    found = read_set(folder / "AA.json")
    low, high = found.values["AA.E"].ci95 or (0.0, 0.0)
    assert low < WALL.E < high < 1.01 * low
    assert 5.0 < found.provenance["indices"]["wave_velocity"]["value"] < 7.0  # m/s
    assert found.provenance["sha256"] == read_record(folder / "AA.csv").sha256
    assert (folder / "AA.png").read_bytes().startswith(b"\x89PNG")
    assert read_network(folder / "bench.toml").segment("AA").E == found.values["AA.E"].value
    again = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "-q", "--bootstrap", 0,
                "--out", folder / "AA.ssv")  # fmt: skip
    assert again.output == ""
    assert read_set(folder / "AA.ssv").start_values() == found.start_values()


def test_check_on_the_bench(folder: Path, fast_fmu: Callable[..., Path]) -> None:
    """The set of a fit, its bench FMU and the recording: the radius agrees to the noise (whitened 1 ± 0.15)."""
    # another Poisson's ratio than the default: it must reach the FMU
    run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "-q", "--bootstrap", 0, "--out", folder / "b.json",
        "--bench", folder / "b.toml", "--eta", 0.45)  # fmt: skip
    fmu = fast_fmu(read_network(folder / "b.toml"), None)
    done = run("check", folder / "b.json", fmu, folder / "AA.csv", "--out", folder / "check")
    assert done.exit_code == 0, done.output
    assert "worst channel AA.R" in done.output
    report = json.loads((folder / "check" / "check.json").read_text())
    assert report["channels"]["AA.R"]["whitened"] == pytest.approx(1.0, abs=0.15)
    page = (folder / "check" / "check.html").read_text()
    assert "<img" in page and "E_inc = 1.6" in page and "elastic law regression: ln evidence leads by" in page


def test_other_models_and_options(folder: Path) -> None:
    """Linear: two models are not shown twice; R0 given; a free lag is reported; β-law in the set."""
    done = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--model", "linear", "--bootstrap", 0)
    assert done.exit_code == 0
    assert "(kept)" in done.output and "monotone" not in done.output
    assert "does not describe the loop" in done.output
    done = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--R0", "9.48 mm", "--lag", "--bootstrap", 0,
               "--period", "472.4 ms")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "(given)" in done.output
    assert "P is early by" in done.output  # by 0.1 ± 0.2 ms: not at all
    done = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--bootstrap", 0, "--law", "beta",
               "--out", folder / "beta.json")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert read_set(folder / "beta.json").texts["network.elastic_law"] == "beta"
    # a law that is far off with the R0 of another one, and a lag to hide it in
    done = run("fit", folder / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--law", "beta", "--R0", "9.48 mm", "--lag")
    assert done.exit_code == 2
    assert "phi0 and phiNL run away" in done.stderr


def test_virtual_cohort_and_its_fit(tmp_path: Path) -> None:
    """Two animals: records and cohort.csv, then of three sites results, claims and figures."""
    assert run("virtual", "--animals", 2, "--out", tmp_path / "v", "-q").exit_code == 0
    head, *rows = (tmp_path / "v" / "cohort.csv").read_text().splitlines()
    assert len(rows) == 14
    fitted = [row for row in rows if any(f",{site}," in row for site in ("AA", "MD", "CA"))]
    assert len(fitted) == 6
    (tmp_path / "v" / "cohort.csv").write_text("\n".join([head, *fitted, ""]))
    assert "virtual" in (tmp_path / "v" / "README.txt").read_text().lower()
    done = run("cohort", tmp_path / "v" / "cohort.csv", "--out", tmp_path / "c")
    assert done.exit_code == 0, done.output
    written = {path.suffix for path in (tmp_path / "c").iterdir()}
    assert {".json", ".png"} <= written
    assert "virtual" in done.output


@pytest.mark.slow
def test_calibrate_then_check_a_network(tmp_path: Path) -> None:
    """A synthetic record of the sheep network with E 10 % larger: found to 1e-4; the FMU repeats the record.

    The FMU's own steps and the record's 1 ms samples leave 1e-3 of the pulse.
    """
    sheep = load("sheep")
    stiff = sheep.with_parameters({f"{s.name}.E": 1.1 * s.E for s in sheep.segments})
    beat = simulate_periodic(stiff)
    names = ["inlet.Q", "AA.P", "CA.P", "FA.Q"]
    samples = {name: np.append(np.tile(beat[name][:-1], 3), beat[name][-1]) for name in names}
    write_record(tmp_path / "net.csv", np.arange(1501) * 1e-3, samples)
    done = run("calibrate", tmp_path / "net.csv", "sheep", "--free", "all.E", "--out", tmp_path / "net.json")
    assert done.exit_code == 0, done.output
    (row,) = (line for line in done.stdout.splitlines() if "CA.E" in line)
    assert row.split("│")[-2].strip() == "MPa"
    found = read_set(tmp_path / "net.json")
    for segment in stiff.segments:
        assert found.values[f"{segment.name}.E"].value == pytest.approx(segment.E, rel=1e-4)
    done = run("check", tmp_path / "net.json", build(sheep, tmp_path), tmp_path / "net.csv", "--out", tmp_path / "c")
    assert done.exit_code == 0, done.output
    channels = json.loads((tmp_path / "c" / "check.json").read_text())["channels"]
    assert max(channel["largest"] for channel in channels.values()) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("fit", "no.csv", "--site", "AA", "--h", "1 mm"), "no.csv"),
        (("fit", "AA.csv", "--site", "XX", "--h", "1 mm"), "XX.P"),
        (("fit", "AA.csv", "--site", "AA", "--h", "1 kg"), "--h"),
        (("fit", "AA.csv", "--site", "AA", "--h", "38 mm"), "h is 38 mm"),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--model", "cubic"), "cubic"),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--law", "hooke"), "hooke"),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--period", "5 s"), "period"),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--eta", "-0.3"), "eta = -0.3"),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--out", "AA.txt"), "AA.txt"),
        (
            ("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--out", "x.json", "--bench", "no/b.toml"),
            "no folder no",
        ),
        (("fit", "AA.csv", "--site", "AA", "--h", "0.38 mm", "--out", "x.json", "--figure", "."), "regular file"),
        (("virtual", "--dB", "nan", "--out", "v"), "nan"),
        (("virtual", "--animals", "0", "--out", "v"), "animals"),
        (("cohort", "AA.csv", "--out", "c"), "AA.csv"),
        (("calibrate", "AA.csv", "sheep", "--free", "all.E"), "inlet.Q"),
        (("calibrate", "AA.csv", "sheep", "--free", "all.X"), "X"),
        (("check", "sheep_table1", "no.fmu", "AA.csv"), "no.fmu"),
        (("check", "no.json", "no.fmu", "AA.csv"), "no.json"),
    ],
)
def test_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], sentence: str) -> None:
    """Exit code 2, one sentence on the error stream that names the thing, and nothing new in the folder."""
    monkeypatch.chdir(folder)
    refused_in_one_sentence(app, arguments, sentence, folder)


def test_loop_figure(folder: Path) -> None:
    """A panel a model and the spectrum, every axis with its unit."""
    from fitting.records.alignment.align import align

    beats = align(read_record(folder / "AA.csv"))
    figure = loop_figure([fit(beats, "AA", WALL.h, name) for name in ("linear", "monotone")], beats)
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
    assert labels[:2] == [("radius R, mm", "pressure P, mmHg")] * 2
    assert labels[2] == ("harmonic k", "Fourier coefficient, mmHg")


def test_set_of_a_bundled_name_is_start_values(folder: Path) -> None:
    """Table 1 by name: written again, read again, the same."""
    table1 = read_set("sheep_table1")
    write_set(table1, folder / "t1.json")
    assert read_set(folder / "t1.json") == table1
