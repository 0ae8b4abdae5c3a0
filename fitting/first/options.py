"""What a first model takes from its user instead of the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from solver.quantities.units import MMHG

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
