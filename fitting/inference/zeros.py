"""Zeros of sensors as unknowns of a calibration: ``C.P.zero``, the offset of a channel that all recordings share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import TypeVar

from solver.laws.catalogue import ZERO, zero_of
from solver.network.description import Channel, Network
from solver.quantities.quantity import Quantity

T = TypeVar("T")

_SIZES = {"P": 700.0, "Q": 2e-6, "R": 2e-4}  # the sd of a prior: 5 mmHg, 2 mL/s, 0.2 mm


def zero_name(channel: str) -> str:
    """The name of a channel's zero."""
    return f"{channel}.{ZERO}"


def is_zero(name: str) -> bool:
    """Whether an unknown is the zero of a channel."""
    return name.rpartition(".")[2] == ZERO


def zero_quantities(network: Network) -> dict[str, Quantity]:
    """The zero of every output, by name."""
    return {zero_name(channel): _quantity(channel.rpartition(".")[2]) for channel in network.output_units()}


@cache
def _quantity(signal: str) -> Quantity:
    """The zero of a sensor of P, Q or R."""
    return replace(Channel(signal).quantities()[ZERO], nominal=_SIZES[signal], spread=1.0)


def zero_values(network: Network) -> dict[str, float]:
    """The known zero of every output [SI], by name."""
    return {zero_name(channel): zero_of(network, channel) for channel in network.output_units()}


def apart(values: Mapping[str, T], network: Network) -> tuple[dict[str, T], dict[str, T]]:
    """Values by name, parameters of the network apart from zeros of its outputs."""
    known = zero_quantities(network)
    zeros = {name: value for name, value in values.items() if name in known}
    return {name: value for name, value in values.items() if name not in known}, zeros
