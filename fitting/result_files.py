"""Results on disk: folders that do not mix, and JSON that every reader takes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from solver.errors import InputError

_SIGNS = {"study": ("plan.json",), "discover": ("verdict.json", ".state")}  # both have a folder figures


def check_unmixed(folder: Path, command: str) -> None:
    """Raise ValueError if a folder holds the results of another command, whose files would mix with this one's."""
    for other, names in _SIGNS.items():
        if other != command and any((folder / name).exists() for name in names):
            raise InputError(f"{folder}: it holds the results of {other}; give {command} another folder (--out).")


def json_text(content: Mapping[str, Any], indent: int = 2) -> str:
    """JSON text of plain data, null for numbers that are not finite: JSON has neither NaN nor infinity."""
    return json.dumps(finite(content), indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """The same plain data, None for what is not a finite number."""
    if isinstance(value, Mapping):
        return {key: finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
