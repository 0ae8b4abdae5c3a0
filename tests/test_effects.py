"""The catalogue: off is bit-identical, every way in and out of a network, channels, columns, and a new effect."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy.signal import lsim

from build_fmu import build
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.importer.run import run_fmu
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Settings, Windkessel, sampled_inflow, simulate, simulate_periodic
from solver.errors import InputError
from solver.laws import catalogue, effects
from solver.laws.effect import Effect, SearchSpec, Values
from solver.laws.effects import ALL, BY_NAME
from solver.laws.wall import Wall
from solver.loop import column, loop_pressure
from solver.network.description import from_dict, to_dict
from solver.network.files import dumps, loads
from solver.quantities.quantity import Quantity

QUICK = Settings(dt=2e-3, tolerance=1e-8)
COARSE = Settings(dt=5e-3, element_length=0.1)
DOCS = Path(__file__).parents[1] / "docs" / "effects.md"
ON = {
    "CA.tau": 0.02,
    "CA.springpot": 0.3,
    "CA.learned_fall": 3e4,
    "CA.outlet.learned_open": 1e-10,
    "CA.P_ext": 500.0,
    "CA.E_scale": 1.2,
    "CA.taper": -0.2,
    "CA.leak": 1e-10,
    "CA.K": 20.0,
    "fluid.friction_scale": 2.0,
    "fluid.unsteady_scale": 1.0,
}


def neutral(name: str) -> float:
    return catalogue.neutral_value(name.rpartition(".")[2])


def same(one: Mapping[str, np.ndarray], two: Mapping[str, np.ndarray]) -> bool:
    return set(one) == set(two) and all(np.array_equal(one[name], two[name]) for name in one)


# --- off and on ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*ON, "all at once"])
def test_neutral_is_bit_identical(sheep: Network, name: str) -> None:
    """A network that holds a term at its neutral value is the one without it, to the last bit."""
    terms = {key: neutral(key) for key in ([name] if name in ON else ON)}
    assert same(simulate(sheep.with_terms(terms), duration=0.1), simulate(sheep, duration=0.1))


def test_a_text_is_no_term(sheep: Network) -> None:
    """Numbers are in SI units here: a text with a unit is refused by its name, as a parameter's is."""
    with pytest.raises(InputError, match=r"CA\.tau = '5 ms': must be a number in s\."):
        sheep.with_terms({"CA.tau": "5 ms"})  # type: ignore[dict-item]


@pytest.mark.parametrize("name", [name for name in ON if name != "CA.K"])
def test_neutral_beside_a_neighbour(sheep: Network, name: str) -> None:
    """A member without the effect does not notice that its neighbour has it; a stenosis alone changes the mesh."""
    network, off = sheep.with_terms({name: neutral(name)}), neutral(name)
    absent = simulate(sheep, duration=0.1, parameters={"CA.E": np.full(2, sheep.segment("CA").E)}, settings=QUICK)
    beside = simulate(network, duration=0.1, parameters={name: np.array([off, ON[name]])}, settings=QUICK)
    for channel in absent:
        if channel != "inlet.Q":
            assert np.array_equal(absent[channel][0], beside[channel][0]), channel
    assert np.abs(beside["CA.Q"][1] - beside["CA.Q"][0]).max() > 1e-3 * np.ptp(beside["CA.Q"][0])


def test_stenosis_mesh(sheep: Network) -> None:
    """The cuts of a stenosis move the answer by the error of the mesh only: 1e-4 of the pulse."""
    plain = simulate(sheep, settings=QUICK)
    cut = simulate(sheep.with_terms({"CA.K": 0.0}), parameters={"CA.K": np.array([0.0, 1.0])}, settings=QUICK)
    for name in plain:
        if name != "inlet.Q":
            assert np.abs(cut[name][0] - plain[name]).max() <= 1e-4 * np.ptp(plain[name]), name


def test_batch_equals_single_runs(sheep: Network) -> None:
    """All effects at once in a batch of two sizes: each member is what it is alone, to 1e-12."""
    network = sheep.with_terms({name: neutral(name) for name in ON})
    batch = {name: np.array([0.5, 1.0]) * (value - neutral(name)) + neutral(name) for name, value in ON.items()}
    together = simulate(network, duration=0.2, parameters=batch, settings=QUICK)
    for i in range(2):
        alone = simulate(sheep.with_terms({n: v[i] for n, v in batch.items()}), duration=0.2, settings=QUICK)
        for name in alone:
            assert np.abs(together.member(i)[name] - alone[name]).max() <= 1e-11 * np.abs(alone[name]).max(), name


