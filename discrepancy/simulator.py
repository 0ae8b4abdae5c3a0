"""Periodic beats of one network under one inflow, for batches of hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fitting.records.noise import NEIGHBOURS, response
from solver import NonPhysicalState, Settings, simulate_periodic
from solver.network import Network
from solver.simulate import Waveforms

Array = np.ndarray
Tell = Callable[[str], None]

_PERIODIC = 1e-5
_SHORTER = 2  # times that the step is halved where the model as given breaks down


@dataclass
class Simulator:
    """Simulates hypotheses of one network under one inflow, and remembers the periodic states it started from.

    start : time [s] in the beat at which runs begin: where the flow is least, because a run begins at rest, and a
    flow that sets in at once would strain the walls as no heart does.
    """

    network: Network
    drive: Callable[[Array], Array]
    T: float
    names: tuple[str, ...]
    K: int
    settings: Settings
    start: float
    tell: Tell = field(default=lambda _: None)
    simulations: int = 0
    starts: dict[str, Waveforms] = field(default_factory=dict)

    def _beat(self, network: Network, parameters: Mapping[str, Array], start: Waveforms | None) -> Waveforms:
        """The periodic beats; from rest where the earlier state has another mesh (a stenosis elsewhere)."""
        try:
            return simulate_periodic(
                network,
                lambda t: self.drive(t + self.start),
                self.T,
                parameters=parameters,
                settings=self.settings,
                tolerance=_PERIODIC,
                start=start,
            )
        except ValueError:
            if start is None:
                raise
        return self._beat(network, parameters, None)

    def halved(self) -> Simulator:
        """The same with half the step."""
        return replace(self, settings=replace(self.settings, dt=self.settings.dt / 2.0), starts={})

    def finer(self) -> Simulator:
        """The same with half the step and half the elements, to see what both do."""
        half = self.halved()
        return replace(half, settings=replace(half.settings, element_length=self.settings.element_length / 2.0))

    def coefficients(self, network: Network, parameters: Mapping[str, Array], key: str) -> Array:
        """X : (B, K+1, m) of the periodic beats; ``key`` names networks that can start from one another's state."""
        size = next(iter(parameters.values())).size if parameters else 1
        beat = self._beat(network, parameters, self.starts.get(key))
        self.starts[key] = beat.member(0)
        self.simulations += size
        self.tell(f"{self.simulations} simulations")
        waves = np.stack([np.atleast_2d(beat[name])[:, :-1] for name in self.names], axis=-1)
        turn = np.exp(-2j * np.pi * np.arange(self.K + 1) * (self.start / self.T))
        return np.fft.rfft(waves, axis=1, norm="forward")[:, : self.K + 1] * turn[:, None]


def started(simulator: Simulator) -> tuple[Simulator, Array]:
    """The model as given under this inflow, with shorter steps if it needs them.

    Raises NonPhysicalState if none will do.
    """
    for _ in range(_SHORTER):
        try:
            return simulator, simulator.coefficients(simulator.network, {}, "")[0]
        except NonPhysicalState:
            simulator = simulator.halved()
    return simulator, simulator.coefficients(simulator.network, {}, "")[0]


def linear_response(network: Network, names: Sequence[str], T: float, K: int, parameters: Mapping[str, float]) -> Array:
    """The linearised response (K + 1 + neighbours, m) to the inflow; where the linear solver lacks a term of a wall,
    that of the walls without terms."""
    try:
        return response(network, names, T, K + NEIGHBOURS, parameters)
    except ValueError:
        plain = replace(network, segments=tuple(replace(s, terms={}) for s in network.segments))
        known = {n: v for n, v in parameters.items() if n in plain.parameters()}
        return response(plain, names, T, K + NEIGHBOURS, known)
