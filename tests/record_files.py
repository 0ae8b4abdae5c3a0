"""Small record files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fitting.records.read.record import read_record

T, DT, N = 0.5, 0.005, 1000
TIME = np.arange(N) * DT
WAVE = np.sin(2 * np.pi * TIME / T) + 0.3 * np.sin(4 * np.pi * TIME / T + 1.0)
P_MMHG = 85.0 + 15.0 * WAVE
R_MM = 9.0 + 0.3 * WAVE


def text(columns: dict[str, np.ndarray], decimals: int = 9) -> str:
    """CSV of the columns, NaN as an empty field."""
    table = np.column_stack(list(columns.values()))
    rows = [",".join("" if np.isnan(v) else f"{v:.{decimals}f}" for v in row) for row in table]
    return "\n".join([",".join(columns), *rows]) + "\n"


def bench(**changes: np.ndarray) -> dict[str, np.ndarray]:
    """A bench record of AA; the keys P and R are its columns."""
    columns = {"time [s]": TIME, "AA.P [mmHg]": P_MMHG, "AA.R [mm]": R_MM}
    names = {"time": "time [s]", "P": "AA.P [mmHg]", "R": "AA.R [mm]"}
    return columns | {names[key]: value for key, value in changes.items()}


def save(folder: Path, content: str | bytes) -> Path:
    path = folder / "record.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# --- what is refused ----------------------------------------------------------------------------------------------


def refusal(folder: Path, content: str | bytes) -> str:
    path = save(folder, content)
    with pytest.raises(ValueError) as caught:
        read_record(path)
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}: ") and sentence.endswith(".") and "\n" not in sentence
    return sentence.removeprefix(f"{path}: ")
