"""Build the compiled engine for this machine: python native/build.py [--with cc|ziglang|FILE].

Takes the machine's C compiler (cc, gcc, clang) or, where there is none, that of the package ziglang
(pip install arterial-fmu[engine]). Without either, everything runs on NumPy.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from solver.native import LIBRARY, sources  # noqa: E402

# for every processor of its kind, and without contraction: the same numbers everywhere
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-Wall", "-Wextra", "-shared",
         "-fvisibility=hidden", *([] if sys.platform == "win32" else ["-fPIC"])]  # fmt: skip


def compilers(wanted: str | None) -> list[list[str]]:
    """The compilers to try, in order."""
    zig = [[sys.executable, "-m", "ziglang", "cc"]] if importlib.util.find_spec("ziglang") else []
    if wanted == "ziglang":
        return zig
    names = [wanted] if wanted else ["cc", "gcc", "clang"]
    return [[found] for found in map(shutil.which, names) if found] + (zig if not wanted else [])


def build(wanted: str | None = None, library: Path = LIBRARY) -> str:
    """Build the library by the first compiler that can, and say what was done."""
    failed = ["No C compiler"]
    for compiler in compilers(wanted):
        start = time.perf_counter()
        library.parent.mkdir(parents=True, exist_ok=True)
        beside = library.with_name(f".{os.getpid()}-{library.name}")
        files = [f'-DARTERIAL_SOURCES="{sources()}"', *sorted(map(str, HERE.glob("*.c"))), "-o", str(beside), "-lm"]
        done = subprocess.run([*compiler, *FLAGS, *files], capture_output=True, text=True)
        if done.returncode == 0:
            os.replace(beside, library)
            name = " ".join([Path(compiler[0]).name, *compiler[1:]])
            return f"Built the compiled engine with {name} in {time.perf_counter() - start:.1f} s: {library}"
        failed.append(f"{' '.join(compiler)} does not compile native/: {done.stderr.strip()}")
    return (
        f"{failed[-1]}. The solver runs on NumPy; for the compiled engine: pip install ziglang, then "
        "python native/build.py"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--with", dest="compiler", help="a C compiler by name or path, or ziglang")
    print(build(parser.parse_args().compiler))
