"""What a gap to held-out beats is in words: in units of the noise, and in those of the channels."""

from __future__ import annotations

from collections.abc import Mapping

from fitting.records.amounts import changes, sizes
from solver.legible import number

from .show import Gap


def change(before: Gap, after: Gap) -> str:
    """How the gap to held-out beats changes, in words that follow the numbers."""
    first, last = (number(each.total[1]) for each in (before, after))
    if first == last:
        return f"stays at {first}"
    return f"{'falls' if after.total[1] < before.total[1] else 'rises'} from {first} to {last}"


def changed(before: Gap, after: Gap) -> str:
    """The same with its unit and, in brackets, what channels leave before and after: "Ao.P from 1.3 to 0.9 mmHg"."""
    rms = changes(_held_out(before.rms), _held_out(after.rms), _held_out(before.channels))
    return f"{change(before, after)} times the noise" + (f" ({rms})" if rms else "")


def left(gap: Gap) -> str:
    """The gap to held-out beats with its unit and, in brackets, what the channels leave: "1.3 mmHg of Ao.P"."""
    rms = sizes(_held_out(gap.rms), _held_out(gap.channels))
    return f"{gap.total[1]:.3g} times the noise" + (f" ({rms})" if rms else "")


def _held_out(pairs: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    return {name: pair[1] for name, pair in pairs.items()}
