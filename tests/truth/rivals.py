"""Which effects look alike on a network: sensitivities of all effects at all places, on one standard beat."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from .anatomy import anatomy
from .animal import Nuisance, individual, priors
from .beat import Beat
from .hide import ALL, CHANNEL, Effect, hide
from .network import Balance, Linearised
from .records import SITES, Case, Made, points_for
from .refit import weights, whitened
from .sensors import pulsatile, sensed
from .shapes import ejection

Array = np.ndarray

_BEAT = Beat(0.5)
_SHAPE_SEED = 20170807
_STEP_LOG, _STEP_R_T = 0.01, 0.005  # of a scale's logarithm, of a reflection

# sizes of the rivals' finite differences: small beside typical effects, so that the columns are tangents
_WALLS = {
    "wall_viscosity": 1e-3,
    "nonlinear_wall_viscosity": 0.05,
    "nonlinear_elasticity": 0.1,
    "stress_relaxation": 1e-3,
    "external_pressure": 100.0,
}
_SEGMENTS = {"wall_stiffness": 0.02, "taper": 0.02, "side_branch": 0.01, "stenosis": 1.0}
_WHOLE = {"fluid_friction": 0.1, "velocity_profile": 0.05, "unsteady_friction": 0.2}


class _Rival(NamedTuple):
    name: str
    where: tuple[str, ...]
    columns: tuple[Array, ...]  # each (channels, K + 1)


class Standard:
    """The standard beat of a base network, and the change of every channel with each effect."""

    def __init__(self, case: Case) -> None:
        network = case.network()
        self.model = anatomy(network)
        self.names = tuple(f"{site}.{kind}" for site in SITES for kind in "PQR")
        self.n = points_for(self.model)
        self.inflow = ejection(np.random.default_rng(_SHAPE_SEED), _BEAT, network.inlet.Q_max)
        balance = Balance(self.model, _BEAT, self.n)
        self.flow = balance.solve(self.inflow)
        self.state = self._stacked(self.flow.channels)
        response = Linearised(balance, self.flow.unknown).inlet_response()
        self.response = np.stack([response[name] for name in self.names])
        self.nuisance = self._of(priors("network", self.model, 0.0))
        self.rivals = self._rivals()

    def _stacked(self, channels: dict[str, Array]) -> Array:
        return np.stack([channels[name] for name in self.names])

    @cached_property
    def walls(self) -> list[Array]:
        """Change of every channel with one standard deviation of each wall and end by itself."""
        return self._of(individual(self.model, 1.0))

    def _of(self, prior: dict[str, float]) -> list[Array]:
        """Change of every channel with one standard deviation of each nuisance."""
        return [self._moved(name) * sd for name, sd in prior.items()]

    def _moved(self, name: str) -> Array:
        step = _STEP_R_T if name.endswith("R_t") else _STEP_LOG
        model = Nuisance().moved({name: step}).applied(self.model)
        flow = Balance(model, _BEAT, self.n).solve(self.inflow, self.flow.unknown)
        return (self._stacked(flow.channels) - self.state) / step

    def column(self, effect: Effect) -> Array:
        """Change of the channels with an effect, less that of a model driven by the recorded inflow."""
        if effect.on_channel:
            change = np.zeros_like(self.state)
            for name in effect.where:
                if name == "inlet.Q":
                    change -= self.response * (sensed(self.inflow, effect, _BEAT) - self.inflow)
                else:
                    i = self.names.index(name)
                    change[i] = sensed(self.state[i], effect, _BEAT) - self.state[i]
            return change
        balance = Balance(hide(self.model, effect), _BEAT, self.n)
        start = self.flow.unknown if len(balance.pieces) == self.flow.unknown.shape[1] else None
        return self._stacked(balance.solve(self.inflow, start).channels) - self.state

    def _rivals(self) -> list[_Rival]:
        segments = [(v.name,) for v in self.model.vessels]
        chosen = [Effect(name, where, size) for name, size in _WALLS.items() for where in [*segments, ALL]]
        chosen += [Effect(name, where, size) for name, size in _SEGMENTS.items() for where in segments]
        chosen += [Effect(name, ALL, size) for name, size in _WHOLE.items()]
        for end in self.model.ends:
            chosen.append(Effect("terminal_reflection", (end.vessel,), 0.02))
            chosen.append(Effect("terminal_compliance", (end.vessel,), 0.02, 0.7))
        chosen += [Effect("junction_loss", where, 0.1) for where in [*((j.inflow[0],) for j in self.model.joins), ALL]]
        rivals = [_Rival(e.name, e.where, (self.column(e),)) for e in chosen]
        rivals += [self._springpot(where) for where in [*segments, ALL]]
        return rivals + [r for channel in (*self.names, "inlet.Q") for r in self._sensors(channel)]

    def _springpot(self, where: tuple[str, ...]) -> _Rival:
        """A springpot of any order: small ones of a low and of a high order together."""
        name = "fractional_viscosity"
        return _Rival(name, where, tuple(self.column(Effect(name, where, 0.05, order)) for order in (0.2, 0.6)))

    def _sensors(self, channel: str) -> list[_Rival]:
        iw = 1j * _BEAT.omega
        x = self.inflow if channel == "inlet.Q" else self.state[self.names.index(channel)]
        level = np.zeros_like(x)
        level[0] = pulsatile(x)
        shapes = {
            "channel_lag": (-iw * x,),
            "channel_gain": (x,),
            "channel_offset": (level,),
            "catheter_resonance": (-iw * x, iw**2 * x),
        }
        assert tuple(shapes) == CHANNEL
        return [_Rival(name, (channel,), tuple(self._spread(channel, c) for c in cs)) for name, cs in shapes.items()]

    def _spread(self, channel: str, change: Array) -> Array:
        if channel == "inlet.Q":
            return -self.response * change
        full = np.zeros_like(self.state)
        full[self.names.index(channel)] = change
        return full


@lru_cache(maxsize=8)
def standard(base: str, elastic_law: str, viscous_law: str) -> Standard:
    """The standard beat of a base network; made once."""
    return Standard(Case("network", "all", 40.0, (), base, elastic_law, viscous_law))


def rival_sines(made: Made) -> dict[str, float]:
    """Sine of the angle between a record's one effect and each rival (name@where), after the nuisance."""
    case, (effect,) = made.case, made.case.effects
    basis = standard(case.base, case.elastic_law, case.viscous_law)
    kept = [basis.names.index(name) for name in case.names[1:]]
    noise = np.array([made.noise[name] for name in case.names[1:]])
    weight = weights(made, _BEAT.K + 1)

    def white(column: Array) -> Array:
        return whitened(column[kept], noise, basis.response[kept], made.noise["inlet.Q"], weight)

    walls = [case.walls * c for c in basis.walls] if case.walls else []
    free = np.stack([white(c) for c in (*basis.nuisance, *walls)], axis=1)
    free = np.concatenate([free, np.eye(free.shape[1])])  # the prior
    Q = np.linalg.qr(free)[0]

    def unabsorbed(column: Array) -> Array:
        v = np.concatenate([white(column), np.zeros(free.shape[1])])
        return v - Q @ (Q.T @ v)

    own = unabsorbed(basis.column(effect))
    ours = _this_animal(case)
    sine: dict[str, float] = {}
    for rival in basis.rivals:
        if (rival.name, rival.where) == (effect.name, effect.where) or rival.name in ours:
            continue
        columns = np.stack([unabsorbed(c) for c in rival.columns], axis=1)
        size = np.linalg.norm(columns, axis=0)
        if (size > 0.0).all():
            units = columns / size
            rest = own - units @ np.linalg.lstsq(units, own, rcond=1e-10)[0]
            sine[f"{rival.name}@{','.join(rival.where)}"] = float(np.linalg.norm(rest) / np.linalg.norm(own))
    return sine


def _this_animal(case: Case) -> tuple[str, ...]:
    """Effects that are merely an animal's walls where these are off by themselves: a stiffness, a scale of phi0."""
    if not case.walls:
        return ()
    return ("wall_stiffness",) if case.base == "elastic" else ("wall_stiffness", "wall_viscosity")
