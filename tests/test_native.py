"""The compiled engine makes the steps of NumPy, with every law, effect and outlet, from their Python classes alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from native_build import FILE, build
from test_halving import LONG, jumping
from test_several_inlets import fork
from test_table_source import table
from test_toy import Orifice, TissueSupport

from solver import (
    InputError,
    Network,
    NonPhysicalState,
    Reflection,
    Settings,
    Waveforms,
    Windkessel,
    load,
    simulate,
    simulate_periodic,
)
from solver.laws import effects
from solver.laws.effect import Array, Drag, Effect, Points, SearchSpec, Values
from solver.laws.outlets import OUTLETS, Outlet, Pressure, Resistance
from solver.laws.wall import Wall
from solver.laws.wall_laws import ELASTIC_LAWS, Beta
from solver.network.curve import Curve
from solver.network.files import bundled_names
from solver.network.inflow import drives_of
from solver.network.table_source import KINDS, TableSource
from solver.quantities.quantity import Quantity
from solver.scheme.model import build as build_model
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import initial_state
from solver.tracing import native
from solver.tracing.steps import Programs

COARSE = Settings(dt=2e-3)
EQUAL = 1e-10  # of each channel's pulse


@pytest.fixture(scope="module", autouse=True)
def engine() -> None:
    """The engine of this checkout, built where there is a compiler; without one, the tests say so."""
    try:
        native.library()
    except native.NoEngine:
        said = build()
        native.library.cache_clear()
        try:
            native.library()
        except native.NoEngine as reason:
            pytest.skip(f"{said} ({reason})")


def off(found: Waveforms, expected: Waveforms) -> float:
    """The largest difference, by each channel's pulse, or by 1e-2 of the largest of its kind where it has none."""
    size = dict[str, float]()
    for name, x in expected.items():
        size[name[-1]] = max(np.abs(x).max(), size.get(name[-1], 0.0))
    return max(np.abs(found[name] - x).max() / max(np.ptp(x), 1e-2 * size[name[-1]]) for name, x in expected.items())


def both(network: Network, duration: float = 0.2, **options: Any) -> tuple[Waveforms, Waveforms]:
    """A run by the engine, and by NumPy."""
    options = {"settings": COARSE, **options}
    found = simulate(network, duration=duration, backend="native", **options)
    assert found.backend == "native"
    return found, simulate(network, duration=duration, backend="numpy", **options)


def elastic(network: Network) -> dict[str, float]:
    return {f"{s.name}.{key}": 0.0 for s in network.segments for key in ("phi0", "phiNL")}


def test_sources() -> None:
    """C99 in at most 1200 lines, with no header but these: no allocation in a step, and no global that changes.
    cpuid.h is the compiler's, for the features of x86-64 processors."""
    sources = {path.name: path.read_text(encoding="utf-8") for path in FILE.parent.glob("*.[ch]")}
    assert sum(text.count("\n") for text in sources.values()) <= 1200
    for name, text in sources.items():
        assert set(re.findall(r"#include [<\"](.+?)[>\"]", text)) <= {
            "balance.h",
            "engine.h",
            "run.h",
            "cpuid.h",
            "math.h",
            "stdint.h",
            "string.h",
        }, name
        assert not re.search(
            r"alloc\(|free\(|^(?!static const)(static )?\w+ \w+(\[.*\])? =", text, flags=re.MULTILINE
        ), name


def test_wide_vectors_give_the_same_numbers() -> None:
    """A processor with AVX2 and one without it: the same outputs, bit for bit, also where steps start anew."""
    model, dt = build_model(load("adan56"), None, Settings()), Settings().dt
    engine = native.Engine(model, dt)
    if not engine._c.wide:
        pytest.skip("this processor has no AVX2")
    drive = drives_of(model.network, None, 1)((np.arange(20)[:, None] + INFLOW_TIMES) * dt)
    tables = np.empty((2, len(drive), 1, len(model.network.output_units())))
    for found, wide in zip(tables, (1, 0), strict=True):
        engine._c.wide = wide
        assert engine._steps(initial_state(model), drive, found)[0] == len(drive)
    np.testing.assert_array_equal(tables[0], tables[1])


# --- networks --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", bundled_names())
@pytest.mark.parametrize("walls", ["elastic", "as they are"])
def test_bundled_networks(name: str, walls: str) -> None:
    """All networks that come along; those in files are viscoelastic where their source is."""
    network = load(name)
    found, expected = both(network, parameters=elastic(network) if walls == "elastic" else None)
    assert off(found, expected) < EQUAL


