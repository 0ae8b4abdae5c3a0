"""What sensors are known to have: ``inlet.Q=lowpass 10 Hz order 2``, ``inlet.Q=delay 20 ms``, ``C.P=zero 4 mmHg``."""

from __future__ import annotations

from collections.abc import Iterable

from solver.errors import InputError
from solver.laws import effects
from solver.laws.sensors import Known
from solver.network.description import Channel, Network
from solver.quantities.text import typed_quantity


def with_filters(network: Network, filters: Iterable[str]) -> Network:
    """The network whose channels have these filters, beside those of its file.

    Raises ValueError, one sentence, for a filter or channel that is none, and for a number without unit.
    """
    terms: dict[str, float] = {}
    for text in filters:
        channel, _, words = (part.strip() for part in text.partition("="))
        found = [(e, parsed) for e in effects.ALL if isinstance(e, Known) and (parsed := e.parse(words)) is not None]
        if not found:
            raise InputError(
                f'--filter "{text}": must be CHANNEL=lowpass FREQUENCY, such as "inlet.Q=lowpass 10 Hz", with order 2 '
                "behind it if it is not of first order, CHANNEL=delay TIME, such as inlet.Q=delay 20 ms, or "
                "CHANNEL=zero AMOUNT, such as C.P=zero 4 mmHg."
            )
        if channel not in network.channel_names():
            raise InputError(
                f'--filter "{text}": network {network.name} has no channel {channel!r}; use one of '
                f"{', '.join(network.channel_names())}."
            )
        ((effect, stated),) = found
        units = {key: Channel(channel).quantities()[key].unit for key in effect.terms}
        values = {key: typed_quantity(stated[key], unit, f"--filter {channel}") for key, unit in units.items()}
        neutral = all(values[key] == effect.neutral[key] for key in effect.terms if key not in effect.how)
        if neutral and effect.refuses_neutral:
            raise InputError(f'--filter "{text}": a filter that is none; {effect.refuses_neutral}.')
        terms |= {f"{channel}.{key}": value for key, value in values.items()}
    return network.with_terms(terms)
