"""A wall's law that was learned from a record: some of a few terms of strain and strain rate, where they were seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .effect import Array, Effect, SearchSpec, Values
from .quantity import Quantity
from .wall import Wall

_BEYOND = 0.25  # of a range that was seen, by which it is held farther: a refit and other beats move within that


class LearnedWall(Effect):
    """A further viscous stress, :class:`~solver.laws.LearnedStress`: what is found where no law of the catalogue is."""

    name = "learned_wall"
    equation = (
        "σ = … + (rise u + fall (1 - u)) ε̇ + cubic ε̇³ + friction tanh(4ε̇/rate), u = (ε - low)/span in [0, 1]; beyond "
        "±rate its slope in ε̇ is held"
    )
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "learned_rise": Quantity("Pa.s", "learned viscosity at the highest strain", 0.0, 1e8, nominal=1e3),
        "learned_fall": Quantity("Pa.s", "learned viscosity at the lowest strain", 0.0, 1e8, nominal=1e3),
        "learned_cubic": Quantity("Pa.s^3", "learned stress per cube of the strain rate", 0.0, 1e10, nominal=1e3),
        "learned_friction": Quantity(
            "Pa", "learned stress that high strain rates do not exceed", 0.0, 1e8, nominal=1e3
        ),
        "learned_low": Quantity("1", "lowest strain of the learned law, held below", -0.9, 10.0, nominal=0.1),
        "learned_span": Quantity("1", "range of its strains, held above", 0.0, 10.0, nominal=0.1, open_low=True),
        "learned_rate": Quantity(
            "1/s", "highest strain rate of the law, its slope held beyond", 0.0, 1e4, open_low=True
        ),
    }
    neutral = dict.fromkeys(tuple(terms)[:5], 0.0) | {"learned_span": 1.0, "learned_rate": 1.0}
    how = ("learned_low", "learned_span", "learned_rate")
    library = ("learned_rise", "learned_fall", "learned_cubic", "learned_friction")
    # of E, as much as 0.3 of an ordinary viscosity φ0 = 0.017 s E does at strain rates of 0.5/s
    search = SearchSpec(
        typical={"learned_rise": 0.005, "learned_fall": 0.005, "learned_cubic": 0.02, "learned_friction": 0.0025},
        relative={
            "learned_rise": ("E", "s"),
            "learned_fall": ("E", "s"),
            "learned_cubic": ("E", "s^3"),
            "learned_friction": ("E", "1"),
        },
        local=True,
    )
    signature = "a loss that no viscosity of the catalogue has"
    confusable = ("nonlinear_wall_viscosity", "fractional_viscosity")
    separator = "other pressures and heart rates"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, learned=np.stack(np.broadcast_arrays(*(values[key] for key in self.terms))))

    def valid(self, strain: Array, rate: Array) -> dict[str, float]:
        low, high = float(strain.min()), float(strain.max())
        more = _BEYOND * (high - low)
        most = (1.0 + _BEYOND) * float(np.abs(rate).max())
        return {"learned_low": low - more, "learned_span": high - low + 2.0 * more, "learned_rate": most}

    def formula(self, keys: Sequence[str]) -> str:
        each = {
            "learned_rise": "rise u ε̇",
            "learned_fall": "fall (1 - u) ε̇",
            "learned_cubic": "cubic ε̇³",
            "learned_friction": "friction tanh(4ε̇/rate)",
        }
        said = f"σ = … + {' + '.join(each[key] for key in keys)}"
        return said + (", u = (ε - low)/span" if {"learned_rise", "learned_fall"} & set(keys) else "")
