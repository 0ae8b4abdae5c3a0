"""Two faults of pythonfmu's wrapper that an FMU can mend from inside, on Linux.

**Abort at exit.** Where the process ends with the wrapper's library still loaded, the library's static object lets go
of the Python interpreter, and then its function ``finalizePythonInterpreter`` does so again, in memory that is already
free. Depending on the heap the process is aborted ("corrupted unsorted chunks") after it has done its work: upstream
issue 228. The function does nothing the second time, so it is registered to run before the static object ends.

**Ctrl-C.** The wrapper starts Python where the host is not Python, and Python then takes SIGINT for itself, where
nobody asks for it. It does so only where the host had left the signal alone, and that gets its default action back.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from functools import cache
from pathlib import Path


@cache
def mend(resources: str) -> None:
    """Mend both for the library of the FMU that is unpacked around ``resources``, once in a process."""
    if sys.platform != "linux":
        return
    c = ctypes.CDLL(None)
    for library in Path(resources).parent.glob("binaries/linux64/*.so"):
        try:
            loaded = ctypes.CDLL(os.fspath(library), mode=os.RTLD_NOLOAD | os.RTLD_NOW)
            c.__cxa_atexit(loaded.finalizePythonInterpreter, None, None)
        except (OSError, AttributeError):  # the host has loaded another copy, or the wrapper is another one
            continue
    if not sys.orig_argv and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        c.signal(signal.SIGINT, ctypes.c_void_p(0))  # SIG_DFL; signal.signal refuses outside Python's main thread
