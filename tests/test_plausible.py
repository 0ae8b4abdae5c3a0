"""Numbers that no artery has: refused at the door of every command that takes a record, with the likely unit."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refused import refused
from test_command import run

from fitting.check.fmu_run import RunFailed
from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.records.plausible import Artery, arteries, check_plausible
from fitting.records.read.columns import Reading
from fitting.records.read.record import Record, read_record, write_record
from fitting.results.parameter_set import ParameterSet, Value, write_set
from solver import load, simulate_periodic
from solver.io.exit_codes import ExitCode
from solver.quantities.units import MMHG

TIME = 1e-3 * np.arange(4000)
BEAT = 0.5 - 0.5 * np.cos(2.0 * np.pi * TIME / 0.5)  # 0 to 1, median 0.5
MM, KPA = 1e-3, 1e3


def pressure(mean: float, pulse: float) -> dict[str, np.ndarray]:
    """CA.P [Pa] of a mean and a pulse [mmHg]."""
    return {"CA.P": MMHG * (mean + pulse * (BEAT - 0.5))}


def radius(mean: float) -> dict[str, np.ndarray]:
    """CA.R [m] of a mean [mm]."""
    return {"CA.R": MM * mean * (1.0 + 0.05 * (BEAT - 0.5))}


def record(channels: dict[str, np.ndarray], scale: float = 1.0) -> Record:
    return Record("r.csv", "", TIME, channels, scales=dict.fromkeys(channels, scale))


ARTERY = Artery(R0=4 * MM, h=0.8 * MM, slope=2e5 * 0.8e-3 / (0.75 * 16e-6))


@pytest.mark.parametrize("mean", [40.0, 95.0, 187.0])
def test_kPa_and_mmHg(mean: float) -> None:
    """Means from 40 to 187 mmHg, pulses of 0.45 of them: as they are, and with kPa and mmHg confused either way."""
    known = {"CA": replace(ARTERY, slope=None)}
    check_plausible(record(pressure(mean, 0.45 * mean), MMHG), known)
    fit = 'its numbers fit the unit {0}: correct the title, or --map "CA.P=CA.P [{0}]", or --as-measured'
    for factor, read, true in ((MMHG / KPA, MMHG, "kPa"), (KPA / MMHG, KPA, "mmHg"), (1.0 / MMHG, 1.0, "mmHg")):
        wrong = record(pressure(factor * mean, factor * 0.45 * mean), read)
        refused(lambda wrong=wrong: check_plausible(wrong, known), "r.csv: CA.P: its ", [fit.format(true)])


@pytest.mark.parametrize(
    ("title", "given", "scale", "option", "R0"),
    [
        ("Pressure (kPa)", "CA.P", 1.0, "Pressure (kPa)=CA.P [mmHg]", None),
        ("Cath", "CA.P [kPa]", 1.0, "Cath=CA.P [mmHg]", None),
        ("Diam (cm)", "CA.D", 2.0, "Diam (cm)=CA.D [mm]", None),
        ("Radius (cm)", "CA.R", 0.2, "Radius (cm)=CA.D [cm]", 4.0),
        ("Sono", "-CA.R [mm]", -2.0, "Sono=-CA.D [mm]", 4.0),
    ],
)  # fmt: skip
def test_the_option_that_is_advised_reads_the_column(
    tmp_path: Path, title: str, given: str, scale: float, option: str, R0: float | None
) -> None:
    """It has the title of the file, and a diameter stays one: pasted in place of the wrong one it is accepted."""
    values = (pressure(95.0, 40.0)["CA.P"] / MMHG if ".P" in given else radius(4.4)["CA.R"] / MM) * scale
    path = tmp_path / "r.csv"
    rows = "\n".join(f"{t:.4f},{x:.6f}" for t, x in zip(TIME, values, strict=True))
    path.write_text(f"Time [s],{title}\n{rows}\n")
    known = {"CA": Artery(R0=R0 and R0 * MM)}
    wrong = read_record(path, Reading(names={title: given}))
    refused(lambda: check_plausible(wrong, known), f"{path}: CA.", [f'--map "{option}"'])
    check_plausible(read_record(path, Reading(names=dict([option.split("=")]))), known)


def test_pressures_that_are_none_of_an_artery_or_are_one() -> None:
    """Lungs (20/9 mmHg), a giraffe, shock, and the published sheep, whose pressures are told from a reference, pass;
    a vein does not, nor a pulse of 250 mmHg."""
    for mean, pulse in ((14.0, 11.0), (200.0, 80.0), (30.0, 15.0), (8.0, 13.0), (-3.0, 20.0)):
        check_plausible(record(pressure(mean, pulse)), {})
    for mean, pulse, words in ((9.0, 4.0, "its pulse but 0.44 of that"), (150.0, 250.0, "its pulse is 250 mmHg")):
        refused(lambda m=mean, p=pulse: check_plausible(record(pressure(m, p)), {}), "r.csv: CA.P", [words])


def test_a_flow_under_the_title_of_a_pressure() -> None:
    """Swapped columns: from -80 to 520 mL/s, read as mmHg. In Pa its pulse would be an artery's, but no unit makes a
    number that falls below zero a pressure above it: so the column is asked for first."""
    flow = {"CA.P": MMHG * (600.0 * np.maximum(BEAT - 0.4, -0.13))}
    first = "its pulse is 438 mmHg, and that of arteries from 2 to 200 mmHg; it falls to zero or below, as a flow does"
    words = [first, "check that the column is a pressure; if it is, its numbers fit the unit Pa: correct the title"]
    refused(lambda: check_plausible(record(flow, MMHG), {}), "r.csv: CA.P: its ", words)


def test_lengths() -> None:
    """mm read as cm and the reverse, by the wall's thickness or the model's radius; a diameter; another artery."""
    thick = {"CA": Artery(h=0.8 * MM)}
    check_plausible(record(radius(4.1), MM), {"CA": ARTERY})
    for channels, scale, known, words in (
        (radius(41.0), 1e-2, {}, "its numbers fit the unit mm"),
        (
            radius(31.0),
            1e-2,
            {"CA": Artery(h=0.6 * MM)},
            "h is 0.6 mm, which is 0.019 of it, where",
        ),
        (radius(0.41), MM, thick, "its numbers fit the unit cm"),
        (radius(8.2), MM, {"CA": ARTERY}, 'a diameter: give it as one, --map "CA.R=CA.D [mm]"'),
        (radius(41.0), 1e-2, {"CA": ARTERY}, "its numbers fit the unit mm"),
        (radius(13.0), MM, {"CA": ARTERY}, "check its unit, its sensor, and whether it is of this artery"),
    ):
        wrong = record(channels, scale)
        refused(lambda wrong=wrong, known=known: check_plausible(wrong, known), "r.csv: CA.R: its mean", [words])


def test_pressure_against_radius() -> None:
    """Where the wall is known: P rises with R by 6 times the model's dP/dR, or a sixth, at most."""
    pulse = ARTERY.slope * 0.05 * 4.1 * MM / MMHG  # type: ignore[operator]
    for factor in (0.2, 5.0):
        check_plausible(record(pressure(0.0, factor * pulse) | radius(4.1)), {"CA": ARTERY})
    for factor in (1.0 / 7.5, 7.5):
        wrong = record(pressure(0.0, factor * pulse) | radius(4.1))
        refused(lambda wrong=wrong: check_plausible(wrong, {"CA": ARTERY}), "r.csv: CA.P: it rises", ["as steeply"])


