"""How a callback may fail: one sentence for the log, and references that keep the host alive."""

from __future__ import annotations

import ctypes
import traceback

from pythonfmu import Fmi2Slave

from solver.errors import InputError
from solver.scheme.failure import NonPhysicalState


def compensate(instance: Fmi2Slave) -> None:
    """The wrapper drops these references before it reports fmi2Fatal, and once more when it frees the instance."""
    for owner in (type(instance), instance, instance.log_queue):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(owner))


def sentence(who: str, error: BaseException, what: str) -> str:
    """What goes to the host's log, where it is a printf format by the standard.

    A user's mistake is one sentence. Of a fault of ours, which must not kill the host either, it is everything.
    """
    if isinstance(error, (InputError, NonPhysicalState)):
        text = str(error)
    elif isinstance(error, KeyboardInterrupt):
        text = f"interrupted while {what}."
    else:
        text = f"internal error while {what}\n{traceback.format_exc()}"
    return f"{who}: {text}".replace("%", "%%")
