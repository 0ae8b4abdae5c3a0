"""``arterial-fmu``: one command for everything. Its names, its exit codes, its JSON, its progress, its completion."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shellingham
from commands import without_progress
from test_discrepancy_cli import outcome, plan
from typer.testing import CliRunner

import arterial_fmu.__main__
from arterial_fmu.cli.commands import COMMANDS, load
from arterial_fmu.cli.terminal import progress
from arterial_fmu.cli.terminal.options import networks_for
from discrepancy.findings.outcome import verdict_json
from discrepancy.plan.sensor_plan import plan_json
from fitting.results.parameter_set import read_set
from solver.io.exit_codes import ExitCode

ROOT = Path(__file__).resolve().parents[1]
HEAVY = {"numpy", "scipy", "matplotlib", "polars", "fmpy", "pint", "rich.progress", "solver", "fitting", "discrepancy"}


def run(*arguments: object, **environment: str) -> Any:
    """A command in this process, without a terminal."""
    runner = CliRunner(env={"COLUMNS": "160", **environment})
    return runner.invoke(arterial_fmu.__main__.app, [str(each) for each in arguments], prog_name="arterial-fmu")


def printed(*arguments: object) -> dict[str, Any]:
    """The JSON object on the output of a command that went well, which holds nothing else."""
    done = run(*arguments, "--json")
    assert done.exit_code == ExitCode.DONE, done.output
    found = json.loads(done.stdout)
    assert isinstance(found, dict)
    return found


# --- names ----------------------------------------------------------------------------------------------------------


def test_help_imports_nothing_heavy() -> None:
    """--help knows every name, and loads neither NumPy nor the packages behind the commands."""
    code = (
        "import sys; from arterial_fmu.__main__ import main; sys.argv[1:] = ['--help']\n"
        "try: main()\n"
        f"finally: print(sorted({HEAVY} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (0, "[]")
    assert all(f"  {name} " in done.stdout and command.does in done.stdout for name, command in COMMANDS.items())


WRONG = (
    "first no.csv", "fit no.csv --site AA --h 0.4mm", "fit r.csv --site AA --h 0.4",
    "calibrate no.csv sheep --free all.E", "calibrate r.csv no.toml --free all.E", "check no.json sheep r.csv",
    "check sheep_table1 sheep r.csv --backend no", "discover no.csv --out o", "discover r.csv --out o --model no.toml",
    "discover r.csv --out o --walls no", "isolability no.toml --channels AA.P", "cohort no.csv --out o",
)  # fmt: skip


def test_refusals_import_nothing_heavy(tmp_path: Path) -> None:
    """A missing file, a number without unit or an unknown word is refused before the imports that take seconds."""
    (tmp_path / "r.csv").touch()
    late = {"scipy.linalg", "scipy.optimize", "matplotlib", "polars", "fmpy", "jinja2"}
    code = (
        "import sys; from arterial_fmu.__main__ import app\n"
        f"for line in {WRONG}:\n"
        "    try: app(line.split())\n"
        f"    except SystemExit as end: print(line, end.code, sorted({late} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.splitlines() == [f"{line} 2 []" for line in WRONG], done.stderr
    assert done.stderr.count("Error: ") == len(WRONG)


def commands() -> list[tuple[str, ...]]:
    """Every command, and those inside build and import."""
    found: list[tuple[str, ...]] = []
    for name in COMMANDS:
        inside = getattr(load(name), "commands", None)
        found += [(name, each) for each in inside] if inside else [(name,)]
    return found


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_help_and_json(words: tuple[str, ...]) -> None:
    """Every command has a --help of its own, and --json."""
    done = run(*words, "--help")
    assert done.exit_code == 0
    assert f"Usage: arterial-fmu {' '.join(words)} " in done.stdout
    assert "--json" in done.stdout


def test_version_and_unknown_names() -> None:
    """--version; a name that is none is answered with one that is."""
    version, steps = run("--version").stdout.splitlines()
    assert version == f"arterial-fmu {import_module('fmu_src').__version__}"
    assert steps.startswith(("steps by NumPy and the compiled engine (", "steps by NumPy; the compiled engine "))
    done = run("solv")
    assert done.exit_code == ExitCode.BAD_INPUT
    assert "Did you mean 'solve'?" in done.stderr


# --- exit codes -----------------------------------------------------------------------------------------------------

BAD = {
    "solve": [("no.toml",), ("sheep", "--dt", "1 kg")],
    "list": [("--nonsense",)],
    "import": [("csv", "no.csv"), ("openbf", "no.yaml")],
    "export": [("no.toml",)],
    "build": [("no.toml",), ("heart", "--species", "cat"), ("body", "--set", "x"), ("system", "cca")],
    "run": [("no.fmu",), ("README.md",)],
    "doctor": [("no.fmu",), ("README.md",)],
    "virtual": [("--animals", "0", "--out", "v")],
    "fit": [("no.csv", "--site", "AA", "--h", "1 mm"), ("README.md", "--site", "AA", "--h", "1 mm"), ("no.csv",)],
    "cohort": [("no.csv", "--out", "c")],
    "first": [("no.csv",), ("README.md", "--like", "cat"), ("no.csv", "--distance", "FA")],
    "calibrate": [("no.csv", "sheep", "--free", "all.E")],
    "check": [("sheep_table1", "no.fmu", "no.csv")],
    "discover": [("no.csv", "--model", "sheep", "--out", "o")],
    "isolability": [("no.toml", "--channels", "AA.P"), ("sheep", "--channels", "XX.P")],
    "study": [
        ("sheep", "--out", "o"),
        ("no.toml", "--vary", "all.E=0.8..1.2x", "--out", "o"),
        ("sheep", "--vary", "all.X=0.8..1.2x", "--out", "o"),
        ("sheep", "--vary", "all.E=0.8..1.2x", "--out", "o", "--samples", "3"),
        ("sheep", "--vary", "all.E=0.8..1.2x", "--out", "o", "--sites", "XX"),
        ("sheep", "--vary", "all.E=0.8..1.2x", "--out", "o", "--jobs", "0"),
        ("sheep", "--vary", "all.E=0.8..1.2x", "--out", "o", "--inflow", "no.csv"),
        ("no.fmu", "--vary", "all.E=0.8..1.2x", "--out", "o"),
    ],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_bad_input(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Exit code 2 and one sentence on the error stream; nothing on the output, no traceback, no file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "README.md").write_text("not what was asked for")
    for arguments in BAD[name]:
        for option in ((), ("--json",)):
            done = run(name, *arguments, *option)
            assert done.exit_code == ExitCode.BAD_INPUT == 2, done.output
            if name != "doctor":  # whose findings are its result
                assert done.stdout == ""
                assert done.stderr.strip().splitlines()[-1].startswith("Error: ")
                assert done.stderr.count("Error: ") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]


def test_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C: 130, and one sentence that says what is left."""

    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("arterial_fmu.cli.solve.simulate_periodic", stop)
    done = run("solve", "sheep")
    assert (done.exit_code, done.stderr) == (ExitCode.INTERRUPTED, "Interrupted: nothing was written.\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is full")