def test_flows() -> None:
    """A peak of 0.5 m/s passes; of 60 times that, mL/min read as mL/s, does not."""
    Q = 0.5 * np.pi * (4 * MM) ** 2 * BEAT
    check_plausible(record({"CA.Q": Q}, 1e-6), {"CA": ARTERY})
    wrong = record({"CA.Q": 60.0 * Q}, 1e-6)
    refused(lambda: check_plausible(wrong, {"CA": ARTERY}), "r.csv: CA.Q: its peak is 30 m/s", ["the unit mL/min"])


def test_published_networks_are_plausible() -> None:
    """The beats of every network that comes along with arteries of animals, at all its sites."""
    for name in ("sheep", "human", "cca"):
        network = load(name)
        beat = simulate_periodic(network, tolerance=1e-2)
        channels = {n: beat[n] for n in beat.columns if n[-2:] in (".P", ".Q", ".R")}
        check_plausible(Record(name, "", beat.time, channels), arteries(network))


# --- the doors ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """wrong.csv: AA of a virtual animal whose pressure has [kPa] for [mmHg] in its title; a cohort of it; an FMU."""
    folder = tmp_path_factory.mktemp("doors")
    write_cohort(virtual_cohort(1, animals=1), folder)
    right = next(folder.glob("*_AA.csv"))
    (folder / "wrong.csv").write_text(right.read_text().replace("[mmHg]", "[kPa]", 1))
    (folder / "wrong_cohort.csv").write_text("animal,site,record,h [mm],R0 [mm]\n1,AA,wrong.csv,0.38,\n")
    shutil.copy(fmus["sheep"], folder)
    network = read_record(folder / "wrong.csv")
    flow = {"inlet.Q": 50e-6 * np.sin(2.0 * np.pi * network.time / 0.5) ** 2, "AA.P": network.channels["AA.P"]}
    write_record(folder / "wrong_network.csv", network.time, flow, {"AA.P": "kPa"})
    return folder


