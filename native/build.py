"""Build the compiled engine for this machine: python native/build.py [--with cc|ziglang|FILE].

Takes the machine's C compiler (cc, gcc, clang) or, where there is none, that of the package ziglang
(pip install arterial-fmu[engine]). Without either, everything runs on NumPy. Wheels bring the engine of all platforms:
``native/arterial_backend.py``.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from fmu_src import compiler  # noqa: E402
from solver.io.writing import write_whole  # noqa: E402
from solver.tracing.native import LIBRARY, sources  # noqa: E402


def compilers(wanted: str | None) -> list[list[str]]:
    """The compilers to try, in order."""
    zig = [command for command in (compiler.ziglang(),) if command]
    if wanted == "ziglang":
        return zig
    if wanted:
        return [[found] for found in (shutil.which(wanted),) if found]
    return compiler.own() + zig


def build(wanted: str | None = None, library: Path = LIBRARY) -> str:
    """Build the library by the first compiler that can, and say what was done."""
    failed = "No C compiler"
    for command in compilers(wanted):
        start = time.perf_counter()
        try:
            made = compiler.compiled(
                command, compiler.engine_files(HERE), library.suffix, f'ARTERIAL_SOURCES="{sources()}"'
            )
        except compiler.NotCompiled as error:
            failed = str(error)
            continue
        library.parent.mkdir(parents=True, exist_ok=True)
        write_whole(library, made)
        name = " ".join([Path(command[0]).name, *command[1:]])
        return f"Built the compiled engine with {name} in {time.perf_counter() - start:.1f} s: {library}"
    return (
        f"{failed}. The solver runs on NumPy; for the compiled engine: pip install ziglang, then python native/build.py"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--with", dest="compiler", help="a C compiler by name or path, or ziglang")
    print(build(parser.parse_args().compiler))