@pytest.mark.parametrize("line", ["list --json", "solve sheep --duration 10ms"])
def test_output_that_cannot_be_written(line: str) -> None:
    """A disk without room is a sentence; a reader that has enough, the code of SIGPIPE; none at all is fine."""
    command = [sys.executable, "-m", "arterial_fmu", *line.split()]
    with open("/dev/full", "w") as disk:
        done = subprocess.run(command, stdout=disk, stderr=subprocess.PIPE, text=True)
    assert done.returncode == ExitCode.BAD_INPUT
    assert without_progress(done.stderr) == (
        "Error: the output cannot be written (No space left on device); check where it goes.\n"
    )
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (done.returncode, without_progress(done.stderr)) == (ExitCode.NOT_READ, "")
    closed = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], stderr=subprocess.PIPE, text=True)
    assert (closed.returncode, without_progress(closed.stderr)) == (ExitCode.DONE, "")


def test_the_table_of_exit_codes() -> None:
    """The page of the command line says what each means."""
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    table = page.partition("| Code | Meaning |\n|---|---|\n")[2].partition("\n\n")[0]
    assert [int(row.split("|")[1]) for row in table.splitlines()] == list(ExitCode)


# --- JSON -----------------------------------------------------------------------------------------------------------


def test_json_of_a_run(tmp_path: Path) -> None:
    """solve: the range and the mean of every variable of the last beat, as in the table; a mean over time."""
    out = tmp_path / "beat.csv"
    found = printed("solve", "sheep", "--dt", "5 ms", "--out", out)
    titles = out.read_text().splitlines()[0].split(",")
    table = dict(
        zip((title.split(" ")[0] for title in titles), np.loadtxt(out, delimiter=",", skiprows=1).T, strict=True)
    )
    time = table.pop("time")
    assert list(found["variables"]) == list(table)
    for name, values in table.items():
        mean = np.trapezoid(values, time) / np.ptp(time)
        each = found["variables"][name]
        np.testing.assert_allclose([each["min"], each["max"], each["mean"]], [values.min(), values.max(), mean], 1e-9)
    assert found["network"] == "sheep" and found["change"] < 1e-5 and found["written"] == [str(out)]
    assert printed("solve", "sheep", "--dt", "5 ms", "--duration", "10 ms")["change"] is None


