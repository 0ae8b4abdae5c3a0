"""The part of a slave that fails in one sentence, with references that keep the host alive, and saves its state."""

from __future__ import annotations

import ctypes
import traceback
import weakref
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from pythonfmu import Fmi2Slave

from solver.errors import InputError, NonPhysicalState
from solver.io.saved import from_bytes, to_bytes
from solver.lumped.component import Component

INSTANTIATED, INITIALIZING, STEPPING, TERMINATED = "instantiated", "initialization mode", "stepping", "terminated"

P = ParamSpec("P")
T = TypeVar("T")

_KEPT = ("values", "phase", "t0", "stop_time", "outdated", "late_due", "changed")  # attributes of a slave in a state
_INSTANCES: weakref.WeakSet[SavingSlave] = weakref.WeakSet()  # that the host has not freed


@dataclass
class Snapshot:
    """A saved state: the attributes of the slave that ``_KEPT`` names, and those of the component. blob : the same in
    bytes."""

    guid: str
    slave: dict[str, Any]
    component: dict[str, Any]
    blob: bytes | None = None


def guarded(what: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A callback of a slave that fails in one sentence: what it was doing, and why that failed."""

    def of(callback: Callable[P, T]) -> Callable[P, T]:
        @wraps(callback)
        def guarding(*given: P.args, **named: P.kwargs) -> T:
            try:
                return callback(*given, **named)
            except BaseException as error:
                slave: Any = given[0]
                message = sentence(slave.instance_name, error, what)
            compensate(slave)
            raise ValueError(message)

        return guarding

    return of


class SavingSlave(Fmi2Slave):
    """The four hooks of saved states, two of which the wrapper calls on the class: they know no instance, so no log."""

    content_hash = ""
    values: list[Any]
    phase: str
    component: Component

    @classmethod
    @abstractmethod
    def _new(cls) -> Component:
        """A new component."""

    @classmethod
    @abstractmethod
    def _title(cls) -> str:
        """What a message begins with where the instance is not known."""

    @abstractmethod
    def _settle(self) -> None:
        """Make sure that the right code runs."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        _INSTANCES.add(self)

    # --- saved states ---------------------------------------------------------------------------------------------

    @guarded("saving the state")
    def _get_fmu_state(self) -> Snapshot:
        slave = {**{name: getattr(self, name) for name in _KEPT}, "values": tuple(self.values)}
        return Snapshot(self.content_hash, slave, self.component.__dict__.copy())

    @guarded("restoring the state")
    def _set_fmu_state(self, state: Any) -> None:
        _check_state(state, self.content_hash)
        if self.phase == INSTANTIATED:
            self._settle()
        self.__dict__ |= {**state.slave, "values": list(state.slave["values"])}
        self.component.__dict__ = state.component.copy()

    @classmethod
    def _fmu_state_to_bytes(cls, state: Any) -> bytes:
        def write() -> bytes:
            _check_state(state, cls.content_hash)
            if state.blob is None:  # the wrapper asks twice: for the size and for the bytes
                component = cls._new()
                component.__dict__ |= state.component
                content = {name: value for name, value in state.component.items() if name not in component.remade}
                state.blob = to_bytes(cls.content_hash, {"slave": state.slave, "component": content}, component.kinds())
            return state.blob

        return cls._refused("writing a state", write)

    @classmethod
    def _fmu_state_from_bytes(cls, blob: bytes) -> Snapshot:
        def read() -> Snapshot:
            component = cls._new()
            content = from_bytes(blob, cls.content_hash, component.kinds())
            component.__dict__ |= content["component"]
            component.resumed()
            return Snapshot(cls.content_hash, content["slave"], component.__dict__, blob)

        return cls._refused("reading a state", read)

    # --- errors ---------------------------------------------------------------------------------------------------

    @classmethod
    def _refused(cls, what: str, action: Callable[[], T]) -> T:
        """As :func:`guarded`, where the instance is not known: any of this class may be the one that is called.

        The others stay in memory after the host has freed them, a quarter of a megabyte each.
        """
        try:
            return action()
        except BaseException as error:
            message = sentence(cls._title(), error, what)
        for instance in list(_INSTANCES):
            if type(instance) is cls:
                compensate(instance)
        raise ValueError(message)


def _check_state(state: Any, guid: str) -> None:
    if not isinstance(state, Snapshot) or state.guid != guid:
        raise InputError("the state is not one of this FMU; give one that this FMU saved.")


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
