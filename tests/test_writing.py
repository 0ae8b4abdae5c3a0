"""Files that commands write: looked at before the work, all or none, and nobody's edits or other results replaced."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from refused import refused
from test_command import run
from test_study import sheep, varied

from arterial_fmu.study.plan import plan_of
from arterial_fmu.study.store import Store
from discrepancy.workflow import discover
from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.inference.models.bench_network import bench_network
from fitting.results.parameter_set import read_set, write_set
from solver import load, write_network
from solver.errors import InputError
from solver.io.exit_codes import ExitCode
from solver.io.writing import check_destinations, write_all, write_folder


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Path]]:
    """A disk with room for two files; those that were begun."""
    begun: list[Path] = []
    real = Path.write_bytes

    def write(path: Path, content: bytes) -> int:
        begun.append(path)
        if len(begun) > 2:
            real(path, content[:1])
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, content)

    monkeypatch.setattr(Path, "write_bytes", write)
    yield begun


# --- all or none ----------------------------------------------------------------------------------------------------


def test_a_full_disk(tmp_path: Path, full: list[Path]) -> None:
    """The third of four files cannot be written: the old first stays, no new one is there, nor is the new folder."""
    (tmp_path / "a").write_text("old")
    files = {tmp_path / name: name for name in "abcd"}
    refused(lambda: write_all(files), tmp_path / "c", ["No space left on device"])
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a": "old"}
    full.clear()
    refused(lambda: write_folder(tmp_path / "new" / "one", dict.fromkeys("abcd", "x")), tmp_path, ["No space left"])
    assert [p.name for p in tmp_path.iterdir()] == ["a"] and len(full) == 3


def test_moving_is_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process is killed between two moves: the last file, the sign of a whole result, is not there."""
    old = {tmp_path / name: "old" for name in "abc"}
    write_all(old)
    real = os.replace

    def killed(aside: Path, target: Path) -> None:
        if target.name == "b":
            raise SystemExit
        real(aside, target)

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(SystemExit):
        write_all(dict.fromkeys(old, "new"))
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a": "new", "b": "old"}