def test_terms_that_are_fields_in_disguise(sheep: Network) -> None:
    """E_scale is E, friction_scale is friction, P_ext everywhere is P_ref: to 1e-12 of the largest value."""
    E, friction = sheep.segment("CA").E, sheep.fluid.friction
    pairs = [
        ({"CA.E_scale": 1.25}, {"CA.E": 1.25 * E}),
        ({"fluid.friction_scale": 2.0}, {"fluid.friction": 2.0 * friction}),
        ({f"{s.name}.P_ext": 300.0 for s in sheep.segments}, {"network.P_ref": 300.0}),
    ]
    for terms, fields in pairs:
        one = simulate(sheep.with_terms(terms), duration=0.2)
        two = simulate(sheep.with_parameters(fields), duration=0.2)
        for name in one:
            assert np.abs(one[name] - two[name]).max() <= 1e-12 * np.abs(two[name]).max(), (name, terms)


def test_tau_is_continuous(sheep: Network) -> None:
    """dP/dτ at τ = 0 by steps of 1e-4 and 1e-6 s agrees to 1 %: nothing jumps where memory appears."""
    network = sheep.with_terms({"CA.tau": 0.0})
    run = simulate(network, duration=0.2, parameters={"CA.tau": np.array([0.0, 1e-6, 1e-4])}, settings=QUICK)
    for name in ("CA.P", "CA.Q", "AA.P"):
        small, large = (run[name][1] - run[name][0]) / 1e-6, (run[name][2] - run[name][0]) / 1e-4
        assert np.linalg.norm(small - large) <= 1e-2 * np.linalg.norm(large), name


# --- the catalogue -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", ALL, ids=BY_NAME)
def test_every_row_is_complete(effect: Effect, sheep: Network) -> None:
    """Texts, quantities with neutral values in range, and variables that a network accepts, at every place."""
    assert effect.equation and effect.signature and effect.separator and effect.terms
    assert all(rival in BY_NAME or rival == "area" for rival in effect.confusable)
    assert set(effect.neutral) <= set(effect.terms)
    for key, value in effect.neutral.items():
        effect.terms[key].check(key, value)
    for place in effect.where(sheep, ("CA.P", "MD.Q")):
        names = effect.variables(sheep, place)
        assert names.keys() == effect.terms.keys()
        if effect.name not in ("terminal_compliance", "nonlinear_wall_viscosity", "wall_viscosity"):
            added = effect.add(sheep, place, effect.neutral)
            held = added.parameters() | {f"{c.name}.{key}": v for c in added.channels for key, v in c.terms.items()}
            assert all(held[name] == effect.neutral[key] for key, moved in names.items() for name in moved)


def test_places(sheep: Network) -> None:
    """Where effects act in the sheep's network, and what they move there."""
    assert BY_NAME["wall_stiffness"].where(sheep) == tuple(s.name for s in sheep.segments)
    assert BY_NAME["unsteady_friction"].where(sheep) == ("all",)
    assert BY_NAME["unsteady_friction"].variables(sheep, "all") == {"unsteady_scale": ("fluid.unsteady_scale",)}
    assert BY_NAME["stress_relaxation"].variables(sheep, "CA") == {"tau": ("CA.tau",)}
    assert BY_NAME["junction_loss"].variables(sheep, "AA") == {"k": ("AA.junction.k",)}
    assert BY_NAME["terminal_reflection"].variables(sheep, "CA") == {"R_t": ("CA.outlet.R_t",)}
    assert BY_NAME["channel_lag"].where(sheep, ("CA.P",)) == ("CA.P",)
    assert len(BY_NAME["external_pressure"].variables(sheep, "all")["P_ext"]) == len(sheep.segments)
    elastic = sheep.with_parameters({"CA.phi0": 0.0})
    assert "CA" not in BY_NAME["stress_relaxation"].where(elastic)


