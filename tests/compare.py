"""How waveforms are compared, and the reference waveforms."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from solver import Waveforms

DATA = Path(__file__).parent / "data"
Array = np.ndarray


def relative_error(name: str, value: Array, reference: Array) -> float:
    """Relative L2 error: of a flow by its norm, of a pressure or radius by its mean-removed norm."""
    scale = reference if name.endswith(".Q") else reference - reference.mean()
    return float(np.linalg.norm(value - reference) / np.linalg.norm(scale))


def reference(name: str) -> dict[str, Array]:
    """One of the two reference beats of the sheep network, 501 samples 1 ms apart, in SI."""
    with (DATA / f"{name}.csv").open() as file:
        rows = list(csv.reader(file))
    table = np.array(rows[1:], float)
    return {title.split(" ")[0]: table[:, i] for i, title in enumerate(rows[0])}


def errors_against(result: Waveforms, expected: Mapping[str, Array], beat: float = 0.5) -> dict[str, float]:
    """Error of every channel that both have, over the last beat, at the reference's samples (last point left out)."""
    step = round(1e-3 / (result.time[1] - result.time[0]))
    start = len(result.time) - 1 - round(beat / (result.time[1] - result.time[0]))
    return {
        name: relative_error(name, result[name][start::step][:-1], expected[name][:-1])
        for name in result
        if name in expected and name != "inlet.Q"
    }


def elastic(network_segments: tuple) -> dict[str, float]:
    """Start values that switch wall viscosity off."""
    return {f"{segment.name}.phi0": 0.0 for segment in network_segments}
