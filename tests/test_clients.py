"""Hosts of other makers drive the same FMU with the same inflow: FMPy, ecos, libcosim, and one of our own in C.

None of them interpolates: inlet.Q = Q(t) is set before the step from t. So they must give the same answers, and where
they make the same calls, the same bits. Each host runs in a process of its own; see tests/clients. ecos and libcosim
know no Enumerations: which interpolation is the FMU's own start value, given when it is built.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from c_host import CHost, unpack
from fmus import Store

from build_fmu import build
from fmu_src.contents.models import body_model, heart_model
from fmu_src.importer import doctor
from fmu_src.variables.arteries_variables import INTERPOLATIONS
from solver import Network, load

CLIENTS = Path(__file__).parent / "clients"
STEP = 1e-3
N = 50  # steps


@dataclass(frozen=True)
class Job:
    """What every host does with an FMU: start values by name as (FMI type, value), inflow, and the outputs to read."""

    fmu: str
    folder: str
    starts: dict[str, tuple[str, Any]]
    inflow: Sequence[float]
    outputs: Sequence[str]
    step: float = STEP


def job(fmu: Path, folder: Path) -> Job:
    """A half-sine inflow into an FMU of the sheep network, with two start values: a parameter and an input."""
    variables = {v.name: v for v in fmpy.read_model_description(os.fspath(fmu)).modelVariables}
    starts = {"CA.phi0": ("Real", 2e3), "CA.outlet.P_venous": ("Real", 200.0)}
    outputs = [name for name, v in variables.items() if v.causality == "output"]
    inflow = load("sheep").inlet.Q(np.arange(N) * STEP).tolist()
    return Job(os.fspath(fmu), os.fspath(folder / "unzipped"), starts, inflow, outputs)


def run_client(name: str, jobs: Sequence[Job], folder: Path) -> np.ndarray:
    """The outputs after each step that a host in tests/clients found in one process : (jobs, n, outputs)."""
    return run_script(f"with_{name}", json.dumps([*map(vars, jobs)]), folder)


def run_script(name: str, job: str, folder: Path) -> np.ndarray:
    """The table that a script of tests/clients prints, and nothing beside it."""
    order = folder / f"{name}.json"
    order.write_text(job)
    line = [sys.executable, os.fspath(CLIENTS / f"{name}.py"), os.fspath(order)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=300, cwd=folder)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def run_c(host: CHost, job: Job, folder: Path, environment: Mapping[str, str] | None = None) -> np.ndarray:
    """The same with the host in C."""
    fmu = unpack(Path(job.fmu), folder / "c_host")
    set_starts = [f"set{kind} 0 {fmu.references[name]} {value!r}" for name, (kind, value) in job.starts.items()]
    read = " ".join(["getReal 0", *(str(fmu.references[name]) for name in job.outputs)])
    commands = [f"library 0 {fmu.library}", fmu.instantiate(0), "setup 0 0 1", *set_starts, "enter 0", "exit 0"]
    for i, Q in enumerate(job.inflow):
        commands += [f"setReal 0 {fmu.references['inlet.Q']} {Q!r}", f"step 0 {i * job.step!r} {job.step!r}", read]
    run = host.run([*commands, "terminate 0", "free 0"], environment)
    assert (run.code, run.errors) == (0, "")
    assert {answer.status for answer in run.answers} == {"ok"}
    start = commands.index(read)
    return np.array([answer.values for answer in run.answers[start : len(commands) : 3]])


def skip_unless_installed(name: str) -> None:
    """ecos needs a library that it does not bring."""
    package = {"ecos": "ecospy", "libcosim": "libcosimpy"}.get(name)
    if package and (said := not_loaded(package)):
        pytest.skip(said)


@cache
def not_loaded(package: str) -> str:
    """Why a package cannot be used, if so."""
    if find_spec(package) is None:
        return f"{package} is not installed"
    done = subprocess.run([sys.executable, "-c", f"import {package}"], capture_output=True, text=True)
    why = (done.stderr.strip().splitlines() or [""])[-1]
    return f"{package} cannot be loaded ({why}); apt-get install libtbb12" if done.returncode else ""


@pytest.fixture(scope="module")
def built(sheep: Network, stored: Store) -> dict[str, Path]:
    """The sheep FMU by its start value of inlet.interpolation."""
    return {kind: stored(build, sheep, starts={"inlet.interpolation": kind}) for kind in INTERPOLATIONS}


@pytest.fixture(scope="module")
def reference(built: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """What FMPy finds, call by call."""
    folder = tmp_path_factory.mktemp("fmpy")
    found = run_client("fmpy", [job(fmu, folder / kind) for kind, fmu in built.items()], folder)
    return dict(zip(built, found, strict=True))


TOGETHER = ("simulate_fmu", "libcosim")  # which take all FMUs in one process
FOUND: dict[tuple[str, Path], np.ndarray] = {}


def check_client(
    client: str,
    kind: str,
    built: Mapping[str, Path],
    reference: Mapping[str, np.ndarray],
    folder: Path,
    request: pytest.FixtureRequest,
    **environment: str,
) -> None:
    """50 steps of 1 ms, every output: the bits of FMPy.

    Up to round-off, 1e-12, with FMPy's own driver, which interpolates the inflow once more, and with libcosim, which
    counts the time in ns. environment : of the host in C.
    """
    skip_unless_installed(client)
    fmu, expected = built[kind], reference[kind]
    task = job(fmu, folder)
    if client == "c":
        FOUND[client, fmu] = run_c(request.getfixturevalue("c_host"), task, folder, environment)
    if (client, fmu) not in FOUND:
        each = [*built.values()] if client in TOGETHER else [fmu]
        tables = run_client(client, [job(other, folder / f"{i}") for i, other in enumerate(each)], folder)
        FOUND.update({(client, other): table for other, table in zip(each, tables, strict=True)})
    found = FOUND[client, fmu]
    assert found.shape == expected.shape == (N, len(task.outputs))
    assert np.ptp(expected[:, task.outputs.index("CA.P")]) > 100.0
    tolerance = 1e-12 if client in ("simulate_fmu", "libcosim") else 0.0
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance * 1e-6)


HOSTS = ["simulate_fmu", "ecos", "libcosim", "c"]


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("client", HOSTS)
def test_same_answers(
    client: str,
    interpolation: str,
    built: dict[str, Path],
    reference: dict[str, np.ndarray],
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    check_client(client, interpolation, built, reference, tmp_path, request)


@pytest.fixture(scope="module")
def fmus_of_all_kinds(built: dict[str, Path], stored: Store) -> list[Path]:
    """Arteries, a heart and a body."""
    return [built["hold"], stored.lumped(heart_model), stored.lumped(body_model)]


def check_by_fmutool(fmu: Path) -> None:
    """The checks of fmu-manipulation-toolbox: the description's schema, and the rules of the standard beside it."""
    done = subprocess.run([tool("fmutool"), "-input", fmu, "-check"], capture_output=True, text=True, timeout=60)
    said = done.stdout + done.stderr
    assert done.returncode == 0
    assert "This FMU seems to be compliant with FMI-2.0." in said
    assert "No semantic error" in said
    assert "ERROR" not in said and "WARNING" not in said


