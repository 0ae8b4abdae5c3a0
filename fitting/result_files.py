"""Results on disk: the folder they go to, and JSON that every reader takes."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def make_folder(path: str | os.PathLike[str]) -> Path:
    """The folder, made if it is missing. Raises ValueError if it cannot be made."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        file = next((each for each in (folder, *folder.parents) if each.is_file()), None)
        if file is not None:
            raise ValueError(f"{folder}: {_what(file, folder)}; give another folder.") from None
        raise ValueError(f"{folder}: cannot be made ({error.strerror}); give another folder.") from None
    return folder


def _what(file: Path, folder: Path) -> str:
    """Why a file is in the way of a folder."""
    return "is a file, not a folder" if file == folder else f"cannot be made, as {file} is a file"


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
