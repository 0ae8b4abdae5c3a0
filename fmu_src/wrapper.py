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
import re
import signal
import sys
from functools import lru_cache
from pathlib import Path


def mend() -> None:
    """Mend both, for every library of the wrapper that the process has loaded."""
    if sys.platform != "linux":
        return
    for library in _loaded():
        _end_in_time(library)
    if not getattr(sys, "orig_argv", True) and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        try:  # a host that embeds Python itself keeps what it has
            signal.signal(signal.SIGINT, signal.default_int_handler)
        except ValueError:  # this is not Python's main thread, which the wrapper made for itself
            ctypes.CDLL(None).signal(signal.SIGINT, ctypes.c_void_p(0))  # SIG_DFL


def _loaded() -> set[str]:
    """The paths of the wrapper's libraries in this process."""
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return set()
    return set(re.findall(r"/\S.*/binaries/linux64/.*\.so$", maps, flags=re.MULTILINE))


@lru_cache(maxsize=None)  # noqa: UP033, older Pythons get as far as the sentence that rejects them
def _end_in_time(library: str) -> None:
    try:
        wrapper = ctypes.CDLL(library, mode=os.RTLD_NOLOAD | os.RTLD_NOW)
        ctypes.CDLL(None).__cxa_atexit(wrapper.finalizePythonInterpreter, None, None)
    except (OSError, AttributeError):  # not loaded under this name, or no wrapper of this kind
        return
