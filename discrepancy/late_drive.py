"""Sensors that are early, where a flow drives the model: the simplest reading is that the flow meter is late."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from solver.legible import number
from solver.sensors import Sensor
from solver.units import INFLOW, readable

from .outcome import NamedEffect
from .places import entry


def late_drive(effects: Iterable[NamedEffect], channels: Sequence[str]) -> str:
    """ "inlet.Q is 22 ms late", if all pressures and radii among the channels are early by delays that agree within
    their intervals; flows without a delay are then late with it. Else "".

    effects : that were added to a model driven by inlet.Q.
    """
    delays = {e.where[0]: ends for e in effects if (ends := _delay(e)) is not None}
    others = {name for name in channels if not name.endswith(".Q")}
    if not delays or not others <= set(delays) or any(value >= 0.0 for value, _, _ in delays.values()):
        return ""
    if max(low for _, low, _ in delays.values()) > min(high for _, _, high in delays.values()):
        return ""
    late = [INFLOW, *(name for name in channels if name.endswith(".Q") and name not in delays)]
    unit, factor = readable("s", "ms")
    size = number(-factor * sum(value for value, _, _ in delays.values()) / len(delays))
    return f"{' and '.join(late)} {'are' if len(late) > 1 else 'is'} {size} {unit} late"


def _delay(effect: NamedEffect) -> tuple[float, float, float] | None:
    """Value and ends [s] of an effect that is nothing but a delay of its channel."""
    sensor = entry(effect.name)
    if not isinstance(sensor, Sensor) or len(effect.where) != 1:
        return None
    each = {name.rpartition(".")[2]: e for name, e in effect.parameters.items()}
    if not set(sensor.terms) <= set(each):
        return None
    value = sensor.delay({key: e.value for key, e in each.items()})
    low, high = (sensor.delay({key: e.ci95[i] for key, e in each.items()}) for i in (0, 1))
    return None if value is None or low is None or high is None else (value, low, high)