def test_terminal_compliance(sheep: Network) -> None:
    """The outlet becomes a Windkessel with the venous pressure it had."""
    venous = sheep.with_parameters({"CA.outlet.P_venous": 700.0})
    found = BY_NAME["terminal_compliance"].add(venous, "CA", {"R1": 3e8, "C": 4e-10, "R2": 3e9})
    assert found.outlets[0] == Windkessel("CA", R1=3e8, C=4e-10, R2=3e9, P_venous=700.0)
    with pytest.raises(ValueError, match="give R2 too"):
        BY_NAME["terminal_compliance"].add(venous, "CA", {"R1": 3e8, "C": 4e-10})


def test_a_key_belongs_to_one_effect() -> None:
    """A neutral value is found by the key alone."""
    keys = [key for effect in ALL for key in effect.terms]
    assert len(keys) == len(set(keys))


def test_docs_are_current() -> None:
    """docs/effects.md holds the table that the catalogue makes of itself."""
    assert catalogue.table() in DOCS.read_text(encoding="utf-8")


# --- networks, files, errors ---------------------------------------------------------------------------------------


def test_round_trips(sheep: Network) -> None:
    """Terms and channels survive plain data and network files, and only what is there is written."""
    full = sheep.with_terms({**ON, "CA.P.lag": 3e-3, "CA.P.gain": 1.02, "inlet.Q.offset": 1e-6, "MD.R.f_n": 20.0})
    assert full.with_parameters({"CA.tau": 0.03}).parameters()["CA.tau"] == 0.03
    assert from_dict(json.loads(json.dumps(to_dict(full)))) == full
    assert loads(dumps(full), "full") == full
    text = dumps(full)
    assert (
        'tau = "0.02 s"' in text
        and '[channels."CA.P"]' in text
        and 'offset = "1e-06 m**3/s"' in text.replace("m^3", "m**3")
    )
    assert "tau" not in dumps(sheep)
    assert set(full.parameters()) - set(sheep.parameters()) == set(ON)
    assert loads(dumps(sheep).replace("[segments.CA]", '[segments.CA]\ntau = "20 ms"'), "x").segment("CA").terms == {
        "tau": 0.02
    }


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"CA.tao": 0.1}, "did you mean CA.tau"),
        ({"CA.tau": -1.0}, "relaxation time tau"),
        ({"XX.tau": 0.1}, "XX.tau: neither a parameter nor a term"),
        ({"CA.P.lag": 5.0}, "delay of the channel"),
        ({"CA.S.lag": 0.1}, "neither a parameter nor a term"),
        ({"CA.gain": 1.0}, "neither a parameter nor a term"),
        ({"AA.junction.k": 2.0}, "AA"),
    ],
)
def test_refusals(sheep: Network, values: dict[str, float], words: str) -> None:
    """One sentence that names the thing."""
    with pytest.raises(ValueError, match=words):
        sheep.with_terms(values)


def test_file_errors(sheep: Network) -> None:
    """Keys that are no terms are refused with the allowed ones."""
    text = dumps(sheep)
    for old, new, words in (
        ("[segments.CA]", "[segments.CA]\ntao = 1.0", "use one of .*tau"),
        ("[fluid]", "[fluid]\ntau = 1.0", "use one of .*friction_scale"),
        ("[sites]", '[channels."CA.P"]\nlagg = 1.0\n[sites]', "did you mean lag"),
        ("[sites]", "[channels.CA]\nlag = 1.0\n[sites]", "in quotes and with its signal"),
        ("[sites]", '[channels."XX.P"]\nlag = 0.1\n[sites]', "no such output"),
        ("[segments.CA]", '[segments.CA]\nleak = "1 m"', "Pa"),
    ):
        with pytest.raises(ValueError, match=words):
            loads(text.replace(old, new), "file")
    with pytest.raises(ValueError, match="it cannot act at 'AA'"):
        BY_NAME["terminal_reflection"].variables(sheep, "AA")
    with pytest.raises(ValueError, match="unknown key 'phi'"):
        BY_NAME["wall_viscosity"].add(sheep, "CA", {"phi": 1.0})


# --- channels ------------------------------------------------------------------------------------------------------

BEAT, N = 0.8, 400
TIME = np.arange(N) * BEAT / N


def _signal(t: np.ndarray) -> np.ndarray:
    return 9e3 + 1e3 * np.sin(2 * np.pi * t / BEAT) + 300.0 * np.cos(10 * np.pi * t / BEAT + 1.0)


