"""The build backend: setuptools', and the compiled libraries and C sources of ``native/`` in wheels.

A wheel is for all platforms: it has the engine and the binary of FMUs for each, 1 MB together. Both are compiled by the
package ziglang, which wheels therefore need when they are built, and editable installs do not. Without it, or where it
fails, the wheel has the sources alone, and what is installed from it runs on NumPy.
"""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403, the other hooks
from setuptools.command.build_py import build_py

NATIVE = Path(__file__).resolve().parent
if str(NATIVE.parent) not in sys.path:
    sys.path.append(str(NATIVE.parent))

from fmu_src import compiler  # noqa: E402, neither it nor its package imports what must be installed


def get_requires_for_build_wheel(config_settings: Mapping[str, Any] | None = None) -> list[str]:
    """What setuptools needs, and the compiler."""
    return [*build_meta.get_requires_for_build_wheel(config_settings), "ziglang>=0.13"]


class BuildPy(build_py):
    """Modules and data, and ``solver/engine``: libraries by platform, sources/."""

    def run(self) -> None:
        """Copy and compile into the folder that becomes the wheel; an editable install has the folder itself."""
        super().run()
        if self.editable_mode:
            return
        folder = Path(self.build_lib, "solver", "engine")
        shutil.rmtree(folder, ignore_errors=True)  # of an earlier build
        for path in _sources():
            target = folder / "sources" / path.relative_to(NATIVE)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        if compiler.ziglang() is None:
            self.warn("ziglang is not installed: this wheel has no compiled engine and no binaries of native FMUs.")
            return
        for name in compiler.PLATFORMS:
            try:
                _write_libraries(name, folder)
            except compiler.NotCompiled as error:
                self.warn(f"this wheel has no libraries for {name}: {error}")

    def get_source_files(self) -> list[str]:
        """What a source distribution takes along: native/, too."""
        tools = [NATIVE / "arterial_backend.py", NATIVE / "build.py"]
        return [*super().get_source_files(), *(str(p.relative_to(NATIVE.parent)) for p in [*tools, *_sources()])]


def _sources() -> list[Path]:
    return sorted([*NATIVE.glob("*.[ch]"), *NATIVE.glob("fmu/*.[ch]")])


def _write_libraries(name: str, folder: Path) -> None:
    """Compile the engine and the binary of FMUs for a platform. Raises NotCompiled."""
    platform = compiler.PLATFORMS[name]
    command, fmu = compiler.ziglang(platform.target) or [], compiler.fmu_sources(NATIVE)
    # as solver.tracing.native, which this must not import, digests them
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(NATIVE.glob("*.[ch]")))).hexdigest()[:16]
    engine = compiler.compiled(command, compiler.engine_files(NATIVE), platform.suffix, f'ARTERIAL_SOURCES="{digest}"')
    (folder / f"arterial_engine-{platform.fmi3}{platform.suffix}").write_bytes(engine)
    files = [NATIVE / path for path in fmu if path.endswith(".c")]
    binary = compiler.compiled(command, files, platform.suffix)
    (folder / compiler.fmu_library(name, fmu, platform.target)).write_bytes(binary)
