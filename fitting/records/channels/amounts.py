"""What is left of channels, in the units that people read."""

from __future__ import annotations

from collections.abc import Mapping

from solver.quantities.legible import number
from solver.quantities.units import of_signal

_MOST = 4  # channels by name


def sizes(rms: Mapping[str, float], loud: Mapping[str, float] | None = None) -> str:
    """ "1.3 mmHg of Ao.P, 2.1 mmHg of Pe.P"; rms : by channel [SI]. Of many channels, those of the largest ``loud``."""
    texts = [f"{size_text(name, rms[name])} of {name}" for name in loudest(rms, loud)]
    return ", ".join(texts) + (f" and {rest} more" if (rest := len(rms) - len(texts)) else "")


def changes(before: Mapping[str, float], after: Mapping[str, float], loud: Mapping[str, float] | None = None) -> str:
    """ "Ao.P from 1.3 to 0.9 mmHg, Pe.P still 2.1 mmHg"."""
    texts = []
    for name in loudest(before, loud):
        first, last = size_text(name, before[name]), size_text(name, after[name])
        number_alone = size_text(name, before[name], unit=False)
        texts.append(f"{name} still {last}" if first == last else f"{name} from {number_alone} to {last}")
    return ", ".join(texts) + (f" and {rest} more" if (rest := len(before) - len(texts)) else "")


def loudest(rms: Mapping[str, float], loud: Mapping[str, float] | None = None) -> list[str]:
    """The channels that are shown, in the order in which they stand."""
    most = sorted(rms, key=lambda name: -(loud or {}).get(name, 0.0))[:_MOST]
    return [name for name in rms if name in most]


def size_text(name: str, rms: float, unit: bool = True) -> str:
    """The rms [SI] of a channel: "1.3 mmHg"."""
    display, factor = of_signal(name)
    return f"{number(factor * rms, 2)} {display}" if unit else number(factor * rms, 2)
