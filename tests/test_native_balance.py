"""Harmonic balance by the compiled engine is that of NumPy, with every law, effect and outlet, from its class alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, SETTINGS, exact, record
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from test_native import TOYS, branching, elastic, engine, values_of
from test_several_inlets import fork
from test_toy import Orifice

import solver.harmonics
import solver.periodic.native_balance
from fitting.calibrate.network_calibration import calibrate
from solver import (
    Inlet,
    InputError,
    Junction,
    Network,
    Pressure,
    Reflection,
    Resistance,
    Segment,
    Settings,
    Site,
    Windkessel,
    beat_harmonics,
    load,
)
from solver.laws import effects
from solver.laws.effect import Array, Effect
from solver.laws.outlets import OUTLETS, Outlet
from solver.laws.wall_laws import ELASTIC_LAWS
from solver.mesh.sources import Drop, Outflow, OutletFlow, Source, WallPressure
from solver.network.curve import Curve
from solver.network.files import bundled_names
from solver.network.table_source import TableSource
from solver.periodic.native_balance import BalanceEngine, Unsolved
from solver.periodic.small_waves import source_responses
from solver.tracing.native import NoEngine
from solver.tracing.steps import Programs

__all__ = ["branching", "engine"]  # fixtures: the first asked for by name, the second by every test

K = 8
EQUAL = 1e-10  # of the largest harmonic of its kind; 1e-11 at most was measured


def names(network: Network) -> list[str]:
    return list(network.output_units())


def off(network: Network, found: Array, expected: Array, least: dict[str, float] | None = None) -> float:
    """The largest difference of harmonics (B, K+1, m), by the largest of the same kind of output, or by the ``least``
    scale of a kind where that is larger; NaN where NaN."""
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    kinds = np.array([name[-1] for name in names(network)])
    scales = dict.fromkeys(set(kinds.tolist()), 1e-300) | (least or {})
    largest = {kind: np.nanmax(np.abs(expected[..., kinds == kind]), initial=x) for kind, x in scales.items()}
    return float(np.nanmax(np.abs(found - expected) / [largest[kind] for kind in kinds], initial=0.0))


def both(network: Network, *arguments: Any, **options: Any) -> float:
    """How far the engine is from NumPy; it makes the whole batch by itself once its program is known to be right."""
    given = (network, names(network), K, *arguments)
    expected = beat_harmonics(*given, backend="numpy", **options)
    found = beat_harmonics(*given, backend="native", **options)
    assert not np.isnan(expected).all()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver.harmonics, "_by_numpy", None)
        np.testing.assert_array_equal(beat_harmonics(*given, backend="native", **options), found)
    return off(network, found, expected)


@pytest.mark.parametrize("name", bundled_names())
@pytest.mark.parametrize("walls", [pytest.param("elastic", marks=pytest.mark.slow), "as they are"])
def test_bundled_networks(name: str, walls: str) -> None:
    network = load(name)
    assert both(network, parameters=elastic(network) if walls == "elastic" else None) < EQUAL


@pytest.mark.parametrize("effect", [e for e in effects.ALL if e.owner != "channel"], ids=lambda e: e.name)
def test_effects(effect: Effect, sheep: Network) -> None:
    """Leaks fill areas and memories are filters: all of them do something, and the same."""
    place = next(p for p in ("CA", "all", *effect.where(sheep)) if p in effect.where(sheep))
    network = effect.add(sheep, place, values_of(effect))
    assert both(network) < EQUAL
    plain, changed = (beat_harmonics(n, names(sheep), K) for n in (sheep, network))
    assert off(sheep, plain, changed) > 1e-7


@pytest.mark.parametrize("outlet", OUTLETS, ids=lambda kind: kind.__name__)
def test_outlets(outlet: type[Outlet], sheep: Network) -> None:
    numbers = {
        Reflection: {"R_t": 0.6},
        Windkessel: {"R1": 1e8, "C": 1e-10, "R2": 4e9},
        Resistance: {"R": 3e9},
        Pressure: {},
    }
    assert both(sheep.with_outlet(outlet("CA", P_venous=500.0, **numbers[outlet]))) < EQUAL


@pytest.mark.parametrize(("toy", "place", "values"), TOYS, ids=lambda x: getattr(x, "name", ""))
def test_toy_effects(
    toy: Effect, place: str, values: dict[str, float], sheep: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Effects that are a Python class of the tests, of the wall, with memory, and with a mass source."""
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, toy))
    assert both(toy.add(sheep, place, values)) < EQUAL


