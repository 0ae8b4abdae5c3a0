"""More than the catalogue holds: partial answers of a network, and when a further effect is not worth a simulation."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, N, T, inflow, record
from small_network import NAMES, term, terms

from discrepancy import thresholds as at
from discrepancy.compare import Compared, hopeless
from discrepancy.further import further, with_one_more
from discrepancy.intervals import stated
from discrepancy.name import name
from discrepancy.verdict import Naming
from discrepancy.weigh import Named
from fitting.inference.added import estimates
from fitting.inference.fit import Fit
from fitting.inference.network import NetworkProblem, network_problem
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term
from solver import Network, Settings, simulate_periodic
from solver.effects import BY_NAME

KNOWN = ("wall_stiffness", "channel_gain", "terminal_reflection")  # all that is searched for

# --- a stenosis that nobody looks for ---------------------------------------------------------------------------------


@cache
def problem(K: float) -> NetworkProblem:
    """B 25 % stiffer and a stenosis in C, by the same solver on half the elements; 40 dB."""
    hidden = BY_NAME["stenosis"].add(NETWORK.with_parameters({"B.E": 1.25 * 9e5}), "C", {"K": K})
    settings = Settings(dt=T / 200, element_length=Settings().element_length / 2.0, tolerance=1e-7)
    beat = simulate_periodic(hidden, inflow, T, settings=settings, tolerance=1e-6)
    X = {n: np.fft.rfft(beat[n][:-1], norm="forward")[: N // 2 + 1] for n in ("inlet.Q", *NAMES)}
    return network_problem(record({n: np.fft.irfft(x, N, norm="forward") for n, x in X.items()}, 15, 0.01), NETWORK)


def named(K: float) -> Naming:
    return name(problem(K), terms(*KNOWN), walls="common")


def test_a_stiff_wall_beside_what_is_in_no_catalogue() -> None:
    """K = 3: the stiff wall is named, and that more remains, most of it at the stenosis.

    The interval that is stated is fifteen times as wide as by noise alone, and still too narrow: 1.217 ± 0.023 for 1.25
    """
    naming = named(3.0)
    assert (naming.verdict, naming.best.label) == ("partial", "wall_stiffness at B")
    assert [n.label for n in naming.members] == ["wall_stiffness at B"]
    assert naming.reason is not None and naming.reason.startswith("whitened RMS 3.") and "most in C.P" in naming.reason
    assert at.PART_CLOSED < naming.confidence < 0.67
    (plain,) = problem(3.0).refit([(term("wall_stiffness", "B"),)])
    assert plain is not None
    low, high = stated(NETWORK, naming, naming.best, naming.best.fit.terms[0])["B.E_scale"].ci95
    assert 0.5 * (low + high) == pytest.approx(1.217, abs=0.003)
    assert high - low == pytest.approx(15.0 * np.ptp(scale_of(plain)), rel=0.1)


def scale_of(fit: Fit) -> tuple[float, float]:
    """The 95 % interval of the stiffness of B."""
    return estimates(NETWORK, fit, fit.terms[0], 1.96)["B.E_scale"].ci95


def test_where_more_than_half_remains_nothing_is_named() -> None:
    """K = 30, ten times as much: the stiff wall comes nearest and closes less than half of the gap."""
    naming = named(30.0)
    assert (naming.verdict, naming.members) == ("unknown", ())
    assert naming.reason is not None and naming.reason.startswith("wall_stiffness at B comes nearest")


# --- what a further effect must promise -------------------------------------------------------------------------------


def fit_of(z: np.ndarray, *effects: Term) -> Fit:
    """A hypothesis with this residual, whose unknowns do nothing more."""
    unknowns = tuple(u for t in effects for u in t.unknowns)
    n, p = len(z), len(unknowns)
    return Fit(effects, unknowns, np.zeros(p), z, np.zeros((n, p)), np.zeros(n, int), np.zeros(n, int))


def compared(problem: Any, z: np.ndarray, *candidates: Term) -> Compared:
    """One effect that leaves the residual z, and others that may be added."""
    first = Named(fit_of(z, term("wall_stiffness", "B")), 0.0, 100.0)
    none = Named(fit_of(2.0 * z), float(z @ z), 100.0)
    return Compared(problem, (none,), (first,), {}, candidates)


@pytest.mark.parametrize(("ratio", "expected"), [(0.99, False), (1.01, True)])
def test_hopeless(ratio: float, expected: bool) -> None:
    """χ² a datum of the best effect against HOPELESS, and of a model without effect against what is another animal."""
    found = compared(None, np.full(50, np.sqrt(at.HOPELESS * ratio)))
    assert hopeless(found) is expected
    z = np.full(50, np.sqrt(at.ANOTHER_ANIMAL * ratio))
    assert hopeless(Compared(found.problem, (Named(fit_of(z), -1.0, 100.0),), found.ranked, {}, ())) is expected


@dataclass
class Promising:
    """A problem whose candidates each have one column, and which notes what it is asked to refit."""

    columns_of: dict[str, np.ndarray]
    network: Network = NETWORK
    site: None = None
    asked: list[str] = field(default_factory=list)

    def refine(self, fits: Sequence[Fit], runs: Runs) -> list[Fit]:
        return list(fits)

    def columns(self, base: Fit, terms: Sequence[Term], runs: Runs) -> dict[str, np.ndarray]:
        return {t.label: self.columns_of[t.label][:, None] for t in terms if t.label in self.columns_of}

    def refined(self, fit: Fit, term: Term) -> None:
        return None

    def refit(self, hypotheses: Sequence[tuple[Term, ...]], *_: Any) -> list[Fit | None]:
        self.asked += [hypothesis[-1].label for hypothesis in hypotheses]
        return [None] * len(hypotheses)


@pytest.mark.parametrize(
    ("left", "enough"),
    [(10.0, at.FAR_LEFT), (100.0, 100.0 * at.PART_LEFT)],
    ids=["near the noise, by the cost a datum", "far from it, by the part of the cost"],
)
def test_a_second_effect_is_refitted_if_its_promise_is_near_the_noise(left: float, enough: float) -> None:
    """Of 50 data with χ² of 10 and of 100 a datum: what promises to leave 1 % less than the threshold is refitted, and
    what promises to leave 1 % more is not."""
    just, short = term("channel_gain", "A.P"), term("channel_gain", "B.P")
    z = np.full(50, np.sqrt(left))
    problem = Promising({t.label: _leaving(z, 50.0 * enough * x) for t, x in ((just, 0.99), (short, 1.01))})
    assert with_one_more(compared(problem, z, just, short), Runs(), set(), at.BRANCHES) == []
    assert problem.asked == [just.label]


def _leaving(z: np.ndarray, chi2: float) -> np.ndarray:
    """A column whose best multiple leaves this χ² of z; long, so that its prior costs nothing."""
    across = np.zeros_like(z)
    across[:2] = 1.0, -1.0
    share = np.sqrt(1.0 - chi2 / float(z @ z))  # cosine of the angle to z
    return 1e5 * (share * z / np.linalg.norm(z) + np.sqrt(1.0 - share**2) * across / np.linalg.norm(across))


@pytest.mark.parametrize(("K", "walls"), [(10.0, [False, True]), (100.0, [True])], ids=["bad", "hopeless"])
def test_nothing_is_added_to_walls_in_common_that_are_hopeless(
    K: float, walls: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Residuals of 85 and of some thousand χ² a datum with walls in common: further effects are tried beside the best
    of these and of walls that differ, and of the latter alone."""
    tried: list[bool] = []

    def noted(found: Compared, *rest: Any) -> Iterator[Compared]:
        tried.append(found.best.individual)
        yield from further(found, *rest)

    monkeypatch.setattr(sys.modules["discrepancy.name"], "further", noted)
    name(problem(K), terms("channel_gain", "terminal_reflection"))
    assert tried == walls
