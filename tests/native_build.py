"""native/build.py as a module."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

FILE = Path(__file__).resolve().parents[1] / "native" / "build.py"


def _module() -> Any:
    spec = importlib.util.spec_from_file_location("native_build_script", FILE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


build = _module().build