def test_toy_outlet(sheep: Network) -> None:
    assert both(sheep.with_outlet(Orifice("CA", R_v=5e8, b=2e14))) < EQUAL


@pytest.mark.parametrize("causality", ["flow", "pressure"])
def test_inlets(causality: str) -> None:
    """Two inlets, the second driven by flow or by pressure."""
    network = fork(B=causality)
    pressure = {"inlet.Q": network.inlet.Q, "B.inlet.P": lambda t: 1e4 + 1e3 * np.sin(20.0 * np.asarray(t))}
    assert both(network, pressure if causality == "pressure" else None, 0.1 * np.pi) < EQUAL


def test_a_batch_is_its_members(sheep: Network) -> None:
    """Each with an inflow and a memory of its own: as NumPy, and to the last bit what it is alone."""
    held = effects.BY_NAME["stress_relaxation"].add(sheep, "all", {"tau": 0.01})
    batch = {"CA.tau": np.array([0.0, 0.01, 0.2]), "AA.phi0": np.array([0.0, 1e4, 2e4])}
    flows = lambda t: sheep.inlet.Q(t)[:, None] * np.array([1.0, 2.0, 0.5])  # noqa: E731
    assert both(held, flows, parameters=batch) < EQUAL
    whole = beat_harmonics(held, names(held), K, flows, parameters=batch)
    one = {name: x[2:] for name, x in batch.items()}
    alone = beat_harmonics(held, names(held), K, lambda t: flows(t)[:, 2], parameters=one)
    np.testing.assert_array_equal(whole[2], alone[0])


@pytest.mark.parametrize("outlet", [Reflection("CA", R_t=0.3), Windkessel("CA", R1=1e8, C=1e-10, R2=4e9)])
def test_sources(outlet: Outlet, sheep: Network) -> None:
    """Terms that are added to the equations, in a balance and as small waves."""
    network = sheep.with_outlet(outlet)
    sources: list[Source] = [WallPressure("AA"), Drop("CA", 0.2, 0.5), Outflow("AA"), OutletFlow("CA")]
    units = np.array([100.0, 50.0, 1e-6, 1e-6])
    g = units * np.exp(1j * np.add.outer(np.arange(4), np.arange(4)))
    assert both(network, sources=sources, amplitudes=g) < EQUAL
    given = (network, names(network), K, sources, units)
    found, expected = (source_responses(*given, backend=b) for b in ("native", "numpy"))
    # small differences of outputs: an inflow that is 1e-14 larger moves NumPy's own as much (1e-7)
    assert 0.0 < off(network, found, expected) < 1e-6


def test_tables_of_sources(sheep: Network) -> None:
    """They are part of the forcing, so that the program is that of the network without them."""
    curve = Curve.series("Q", 0.0, np.array([2e-6, 1e-6]), np.array([1e-6, 0.0]), sheep.inlet.T)
    assert both(replace(sheep, sources=(TableSource("outlet", "CA", curve, {}),))) < EQUAL


