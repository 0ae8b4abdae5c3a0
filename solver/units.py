"""Units: the SI unit of every kind of signal."""

from __future__ import annotations

SIGNAL_UNITS = {"P": "Pa", "Q": "m^3/s", "R": "m"}  # by the last letter of an output's name
