"""A table of an additional term at one place: a source of model.toml, which describes without explaining.

    [[sources]]
    kind = "outlet"   segment = "CA"   T = "0.5 s"   Q_mean = 0   Q_cos = ["0.1 mL/s"]   Q_sin = [0]

adds g(t) to the equations of a network, as :mod:`solver.mesh.sources` has them, from t = 0 of a simulation on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..laws.effect import Described
from ..quantities.text import check_keys, did_you_mean, parse_quantity
from . import inlet_curves
from .curve import Curve

# the signal of each kind, and its position keys with their ranges
KINDS: Mapping[str, tuple[str, Mapping[str, tuple[float, float, float]]]] = {
    "wall": ("P", {"degree": (0.0, 2.0, 0.0)}),
    "drop": ("P", {"start": (0.0, 1.0, 0.0), "end": (0.0, 1.0, 1.0)}),
    "step": ("P", {"end": (0.0, 1.0, 1.0)}),
    "outflow": ("Q", {}),
    "outlet": ("Q", {}),
}
WHOLE = ("degree", "step.end")  # numbers that are counted
_SAME_PERIOD = 1e-6


@dataclass(frozen=True)
class TableSource:
    """g(t) of a kind of source in a segment, or at its outlet; how : the numbers that say where in it.

    Raises ValueError for an unknown kind or number, or a curve of another signal.
    """

    kind: str
    segment: str
    curve: Curve
    how: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        where = self.label
        if self.kind not in KINDS:
            raise InputError(f"{where}: no such kind; use {', '.join(KINDS)}{did_you_mean(self.kind, KINDS)}.")
        signal, known = KINDS[self.kind]
        if self.curve.signal != signal:
            raise InputError(f"{where}: it is given as {self.curve.signal}; give {signal} of a source {self.kind}.")
        check_keys(where, self.how, known)
        for key, (low, high, _) in known.items():
            whole = {key, f"{self.kind}.{key}"} & set(WHOLE)
            if not low <= self.value(key) <= high or (whole and self.value(key) % 1.0):
                raise InputError(f"{where}: {key} = {self.value(key):g}; give {'a whole number' if whole else 'one'} "
                                 f"from {low:g} to {high:g}.")  # fmt: skip
        if self.kind == "drop" and not self.value("start") < self.value("end"):
            raise InputError(f"{where}: it ends at {self.value('end'):g}, before it starts; give start < end.")

    @property
    def label(self) -> str:
        """In a sentence."""
        return f"source {self.kind} of {self.segment}"

    def value(self, key: str) -> float:
        """A position key."""
        return float(self.how.get(key, KINDS[self.kind][1][key][2]))

    def check_repeats(self, T: float) -> None:
        """Raise ValueError unless it repeats within beats of T [s]."""
        beats = T / self.curve.period
        if not round(beats) or abs(beats - round(beats)) > _SAME_PERIOD * beats:
            raise InputError(
                f"{self.label}: it repeats every {self.curve.period:g} s and the beat every {T:g} s; a table describes "
                "the beat that it was made of: give that period, or leave the source out."
            )


def check(sources: tuple[TableSource, ...], network: Described) -> None:
    """Raise ValueError for a source in no segment, or at no outlet."""
    segments, outlets = [s.name for s in network.segments], [o.segment for o in network.outlets]
    for source in sources:
        known = outlets if source.kind == "outlet" else segments
        if source.segment not in known:
            near = did_you_mean(source.segment, known)
            raise InputError(f"{source.label}: network {network.name} has none there; use {', '.join(known)}{near}.")


def refuse(sources: tuple[TableSource, ...], action: str) -> None:
    """Raise ValueError where there are sources that something does not have."""
    for source in sources:
        raise InputError(f"{source.label}: {action} does not have tables of sources; leave it out.")


def read(table: Any, folder: Path | None) -> TableSource:
    """That of a section [[sources]]. Raises ValueError."""
    if not isinstance(table, dict) or not all(isinstance(table.get(key), str) for key in ("kind", "segment")):
        raise InputError('sources: must be sections [[sources]] with kind = "outlet" and segment = "CA".')
    kind, segment = table["kind"], table["segment"]
    where, numbers = f"source {kind} of {segment}", tuple(KINDS.get(kind, ("", {}))[1])
    check_keys(where, table, ("kind", "segment", "T", *numbers, *inlet_curves.KEYS))
    period = parse_quantity(table["T"], "s", f"{where}: T") if "T" in table else None
    curve = inlet_curves.read(table, where, folder, period)
    if curve is None:
        raise InputError(f"{where}: it has no values; give a table or a series, such as Q_mean, Q_cos, Q_sin and T.")
    how = {key: parse_quantity(table[key], "1", f"{where}: {key}") for key in numbers if key in table}
    return TableSource(kind, segment, curve, how)


def section(source: TableSource) -> dict[str, Any]:
    """The section that :func:`read` makes an equal one of."""
    return {"kind": source.kind, "segment": source.segment, **source.how, **inlet_curves.section(source.curve)}
