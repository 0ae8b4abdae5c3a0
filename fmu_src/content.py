"""The hash of an FMU's content, which names its code and is its GUID: for the build, and for whoever checks a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping

# stand where the hash itself does: in the paths of the code, and in the script of the slave
PACKAGE, NAME, GUID = "PACKAGE", "NAME", "GUID"
SCRIPT = "resources/NAME.py"


def digest(files: Mapping[str, bytes], execution_tool: bool, wrapper: str) -> str:
    """The hash, as hexadecimal digits, of resources and documents by path, a flag, and the version of the wrapper."""
    hashes = [(path, hashlib.sha256(files[path]).hexdigest()) for path in sorted(files)]
    return hashlib.sha256(json.dumps([hashes, execution_tool, wrapper]).encode()).hexdigest()


def name(digest: str) -> str:
    """The name of the slave's module; that of the package with its code begins with one underscore more."""
    return f"arterial_{digest[:8]}"


def guid(digest: str) -> str:
    return f"{{{digest[:32]}}}"


def without_names(files: Mapping[str, bytes], module: str, guid: str) -> dict[str, bytes]:
    """What the hash was made of: the files of a built FMU without the names that carry the hash.

    The wrapper's files, the binaries and the description are not among them: they follow from the rest.
    """
    found = {}
    for path, content in files.items():
        if path == f"resources/{module}.py":
            found[SCRIPT] = content.replace(module.encode(), NAME.encode()).replace(guid.encode(), GUID.encode())
        elif path.startswith(f"resources/_{module}/"):
            found[path.replace(f"_{module}", PACKAGE, 1)] = content
        elif path.startswith(("resources/", "documentation/")) or path == "model.png":
            found[path] = content
    return {p: c for p, c in found.items() if not p.startswith(("resources/pythonfmu/", "resources/slavemodule.txt"))}