def test_json_of_networks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """list, export, import: what it is, how large, and which files were written."""
    monkeypatch.chdir(tmp_path)
    listed = {each["name"]: each for each in printed("list")["networks"]}
    assert listed["sheep"]["segments"] == 10 and listed["sheep"]["species"] == "sheep"
    assert printed("export", "sheep") == {"name": "sheep", "segments": 10, "outlets": 5, "written": ["sheep.csv"]}
    again = printed("import", "csv", "sheep.csv", "--out", "again.toml")
    assert (again["segments"], again["outlets"], again["written"]) == (10, 5, ["again.toml"])


def test_json_of_fmus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """build, run, doctor: a file and its size; the ranges of all inputs and outputs; the findings."""
    monkeypatch.chdir(tmp_path)
    built = printed("build", "sheep")
    assert built == {"written": ["dist/sheep.fmu"], "bytes": Path("dist/sheep.fmu").stat().st_size}
    line = [sys.executable, "-m", "arterial_fmu", "run", "dist/sheep.fmu", "--stop-time", "10 ms", "--json"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}  # a process that has run an FMU keeps its code
    done = subprocess.run(line, capture_output=True, text=True, check=True, env=environment)
    found = json.loads(done.stdout)
    assert found["written"] == ["result.csv"] and Path("result.csv").is_file()
    assert found["variables"]["CA.P"]["unit"] == "Pa"
    examined = run("doctor", "dist/sheep.fmu", "--json")
    assert examined.exit_code in (ExitCode.DONE, ExitCode.DOES_NOT_RUN)
    assert json.loads(examined.stdout)["findings"][0]["what"] == "file"


def test_json_of_fits(tmp_path: Path) -> None:
    """virtual: its files; fit: a parameter set, as --out writes it."""
    made = printed("virtual", "--animals", "1", "--out", tmp_path / "v")["written"]
    assert made[0] == str(tmp_path / "v" / "cohort.csv") and len(made) > 1 and all(map(os.path.isfile, made))
    record = next(name for name in made if name.endswith("_AA.csv"))
    out = tmp_path / "AA.json"
    done = run("fit", record, "--site", "AA", "--h", "0.38 mm", "--bootstrap", "0", "--out", out, "--json")
    assert done.exit_code == 0, done.output
    assert done.stdout == out.read_text(encoding="utf-8")
    assert read_set(out).values["AA.E"].ci95 is not None
    assert f"wrote {out}" in done.stderr


def test_json_of_diagnoses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """discover: what verdict.json holds; isolability: the plan."""
    monkeypatch.setattr("discrepancy.workflow.discover", lambda *_, **__: outcome())
    monkeypatch.setattr("discrepancy.plan.sensor_plan.plan_sensors", lambda *_, **__: plan())
    record = tmp_path / "r.csv"
    record.touch()
    assert printed("discover", record, "--model", "sheep", "--out", "o") == verdict_json(outcome())
    assert printed("isolability", "sheep", "--channels", "AA.P") == plan_json(plan())
    unusable = outcome(verdict="unusable", effects=(), gap_before=None, gap_after=None, reason="too short.")
    monkeypatch.setattr("discrepancy.workflow.discover", lambda *_, **__: unusable)
    done = run("discover", record, "--model", "sheep", "--out", "o", "--json")
    assert done.exit_code == ExitCode.UNUSABLE == 3
    assert json.loads(done.stdout)["verdict"] == "unusable" and "Unusable: too short." in done.stderr


# --- progress -------------------------------------------------------------------------------------------------------


