"""The binary of FMUs that need no Python: one for all networks, which wheels bring for every platform.

In a checkout it is compiled when it is first needed, and kept. Not part of the code of FMUs.
"""

from __future__ import annotations

import os
import struct
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from solver.errors import InputError
from solver.tracing.native import ENGINES, PLATFORM, SOURCES

from .. import compiler
from ..compiler import PLATFORMS


def here() -> str | None:
    """The platform of this machine, None where it is none of them."""
    return next((name for name, p in PLATFORMS.items() if p.fmi3 == PLATFORM), None)


def sources() -> dict[str, bytes]:
    """The C files by path in ``native/``. Raises ValueError where they are not."""
    found = compiler.fmu_sources(SOURCES)
    if not found:
        raise InputError(f"{SOURCES}: the sources of FMUs without Python are not there; install arterial-fmu again.")
    return found


def binary(name: str) -> bytes:
    """The library for a platform: the wheel's, one that was kept, or compiled now.

    Raises ValueError where nothing can compile it. A compiled one is kept under a name with the hash of its sources.
    Two processes may compile it at once: each has its own, and one of them stays.
    """
    if name not in PLATFORMS:
        raise InputError(
            f"--platforms {name}: must be {', '.join(PLATFORMS)}, or several of these, separated by commas."
        )
    files, target = sources(), PLATFORMS[name].target
    known = compiler.fmu_library(name, files, target)
    content = _kept(known)
    if content is None:
        command = _compiler(name)
        known = known if target in command else compiler.fmu_library(name, files, command[0])
        content = _kept(known)
    if content is None:
        try:
            paths = [SOURCES / path for path in files if path.endswith(".c")]
            content = compiler.compiled(command, paths, PLATFORMS[name].suffix)
        except compiler.NotCompiled as error:
            raise InputError(f"{error}.") from None
        _keep(known, content, name)
    return content


def _compiler(name: str) -> list[str]:
    """What compiles for a platform."""
    portable = compiler.ziglang(PLATFORMS[name].target)
    if portable:
        return portable
    own = compiler.own() if name == here() else []
    if own:
        return own[0]
    reason = "no C compiler (cc, gcc, clang) is there" if name == here() else f"the one here makes no binary for {name}"
    raise InputError(
        "an FMU that needs no Python has a binary, which the published wheels of arterial-fmu bring; this installation "
        f"has none for {name}, and {reason}: pip install ziglang."
    )


# --- libraries that were compiled before --------------------------------------------------------------------------


def cache() -> Path | None:
    """Where compiled libraries are kept: in a checkout beside the engine, else in the user's own folder; None where
    there is no home."""
    if SOURCES.parent == ENGINES.parents[1] and os.access(ENGINES if ENGINES.is_dir() else ENGINES.parent, os.W_OK):
        return ENGINES
    try:
        return _users() / "arterial-fmu"
    except RuntimeError:
        return None


def _users() -> Path:
    """The folder of the user's caches, as the operating system has it. Raises RuntimeError where there is no home."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _kept(file: str) -> bytes | None:
    """A library of the wheel or of the cache; another process may remove it at any time."""
    for folder in filter(None, dict.fromkeys((ENGINES, cache()))):
        with suppress(OSError):
            return (folder / file).read_bytes()
    return None


def _keep(file: str, content: bytes, name: str) -> None:
    """Write a library aside, rename it, and remove those of other sources. Without a cache it is compiled again."""
    folder = cache()
    if folder is None:
        return
    with suppress(OSError):  # a full disk, or a file that another process has open: the library is in memory
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as aside:
            made = Path(aside) / file
            made.write_bytes(content)
            os.replace(made, folder / file)
        for old in set(folder.glob(f"{name}-*")) - {folder / file}:
            old.unlink(missing_ok=True)


def fat(x86_64: bytes, arm64: bytes) -> bytes:
    """Two libraries for macOS as one, which loaders of either machine open: a Mach-O universal binary."""
    page, at, head, body = 14, 1 << 14, struct.pack(">2I", 0xCAFEBABE, 2), b""
    for kind, subtype, content in ((0x01000007, 3, x86_64), (0x0100000C, 0, arm64)):
        head += struct.pack(">5I", kind, subtype, at, len(content), page)
        body += content + bytes(-len(content) % (1 << page))
        at += len(content) + -len(content) % (1 << page)
    return head.ljust(1 << page, b"\0") + body
