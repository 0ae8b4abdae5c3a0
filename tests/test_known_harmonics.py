"""An inflow that knows its harmonics saves the samples of a balance."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.records.channels.inflow import Inflow
from solver import beat_harmonics, load
from solver.network.inflow import drives_of
from solver.periodic.harmonic_balance import spectrum
from solver.scheme.model import build

SHEEP = load("sheep")
T, K = 0.6, 40


def inflow(members: int = 0) -> Inflow:
    """Q_k of a smooth pulse, 25 harmonics, the last with half its weight; for members of a batch, each with its own
    size."""
    X = 5e-5 * np.exp(-0.3 * np.arange(26) + 1j * np.arange(26)) * (1.0 + np.arange(max(members, 1))[:, None] / 9.0)
    X[..., 0] = X[..., 0].real + 1e-6j  # no imaginary mean flows
    return Inflow(T, X if members else X[0], np.ones(26, bool))


@pytest.mark.parametrize("members", [0, 3], ids=["one", "a batch"])
def test_the_harmonics_are_those_of_the_samples(members: int) -> None:
    """The discrete transform of 4096 samples of a flow of 25 harmonics is exact: to 1e-13 of the largest; also of some
    members of a batch."""
    model = build(SHEEP, {"AA.E": SHEEP.parameters()["AA.E"] * np.ones(3)})
    own = inflow(members)
    for drives, sampled in (
        (drives_of(SHEEP, own, 3), drives_of(SHEEP, lambda t: own(t), 3)),
        (
            drives_of(SHEEP, own, 3).members(np.array([2, 0])),
            drives_of(SHEEP, lambda t: own(t), 3).members(np.array([2, 0])),
        ),
    ):
        known, found = spectrum(model, drives, T, K), spectrum(model, sampled, T, K)
        assert known.shape == found.shape
        np.testing.assert_allclose(known, found, rtol=0.0, atol=1e-13 * np.abs(found).max())


def test_another_period_is_sampled() -> None:
    """A flow of period T over 2 T has the harmonics of even number alone."""
    model = build(SHEEP)
    found = spectrum(model, drives_of(SHEEP, inflow(), 1), 2.0 * T, K)[:, 0, 0]
    known = inflow().harmonics(T, K // 2)
    assert known is not None
    np.testing.assert_allclose(found[::2], known, rtol=0.0, atol=1e-13 * np.abs(known).max())
    np.testing.assert_allclose(found[1::2], 0.0, atol=1e-13 * np.abs(known).max())


def test_the_beat_is_the_same() -> None:
    """Harmonics of P of the sheep with the harmonics known and sampled: to 1e-12 of the largest."""
    own = inflow()
    one, other = (beat_harmonics(SHEEP, ["CA.P"], 10, q, T) for q in (own, lambda t: own(t)))
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12 * np.abs(one).max())