def _observed(terms: dict[str, float]) -> np.ndarray:
    omega = 2 * np.pi / BEAT * np.arange(N // 2 + 1)
    return np.fft.irfft(catalogue.observe(terms, np.fft.rfft(_signal(TIME), norm="forward"), omega), N, norm="forward")


def test_lag_gain_offset() -> None:
    """y(t) = g x(t - lag) + o, in the time domain: 1e-12."""
    found = _observed({"lag": 7e-3, "gain": 1.1, "offset": -250.0})
    np.testing.assert_allclose(found, 1.1 * _signal(TIME - 7e-3) - 250.0, rtol=1e-12)
    assert same({"x": _observed({"f_n": 0.0})}, {"x": _observed({})})


def test_catheter_against_the_oscillator() -> None:
    """ÿ + 2ζω_n ẏ + ω_n² y = ω_n² x, integrated for ten beats: 1e-4 of the pulse."""
    wn, zeta = 2 * np.pi * 15.0, 0.1
    t = np.arange(10 * 16 * N + 1) * BEAT / (16 * N)
    _, y, _ = lsim(([wn**2], [1.0, 2 * zeta * wn, wn**2]), _signal(t), t)
    last = y[-16 * N - 1 : -1 : 16]
    assert np.abs(_observed({"f_n": 15.0, "zeta": zeta}) - last).max() <= 1e-4 * np.ptp(last)


# --- the local wall law --------------------------------------------------------------------------------------------


def test_loop_pressure_and_columns(sheep: Network) -> None:
    """One Fourier mode of ε̇: memory in closed form, dP/dτ at τ = 0 its derivative, dP/dP_ext = 1."""
    s, omega = sheep.segment("CA"), 2 * np.pi / BEAT
    R = s.R0 * (1.0 + 0.03 * np.cos(omega * TIME))
    rate = -0.03 * omega * np.sin(omega * TIME)
    K_h = s.h / (0.75 * s.R0)

    def exact(tau: float) -> np.ndarray:
        a = omega * tau
        memory = -0.03 * omega * (np.sin(omega * TIME) - a * np.cos(omega * TIME)) / (1.0 + a * a)
        return K_h * (s.E * (R / s.R0 - 1.0) + s.R0 / R * s.phi0 * memory)

    for tau in (0.0, 0.05):
        found = loop_pressure(sheep.with_terms({"CA.tau": tau}), "CA", R, BEAT)
        np.testing.assert_allclose(found, exact(tau), rtol=1e-10, atol=1e-8)
    by_tau = K_h * s.R0 / R * s.phi0 * 0.03 * omega**2 * np.cos(omega * TIME)
    np.testing.assert_allclose(column(sheep, "CA.tau", R, BEAT), by_tau, atol=1e-5 * np.ptp(by_tau))
    np.testing.assert_allclose(column(sheep, "CA.P_ext", R, BEAT), 1.0, rtol=1e-8)
    by_phi0 = K_h * s.R0 / R * rate
    np.testing.assert_allclose(column(sheep, "CA.phi0", R, BEAT), by_phi0, atol=1e-7 * np.ptp(by_phi0))
    for variable in ("CA.leak", "CA.taper", "CA.K"):
        assert not column(sheep, variable, R, BEAT).any()
    with pytest.raises(ValueError, match="no segment"):
        loop_pressure(sheep, "XX", R, BEAT)
    with pytest.raises(ValueError, match="positive radii"):
        loop_pressure(sheep, "CA", -R, BEAT)


# --- warm start ----------------------------------------------------------------------------------------------------


def test_warm_start(sheep: Network) -> None:
    """From a beat of nearly the same network: fewer beats, the same answer within twice the tolerance."""
    cold = simulate_periodic(sheep, settings=COARSE)
    batch = {"CA.E": sheep.segment("CA").E * np.array([1.0, 1.05])}
    expected = simulate_periodic(sheep, parameters=batch, settings=COARSE)
    found = simulate_periodic(sheep, parameters=batch, settings=COARSE, start=cold)
    assert found.beats < expected.beats
    for name in expected:
        assert np.abs(found[name] - expected[name]).max() <= 2e-5 * np.ptp(expected[name]), name
    again = simulate_periodic(sheep, parameters={"CA.E": batch["CA.E"][1]}, settings=COARSE, start=found.member(1))
    assert again.beats == 2  # the least that shows that beats repeat
    memory = sheep.with_terms({"CA.tau": 0.02})
    grown = simulate_periodic(memory, settings=COARSE, start=cold)
    plain = simulate_periodic(memory, settings=COARSE)
    assert np.abs(grown["CA.P"] - plain["CA.P"]).max() <= 1e-4 * np.ptp(plain["CA.P"])
    assert simulate_periodic(sheep, settings=COARSE, start=grown).beats <= cold.beats


def test_warm_start_refusals(sheep: Network) -> None:
    """Another step, another mesh, another batch, or a result without a state."""
    cold = simulate_periodic(sheep, settings=COARSE)
    with pytest.raises(ValueError, match="another mesh or with another step"):
        simulate_periodic(sheep, settings=Settings(dt=1e-3), start=cold)
    with pytest.raises(ValueError, match="another mesh or with another step"):
        simulate_periodic(sheep.with_terms({"CA.K": 5.0}), settings=COARSE, start=cold)
    with pytest.raises(ValueError, match="does not contain its last state"):
        simulate_periodic(sheep, settings=COARSE, start=replace(cold, end=None))
    pair = simulate_periodic(sheep, parameters={"CA.E": np.array([4e6, 4.1e6])}, settings=COARSE)
    with pytest.raises(ValueError, match="of 2 parameter sets"):
        simulate_periodic(sheep, settings=COARSE, start=pair)


# --- the FMU -------------------------------------------------------------------------------------------------------

ONE_BY_ONE = [{name: value} for name, value in (*ON.items(), ("AA.junction.k", 0.7))]


@pytest.mark.slow
def test_fmu_with_everything(sheep: Network, tmp_path: Path) -> None:
    """One FMU with all terms: all on, then some alone by start values, equals the solver to 1e-9 (measured 0)."""
    network = sheep.with_terms({**ON, "AA.junction.k": 0.7, "CA.P.lag": 3e-3})
    fmu = build(network, tmp_path)
    t = np.arange(101) * 1e-3
    off = {name: neutral(name) for name in ON} | {"AA.junction.k": 0.0}
    for starts in ({}, *({**off, **on} for on in ONE_BY_ONE)):
        found = run_fmu(fmu, network.inlet.Q, 0.1, start_values=starts)
        expected = simulate(network, sampled_inflow(t, network.inlet.Q(t)), 0.1, parameters=starts)
        for name in expected:
            error = np.abs(found[name] - expected[name]).max()
            assert error <= 1e-9 * np.abs(expected[name]).max(), (name, starts)


def test_tuning_while_running(sheep: Network) -> None:
    """Memory that is tuned on and off between steps, at points off the internal grid too: the run goes on, and what
    was off before has the past of a wall without memory."""
    network = sheep.with_terms({"CA.tau": 0.0, "MD.springpot": 0.0, "fluid.unsteady_scale": 0.0})
    values = {v.name: v.start for v in variable_table(network, QUICK)}
    tuned = {"CA.tau": 1e-9, "MD.springpot": 1e-9, "fluid.unsteady_scale": 1e-9}
    runs = []
    for changes in ({}, tuned):
        component, t = CoSimulation(network, QUICK), 0.0
        component.initialize(0.0, values)
        for i in range(60):
            if i in (20, 40):
                component.retune(values | (changes if i == 20 else {}))
            component.step(t, 1.3e-3, {**values, "inlet.Q": float(sheep.inlet.Q(t))})
            t += 1.3e-3
        runs.append(component.outputs())
    np.testing.assert_allclose(runs[1], runs[0], rtol=1e-6)


# --- a new effect --------------------------------------------------------------------------------------------------


class Toy(Effect):
    """A wall that is stiffer toward its end."""

    name = "toy"
    equation = "K becomes K (1 + toy x/L)"
    owner = "segment"
    places = ("segment",)
    terms = {"toy": Quantity("1", "toy of the wall", 0.0, 10.0)}
    neutral: ClassVar[Mapping[str, float]] = {"toy": 0.0}
    signature = "none"
    confusable = ("taper",)
    separator = "none"

    def wall(self, wall: Wall, values: Values, x: np.ndarray) -> Wall:
        return replace(wall, K=wall.K * (1.0 + values["toy"] * x))


def test_a_new_effect(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """One class appended to ALL: solver, FMU variable, file key, regression column, docs row."""
    monkeypatch.setattr(effects, "ALL", (*ALL, Toy()))
    network = Toy().add(sheep, "CA", {"toy": 0.4})
    assert loads(dumps(network), "x") == network and "toy = 0.4" in dumps(network)
    row = next(v for v in variable_table(network, QUICK) if v.name == "CA.toy")
    assert (row.causality, row.start, row.quantity) == ("parameter", 0.4, Toy.terms["toy"])
    assert not any(v.name == "CA.toy" for v in variable_table(sheep, QUICK))
    waves, plain = simulate(network, duration=0.2, settings=QUICK), simulate(sheep, duration=0.2, settings=QUICK)
    assert np.abs(waves["CA.P"] - plain["CA.P"]).max() > 5e-3 * np.ptp(plain["CA.P"])
    assert same(simulate(network.with_terms({"CA.toy": 0.0}), duration=0.2, settings=QUICK), plain)
    R = sheep.segment("CA").R0 * (1.0 + 0.03 * np.cos(2 * np.pi * TIME / BEAT))
    s = sheep.segment("CA")
    exact = 0.5 * s.E * s.h / (0.75 * s.R0) * (R / s.R0 - 1.0)
    np.testing.assert_allclose(column(sheep, "CA.toy", R, BEAT), exact, atol=1e-7 * np.ptp(exact))
    assert "| `toy` |" in catalogue.table()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"typical": {"toy": 0.0}}, "size 0 of toy; give a finite one above 0"),
        ({"starts": ((1.0,), (1.0, 2.0))}, "starts .* finite points of one length"),
        ({"starts_along": ((np.nan,),)}, "starts_along .* finite points of one length"),
        ({"source": "segment"}, "'segment'; use one of wall, drop"),
    ],
    ids=str,
)
def test_what_a_search_cannot_use(given: dict, said: str) -> None:
    """A size that is none, points that are none or of several lengths, and a source that there is not."""
    with pytest.raises(InputError, match=said):
        SearchSpec(**given)


