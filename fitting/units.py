"""Units: SI by kind of channel, what people read instead, and what drives a network."""

from __future__ import annotations

INFLOW = "inlet.Q"  # the channel of a record, and the input of an FMU, that drives a network
MMHG = 133.322387415  # Pa

# last letter of a channel's name -> SI unit; unit people read it in, factor from SI
UNITS = {"P": "Pa", "Q": "m^3/s", "R": "m"}
DISPLAY = {"P": ("mmHg", 1.0 / MMHG), "Q": ("mL/s", 1e6), "R": ("mm", 1e3)}

# SI unit of an index -> unit people read it in, factor from SI
READ = {
    "Pa": ("MPa", 1e-6),
    "1/Pa": ("10⁻³/mmHg", 1e3 * MMHG),
    "m^2/Pa": ("mm²/mmHg", 1e6 * MMHG),
    "m/s": ("m/s", 1.0),
    "J/m": ("mJ/m", 1e3),
    "s": ("ms", 1e3),
    "1": ("", 1.0),
}
