"""The findings of the doctor for an FMU that needs no Python: rows of subject, state, finding and remedy."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from .arrays import with_guid
from .binaries import PLATFORMS, here
from .native_fmu import DESCRIPTION, RESOURCE, guid_of

Row = tuple[str, str, str, str]


def is_native(names: Sequence[str]) -> bool:
    return RESOURCE in names


def rows(path: Path, names: Sequence[str], guid: str, model: str, fmi3: bool) -> Iterator[Row]:
    """Contents, Python and binaries."""
    try:
        made = guid_of(_contents(path, names, guid)) == guid
    except (ValueError, IndexError, KeyError, zipfile.BadZipFile):
        made = False
    anew = "build it anew with arterial-fmu build --native, or copy it once more"
    if made:
        yield "contents", "ok", f"{model}, built by this project; code and data match the GUID", ""
    else:
        yield "contents", "no FMU of this project", "code or data were changed after the FMU was built (GUID)", anew
    yield "Python", "ok", "not needed by the host", ""
    found = sorted({name.split("/")[1] for name in names if name.startswith("binaries/") and name.count("/") == 2})
    name = here() or ""
    mine = PLATFORMS.get(name)
    listed = ", ".join(found) or "none"
    if mine is not None and (mine.fmi3 if fmi3 else mine.fmi2) in found:
        yield "binary", "ok", f"{listed}; tested on Linux x86-64", ""
    else:
        remedy = f"build it with --platforms {name}" if name else "compile sources/ for this machine"
        yield "binary", "problem", f"none for this machine (there is {listed})", remedy


def _contents(path: Path, names: Sequence[str], guid: str) -> dict[str, bytes]:
    """The files as they were before the GUID was known."""
    with zipfile.ZipFile(path) as file:
        found = {name: file.read(name) for name in names if not name.startswith("binaries/")}
    found[RESOURCE] = with_guid(found[RESOURCE], "")
    found[DESCRIPTION] = found[DESCRIPTION].replace(guid.encode(), b"")
    return found
