"""A host that instantiates and steps for long does not grow: resident memory of a process of its own, on Linux."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from fmus import run_python

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc/self/statm, as Linux has it")

HOST = r"""
import gc, json, os, sys
import fmpy
fmu, folder, what, n = sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4])
description = fmpy.read_model_description(fmu)
inlet = next(v.valueReference for v in description.modelVariables if v.name == "inlet.Q")
outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
fmpy.extract(fmu, folder)

def resident():  # MB
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6

def begin():
    slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave

def step(slave, i, h=2e-3):
    slave.setReal([inlet], [1e-5 * (i % 10)])
    slave.doStep(i * h, h)
    return slave.getReal(outputs[:40])

def cycle():  # instantiate, step, save, restore, reset, free
    slave = begin()
    step(slave, 0)
    state = slave.getFMUState()
    again = slave.deSerializeFMUstate(slave.serializeFMUState(state))
    slave.setFMUState(again)
    step(slave, 1)
    for each in (state, again):
        slave.freeFMUState(each)
    slave.reset()
    slave.freeInstance()

sizes = []
if what == "cycles":
    for i in range(n + 20):
        if i == 20:  # after what a process keeps for good
            sizes.append(resident())
        cycle()
else:
    slave = begin()
    for i in range(n + 1000):
        if i == 1000:
            sizes.append(resident())
        step(slave, i)
        if i % 100 == 0:
            state = slave.getFMUState()
            slave.setFMUState(state)
            slave.freeFMUState(state)
    slave.freeInstance()
print(json.dumps([*sizes, resident()]))
"""


def growth(fmu: Path, folder: Path, what: str, n: int) -> float:
    """MB by which the process grows over n cycles or steps, after what it takes at first."""
    done = run_python(HOST, os.fspath(fmu), os.fspath(folder / "fmu"), what, str(n), cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    before, after = json.loads(done.stdout)
    print(f"{n} {what}: from {before:.1f} to {after:.1f} MB", file=sys.stderr)
    return float(after - before)


@pytest.mark.slow
def test_cycles(fmus: dict[str, Path], tmp_path: Path) -> None:
    """Instantiate, step, save, restore, reset and free, 60 times: below 3 MB (measured 0.8)."""
    assert growth(fmus["coarse sheep"], tmp_path, "cycles", 60) < 3.0


@pytest.mark.slow
def test_steps(fmus: dict[str, Path], tmp_path: Path) -> None:
    """2000 steps: below 0.5 MB (measured 0.0)."""
    assert growth(fmus["coarse sheep"], tmp_path, "steps", 2000) < 0.5


@pytest.mark.endurance
def test_many_cycles(fmus: dict[str, Path], tmp_path: Path) -> None:
    """200 times: below 10 MB (measured 1.2)."""
    assert growth(fmus["coarse sheep"], tmp_path, "cycles", 200) < 10.0


@pytest.mark.endurance
def test_many_steps(fmus: dict[str, Path], tmp_path: Path) -> None:
    """100 000 steps: below 10 MB (measured 0.0)."""
    assert growth(fmus["coarse sheep"], tmp_path, "steps", 100_000) < 10.0