def test_beats(sheep: Network) -> None:
    """Beats until they repeat: as many, and equal; elastic walls that begin at rest under another pressure."""
    for parameters in ({}, elastic(sheep)):
        runs = [
            simulate_periodic(sheep, parameters=parameters, settings=COARSE, backend=b) for b in ("native", "numpy")
        ]
        assert runs[0].beats == runs[1].beats and off(*runs) < EQUAL
        again = simulate_periodic(sheep, parameters=parameters, settings=COARSE, start=runs[0], backend="native")
        assert again.backend == "native" and again.beats == 2


def test_a_run_of_one_step(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of its program, which is compared with NumPy's; and runs step by step, as for progress."""
    told = list[float]()
    for n, progress in ((1, None), (5, lambda part, label: told.append(part))):
        monkeypatch.setattr("solver.tracing.steps._programs", Programs())  # none that was compared before
        found, expected = both(sheep, n * COARSE.dt, progress=progress)
        assert len(found.time) == n + 1 and off(found, expected) < EQUAL
    assert told[:5] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])


def test_batch_is_its_members(sheep: Network) -> None:
    """A batch, one of whose members has memory: each is what it is alone, and what NumPy makes of it."""
    held = effects.BY_NAME["stress_relaxation"].add(sheep, "all", {"tau": 0.01})
    batch = {
        "CA.tau": np.array([0.0, 0.01, 0.2]),
        "AA.phi0": np.array([0.0, 1e4, 2e4]),
        "CA.outlet.R_t": np.full(3, 0.3),
    }
    flows = lambda t: sheep.inlet.Q(t)[:, None] * np.array([1.0, 2.0, 0.5])  # noqa: E731
    found, expected = both(held, parameters=batch, inflow=flows)
    assert off(found, expected) < EQUAL
    alone, _ = both(held, parameters={name: float(x[1]) for name, x in batch.items()}, inflow=lambda t: flows(t)[:, 1])
    np.testing.assert_array_equal(found.member(1)["CA.P"], alone["CA.P"])


@pytest.mark.parametrize("causality", ["flow", "pressure"])
def test_inlets(causality: str) -> None:
    """Two inlets, the second driven by flow or by pressure."""
    network = fork(B=causality)
    driven = {"inlet.Q": network.inlet.Q} | (
        {"B.inlet.P": lambda t: 1e4 + 1e3 * np.sin(20.0 * np.asarray(t))} if causality == "pressure" else {}
    )
    found, expected = both(network, inflow=driven if causality == "pressure" else None)
    assert off(found, expected) < EQUAL


# --- every class ------------------------------------------------------------------------------------------------------

VALUES = {
    "wall_viscosity": {"phi0": 5e4}, "nonlinear_wall_viscosity": {"phiNL": 2e3}, "nonlinear_elasticity": {"ENL": 3e5},
    "terminal_reflection": {"R_t": -0.2}, "terminal_compliance": {"R1": 1e8, "C": 1e-10, "R2": 4e9},
    "junction_loss": {"k": 0.7}, "side_branch": {"leak": 2e-9}, "stenosis": {"K": 30.0},
    "fractional_viscosity": {"springpot": 0.4, "springpot_order": 0.3},
    "learned_outlet": {"learned_open": 3e-10, "learned_shut": 1e-10, "learned_from": 8e3, "learned_over": 4e3},
    "learned_wall": {
        "learned_rise": 9e3, "learned_fall": 2e3, "learned_cubic": 1e3, "learned_friction": 2e3, "learned_low": 0.02,
        "learned_span": 0.1, "learned_rate": 0.5,
    },
}  # fmt: skip


def values_of(effect: Effect) -> dict[str, float]:
    """Values that switch an effect on: given above, or one typical size away from the neutral one."""
    given = VALUES.get(effect.name, {})
    return given or {key: effect.neutral[key] + effect.search.typical[key] for key in effect.search.typical}


@pytest.mark.parametrize("effect", [e for e in effects.ALL if e.owner != "channel"], ids=lambda e: e.name)
def test_effects(effect: Effect, sheep: Network) -> None:
    """Every effect of the equations (those of channels come after them): it does something, and the same."""
    place = next(p for p in ("CA", "all", *effect.where(sheep)) if p in effect.where(sheep))
    found, expected = both(effect.add(sheep, place, values_of(effect)))
    assert off(found, expected) < EQUAL
    assert off(simulate(sheep, duration=0.2, settings=COARSE), expected) > 1e-5


@pytest.mark.parametrize("outlet", OUTLETS, ids=lambda kind: kind.__name__)
def test_outlets(outlet: type[Outlet], sheep: Network) -> None:
    """Every kind of outlet, with a venous pressure."""
    numbers = {
        Reflection: {"R_t": 0.6},
        Windkessel: {"R1": 1e8, "C": 1e-10, "R2": 4e9},
        Resistance: {"R": 3e9},
        Pressure: {},
    }
    found, expected = both(sheep.with_outlet(outlet("CA", P_venous=500.0, **numbers[outlet])))
    assert off(found, expected) < EQUAL


