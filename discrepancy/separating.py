"""Which measurement would tell the members of a class apart, in a sentence."""

from __future__ import annotations

from .places import entry, of_sensor
from .verdict import Naming


def separating_measurement(naming: Naming) -> str | None:
    """What the catalogue says separates the best of the class from the others; None for a class of one."""
    if len(naming.members) < 2:
        return None
    effects = list(dict.fromkeys(t.effect for n in naming.members for t in n.fit.terms))
    places = list(dict.fromkeys(t.place for n in naming.members for t in n.fit.terms))
    sensors = [e for e in effects if of_sensor(e)]
    if sensors and len(effects) > len(sensors):
        channels = [t.place for n in naming.members for t in n.fit.terms if t.is_sensor]
        named = " and ".join(dict.fromkeys(channels))
        return (
            f"Calibrate {named}: feed its sensor a known wave, or record the same beats with a second sensor there; "
            f"a fault of the measurement shows without the artery."
        )
    if len(effects) == 1:
        return (
            f"The effect is clear, its place is not ({', '.join(places)}): record pressure, flow and radius between "
            f"these places."
        )
    said = dict.fromkeys(entry(e).separator for e in effects)
    return f"Measure what tells them apart: {'; '.join(said)}."