@pytest.mark.parametrize(
    "line",
    [
        "fit wrong.csv --site AA --h 0.38mm --bootstrap 0",
        "cohort wrong_cohort.csv --out c",
        "calibrate wrong_network.csv sheep --free all.E",
        "check sheep_table1 sheep.fmu wrong_network.csv --out k",
        "discover wrong_network.csv --model sheep --out d",
    ],
)
def test_at_the_door(line: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One sentence with the unit; no result of a wall that is 7.5 times too stiff."""
    monkeypatch.chdir(folder)
    done = run(*line.split())
    assert done.exit_code == (ExitCode.UNUSABLE if line.startswith("discover") else ExitCode.BAD_INPUT), done.output
    assert "AA.P: its mean is" in done.output and "its numbers fit the unit mmHg" in done.output


def test_as_measured(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A phantom is fitted all the same."""
    monkeypatch.chdir(folder)
    line = "fit wrong.csv --site AA --h 0.38mm --bootstrap 0 --as-measured".split()
    assert run(*line, "--out", tmp_path / "AA.json").exit_code == 0
    assert run("cohort", "wrong_cohort.csv", "--as-measured", "--out", tmp_path / "c").exit_code == 0


def test_a_set_of_another_artery(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A set whose CA has a radius of 13 mm: said before the FMU is run, not when its viscosity turns negative."""
    monkeypatch.chdir(folder)
    write_set(ParameterSet("rat", {"CA.R0": Value(0.013, "m"), "CA.E": Value(1e6, "Pa")}), tmp_path / "rat.json")
    monkeypatch.setattr("fitting.check.fmu_build.periodic_answer", lambda *_: pytest.fail("the FMU was run"))
    done = run("check", tmp_path / "rat.json", "sheep.fmu", "wrong_network.csv", "--out", tmp_path / "k")
    assert done.exit_code == ExitCode.BAD_INPUT
    assert "its CA.R0 is 13 mm, that of the FMU sheep is 4.06 mm: the set is of another artery" in done.stderr


def test_a_set_of_another_network(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrated in a network of another name: where the FMU then fails, the sentence says so."""

    def fail(*_: object) -> None:
        raise RunFailed("sheep.fmu: the effective wall viscosity turned negative.")

    monkeypatch.setattr("fitting.check.fmu_build.periodic_answer", fail)
    for network in ("goat", "sheep"):
        write_set(ParameterSet("s", {"CA.E": Value(1e6, "Pa")}, provenance={"network": network}), tmp_path / "s.json")
        line = (tmp_path / "s.json", folder / "sheep.fmu", folder / "wrong_network.csv", "--as-measured")
        done = run("check", *line, "--out", tmp_path / "k")
        assert "viscosity turned negative." in done.stderr
        assert ("s was calibrated in the network goat, and the FMU is sheep." in done.stderr) == (network == "goat")
