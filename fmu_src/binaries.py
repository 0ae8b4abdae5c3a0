"""The binary of FMUs that need no Python: one for all networks, compiled once a platform, and kept.

Compiled by the machine's C compiler for the machine itself, or by that of the package ziglang for any of
:data:`PLATFORMS`. Not part of the code of FMUs.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from solver.errors import InputError
from solver.native import LIBRARY

SOURCES = Path(__file__).resolve().parents[1] / "native"
ENGINE = ("engine.c", "engine.h", "run.h", "steps.c")  # what steps need
FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-shared",
         "-fvisibility=hidden", "-s")  # fmt: skip


@dataclass(frozen=True)
class Platform:
    """Where FMUs run. fmi2, fmi3 : its folder in ``binaries/``. target : what ziglang calls it."""

    fmi2: str
    fmi3: str
    target: str
    suffix: str


PLATFORMS = {
    "linux64": Platform("linux64", "x86_64-linux", "x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": Platform("aarch64-linux", "aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
    "win64": Platform("win64", "x86_64-windows", "x86_64-windows-gnu", ".dll"),
    "darwin64": Platform("darwin64", "x86_64-darwin", "x86_64-macos", ".dylib"),
    "aarch64-darwin": Platform("aarch64-darwin", "aarch64-darwin", "aarch64-macos", ".dylib"),
}


def here() -> str | None:
    """The platform of this machine, None where it is none of them."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}.get(sys.platform, sys.platform)
    return next((name for name, p in PLATFORMS.items() if p.fmi3 == f"{machine}-{system}"), None)


def sources() -> dict[str, bytes]:
    """The C files by path in ``native/``. Raises ValueError where they are not."""
    files = [*(SOURCES / name for name in ENGINE), *sorted(SOURCES.glob("fmu/*.[ch]"))]
    if not all(file.is_file() for file in files) or len(files) == len(ENGINE):
        raise InputError(
            f"{SOURCES}: the sources of FMUs that need no Python are not there; build in a checkout of the project."
        )
    return {file.relative_to(SOURCES).as_posix(): file.read_bytes() for file in files}


def binary(name: str) -> bytes:
    """The library for a platform, from the cache or compiled now. Raises ValueError where nothing can compile it."""
    if name not in PLATFORMS:
        raise InputError(f"--platforms {name}: must be {', '.join(PLATFORMS)}.")
    command = _compiler(name)
    files = sources()
    key = hashlib.sha256(repr((sorted(files.items()), FLAGS, command)).encode()).hexdigest()[:16]
    kept = _cache() / f"{name}-{key}{PLATFORMS[name].suffix}"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        content = _compiled(name, command)
        beside = kept.with_name(f".{os.getpid()}-{kept.name}")
        beside.write_bytes(content)
        os.replace(beside, kept)
        for old in set(kept.parent.glob(f"{name}-*")) - {kept}:  # of other sources
            old.unlink(missing_ok=True)
    return kept.read_bytes()


def _cache() -> Path:
    """Beside the engine, or where its folder cannot be written, in the temporary one."""
    folder = LIBRARY.parent
    writable = os.access(folder if folder.is_dir() else folder.parent, os.W_OK)
    return folder if writable else Path(tempfile.gettempdir()) / f"arterial-fmu-{os.getuid()}"


def _compiler(name: str) -> list[str]:
    """What compiles for a platform."""
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[name].target]
    own = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if name == here() and own:
        return [own]
    which = "no C compiler (cc, gcc, clang) is there" if name == here() else f"the one here makes no binary for {name}"
    raise InputError(f"an FMU that needs no Python must be compiled once, and {which}: pip install ziglang.")


def _compiled(name: str, command: Sequence[str]) -> bytes:
    files = [str(SOURCES / path) for path in sources() if path.endswith(".c")]
    extra = [] if name == "win64" else ["-fPIC", "-lm"]
    extra += ["-Wl,--build-id=none"] if PLATFORMS[name].suffix == ".so" else []
    with tempfile.TemporaryDirectory(prefix="arterial_compile_") as folder:
        out = Path(folder) / f"arterial{PLATFORMS[name].suffix}"
        done = subprocess.run(
            [*command, *FLAGS, *files, "-o", str(out), *extra], capture_output=True, text=True, cwd=folder
        )
        if done.returncode:
            raise InputError(f"{' '.join(command)} does not compile native/: {done.stderr.strip()}")
        return out.read_bytes()


def fat(x86_64: bytes, arm64: bytes) -> bytes:
    """Two libraries for macOS as one, which loaders of either machine open: a Mach-O universal binary."""
    page, at, head, body = 14, 1 << 14, struct.pack(">2I", 0xCAFEBABE, 2), b""
    for kind, subtype, content in ((0x01000007, 3, x86_64), (0x0100000C, 0, arm64)):
        head += struct.pack(">5I", kind, subtype, at, len(content), page)
        body += content + bytes(-len(content) % (1 << page))
        at += len(content) + -len(content) % (1 << page)
    return head.ljust(1 << page, b"\0") + body
