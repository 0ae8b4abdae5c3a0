"""What the FMU asks of the Python that runs it; imports nothing that may be missing there."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec

TESTED = ((3, 10), (3, 13))  # first and last Python that the FMUs were run under; an older one is rejected
OLDEST = TESTED[0]
PYTHONS = " to ".join(".".join(map(str, version)) for version in TESTED)
PACKAGES = "numpy"


def check() -> None:
    """Raise ImportError, one sentence, if this Python is too old or has no numpy that can be imported."""
    version = ".".join(map(str, sys.version_info[:3]))
    python = f"Python {version} in {sys.prefix}"
    if sys.version_info < OLDEST:
        needed = ".".join(map(str, OLDEST))
        raise ImportError(f"this FMU runs in {python}, but needs Python {needed} or newer; let the host load that one.")
    try:
        import numpy  # noqa: F401
    except Exception as error:
        reason = "has no numpy" if find_spec("numpy") is None else f"cannot import its numpy ({error})"
        raise ImportError(
            f"this FMU runs in {python}, which {reason}; install it there: {_command(version)} -m pip install numpy."
        ) from None


def _command(version: str) -> str:
    """The interpreter of this Python's folder: in a host that is not Python, sys.executable is the host, or nothing."""
    short = ".".join(version.split(".")[:2])
    folders = (os.path.join(sys.prefix, "bin", f"python{short}"), os.path.join(sys.prefix, "python.exe"))
    return next((path for path in folders if os.path.isfile(path)), f"python{short}")
