"""The folder where our own commands unpack an FMU: pythonfmu's wrapper crashes if its path must be encoded in a URI."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

from solver.errors import InputError


@contextmanager
def unpacking_folder(prefix: str) -> Iterator[str]:
    """A new folder that the wrapper survives, in the first of :func:`places` that can hold it; gone at the end.

    Raises ValueError, one sentence, if there is none.
    """
    tried = list(places())
    for place in tried:
        if undecoded(place):
            continue
        try:
            made = tempfile.TemporaryDirectory(prefix=prefix, dir=place, ignore_cleanup_errors=True)
        except OSError:
            continue
        with made as folder:
            yield folder
        return
    raise InputError(
        f"no folder to unpack the FMU into, among {', '.join(map(str, tried))}: each cannot be written, or its path "
        "has characters on which the FMU's wrapper crashes; set TMPDIR to a folder of letters, digits, blanks "
        "and - . _ ~."
    )


def places() -> Iterator[Path]:
    """The temporary folder (TMPDIR), those of the system, the home folder, the current one, in this order."""
    for name in ("TMPDIR", "TEMP", "TMP"):
        if os.environ.get(name):
            yield Path(os.environ[name]).absolute()
    yield from map(Path, ("/tmp", "/var/tmp") if os.name == "posix" else ())
    yield Path(os.path.expanduser("~")).absolute()
    yield Path.cwd()


def undecoded(path: str | os.PathLike[str]) -> str:
    """The characters of a path that are encoded in its URI and that the wrapper does not decode."""
    plain = " /\\:" if os.name == "nt" else " /"
    return "".join(c for c in os.fspath(path) if c not in plain and quote(c, errors="replace") != c)