def test_of_an_earlier_result(tmp_path: Path) -> None:
    """What the new result has not is removed; other files stay."""
    write_folder(tmp_path, {"figures/a": "1", "figures/b": "1", "page": "1"})
    (tmp_path / "mine").write_text("mine")
    written = write_folder(tmp_path, {"figures/a": "2", "page": "2"}, gone=["figures/b"])
    assert written == [tmp_path / "figures" / "a", tmp_path / "page"]
    left = {p.relative_to(tmp_path).as_posix(): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {"figures/a": "2", "page": "2", "mine": "mine"}


def test_two_files_of_one_name(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "a")
    refused(lambda: write_all({tmp_path / "a": "1", tmp_path / "link": "2"}), tmp_path / "link", ["two files"])
    assert not (tmp_path / "a").exists()


# --- before the work ------------------------------------------------------------------------------------------------


def test_destinations(tmp_path: Path) -> None:
    """Each obstacle has its sentence, and where there is none, nothing is left of the look."""
    (tmp_path / "file").write_text("")
    for path, folders, words in (
        (tmp_path / "no" / "a", False, "no folder"),
        (tmp_path / "file" / "a", True, "is a file, not a folder"),
        (tmp_path / "file" / "no" / "a", True, "cannot be made, as"),
        (tmp_path, False, "not a regular file"),
        (Path("/dev/null/x/a"), True, "as /dev/null is a file"),
        (Path("/proc/x/a"), True, "cannot be written"),
    ):
        refused(lambda path=path, folders=folders: check_destinations(path, folders=folders), "/", [words])
    check_destinations(None, tmp_path / "a", tmp_path / "file")
    check_destinations(tmp_path / "new" / "er" / "a", folders=True)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


OUT = {  # a place below a file
    "solve": "sheep --out file/x.csv",
    "import": "csv table.csv --out file/x.toml",
    "export": "sheep --out file/x.csv",
    "build": "sheep --out file/x",
    "run": "sheep.fmu --out file/x.csv",
    "virtual": "--out file/x",
    "fit": "AA.csv --site AA --h 0.38mm --out file/x.json",
    "cohort": "cohort.csv --out file/x",
    "calibrate": "AA.csv sheep --free all.E --out file/x.json",
    "check": "sheep_table1 sheep.fmu AA.csv --out file/x",
    "discover": "AA.csv --model sheep --out file/x",
    "isolability": "sheep --channels AA.P --out file/x.json",
    "study": "sheep --vary all.E=0.8..1.2x --out file/x",
}


@pytest.fixture(scope="module")
def inputs(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "file").write_text("")
    write_cohort(virtual_cohort(1, animals=1), folder)
    next(folder.glob("*_AA.csv")).rename(folder / "AA.csv")
    shutil.copy(fmus["sheep"], folder)
    assert run("export", "sheep", "--out", folder / "table.csv").exit_code == 0
    return folder


@pytest.mark.parametrize("name", OUT)
def test_told_before_the_work(name: str, inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An --out that cannot be: one sentence, before anything is simulated, fitted, run or built."""
    monkeypatch.chdir(inputs)

    def work(*_: Any, **__: Any) -> None:
        raise AssertionError("the work was begun")

    for where in (
        "arterial_fmu.cli.solve._run", "build_fmu.build_model", "arterial_fmu.cli.run.run_fmu",
        "fitting.cohort.virtual.virtual_cohort",
        "arterial_fmu.cli.terminal.record_options.beats_of", "fitting.cohort.fits.fit_cohort",
        "fitting.calibrate.multistart.calibrate_from",
        "fitting.check.fmu_check.check", "discrepancy.recordings.prepare", "discrepancy.plan.sensor_plan.plan_sensors",
        "arterial_fmu.study.command.run",
    ):  # fmt: skip
        monkeypatch.setattr(where, work)
    done = run(name, *OUT[name].split())
    assert done.exit_code == ExitCode.BAD_INPUT, done.output
    assert done.stderr.splitlines()[-1].startswith("Error: file") and "file" in done.stderr


@pytest.mark.parametrize("line", ["sheep", "heart --species human", "body --species human", "system human"])
def test_the_product_that_cannot_be_written(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """build names the file that it would make, before it does."""
    monkeypatch.setattr("build_fmu._pack", lambda *_: pytest.fail("the work was begun"))
    name = {"sheep": "sheep.fmu", "system": "human.ssp"}.get(line.split()[0], f"human_{line.split()[0]}.fmu")
    (tmp_path / name).mkdir()
    done = run("build", *line.split(), "--out", tmp_path)
    assert done.exit_code == ExitCode.BAD_INPUT
    assert f"Error: {tmp_path / name}: cannot be written (not a regular file)" in done.stderr


GIVEN = {  # a file that would be written, and a command that reads it
    "solve": ("net.toml", "net.toml --duration 0.1s --out net.toml"),
    "import": ("table.csv", "csv table.csv --out table.csv --force"),
    "export": ("net.toml", "net.toml --out ./net.toml --force"),
    "build": ("sheep.fmu", "sheep.fmu --set CA.E=5MPa --out ."),
    "run": ("sheep.fmu", "sheep.fmu --stop-time 0.1s --out sheep.fmu"),
    "fit": ("AA.csv", "AA.csv --site AA --h 0.38mm --bench link.toml --force"),
    "calibrate": ("set.json", "AA.csv sheep --free all.E --start set.json --out set.json"),
    "isolability": ("net.toml", "net.toml --channels AA.P --out net.toml"),
    "discover": ("model.toml", "AA.csv --model model.toml --out ."),
}


@pytest.mark.parametrize("name", GIVEN)
def test_what_is_read_is_not_replaced(name: str, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is both read and to be written, also by another path or link: refused, and as it was."""
    monkeypatch.chdir(tmp_path)
    for path in inputs.iterdir():
        shutil.copy(path, tmp_path)
    write_network(load("sheep"), "net.toml")
    write_network(bench_network("AA", read_set("sheep_table1"), 0.5), "model.toml")
    write_set(read_set("sheep_table1"), "set.json")
    Path("link.toml").symlink_to("AA.csv")
    file, line = GIVEN[name]
    before = Path(file).read_bytes()
    done = run(name, *line.split())
    assert done.exit_code == ExitCode.BAD_INPUT, done.output
    assert "is an input file and would be replaced; give another name or folder." in done.stderr
    assert Path(file).read_bytes() == before


# --- what others wrote ----------------------------------------------------------------------------------------------


def test_edited_files_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inputs: Path) -> None:
    """import, export and fit --bench do not replace a file that a person may have edited, but with --force."""
    monkeypatch.chdir(tmp_path)
    bench = ("fit", inputs / "AA.csv", "--site", "AA", "--h", "0.38 mm", "--bootstrap", "0", "--bench", "b.toml")
    for file, line in (
        ("sheep.csv", ("export", "sheep")),
        ("sheep.toml", ("import", "csv", inputs / "table.csv", "--out", "sheep.toml")),
        ("b.toml", bench),
    ):
        (tmp_path / file).write_text("edited")
        done = run(*line)
        assert done.exit_code == ExitCode.BAD_INPUT and f"{file}: exists and may have been edited" in done.stderr, (
            done.output
        )
        assert (tmp_path / file).read_text() == "edited"
        assert run(*line, "--force").exit_code == 0
        assert (tmp_path / file).read_text() != "edited"
        assert run(*line).exit_code == 0  # what it would write is there


def test_study_and_discover_do_not_mix(tmp_path: Path, inputs: Path) -> None:
    """Each refuses a folder that has results of the other, and leaves it as it is."""
    for command, sign, make in (
        ("discover", "plan.json", lambda folder: discover(inputs / "AA.csv", "sheep", folder)),
        ("study", "verdict.json", lambda folder: Store(folder, plan_of(sheep(), varied("all.E=1..2x"), 8, 1, None))),
    ):
        folder = tmp_path / command
        folder.mkdir()
        (folder / sign).write_text("{}")
        refused(lambda make=make, folder=folder: make(folder), folder, [f"give {command} another folder"])
        assert [p.name for p in folder.iterdir()] == [sign]


def test_an_unusable_record_replaces_no_study(tmp_path: Path, inputs: Path) -> None:
    """AA.P in mmHg under a title in kPa: the verdict is told, and the earlier study stays; one like itself does not."""
    out, record = tmp_path / "out", tmp_path / "wrong.csv"
    record.write_text((inputs / "AA.csv").read_text().replace("[mmHg]", "[kPa]", 1))
    earlier = {"verdict.json": '{"verdict": "effect"}', "model.toml": "model", "model.fmu": "fmu"}
    write_folder(out, earlier)
    outcome = discover(record, "sheep", out)
    assert (outcome.verdict, outcome.written) == ("unusable", False)
    assert "it holds an earlier study" in outcome.warnings[-1]
    assert {p.name: p.read_text() for p in out.iterdir()} == earlier
    done = run("discover", record, "--model", "sheep", "--out", out)
    assert done.exit_code == ExitCode.UNUSABLE and "wrote" not in done.output
    assert discover(record, "sheep", tmp_path / "new").written and discover(record, "sheep", tmp_path / "new").written


def test_a_place_that_takes_no_file_is_no_fault_of_the_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that is there and refuses files is an error of what was given, before the work and after it."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("solver.io.writing.tempfile.TemporaryFile", refuse)
    with pytest.raises(InputError, match=r"beat\.csv: cannot be written \(Permission denied\)"):
        check_destinations(tmp_path / "beat.csv")
    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(InputError, match=r"beat\.csv: cannot be written \(Permission denied\)"):
        write_all({tmp_path / "beat.csv": ""})
