"""The system of heart, arteries and body in FMPy, ecos and libcosim: masters that step all parts side by side.

FMPy exchanges nothing before its first step, the others do: the heart starts with what the arteries would tell it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from test_clients import run_script, skip_unless_installed

from build_fmu import build_system
from solver import load

OUTPUTS = ("heart.aorta.Q", "heart.aorta.P", "heart.left_ventricle.P", "heart.left_ventricle.V", "heart.venous.V",
           "arteries.inlet.P", "arteries.network.V", "arteries.venous.V", "body.P")  # fmt: skip


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[("human", 5e-3, 100), ("sheep", 1e-3, 200)], ids=["human", "sheep"])
def system(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """The system of a species, as a job for the clients, and the folder of both."""
    species, step, steps = request.param
    folder = tmp_path_factory.mktemp(species)
    ssp = os.fspath(build_system(load(species), species, folder))
    return folder, {"ssp": ssp, "step": step, "steps": steps, "outputs": OUTPUTS, "parameter_set": "start"}


def run_system(client: str, folder: Path, job: dict[str, object]) -> np.ndarray:
    return run_script(f"ssp_with_{client}", json.dumps(job), folder)


@pytest.fixture(scope="module")
def expected(system: tuple[Path, dict[str, object]]) -> np.ndarray:
    """What FMPy finds."""
    return run_system("fmpy", *system)


@pytest.mark.parametrize("client", ["ecos", "libcosim"])
def test_same_answers(client: str, system: tuple[Path, dict[str, object]], expected: np.ndarray) -> None:
    """From the first step on, every signal: to 1e-9 of its range (1e-14 to 1e-10 measured)."""
    skip_unless_installed(client)
    found = run_system(client, *system)
    assert found.shape == expected.shape == (system[1]["steps"], len(OUTPUTS))
    assert np.max(np.abs(found - expected) / np.ptp(expected, axis=0)) < 1e-9


def test_it_beats(expected: np.ndarray) -> None:
    """The heart has filled the arteries: ejected volume, and a pulse at the inlet."""
    signals = dict(zip(OUTPUTS, expected.T, strict=True))
    assert np.ptp(signals["heart.left_ventricle.V"]) > 20e-6
    assert np.ptp(signals["arteries.inlet.P"]) > 3e3
