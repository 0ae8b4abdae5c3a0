"""Beats that start at another beat: their difference is more accurate than each, with every law, effect and outlet."""

from __future__ import annotations

import numpy as np
import pytest
from test_native import values_of

from solver import InputError, Network, Resistance, Windkessel, beat_harmonics
from solver.laws import effects
from solver.laws.effect import Array, Effect
from solver.laws.effects import BY_NAME
from solver.network.files import loads
from solver.periodic import balance_program
from solver.tracing.steps import Programs

K = 8
ROUGH, SHARP = 1e-5, 1e-10  # tolerances: of the compared beats, and of those they are compared with
WITHIN = 1e-4  # of the largest change of its kind of output; 7e-5 was measured
EQUAL = 1e-7  # of the largest change of its kind: engine and NumPy; 5e-8 was measured with a leak


def names(network: Network) -> list[str]:
    return list(network.output_units())


def change(network: Network, moved: dict[str, Array], **options: object) -> Array:
    """(K+1, m) of the second parameter set against the first."""
    X = beat_harmonics(network, names(network), K, parameters=moved, **options)  # type: ignore[arg-type]
    return np.asarray(X[1] - X[0])


def check(network: Network, moved: dict[str, Array]) -> None:
    exact = change(network, moved, tolerance=SHARP)
    kinds = np.array([n[-1] for n in names(network)])
    numpy, engine = (change(network, moved, tolerance=ROUGH, near=[0, 0], backend=b) for b in ("numpy", "auto"))
    for kind in "PQR":
        of = kinds == kind
        size = np.abs(exact[:, of]).max()
        assert np.abs(numpy - exact)[:, of].max() < WITHIN * size, kind
        assert np.abs(engine - numpy)[:, of].max() < EQUAL * size, kind


@pytest.mark.parametrize("effect", [e for e in effects.ALL if e.owner != "channel"], ids=lambda e: e.name)
def test_effects(effect: Effect, sheep: Network) -> None:
    """Memories, leaks and losses are those of the beat sought; of a wall, its radius and modulus differ."""
    place = next(p for p in ("CA", "all", *effect.where(sheep)) if p in effect.where(sheep))
    network = effect.add(sheep, place, values_of(effect))
    moved = {name: network.parameters()[name] * np.array([1.0, 1.002]) for name in ("CA.E", "DD.R0", "MD.L")}
    check(network, moved)


@pytest.mark.parametrize(("name", "factor"), [("R1", 1.01), ("C", 1.02), ("R2", 1.02)])
def test_outlets_store_by_their_own_numbers(name: str, factor: float, sheep: Network) -> None:
    network = sheep.with_outlet(Windkessel("CA", R1=1e8, C=1e-10, R2=4e9)).with_outlet(Resistance("VA2", R=8e9))
    value = network.parameters()[f"CA.outlet.{name}"]
    check(network, {f"CA.outlet.{name}": value * np.array([1.0, factor])})


SHORT = """
name = "short"
[network]
P_ref = 12450.0
P_0 = 12450.0
[inlet]
segment = "A"
T = 0.55
Q_mean = 4.51e-05
Q_cos = [4.34e-05, -4.65e-05, -5.48e-05, 1.94e-06, 5.59e-06, 3.15e-07, 5.34e-06, -1.68e-06]
Q_sin = [7.70e-05, 6.37e-05, -1.74e-05, -2.92e-05, -1.33e-06, -5.60e-06, 4.91e-07, 6.31e-07]
[segments]
A = { L = 0.31, R0 = 8.89e-3, h = 9.86e-4, E = 4.67e5, phi0 = 664.0, taper = -0.258 }
B = { L = 5e-3, R0 = 6.19e-3, h = 6.86e-4, E = 4.67e5, phi0 = 664.0, taper = -0.258 }
C = { L = 5e-3, R0 = 1.75e-3, h = 1.94e-4, E = 4.67e5, phi0 = 664.0, taper = -0.258 }
[[junctions]]
in = ["A"]
out = ["B", "C"]
[outlets]
B = { R1 = 3.93e7, C = 2.09e-9, R2 = 2.65e8, P_venous = 667.0 }
C = { R1 = 4.91e8, C = 1.67e-10, R2 = 1.18e9, P_venous = 667.0 }
"""


def test_one_that_is_not_found_from_the_other_starts_by_itself() -> None:
    """A branch of 5 mm behind an artery that narrows: from the beat of another length the corrections grow at first,
    and no beat is found; from rest they fall, and the change is that of exact beats to 4e-6."""
    network, moved = loads(SHORT, "short"), {"B.L": 5e-3 * np.array([1.0, 1.01])}
    exact = change(network, moved, tolerance=SHARP)
    for backend in ("numpy", "auto"):
        found = change(network, moved, tolerance=ROUGH, near=[0, 0], backend=backend)
        assert np.abs(found - exact).max() < 8e-6 * np.abs(exact).max()


