"""1D blood flow in networks of viscoelastic arteries.

>>> from solver import load, simulate_periodic
>>> beat = simulate_periodic(load("sheep"))
>>> beat["CA.P"].max()  # Pa
"""

from . import former_names as former_names
from .errors import InputError, NonPhysicalState
from .harmonics import beat_harmonics
from .laws.outlets import Pressure, Reflection, Resistance, Windkessel
from .muscl.settings import MusclSettings
from .network.description import Channel, Fluid, Inlet, Junction, Network, Segment, Site
from .network.files import bundled, find_network, read_network, write_network
from .network.inflow import sampled_inflow
from .scheme.model import Settings
from .simulate import NotPeriodic, repeating_beat, simulate, simulate_periodic
from .waveforms import Waveforms


def load(name_or_path: str) -> Network:
    """The network of a TOML file, or an included one by name ("sheep"). Raises ValueError as :func:`read_network`."""
    return read_network(find_network(name_or_path))


__all__ = [
    "Channel",
    "Fluid",
    "Inlet",
    "InputError",
    "Junction",
    "MusclSettings",
    "Network",
    "NonPhysicalState",
    "NotPeriodic",
    "Pressure",
    "Reflection",
    "Resistance",
    "Segment",
    "Settings",
    "Site",
    "Waveforms",
    "Windkessel",
    "beat_harmonics",
    "bundled",
    "find_network",
    "load",
    "read_network",
    "repeating_beat",
    "sampled_inflow",
    "simulate",
    "simulate_periodic",
    "write_network",
]
