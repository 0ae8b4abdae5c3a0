"""The closed loop of native FMUs: call by call against the Python components, as SSP in FMPy, ecos and libcosim."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmus import Instance
from loops import loop
from native_fmus import needs_compiler
from test_client_system import OUTPUTS, run_system
from test_clients import skip_unless_installed

from build_fmu import build_native, build_native_model, build_system
from fmu_src.contents.models import body_model, heart_model
from fmu_src.contents.system import start_values
from solver import load
from solver.lumped.species import HUMAN_BODY, HUMAN_HEART

pytestmark = needs_compiler
Systems = dict[bool, tuple[Path, dict[str, object]]]


def test_the_loop_of_three_fmus(tmp_path: Path) -> None:
    """Heart, arteries and body in this order, the first 0.2 s in steps of 2 ms: every output to 1e-11 of its largest
    value (measured 1e-12) as the Python components give it."""
    network, h = load("human"), 2e-3
    expected = loop(network, h, 0.2)
    starts = start_values(network, HUMAN_HEART, HUMAN_BODY, parallel=False)
    files = {
        "heart": build_native_model(heart_model("human", starts["heart"], 2), tmp_path),
        "arteries": build_native(network, tmp_path, starts=starts["arteries"]),
        "body": build_native_model(body_model("human", starts["body"], 2), tmp_path),
    }
    parts = {name: Instance(file, tmp_path / name) for name, file in files.items()}
    for part in parts.values():
        part.initialize()
    heart, arteries, body = parts.values()
    veins = [name for name in arteries.references if name.endswith(".P_venous")]
    rows = []
    for i in range(len(expected.time)):
        port, (P,) = arteries.get([f"inlet.{key}" for key in ("P_0", "Z", "Z_0")]), body.get(["P"])
        heart.set({**dict(zip(("aorta.P_0", "aorta.Z", "aorta.Z_0"), port, strict=True)), "venous.P": P})
        heart.slave.doStep(i * h, h)
        arteries.set({"inlet.Q": heart.get(["aorta.Q"])[0], **dict.fromkeys(veins, P)})
        arteries.slave.doStep(i * h, h)
        body.set({"arteries.V": arteries.get(["venous.V"])[0], "heart.V": heart.get(["venous.V"])[0]})
        body.slave.doStep(i * h, h)
        rows.append([x for name in expected.values for part in [name.split(".")[0]]
                     for x in parts[part].get([name.partition(".")[2]])])  # fmt: skip
    known = np.column_stack([*expected.values.values()])
    size = np.abs(known).max(axis=0)
    assert (np.abs(np.array(rows) - known).max(axis=0) <= 1e-11 * size).all()
    assert known[:, [*expected.values].index("heart.aorta.Q")].max() > 3e-4


@pytest.fixture(scope="module")
def systems(tmp_path_factory: pytest.TempPathFactory) -> Systems:
    """The system of the human network, of Python's and of native FMUs: folder and job for the clients."""
    found: Systems = {}
    for native in (False, True):
        folder = tmp_path_factory.mktemp("native" if native else "python")
        ssp = os.fspath(build_system(load("human"), None, folder, native=native))
        job = {"ssp": ssp, "step": 5e-3, "steps": 360, "outputs": OUTPUTS, "parameter_set": "start"}
        found[native] = folder, job
    return found


@pytest.mark.slow
def test_system(systems: Systems) -> None:
    """Two beats of the closed loop in FMPy, every signal to 1e-12 of its range (measured 2e-13)."""
    with zipfile.ZipFile(str(systems[True][1]["ssp"])) as archive:
        for fmu in (name for name in archive.namelist() if name.endswith(".fmu")):
            description = fmpy.read_model_description(archive.open(fmu))
            assert not description.coSimulation.needsExecutionTool
    expected, found = (run_system("fmpy", *systems[native]) for native in (False, True))
    assert np.max(np.abs(found - expected) / np.ptp(expected, axis=0)) <= 1e-12
    assert np.ptp(expected[:, OUTPUTS.index("heart.left_ventricle.V")]) > 20e-6


@pytest.mark.slow
@pytest.mark.parametrize("client", ["ecos", "libcosim"])
def test_in_other_hosts(systems: Systems, client: str) -> None:
    """To 2e-11 of each range (measured 4e-12)."""
    skip_unless_installed(client)
    expected, found = (run_system(each, *systems[True]) for each in ("fmpy", client))
    assert np.max(np.abs(found - expected) / np.ptp(expected, axis=0)) < 2e-11


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    """build system --native; --platforms is refused without it."""
    line = [sys.executable, "-m", "arterial_fmu", "build", "system", "sheep", "--out", os.fspath(tmp_path)]
    refused = subprocess.run([*line, "--platforms", "linux64"], capture_output=True, text=True)
    assert refused.returncode == 2
    assert "add --native." in refused.stderr
    done = subprocess.run([*line, "--native", "--platforms", "linux64"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "sheep.ssp") as archive:
        assert {"resources/sheep.fmu", "resources/sheep_heart.fmu", "resources/sheep_body.fmu"} < set(
            archive.namelist()
        )
