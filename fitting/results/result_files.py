"""Results on disk: separate folders for each command, and standard JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from solver.errors import InputError

_SIGNS = {"study": ("plan.json",), "discover": ("verdict.json", ".state")}  # both have a folder figures


def check_unmixed(folder: Path, command: str) -> None:
    """Raise ValueError if a folder contains the results of another command."""
    for other, names in _SIGNS.items():
        if other != command and any((folder / name).exists() for name in names):
            raise InputError(f"{folder}: it contains the results of {other}; give {command} another folder (--out).")


def json_text(content: Any, indent: int = 2) -> str:
    """JSON text of a value, converted by :func:`plain`."""
    return json.dumps(plain(content), indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Plain data: dataclasses by field, None for numbers that are not finite, which JSON does not support."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