class StiffBed(Effect):
    """An outlet whose reflection is raised by its bed."""

    name, equation, owner, places = "stiff_bed", "R_t becomes R_t + bed", "outlet", ("outlet",)
    terms = {"bed": Quantity("1", "stiffness of the bed", 0.0, 0.9)}
    neutral: ClassVar[Mapping[str, float]] = {"bed": 0.0}
    signature, confusable, separator = "none", ("terminal_reflection",), "none"

    def outlet(self, numbers: Values, values: Values) -> Values:
        return {**numbers, "R_t": numbers["R_t"] + values["bed"]}


class Swirl(Effect):
    """A junction that keeps more of the kinetic pressure."""

    name, equation, owner, places = "swirl", "k becomes k + swirl", "junction", ("junction",)
    terms = {"swirl": Quantity("1", "swirl of the junction", 0.0, 1.0)}
    neutral: ClassVar[Mapping[str, float]] = {"swirl": 0.0}
    signature, confusable, separator = "none", ("junction_loss",), "none"

    def junction(self, numbers: Values, values: Values) -> Values:
        return {**numbers, "k": numbers["k"] + values["swirl"]}


@pytest.mark.parametrize(
    ("effect", "place", "value", "same_as"),
    [
        (StiffBed(), "CA", {"bed": 0.2}, {"CA.outlet.R_t": 0.2}),
        (Swirl(), "AA", {"swirl": 0.5}, {"AA.junction.k": 0.5}),
    ],
    ids=["outlet", "junction"],
)
def test_terms_of_outlets_and_junctions(
    sheep: Network, monkeypatch: pytest.MonkeyPatch, effect: Effect, place: str, value: dict, same_as: dict
) -> None:
    """Held as a term, in the file, and the same bit by bit as the number that it stands for; off, as without it."""
    monkeypatch.setattr(effects, "ALL", (*ALL, effect))
    start = sheep.parameters()[next(iter(same_as))]
    network = effect.add(sheep, place, value)
    assert loads(dumps(network), "x") == network and from_dict(json.loads(json.dumps(to_dict(network)))) == network
    found = simulate(network, duration=0.1, settings=QUICK)
    stands_for = sheep.with_parameters({name: start + more for name, more in same_as.items()})
    assert same(found, simulate(stands_for, duration=0.1, settings=QUICK))
    plain, (key,) = simulate(sheep, duration=0.1, settings=QUICK), value
    off = effect.add(sheep, place, {key: 0.0})
    assert same(simulate(off, duration=0.1, settings=QUICK), plain) and not same(found, plain)