def tool(name: str) -> str:
    """A program of fmu-manipulation-toolbox."""
    found = shutil.which(name, path=sysconfig.get_path("scripts"))
    if found is None:
        pytest.skip("fmu-manipulation-toolbox is not installed")
    return found


def test_fmutool_finds_nothing(fmus_of_all_kinds: list[Path]) -> None:
    for fmu in fmus_of_all_kinds:
        check_by_fmutool(fmu)


def test_doctor_finds_nothing(fmus_of_all_kinds: list[Path]) -> None:
    """Every kind of FMU is found whole, and takes a step."""
    for fmu in fmus_of_all_kinds:
        assert doctor.state(doctor.examine(fmu)) in (doctor.OK, doctor.NOTE), fmu


def check_container(folder: Path, expected: np.ndarray) -> None:
    """fmucontainer's host in C steps the folder's sheep.fmu, inside FMPy: the same answers. Its parameters are built
    in."""
    (folder / "box.csv").write_text("rule;from_fmu;from_port;to_fmu;to_port\nFMU;sheep.fmu;;;\n")
    line = [tool("fmucontainer"), "-fmu-directory", ".", "-container", f"box.csv:{STEP}"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=folder, timeout=120)
    assert done.returncode == 0, done.stderr
    task = job(folder / "box.fmu", folder)
    del task.starts["CA.phi0"]
    np.testing.assert_allclose(run_client("fmpy", [task], folder)[0], expected, rtol=1e-12, atol=1e-18)


def test_within_a_container(sheep: Network, reference: dict[str, np.ndarray], tmp_path: Path) -> None:
    build(sheep, tmp_path, starts={"inlet.interpolation": "smooth", "CA.phi0": 2e3})
    check_container(tmp_path, reference["smooth"])