@st.composite
def networks(draw: Any) -> tuple[Network, dict[str, Any]]:
    """A tree of up to five arteries, perhaps closed to a loop, of any outlets, laws and effects, and a batch of two."""
    real = lambda low, high: draw(st.floats(low, high))  # noqa: E731
    count, loop = draw(st.integers(1, 5)), draw(st.booleans())
    parents = [draw(st.integers(0, i - 1)) for i in range(1, count)]
    ways = {i: [f"S{j}" for j, p in enumerate(parents, 1) if p == i] for i in range(count)}
    segments = [
        Segment(
            f"S{i}",
            real(0.02, 0.15),
            real(3e-3, 1e-2),
            real(5e-4, 1e-3),
            real(5e5, 2e6),
            draw(st.sampled_from([0.0, 1e4])),
        )
        for i in range(count)
    ]
    if loop:  # two ways from the root to one end
        segments += [Segment(name, real(0.02, 0.1), 4e-3, 6e-4, 8e5, 1e4) for name in ("P", "Q", "E")]
        ways[0] += ["P", "Q"]
    junctions = [Junction((f"S{i}",), tuple(way), k=real(0.0, 1.0)) for i, way in ways.items() if way]
    junctions += [Junction(("P", "Q"), ("E",))] if loop else []
    ends = [f"S{i}" for i, way in ways.items() if not way] + (["E"] if loop else [])
    kinds = {
        "R_t": lambda s: Reflection(s, R_t=real(-0.5, 0.9)), "P": lambda s: Pressure(s, P_venous=real(0.0, 500.0)),
        "RCR": lambda s: Windkessel(s, R1=1e8, C=real(1e-10, 1e-8), R2=1e9),
        "R": lambda s: Resistance(s, R=real(1e7, 1e9)),
    }  # fmt: skip
    network = Network(
        "drawn", tuple(segments), Inlet("S0", Q_max=real(2e-5, 5e-5), T=0.4), tuple(junctions),
        tuple(kinds[draw(st.sampled_from(sorted(kinds)))](end) for end in ends),
        tuple(Site(s.name, s.name, real(0.0, 1.0)) for s in segments),
        elastic_law=draw(st.sampled_from(sorted(ELASTIC_LAWS))),
        viscous_law=draw(st.sampled_from(["quadratic", "monotone"])),
    )  # fmt: skip
    for name in draw(
        st.sets(st.sampled_from(["stress_relaxation", "taper", "stenosis", "side_branch", "unsteady_friction"]))
    ):
        effect = effects.BY_NAME[name]
        places = {"all", "S0"} & {*effect.where(network)}  # none for the memory of an elastic wall
        network = effect.add(network, min(places), values_of(effect)) if places else network
    return network, {"S0.E": np.array([8e5, real(5e5, 2e6)])} if draw(st.booleans()) else {}


@pytest.mark.slow
@settings(max_examples=8, phases=[Phase.explicit, Phase.generate])
@given(networks())
def test_drawn_networks(drawn: tuple[Network, dict[str, Any]]) -> None:
    """Any of these: equal, or no steady state with the same sentence, or no balance of the same members; or refused as
    another than NumPy's.

    Rounding errors arise in the areas, and a stiff wall under a low pressure multiplies them: pressures are compared by
    the stiffness E h/R_0. The mean, a wave of 1e4 s, has rounding errors in short pieces: it may be three times as far
    off as an inflow that is 1e-14 larger moves NumPy's own (1.0 times, of 387 networks).
    """
    network, parameters = drawn
    results: list[Any] = []
    for backend, flow in (("numpy", 1.0), ("native", 1.0), ("numpy", 1.0 + 1e-14)):
        given = (network, names(network), K, lambda t, flow=flow: flow * network.inlet.Q(t))
        try:
            results.append(beat_harmonics(*given, parameters=parameters, backend=backend))
        except InputError as error:
            results.append(str(error))
    expected, found, moved = results
    stiff = {"P": max(s.E * s.h / s.R0 for s in network.segments)}
    if isinstance(expected, str):
        assert expected == found
    elif isinstance(found, str):
        assert "is not that of NumPy" in found and 10.0 * off(network, moved, expected) > 10.0 * EQUAL
    else:
        assert off(network, found, expected, stiff) < EQUAL + 3.0 * off(network, moved, expected, stiff)


def test_no_balance(sheep: Network) -> None:
    """Members without a balance are NaN, and one without a steady state is refused, as by NumPy."""
    batch = {"CA.E": sheep.segment("CA").E * np.array([1.0, 1.0])}
    flows = lambda t: sheep.inlet.Q(t)[:, None] * np.array([1.0, 40.0])  # noqa: E731
    found, expected = (
        beat_harmonics(sheep, names(sheep), K, flows, parameters=batch, backend=b) for b in ("native", "numpy")
    )
    assert np.isnan(expected[1]).all() and off(sheep, found, expected) < EQUAL
    sentences = []
    for backend in ("native", "numpy"):
        with pytest.raises(InputError, match="it has no steady state with inlet.Q = 1 m") as error:
            beat_harmonics(sheep, names(sheep), K, lambda t: 0.0 * t + 1.0, backend=backend)
        sentences.append(str(error.value))
    assert sentences[0] == sentences[1]


