"""Free terms beside a hypothesis: an error of the model that goes where waves carry it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from forked import NETWORK, N, T, clean, inflow, record
from small_network import NAMES, term

from discrepancy import thresholds
from discrepancy.name.model_selection import name
from fitting.inference import hierarchy
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.inference.runs import Runs
from fitting.inference.source_maps.place_model import PlaceModel
from fitting.inference.source_maps.source_map import found_beside, map_beside, source_map
from solver import Settings, simulate_periodic
from solver.errors import InputError
from solver.laws.effects import BY_NAME

Array = np.ndarray


@cache
def problem(K: float) -> NetworkProblem:
    """A stenosis in C; 40 dB."""
    if not K:
        return network_problem(record(clean(), 15, 0.01), NETWORK)
    hidden = BY_NAME["stenosis"].add(NETWORK, "C", {"K": K})
    beat = simulate_periodic(hidden, inflow, T, settings=Settings(dt=T / 200, tolerance=1e-7), tolerance=1e-6)
    X = {n: np.fft.rfft(beat[n][:-1], norm="forward")[: N // 2 + 1] for n in ("inlet.Q", *NAMES)}
    return network_problem(record({n: np.fft.irfft(x, N, norm="forward") for n, x in X.items()}, 15, 0.01), NETWORK)


def test_nothing_acts_beside_a_model_that_explains_the_record() -> None:
    """No free term is worth its price."""
    healthy = problem(0.0)
    (none,) = healthy.refit([()])
    assert none is not None and found_beside(healthy, none) is None


def test_a_free_term_beside_the_healthy_model_is_where_the_stenosis_is() -> None:
    """A drop of pressure in C. Its covariance is that of channels: Hermitian, and of no negative variance."""
    narrow = problem(3.0)
    (none,) = narrow.refit([()])
    assert none is not None
    found = found_beside(narrow, none)
    assert found is not None and ("drop", "C") in {(p.kind, p.name) for p in found.places}
    C = found.errors
    np.testing.assert_allclose(C, C.conj().swapaxes(1, 2), atol=1e-12 * np.abs(C).max())
    assert np.linalg.eigvalsh(C).min() > -1e-9 * np.abs(C).max()
    assert hierarchy.score(found.fit) + found.cost < hierarchy.score(none)


def test_nothing_acts_beside_the_law() -> None:
    """With the stenosis in it, the model leaves noise alone."""
    narrow = problem(3.0)
    (law,) = narrow.refit([(term("stenosis", "C"),)])
    assert law is not None and found_beside(narrow, law) is None


@pytest.mark.deep
def test_a_law_beside_which_nothing_acts_competes_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the residual of the right law counts as too large by chance: partial, as no free source is worth its price.
    It was "unknown, the sensor of …, which no law explains", of whose two hypotheses the law was not one."""
    monkeypatch.setattr(thresholds, "MISFIT", -20.0)
    found = name(problem(3.0), (term("stenosis", "C"), term("side_branch", "C")))
    assert (found.verdict, found.best.label) == ("partial", "stenosis at C")
    assert found.best.places == () and found.reason is not None and "acts" not in found.reason


def test_nothing_acts_beside_what_has_no_state() -> None:
    """A fit that ended at an external pressure under which the wall carries no start pressure: no answer, no crash."""
    (law,) = problem(3.0).refit([(term("external_pressure", "C"),)])
    assert law is not None
    ends = {u.name: u for u in law.unknowns}
    there = {"C.P_ext": ends["C.P_ext"].high, "all.E": np.log(0.15) / ends["all.E"].moves[0][1]}  # 40 kPa on 34 kPa
    x = np.array([there.get(u.name, x) for u, x in zip(law.unknowns, law.x, strict=True)])
    with pytest.raises(InputError, match="cannot carry the start pressure"):
        PlaceModel(problem(3.0), Runs(), law.terms, law.unknowns).responses(x)
    assert found_beside(problem(3.0), replace(law, x=x)) is None


def test_the_map_s_animal_is_as_probable_as_the_map_says() -> None:
    """-2 ln evidence of the map, and of the model without effect with the map's terms beside it, their prices with it:
    to 2e-6 (4e-7 measured), though one integrates sources out harmonic by harmonic and the other whitens anew."""
    file = problem(3.0).individual()
    found = source_map(file, Runs())
    animal = file.at((), found.unknowns, found.x)
    (none,) = animal.refit([()])
    assert none is not None
    beside = map_beside(animal, none, found, Runs())
    assert beside is not None
    volume = animal.target.log_volume - file.target.log_volume
    assert hierarchy.score(beside.fit) + beside.cost + volume == pytest.approx(found.score, abs=2e-6)
