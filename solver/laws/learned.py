"""Laws of a wall and of an outlet that are learned from a record: a few terms, valid in the observed range of state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..quantities.quantity import Quantity, quantities
from .effect import Array, Described, Effect, SearchSpec, Values, small_wave_impedance
from .wall import Wall

_BEYOND = 0.25  # margin of validity, as a fraction of the observed range: a refit and other beats stay within it


class LearnedWall(Effect):
    """An additional viscous stress (:class:`~solver.laws.wall_laws.LearnedStress`), learned where no law of the
    catalogue explains the record."""

    name = "learned_wall"
    equation = (
        "σ = … + (rise u + fall (1 - u)) ε̇ + cubic ε̇³ + friction tanh(4ε̇/rate), u = (ε - low)/span in [0, 1]; beyond "
        "±rate it is linear in ε̇"
    )
    owner = "segment"
    places = ("all", "segment")
    terms = {
        "learned_rise": Quantity("Pa.s", "learned viscosity at the highest strain", 0.0, 1e8, nominal=1e3),
        "learned_fall": Quantity("Pa.s", "learned viscosity at the lowest strain", 0.0, 1e8, nominal=1e3),
        "learned_cubic": Quantity("Pa.s^3", "learned stress per cube of the strain rate", 0.0, 1e10, nominal=1e3),
        "learned_friction": Quantity("Pa", "learned friction: its stress at high strain rates", 0.0, 1e8, nominal=1e3),
        "learned_low": Quantity("1", "lowest strain of the learned law, constant below", -0.9, 10.0, nominal=0.1),
        "learned_span": Quantity(
            "1", "strain range of the learned law, constant above", 0.0, 10.0, nominal=0.1, open_low=True
        ),
        "learned_rate": Quantity(
            "1/s", "highest strain rate of the learned law, linear beyond", 0.0, 1e4, open_low=True
        ),
    }
    neutral = dict.fromkeys(tuple(terms)[:5], 0.0) | {"learned_span": 1.0, "learned_rate": 1.0}
    how = ("learned_low", "learned_span", "learned_rate")
    library = ("learned_rise", "learned_fall", "learned_cubic", "learned_friction")
    # relative to E: the stress of 0.3 times an ordinary viscosity, φ0 = 0.017 s E, at strain rates of 0.5/s
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
    signature = "a loss that no viscous law of the catalogue reproduces"
    confusable = ("nonlinear_wall_viscosity", "fractional_viscosity")
    separator = "a second mean pressure and heart rate"

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, learned=np.stack(np.broadcast_arrays(*(values[key] for key in self.terms))))

    def valid(self, strain: Array, rate: Array) -> dict[str, float]:
        low, high = float(strain.min()), float(strain.max())
        more = _BEYOND * (high - low)
        most = (1.0 + _BEYOND) * float(np.abs(rate).max())
        low = max(low - more, self.terms["learned_low"].low)  # a model far off may nearly collapse
        return {"learned_low": low, "learned_span": high + more - low, "learned_rate": most}

    def formula(self, keys: Sequence[str]) -> str:
        each = {
            "learned_rise": "rise u ε̇",
            "learned_fall": "fall (1 - u) ε̇",
            "learned_cubic": "cubic ε̇³",
            "learned_friction": "friction tanh(4ε̇/rate)",
        }
        text = f"σ = … + {' + '.join(each[key] for key in keys)}"
        return text + (", u = (ε - low)/span" if {"learned_rise", "learned_fall"} & set(keys) else "")


class LearnedOutlet(Effect):
    """An additional flow through an outlet, with a conductance that depends on the pressure. No number is negative, so
    that the flow always follows the pressure drop and releases no energy over a cycle. A flow proportional to dP/dt is
    a compliance, which the catalogue already has (``terminal_compliance``)."""

    name = "learned_outlet"
    equation = "Q = … + (open u + shut (1 - u)) (P - P_venous), u = (P - P_venous - from)/over in [0, 1]"
    owner = "outlet"
    places = ("all", "outlet")
    terms = {
        "learned_open": Quantity(
            "m^3/(Pa.s)", "learned conductance at the highest pressure", 0.0, 1e-3, nominal=1e-10, display="mL/(s.mmHg)"
        ),
        "learned_shut": Quantity(
            "m^3/(Pa.s)", "learned conductance at the lowest pressure", 0.0, 1e-3, nominal=1e-10, display="mL/(s.mmHg)"
        ),
        "learned_from": Quantity(
            "Pa", "lowest P - P_venous of the learned law, constant below", -1e6, 1e6, nominal=1e3, display="mmHg"
        ),
        "learned_over": Quantity(
            "Pa",
            "pressure range of the learned law, constant above",
            0.0,
            1e6,
            nominal=1e3,
            display="mmHg",
            open_low=True,
        ),
    }
    neutral = {"learned_open": 0.0, "learned_shut": 0.0, "learned_from": 0.0, "learned_over": 1.0}
    how = ("learned_from", "learned_over")
    library = ("learned_open", "learned_shut")
    search = SearchSpec(typical={"learned_open": 0.1, "learned_shut": 0.1})  # times 1/Z of small waves
    signature = "an outlet whose conductance changes with the pressure"
    confusable = ("terminal_reflection",)
    separator = "a second mean pressure"

    def acts_on(self, owner: Any) -> bool:
        return not owner.stores and bool({"R", "R_t"} & set(quantities(owner)))

    def step(self, network: Described, owner: Any, key: str) -> float:
        Z = small_wave_impedance(network, network.segment(owner.segment))
        return super().step(network, owner, key) / Z

    def outflow(self, P: Array, values: Values) -> tuple[Array, Array]:
        low, over = values["learned_from"], values["learned_over"]
        u = np.clip((P - low) / over, 0.0, 1.0)
        g = values["learned_open"] * u + values["learned_shut"] * (1.0 - u)
        inside = (P >= low) & (P <= low + over)
        bent = np.where(inside, (values["learned_open"] - values["learned_shut"]) / over * P, 0.0)
        return g * P, g + bent

    def valid(self, state: Array, rate: Array) -> dict[str, float]:
        low, high = float(state.min()), float(state.max())
        more = _BEYOND * (high - low)
        return {"learned_from": low - more, "learned_over": high - low + 2.0 * more}

    def formula(self, keys: Sequence[str]) -> str:
        each = {"learned_open": "open u", "learned_shut": "shut (1 - u)"}
        text = " + ".join(each[key] for key in keys)
        return f"Q = … + ({text}) (P - P_venous), u = (P - P_venous - from)/over"
