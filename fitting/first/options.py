"""What a first model takes beside the recording: the options of its user, and typical aortas for what pressure and flow
do not determine (radius, thickness over radius, wave speed, viscosity over E).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.network.description import Network
from solver.network.files import bundled, read_network
from solver.quantities.units import MMHG

REFERENCE = "first model of "  # how the reference of the file of a first model begins
VENOUS = 5.0 * MMHG  # as in the bundled network human


@dataclass(frozen=True)
class FirstOptions:
    """The keywords of :func:`fitting.first.model.first_model`, in SI.

    like : species whose typical aorta replaces missing measurements; mass : of the body [kg]. P_venous [Pa].
    distances : of sites from the root, along the vessels [m]. paths : "Ao,CA", the sites along each path.
    """

    like: str | None = None
    mass: float | None = None
    P_venous: float = VENOUS
    distances: Mapping[str, float] = field(default_factory=dict)
    paths: tuple[str, ...] = ()

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults, as plain data; quantities with their units."""
        plain = {
            "like": self.like,
            "mass": {"value": self.mass, "unit": "kg"},
            "P_venous": {"value": self.P_venous, "unit": "Pa"},
            "distances": {site: {"value": x, "unit": "m"} for site, x in self.distances.items()},
            "paths": list(self.paths),
        }
        usual = vars(FirstOptions())
        return {key: value for key, value in plain.items() if getattr(self, key) != usual[key]}


WEST = "G. B. West, J. H. Brown, B. J. Enquist, Science 276 (1997) 122"
_POWER = 3.0 / 8.0  # of the body mass, for the radius of the aorta; pressure and velocities do not scale
HUMAN, _STROKE, _BEAT = 70.0, 70e-6, 60.0 / 70.0  # [kg], [m³], [s]; a stroke grows with the mass, T with mass^(1/4)
_LIGHTEST, _HEAVIEST = 0.02, 1000.0  # [kg]: a mouse, a horse or an ox


@dataclass(frozen=True)
class Typical:
    """An aorta at its root. R : radius [m]; h_R : h/R; c : wave speed [m/s]; relaxation : φ0/E [s]; source : of all;
    mass : of the body [kg]."""

    R: float
    h_R: float
    c: float
    relaxation: float
    source: str
    mass: float


# of a bundled network its first artery, for the mass that the network is of [kg] and the usual one of the species; the
# masses are our choice
_SPECIES = {
    "human": ("human", HUMAN, HUMAN),
    "sheep": ("sheep", 30.0, 30.0),
    "pig": ("human", HUMAN, 40.0),
    "dog": ("human", HUMAN, 20.0),
}
NAMES = tuple(_SPECIES)


def typical(species: str, mass: float | None = None) -> Typical:
    """The aorta of a species at a body mass [kg], by default its usual one: R ∝ mass^(3/8), all else equal.

    Source of the power: West, Brown and Enquist (1997). Raises InputError for another species or an impossible mass.
    """
    if species not in _SPECIES:
        raise InputError(
            f"--like {species}: must be one of {', '.join(NAMES)}; take the one that is nearest in size, with the body "
            'mass (--mass "3 kg").'
        )
    name, own, usual = _SPECIES[species]
    mass = usual if mass is None else mass
    if not _LIGHTEST <= mass <= _HEAVIEST:
        raise InputError(
            f"--mass = {mass:g} kg: the radius of an aorta follows from the mass for mammals of {_LIGHTEST:g} to "
            f"{_HEAVIEST:g} kg; check its unit."
        )
    network = read_network(bundled(name))
    aorta = network.segment(network.inlet.segment)
    R = float(aorta.R0 * (mass / own) ** _POWER)
    h_R = aorta.h / aorta.R0
    c = float(np.sqrt(aorta.E * h_R / (2.0 * network.fluid.rho * (1.0 - network.eta**2))))
    scaled = "" if mass == own else f", its radius scaled to {mass:g} kg by mass^(3/8) ({WEST})"
    return Typical(R, h_R, c, aorta.phi0 / aorta.E, f"{aorta.name} of the bundled network {name}{scaled}", mass)


def by_stroke(stroke: float) -> Typical:
    """The human aorta scaled to the animal whose stroke volume [m³] this is, at 1 mL/kg within the masses of mammals.

    A stroke tells the size better than the flow or the heart rate, both of which rise in exercise.
    """
    found = typical("human", min(max(HUMAN * stroke / _STROKE, _LIGHTEST), _HEAVIEST))
    return replace(found, source=f"{found.source}: a stroke of {1e6 * stroke:.3g} mL at 1 mL/kg")


def mass_by_period(T: float) -> float:
    """The body mass [kg] of a heart period [s], within the masses of mammals: T ∝ mass^(1/4), as the source of the
    radius has it."""
    return min(max(HUMAN * (T / _BEAT) ** 4, _LIGHTEST), _HEAVIEST)


def is_first(network: Network) -> bool:
    """Whether a network is a first model, edited or not: its reference says so."""
    return network.reference.startswith(REFERENCE)
