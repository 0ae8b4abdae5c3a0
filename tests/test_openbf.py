"""The published networks against openBF's own waveforms (tests/data/openbf), in the middle of every vessel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver import Settings, load, simulate
from solver.io.tables import read

DATA = Path(__file__).parent / "data" / "openbf"


@pytest.mark.parametrize(("name", "P", "Q"), [("cca", 0.30, 0.10), ("ibif", 0.24, 0.32)])
def test_waveforms(name: str, P: float, Q: float) -> None:
    """The same beat from rest as openBF's: rms of the difference in % of the pulse, about its mean and with it.

    Measured in P: cca 0.24 about a mean of 0.36, ibif 0.22 about 0.01; in Q: 0.07 and 0.28 at most.
    """
    table = read(DATA / f"{name}.csv")
    rows = np.array([[float(cell) for cell in cells] for _, cells in table.rows])
    result = simulate(load(name), duration=rows[-1, 0], settings=Settings(dt=4e-3))
    for column, output in zip(rows.T[1:], table.names[1:], strict=True):
        difference = np.interp(rows[:, 0], result.time, result[output]) - column
        pulse = np.ptp(column) / 100.0
        assert np.std(difference) / pulse < {"P": P, "Q": Q}[output[-1]]
        assert abs(np.mean(difference)) / pulse < {"P": 0.4, "Q": 0.1}[output[-1]]