@pytest.mark.parametrize("elastic_law", ELASTIC_LAWS)
@pytest.mark.parametrize("viscous_law", ["quadratic", "monotone"])
def test_laws(elastic_law: str, viscous_law: str, sheep: Network) -> None:
    """Both elastic and both viscous laws, bent."""
    bent = {f"{s.name}.{key}": x for s in sheep.segments for key, x in (("ENL", 1e6), ("phiNL", 2e3))}
    found, expected = both(replace(sheep, elastic_law=elastic_law, viscous_law=viscous_law), parameters=bent)
    assert off(found, expected) < EQUAL


# --- classes that the product does not have ---------------------------------------------------------------------------


class Sliding(Effect):
    """Memory: a layer of fluid that slips along the wall and drags the rest behind it."""

    name = "sliding"
    equation = "∂Q/∂t = … - A w y, dy/dt = -r y + dU/dt"
    owner = "fluid"
    places = ("all",)
    terms = {
        "slip": Quantity("1/s", "weight w of the layer", 0.0, 1e3),
        "fade": Quantity("1/s", "its rate r", 1.0, 1e3),
    }
    neutral = {"slip": 0.0, "fade": 50.0}
    how = ("fade",)
    remembers = True
    search = SearchSpec(typical={"slip": 20.0})
    signature = confusable = separator = ""  # type: ignore[assignment]

    def drag(self, values: Values, points: Points) -> Drag | None:
        shape = (1, *np.broadcast_shapes(points.R0.shape, values["slip"].shape))
        weight, rate = (np.broadcast_to(values[key], shape[1:])[None].copy() for key in ("slip", "fade"))
        return Drag(np.zeros(shape[1:]), weight, rate)


class Filtration(Effect):
    """A mass source: the wall lets fluid through, the more the farther downstream."""

    name = "filtration"
    equation = "∂A/∂t + ∂Q/∂x = -g (x/L)² (P - P_venous)"
    owner = "segment"
    places = ("segment",)
    terms = {"pores": Quantity("m^2/(Pa.s)", "conductance g of the pores", 0.0, 1e-3, nominal=1e-9)}
    neutral = {"pores": 0.0}
    search = SearchSpec(typical={"pores": 1e-9})
    signature = confusable = separator = ""  # type: ignore[assignment]

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, leak=wall.leakage + values["pores"] * x**2)


TOYS: list[tuple[Effect, str, dict[str, float]]] = [
    (TissueSupport(), "CA", {"k_near": 2e6, "k_far": 3e7}),
    (Sliding(), "all", {"slip": 20.0, "fade": 30.0}),
    (Filtration(), "CA", {"pores": 3e-9}),
]