def test_a_member_is_what_it_is_alone(sheep: Network) -> None:
    """To the last bit, whoever else is in the batch; and the beat at which others start is the one without them."""
    moved = {"CA.E": 5e5 * np.array([1.0, 1.1, 1.0, 1.02]), "AA.R0": 0.009 * np.array([1.0, 1.0, 1.001, 1.001])}
    whole = beat_harmonics(sheep, names(sheep), K, parameters=moved, near=[0, 1, 0, 1])
    pair = beat_harmonics(sheep, names(sheep), K, parameters={n: x[[1, 3]] for n, x in moved.items()}, near=[0, 0])
    np.testing.assert_array_equal(whole[[1, 3]], pair)
    alone = beat_harmonics(sheep, names(sheep), K, parameters={n: x[:2] for n, x in moved.items()})
    np.testing.assert_array_equal(whole[:2], alone)


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> Programs:
    """The programs of balances, none at first."""
    found = Programs()
    monkeypatch.setattr(balance_program, "_programs", found)
    return found


@pytest.mark.parametrize(
    ("effect", "key", "size"), [("external_pressure", "P_ext", 5e2), ("nonlinear_elasticity", "ENL", 2e5)]
)
def test_one_program_solves_both(effect: str, key: str, size: float, sheep: Network, programs: Programs) -> None:
    """An effect that is 0 in the beat at which another one starts stays in its equations, and changes nothing there."""
    network = BY_NAME[effect].add(sheep, "CA", {key: 0.0})
    moved = {f"CA.{key}": np.array([0.0, size])}
    X = beat_harmonics(network, names(network), K, parameters=moved, near=[0, 0], backend="native")
    assert len(programs.kept) == 1
    plain = beat_harmonics(sheep, names(sheep), K, backend="native")[0]
    np.testing.assert_allclose(X[0], plain, rtol=0.0, atol=1e-13 * np.abs(plain).max())


def test_effects_that_change_the_same_numbers_share_a_program(sheep: Network, programs: Programs) -> None:
    for effect in ("external_pressure", "wall_stiffness", "taper", "junction_loss"):
        place = BY_NAME[effect].where(sheep)[0]
        beat_harmonics(BY_NAME[effect].add(sheep, place, values_of(BY_NAME[effect])), ["CA.P"], K, backend="native")
    assert len(programs.kept) == 1


def test_parts_without_room_keep_their_starts(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = {"CA.E": 5e5 * np.array([1.0, 1.1, 1.001, 1.101])}
    expected = beat_harmonics(sheep, names(sheep), K, parameters=moved, near=[0, 1, 0, 1])
    monkeypatch.setattr("solver.harmonics.storable", lambda model: (K + 8) // model.coefficients.B)
    found = beat_harmonics(sheep, names(sheep), K, parameters=moved, near=[0, 1, 0, 1])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("backend", ["numpy", "auto"])
def test_near_a_lost_beat_nothing_is_found(backend: str, sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three corrections are too few from the steady state, and enough from waves nearby; but those are no beat whose
    residual could be shared."""
    monkeypatch.setattr("solver.harmonics._CORRECTIONS", 3)
    moved = {"CA.E": 4e6 * np.array([1.0, 1.0001])}
    assert np.isnan(beat_harmonics(sheep, names(sheep), K, parameters=moved, near=[0, 0], backend=backend)).all()


@pytest.mark.parametrize("near", [[0], [0, 2], [1, 0], [0.0, 0.0], [-1, 0], [1, 1, 1]])
def test_refused_in_one_sentence(near: list[float], sheep: Network) -> None:
    with pytest.raises(InputError, match=r"near = .*: it must give, for each of the 2 parameter sets"):
        beat_harmonics(sheep, names(sheep), K, parameters={"CA.E": np.array([5e5, 6e5])}, near=near)  # type: ignore[arg-type]


def test_nothing_moves(sheep: Network) -> None:
    """A parameter set that changes no beat, or so little that a correction is round-off, has the same beat."""
    moved = {"CA.E": 5e5 * np.array([1.0, 1.0, 1.0 + 1e-13])}
    for backend in ("numpy", "auto"):
        X = beat_harmonics(sheep, names(sheep), K, parameters=moved, near=[0, 0, 0], backend=backend)
        np.testing.assert_allclose(X[1:], X[[0, 0]], rtol=1e-9, atol=1e-9 * np.abs(X).max())
