"""The Python of an FMU: its version, library and numpy, and the environment that a host needs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass

from solver.errors import InputError

# Where libpython lies differs: beside an interpreter of its own, in the system's folder of libraries (Debian), or in
# the folder of the configuration. An installation without a shared library has none.
_ASK = """
import json, os, sys, sysconfig
get = sysconfig.get_config_var
folders = [get("LIBDIR"), os.path.join(get("LIBDIR") or "", get("MULTIARCH") or ""), get("LIBPL"),
           os.path.join(sys.base_prefix, "lib")]
names = [get("INSTSONAME"), get("LDLIBRARY"), "libpython%d.%d.so.1.0" % sys.version_info[:2]]
found = [os.path.join(f, n) for f in folders for n in names if f and n and ".so" in n]
try:
    import numpy
    numpy = [numpy.__version__, os.path.dirname(os.path.dirname(numpy.__file__))]
except Exception as error:
    numpy = [None, "%s: %s" % (type(error).__name__, str(error).strip().splitlines()[0] if str(error).strip() else "")]
print(json.dumps({"executable": sys.executable, "version": list(sys.version_info[:3]), "prefix": sys.prefix,
                  "library": next((os.path.realpath(f) for f in found if os.path.isfile(f)), None),
                  "numpy": numpy[0], "numpy_from": numpy[1], "bits": 64 if sys.maxsize > 2**32 else 32}))
"""


@dataclass(frozen=True)
class Interpreter:
    """A Python installation, as it describes itself.

    command : its start command. executable : its own path.
    library : path of its shared library, None if it has none. numpy : version, None if it cannot be imported.
    numpy_from : folder of numpy, or the reason why the import fails.
    """

    command: str
    executable: str
    version: tuple[int, int, int]
    prefix: str
    bits: int
    library: str | None
    numpy: str | None
    numpy_from: str

    @property
    def name(self) -> str:
        return f"Python {'.'.join(map(str, self.version))}"

    def environment(self) -> dict[str, str]:
        """Environment variables for a host on Linux that is not Python; empty if this Python has no shared library.

        LD_PRELOAD: the wrapper does not declare the library that it needs. PATH: the library searches it for
        ``python3``, and this determines the folder of numpy.
        """
        if self.library is None:
            return {}
        return {"PATH": os.path.dirname(self.executable) + ":$PATH", "LD_PRELOAD": self.library}


def interpreter(python: str = sys.executable) -> Interpreter:
    """The installation behind a command such as ``python3.12``. Raises ValueError if it does not start."""
    command = shutil.which(python)
    if command is None:
        raise InputError(f"{python}: there is no such Python; give the path of one, for example {sys.executable}.")
    try:
        done = subprocess.run([command, "-c", _ASK], capture_output=True, text=True, timeout=60)
        facts = json.loads(done.stdout)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise InputError(f"{command}: does not start as Python ({type(error).__name__}); give another.") from None
    return Interpreter(**{**facts, "command": command, "version": tuple(facts["version"])})
