"""The inlet of a network and its drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..quantities.quantity import quantity
from .curve import Curve

CAUSALITY = {"Q": "flow", "P": "pressure"}  # of an inlet, by its prescribed signal


@dataclass(frozen=True)
class Inlet:
    """An inlet and its default inflow: Q(t) = Q_max max(0, sin 2πt/T), the paper's cyclic half-sine.

    causality : the prescribed quantity, flow or pressure; the other one is an output.
    curve : replaces the half-sine; Q_max and T are then those of the curve.
    first : whether its variables are named ``inlet.Q``; those of further inlets are ``LSA.inlet.Q``.
    """

    segment: str
    Q_max: float = quantity(55e-6, "m^3/s", "peak inflow Q_max", 0.0, 1.0, nominal=1e-4, display="mL/s")
    T: float = quantity(0.5, "s", "period T", 1e-3, 100.0)
    causality: str = "flow"
    curve: Curve | None = None
    first: bool = True

    def __post_init__(self) -> None:
        if self.curve is not None:
            object.__setattr__(self, "T", self.curve.period)
        if self._flow is not None:
            object.__setattr__(self, "Q_max", max(0.0, self._flow.largest))

    @property
    def _flow(self) -> Curve | None:
        return self.curve if self.curve is not None and self.curve.signal == "Q" else None

    @property
    def drive(self) -> str:
        """The prescribed variable: inlet.Q or inlet.P."""
        return self.variable("Q" if self.causality == "flow" else "P")

    @property
    def answer(self) -> str:
        """The resulting variable: inlet.P or inlet.Q."""
        return self.variable("P" if self.causality == "flow" else "Q")

    @property
    def name(self) -> str:
        """The prefix of its variables."""
        return "inlet" if self.first else f"{self.segment}.inlet"

    def variable(self, key: str) -> str:
        """The name of one of its variables: inlet.Q."""
        return f"{self.name}.{key}"

    @property
    def shape(self) -> str:
        """The default inflow in words."""
        return "a half-sine" if self._flow is None else "the inflow of the network"

    @property
    def Q_mean(self) -> float:
        """The mean of the inflow [m³/s]."""
        return self.Q_max / np.pi if self._flow is None else self._flow.mean

    @property
    def P_mean(self) -> float | None:
        """The mean of the pressure [Pa], if it has a pressure curve."""
        return self.curve.mean if self.curve is not None and self.curve.signal == "P" else None

    @property
    def mean(self) -> float | None:
        """The mean of the prescribed quantity: of the flow [m³/s], or of the pressure [Pa] if it has a pressure
        curve."""
        return self.Q_mean if self.causality == "flow" else self.P_mean

    def with_mean(self, mean: float | None, T: float) -> Inlet:
        """The same inlet with another :attr:`mean` and another period [s]: a flow is scaled (a half-sine if its mean is
        0); a pressure is shifted."""
        if (mean, T) == (self.mean, self.T):
            return self
        if self.causality == "pressure":
            curve = self.curve and self.curve.scaled(1.0, T / self.T)
            by = 0.0 if mean is None or self.P_mean is None else mean - self.P_mean
            return replace(self, T=T, curve=curve and curve.raised(by))
        if self._flow is None or self.Q_mean == 0.0:
            return replace(self, Q_max=np.pi * (mean or 0.0), T=T, curve=None)
        return replace(self, curve=self._flow.scaled((mean or 0.0) / self.Q_mean, T / self.T))

    def Q(self, t: np.ndarray | float) -> np.ndarray:
        """Inflow Q(t) [m³/s] at times t [s], any shape."""
        # the phase is reduced first: sin(2π t/T) after many beats loses digits
        phase = np.mod(np.asarray(t, float) / self.T, 1.0)
        if self._flow is not None:
            return self._flow.at(phase)
        return self.Q_max * np.maximum(0.0, np.sin(2 * np.pi * phase))

    @property
    def given(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """The default drive, Q(t) [m³/s] or P(t) [Pa]; None for a pressure inlet without a curve."""
        if self.causality == "flow":
            return self.Q
        curve = self.curve
        return None if curve is None or curve.signal == "Q" else lambda t: curve.at(np.asarray(t, float) / self.T)
