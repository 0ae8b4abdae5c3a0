"""Random calls kill no host and change no other instance. ``--seeds 25`` makes 100 000 of them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fmus import Store

from fmu_src.contents.models import body_model, heart_model

MACHINE = Path(__file__).with_name("fuzz_machine.py")


def fuzz(fmus: dict[str, Path], stored: Store, folder: Path, examples: int, steps: int, seed: int) -> dict[str, int]:
    """What one process did; it must have ended well."""
    heart, body = stored.lumped(heart_model), stored.lumped(body_model)
    line = [sys.executable, MACHINE, folder, examples, steps, seed, fmus["coarse sheep"], fmus["mixed"], heart, body]
    done = subprocess.run([os.fspath(str(part)) for part in line], capture_output=True, text=True, cwd=folder)
    last = (folder / "calls").read_text() if (folder / "calls").exists() else "before the first call"
    assert done.returncode == 0, f"{last}\n{done.stdout}\n{done.stderr[-3000:]}"
    found: dict[str, int] = json.loads(done.stdout.splitlines()[-1])
    print(f"{found['calls']} calls, {found['refused']} refused")
    return found


@pytest.mark.slow
def test_fuzz(fmus: dict[str, Path], stored: Store, tmp_path: Path) -> None:
    """Some 2000 calls: the process ends well, each refusal is one sentence, and bystanders give their bits."""
    found = fuzz(fmus, stored, tmp_path, examples=25, steps=60, seed=1)
    assert found["calls"] > 1300
    assert 0.1 < found["refused"] / found["calls"] < 0.7


@pytest.mark.endurance
def test_fuzz_longer(fmus: dict[str, Path], stored: Store, tmp_path: Path, further_seed: int) -> None:
    """The same with other calls, four to five thousand."""
    assert fuzz(fmus, stored, tmp_path, examples=45, steps=100, seed=further_seed)["calls"] > 3500