@pytest.mark.parametrize(("toy", "place", "values"), TOYS, ids=lambda x: getattr(x, "name", ""))
def test_toy_effects(
    toy: Effect, place: str, values: dict[str, float], sheep: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Effects that are a Python class here, of the wall, with memory, and with a mass source, run in the engine."""
    monkeypatch.setattr(effects, "ALL", (*effects.ALL, toy))
    found, expected = both(toy.add(sheep, place, values))
    assert off(found, expected) < EQUAL
    assert off(simulate(sheep, duration=0.2, settings=COARSE), expected) > 1e-4


def test_toy_outlet(sheep: Network) -> None:
    """An outlet that is a Python class of the tests."""
    found, expected = both(sheep.with_outlet(Orifice("CA", R_v=5e8, b=2e14)))
    assert off(found, expected) < EQUAL
    assert off(simulate(sheep, duration=0.2, settings=COARSE), expected) > 1e-3


@dataclass(frozen=True)
class Branching(Beta):
    """A law whose code branches on its numbers."""

    name: str = "branching"

    def pressure(self, s: Array, K: Array, e: Array | None) -> Array:
        return super().pressure(s, K, e) if s.max() < 2.0 else K * s


@pytest.fixture
def branching(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> Iterator[Network]:
    monkeypatch.setitem(ELASTIC_LAWS, "branching", Branching())
    yield replace(sheep, elastic_law="branching")


def test_tables_of_sources() -> None:
    """Every kind of them, a cubic and a straight table beside series, at a Windkessel, too."""
    T = load("sheep").inlet.T
    times, pulse = np.linspace(0.0, T, 11), 2e-6 * np.sin(np.linspace(0.0, np.pi, 11)) ** 2
    sampled = [Curve("Q", tuple(times), (*pulse[:-1], 0.0), interpolation=way) for way in ("cubic", "linear")]
    sources = [table(kind, "CA", T) for kind in KINDS] + [TableSource("outflow", "AA", curve) for curve in sampled]
    network = replace(load("sheep"), sources=tuple(sources)).with_outlet(Windkessel("CA", R1=3e8, C=1e-10, R2=2e9))
    found, expected = both(network)
    assert off(found, expected) < EQUAL
    assert off(found, simulate(replace(network, sources=()), duration=0.2, settings=COARSE)) > 0.1


def test_what_is_not_recorded(branching: Network) -> None:
    """Code that branches on the state runs on NumPy, as the result says; who asks for the engine is told why."""
    run = simulate(branching, duration=0.02, settings=COARSE, backend="auto")
    assert run.backend == "numpy: this network is not recorded: a number is asked for that depends on the state"
    with pytest.raises(InputError, match=r"^backend = 'native': this network is not recorded: .*'numpy'\.$"):
        simulate(branching, duration=0.02, settings=COARSE, backend="native")


# --- what goes wrong --------------------------------------------------------------------------------------------------


def test_halved(sheep: Network) -> None:
    """Steps that do not converge are halved as often, and the run goes on in the engine."""
    network = sheep.with_parameters(elastic(sheep))
    found, expected = (simulate(network, jumping, 0.225, settings=LONG, backend=b) for b in ("native", "numpy"))
    assert found.halved == expected.halved > 0
    assert off(found, expected) < 1e-3  # the iterations that ran away amplify round-off


@pytest.mark.parametrize(
    ("law", "inflow", "said"),
    [
        ("quadratic", 3.0, "the effective wall viscosity turned negative"),
        ("monotone", -40.0, "the flow is supercritical"),
    ],
)
def test_broken_down(law: str, inflow: float, said: str) -> None:
    """A run that breaks down ends with the same sentence: segment, place, time, reason, remedy."""
    network = replace(load("sheep_nonlinear"), viscous_law=law)
    batch = {"CA.E": network.segment("CA").E * np.array([1.0, 1.1])}
    sentences = []
    for backend in ("numpy", "native"):
        with pytest.raises(NonPhysicalState, match=said) as error:
            simulate(network, lambda t: inflow * network.inlet.Q(t), parameters=batch, settings=COARSE, backend=backend)
        sentences.append(str(error.value))
    assert sentences[0] == sentences[1]


def test_a_wrong_engine_is_found_out(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine whose steps are off by 1e-9 is not used: auto goes on with NumPy, which the result says."""
    steps = native.Engine._steps

    def wrong(self: native.Engine, state: Any, drive: Array, table: Array) -> tuple[int, Any]:
        done, after = steps(self, state, drive, table)
        return done, replace(after, H=after.H * (1.0 + 1e-9))

    monkeypatch.setattr(native.Engine, "_steps", wrong)
    monkeypatch.setattr("solver.tracing.steps._programs", Programs())  # none that was compared before
    run = simulate(sheep, duration=0.1, settings=COARSE, backend="auto")
    assert re.fullmatch(r"numpy: a step of it is not that of NumPy: H is 1\.0e-09 off", run.backend)
    assert off(run, simulate(sheep, duration=0.1, settings=COARSE, backend="numpy")) == 0.0


def test_a_minute_wave_runs_on_the_engine(sheep: Network) -> None:
    """Flows of 1e-9 m³/s are a millionth of A0 c0: round-off is a larger part of them, and no other engine's."""
    run = simulate(sheep, lambda t: 1e-9 * np.sin(4.0 * np.pi * t) ** 2, 0.1, settings=COARSE)
    assert run.backend == "native"


def test_without_the_engine(sheep: Network, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where no library is, or one of another version, NumPy does it; an unknown backend, and another scheme."""
    native.library.cache_clear()
    built = native.LIBRARY
    monkeypatch.setattr(native, "LIBRARY", tmp_path / "none.so")
    try:
        run = simulate(sheep, duration=0.02, settings=COARSE, backend="auto")
        assert run.backend.startswith("numpy: the compiled engine is not built; ")
        assert native.available().startswith("NumPy; the compiled engine is not built")
        (tmp_path / "none.so").write_bytes(b"no library")
        with pytest.raises(InputError, match=r"^backend = 'native': the compiled engine does not load: "):
            simulate(sheep, duration=0.02, settings=COARSE, backend="native")
        monkeypatch.setattr(native, "LIBRARY", built)
        monkeypatch.setattr(native, "sources", lambda: "0123456789abcdef")
        with pytest.raises(native.NoEngine, match=r"^the compiled engine is of other sources; in a checkout, "):
            native.library()
    finally:
        native.library.cache_clear()
    with pytest.raises(InputError, match=r"^backend = 'fortran': must be 'numpy', 'auto', 'native'\.$"):
        simulate(sheep, backend="fortran")
    with pytest.raises(InputError, match=r"the engine has the staggered scheme alone"):
        simulate(sheep, scheme="muscl", backend="native")
