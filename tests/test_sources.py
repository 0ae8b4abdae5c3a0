"""Sources in the equations, against what does the same in another way, and small ones against the full balance.

An error is the largest of a harmonic of an output, relative to the largest harmonic of that output's pulse.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from solver import Network, beat_harmonics, load
from solver.laws.effects import ALL
from solver.mesh.sources import Drop, InletFlow, Outflow, OutletFlow, Source, Step, WallPressure
from solver.periodic.small_waves import source_responses

Array = np.ndarray

K = 12


def outputs(network: Network) -> list[str]:
    return [f"{site.name}.{kind}" for site in network.sites for kind in "PQR"]


def one(g: dict[int, complex]) -> Array:
    """Harmonics of one source."""
    found = np.zeros((K + 1, 1), complex)
    for k, value in g.items():
        found[k] = value
    return found


def error(X: Array, exact: Array) -> float:
    return float((np.abs(X - exact) / np.abs(exact[1:]).max(axis=0)).max())


def beat(network: Network, *sources: Source, g: Array | None = None) -> Array:
    return beat_harmonics(network, outputs(network), K, sources=sources, amplitudes=g, tolerance=1e-9)[0]


def test_a_steady_wall_pressure_is_an_external_pressure() -> None:
    """P = P_ext + P_el + …: a source of 500 Pa in the wall of PD is P_ext there, which the scheme has by itself. Both
    to what their last corrections leave (measured: 1.6e-12)."""
    sheep = load("sheep")
    squeezed = beat(sheep.with_terms({"PD.P_ext": 500.0}))
    assert error(beat(sheep, WallPressure("PD"), g=one({0: 500.0})), squeezed) < 5e-12


def test_a_flow_at_the_inlet_is_inflow() -> None:
    """Q(t) + q cos 2πt/T driven at the inlet, and as a source there (measured: 1.4e-13)."""
    sheep, q = load("sheep"), 5e-6
    T, own = sheep.inlet.T, sheep.inlet.given
    assert own is not None

    def more(t: Array) -> Array:
        return own(t) + q * np.cos(2.0 * np.pi * t / T)

    driven = beat_harmonics(sheep, outputs(sheep), K, more, tolerance=1e-9)[0]
    assert error(beat(sheep, InletFlow("AA"), g=one({1: q / 2.0})), driven) < 5e-13


def still(network: Network) -> Callable[[Array], Array]:
    """An inflow that is almost none."""
    return lambda t: 1e-9 * np.sin(2.0 * np.pi * t / network.inlet.T)


@pytest.mark.parametrize(("source", "lost"), [(Outflow("MD"), 1e-6), (OutletFlow("CA"), 0.0)])
def test_what_leaves_is_gone(source: Source, lost: float) -> None:
    """Mass: the mean inflow less that at the ends of the outlets' segments is what leaves on the way, to 5e-13 of it
    (measured: 1.2e-13); what leaves beside an outlet passes the end of its segment."""
    sheep, g = load("sheep"), one({0: 1e-6})
    names = ["AA.Q", *(f"{o.segment}.outlet.Q" for o in sheep.outlets)]
    X = beat_harmonics(sheep, names, K, sources=[source], amplitudes=g, tolerance=1e-10)[0][0].real
    assert X[0] - X[1:].sum() == pytest.approx(lost, abs=5e-19)


def test_a_drop_lowers_the_pressure_behind_it() -> None:
    """A steady drop of 300 Pa where almost nothing flows: it is 300 Pa more in front, and as before behind
    (measured: 4e-11 of it, and 1.1e-8 Pa)."""
    sheep = load("sheep")
    found = beat_harmonics(sheep, ["inlet.P", "PD.P"], K, still(sheep), sources=[Drop("AA", 0.0, 0.4)],
                           amplitudes=one({0: 300.0}), tolerance=1e-9)[0][0].real  # fmt: skip
    assert found[0] == pytest.approx(300.0, rel=2e-10)
    assert found[1] == pytest.approx(0.0, abs=5e-8)


# measured: AC 4.9e-7 and 2.0e-6, means 2.6e-5 and 8.2e-5 (a mean is a wave of 1e4 s)
@pytest.mark.parametrize(("name", "waves", "means"), [("sheep", 1e-6, 5e-5), ("human", 5e-6, 2e-4)])
def test_small_waves_are_the_limit_of_the_balance(name: str, waves: float, means: float) -> None:
    """Every kind of source, in networks with reflections and with Windkessels, about a state almost at rest."""
    network = load(name)
    segments, outlets = [s.name for s in network.segments], [o.segment for o in network.outlets]
    sources = [
        WallPressure(segments[1]), WallPressure(segments[2], 1), Drop(segments[1], 0.2, 0.3), Step(segments[0], 1),
        Step(segments[1], 0), Outflow(segments[2]), OutletFlow(outlets[0]), InletFlow(network.inlet.segment),
    ]  # fmt: skip
    units = [100.0 if s.unit == "Pa" else 1e-7 for s in sources]
    names = outputs(network)

    G = source_responses(network, names, K, sources, units, still(network))
    nothing = beat_harmonics(network, names, K, still(network), tolerance=1e-9)[0]
    for i, source in enumerate(sources):
        size = np.abs(G[i]).max(axis=0)
        for k, expected in ((0, means), (1, waves), (7, waves)):
            g = one({k: 1e-3 * units[i]})
            X = beat_harmonics(network, names, K, still(network), sources=[source], amplitudes=g, tolerance=1e-9)[0]
            assert (np.abs((X - nothing)[k] / 1e-3 - G[i, k]) <= expected * size).all(), (source, k)


def test_effects_say_which_source_they_are() -> None:
    """A wall's, a drop of pressure, a loss of flow, an outlet's, a junction's or a sensor's; a new effect that says
    nothing is that of its owner."""
    kinds = {effect.name: effect.source for effect in ALL}
    assert set(kinds.values()) == {"wall", "drop", "outflow", "outlet", "junction", "channel"}
    assert (kinds["stenosis"], kinds["side_branch"], kinds["taper"]) == ("drop", "outflow", "wall")