def test_progress_ends_it(sheep: Network) -> None:
    """It is called as often as by NumPy, and what it raises ends the search."""
    told: dict[str, list[int]] = {"native": [], "numpy": []}
    for backend, each in told.items():
        beat_harmonics(sheep, ["CA.P"], K, progress=lambda each=each: each.append(1), backend=backend)
    assert len(told["native"]) == len(told["numpy"]) > 2

    def enough() -> None:
        raise TimeoutError

    with pytest.raises(TimeoutError):
        beat_harmonics(sheep, ["CA.P"], K, progress=enough, backend="native")


def test_what_is_not_recorded(branching: Network) -> None:
    """A law that branches on the state has its balance by NumPy; who asks for the engine is told why."""
    expected, found = (beat_harmonics(branching, ["CA.P"], K, backend=b) for b in ("numpy", "auto"))
    np.testing.assert_array_equal(found, expected)
    with pytest.raises(InputError, match=r"^backend = 'native': this network is not recorded: .*'numpy'\.$"):
        beat_harmonics(branching, ["CA.P"], K, backend="native")
    with pytest.raises(InputError, match=r"^backend = 'C': must be"):
        beat_harmonics(branching, ["CA.P"], K, backend="C")


def test_a_wrong_engine_is_found_out(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine that is off by 1e-7 is not used: auto is NumPy, and who asks for the engine is told."""
    beats = BalanceEngine.beats

    def wrong(self: BalanceEngine, *arguments: Any, **options: Any) -> Any:
        return ((beat, found * (1.0 + 1e-7)) for beat, found in beats(self, *arguments, **options))

    monkeypatch.setattr(BalanceEngine, "beats", wrong)
    monkeypatch.setattr("solver.periodic.balance_program._programs", Programs())  # none that was compared before
    expected, found = (beat_harmonics(sheep, ["CA.P"], K, backend=b) for b in ("numpy", "auto"))
    np.testing.assert_array_equal(found, expected)
    with pytest.raises(InputError, match=r"a balance of it is not that of NumPy: P is 1\.0e-07 off"):
        beat_harmonics(sheep, ["CA.P"], K, backend="native")


def test_every_program_is_compared_once(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another mesh of the same network is another program, which is compared, too; a second beat is not."""
    told, compare = list[int](), solver.harmonics._compare
    monkeypatch.setattr("solver.periodic.balance_program._programs", Programs())
    monkeypatch.setattr(solver.harmonics, "_compare", lambda *given: told.append(1) or compare(*given))
    for length, n in ((0.05, 1), (0.05, 1), (0.02, 2), (0.05, 2)):
        beat_harmonics(sheep, ["CA.P"], K, settings=Settings(element_length=length), backend="native")
        assert len(told) == n


def test_what_the_engine_does_not_solve(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is left to NumPy."""

    def unsolved(*_: Any) -> Any:
        raise Unsolved("")

    expected = beat_harmonics(sheep, ["CA.P"], K, backend="numpy")
    monkeypatch.setattr(BalanceEngine, "steady", unsolved)
    np.testing.assert_array_equal(beat_harmonics(sheep, ["CA.P"], K, backend="native"), expected)


def test_elements(sheep: Network) -> None:
    """Shorter elements and a coarse polynomial: other sizes of everything."""
    for options in (Settings(element_length=0.02), Settings(degree=1), Settings(degree=5)):
        assert both(sheep, settings=options) < EQUAL


def test_a_calibration_does_not_depend_on_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noisy record of a fork, three unknowns: as found without it, to 1e-8 of their errors (6e-9); provenance says
    which it was."""
    noisy, found = record(exact(), 15, 0.01, 0), []
    for which in ("native", "numpy: not here"):
        fit = calibrate(noisy, NETWORK, ("all.E", "all.phi0", "C.outlet.R_t"), settings=SETTINGS)
        assert fit.parameter_set().provenance["engine"] == which
        found.append(fit)

        def missing() -> Any:
            raise NoEngine("not here")

        for module in ("solver.tracing.native", "solver.periodic.native_balance", "fitting.results.provenance"):
            monkeypatch.setattr(f"{module}.library", missing)
        solver.periodic.native_balance._library.cache_clear()
    solver.periodic.native_balance._library.cache_clear()
    assert np.abs((found[0].x - found[1].x) / found[1].sd).max() < 1e-8
    assert found[0].chi2 == pytest.approx(found[1].chi2, rel=1e-9)