def test_lines_come_in_time() -> None:
    """None in the first two seconds, then one every ten."""
    now, written = [0.0], list[str]()
    report = progress.lines(written.append, lambda: now[0])
    for now[0], fraction in ((0.0, 0.0), (1.9, 0.1), (2.0, 0.0), (3.0, 0.3), (11.9, 0.4), (12.0, 0.5), (30.0, 1.0)):
        report(fraction, f"at {now[0]:g} s")
    assert written == ["at 2 s", "at 12 s (50 %)", "at 30 s (100 %)"]


def test_progress_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plain lines on the error stream, nothing among the JSON; none with --quiet."""
    monkeypatch.setattr(progress, "FIRST", 0.0)
    monkeypatch.setattr(progress, "NEXT", 0.0)
    done = run("solve", "sheep", "--dt", "5 ms", "--json")
    assert json.loads(done.stdout)["network"] == "sheep"
    lines = done.stderr.splitlines()
    assert len(lines) >= 5 and "\x1b" not in done.stderr and lines[-1].endswith("%)")
    assert run("solve", "sheep", "--dt", "5 ms", "--quiet").output == ""


def test_progress_of_one_that_reports_nothing(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """In a pipe its name is said once it has taken long; not if it was quick."""
    with progress.bar(False, "building"):
        pass
    monkeypatch.setattr(progress, "FIRST", 0.0)
    with progress.bar(False, "building"):
        while not (said := capfd.readouterr().err):
            pass
    assert said == "building\n"


def test_progress_in_a_terminal() -> None:
    """A bar is drawn on the terminal and erased; the JSON goes where the output goes."""
    main, side = pty.openpty()
    line = [sys.executable, "-m", "arterial_fmu", "solve", "sheep", "--dt", "5 ms", "--json"]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=side, env=environment, cwd=ROOT) as process:
        os.close(side)
        drawn = b""
        while chunk := _read(main):
            drawn += chunk
        assert process.stdout is not None
        assert json.loads(process.stdout.read())["network"] == "sheep"
    os.close(main)
    assert process.returncode == 0
    assert "━".encode() in drawn and b"\x1b[2K" in drawn  # the bar, and the line erased


def _read(terminal: int) -> bytes:
    """What was written; nothing once the other side is closed, which Linux says by an error."""
    try:
        return os.read(terminal, 65536)
    except OSError:
        return b""


# --- completion -----------------------------------------------------------------------------------------------------


def test_a_doi_is_never_cut() -> None:
    """In 80 columns every DOI of ``list`` stands whole on a line."""
    lines = run("list", COLUMNS="80").stdout
    assert "doi:10.1080/10255842.2014.948428" in lines and "…" not in lines
    assert max(map(len, lines.splitlines())) <= 80


def completed(*words: str) -> list[str]:
    """What bash offers for the last word."""
    line = {"COMP_WORDS": " ".join(["arterial-fmu", *words]), "COMP_CWORD": str(len(words))}
    return run(_ARTERIAL_FMU_COMPLETE="complete_bash", **line).stdout.splitlines()


def test_completion(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Commands, options, networks that come along and files that could be models."""
    monkeypatch.chdir(tmp_path)
    for name in ("she.toml", "she.fmu", "she.csv"):
        (tmp_path / name).write_text("")
    (tmp_path / "sheds").mkdir()
    assert completed("so") == ["solve"]
    assert completed("solve", "she") == ["sheep", "sheep_nonlinear", "she.fmu", "she.toml", "sheds/"]
    assert completed("solve", "sheep", "--sch") == ["--scheme"]
    assert completed("build", "sy") == ["system"] and completed("build", "wa") == ["wang55"]
    assert completed("import", "") == ["openbf", "csv"]
    assert completed("discover", "r.csv", "--model", "wa") == ["wang55"]
    assert networks_for("no") == []


def test_completion_is_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """``--install-completion`` in bash writes a script for the name arterial-fmu."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(shellingham, "detect_shell", lambda *_: ("bash", "/bin/bash"))
    assert run("--install-completion").exit_code == 0
    script = (tmp_path / ".bash_completions" / "arterial-fmu.sh").read_text()
    assert "_ARTERIAL_FMU_COMPLETE=complete_bash" in script and "arterial-fmu" in (tmp_path / ".bashrc").read_text()
