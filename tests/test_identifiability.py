"""What data determine: made Jacobians whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.inference.intervals import determined, sentences


def test_covariance_is_that_of_data_and_prior() -> None:
    """(JᵀJ/f + 1)⁻¹ in prior units, by the plain inverse; the number of parameters is the trace of the hat matrix."""
    rng = np.random.default_rng(0)
    J, sizes, prior = rng.normal(size=(50, 3)), np.array([0.2, 0.01, 3.0]), np.array([1.0, 1.0, 0.0])
    known = determined(J, prior, sizes, 2.0, 1e-6)
    plain = np.linalg.inv(J.T @ J / 2.0 + np.diag(prior))
    np.testing.assert_allclose(known.covariance, plain * np.outer(sizes, sizes), rtol=1e-10)
    assert known.effective == pytest.approx(np.trace(J @ plain @ J.T) / 2.0, rel=1e-10)
    np.testing.assert_allclose(known.singular_values, np.linalg.svd(J)[1])


def test_what_is_determined_needs_no_sentence() -> None:
    """Two columns at right angles, ten times their prior."""
    known = determined(10.0 * np.eye(4)[:, :2], np.ones(2), np.ones(2), 1.0, 1e-4)
    assert sentences(["a", "b"], [1.0, 1.0], known) == []


def test_a_column_of_nothing() -> None:
    """No effect: the prior is all there is; without a prior, nothing is."""
    J = np.array([[10.0, 0.0], [0.0, 0.0]])
    known = determined(J, np.ones(2), np.array([0.2, 0.2]), 1.0, 1e-4)
    assert sentences(["a", "b"], [0.2, 0.2], known) == ["the data do not determine b (sd 0.2 of prior 0.2)"]
    known = determined(J, np.zeros(2), np.array([0.2, 0.2]), 1.0, 1e-4)
    assert sentences(["a", "b"], [None, None], known) == ["the data do not determine b (and it has no prior)"]


def test_two_columns_alike() -> None:
    """Columns that differ by less than their own error: a + 2 b is known to 0.1/√(1 + …), a and b alone are not.

    In units 0.2 and 0.1 the columns are equal, so x_a/0.2 + x_b/0.1 is what the data see: a + 2 b, with sd 0.2/10.
    """
    column = np.zeros(9)
    column[0] = 10.0
    J = np.stack([column, column * (1.0 + 1e-5)], axis=1)
    known = determined(J, np.zeros(2), np.array([0.2, 0.1]), 1.0, 1e-4)
    assert known.singular_values[1] == 0.0
    assert sentences(["a", "b"], [None, None], known) == [
        "of a and b only the combination a + 2 b is determined (sd 0.02)"
    ]


def test_three_without_effect_are_three() -> None:
    """Null vectors of one null space come as any mixture; the sentences do not."""
    known = determined(np.array([[5.0, 0.0, 0.0, 0.0]]), np.ones(4), np.ones(4), 1.0, 1e-4)
    said = sentences(list("abcd"), [1.0] * 4, known)
    assert sorted(said) == [f"the data do not determine {name} (sd 1 of prior 1)" for name in "bcd"]


def test_three_columns_in_a_plane() -> None:
    """c = a + b in effect: a change along a + b - c does nothing."""
    J = np.array([[10.0, 0.0, 10.0], [0.0, 10.0, 10.0]])
    known = determined(J, np.ones(3), np.ones(3), 1.0, 1e-4)
    assert sentences(list("abc"), [1.0] * 3, known) == ["the data do not determine a change along a + b - c"]


def test_correlated_but_determined() -> None:
    """Columns at 0.1 rad, both known well: a word of warning (correlation -cos 0.1, less what the prior takes)."""
    J = 1e3 * np.array([[1.0, np.cos(0.1)], [0.0, np.sin(0.1)]])
    known = determined(J, np.ones(2), np.ones(2), 1.0, 1e-4)
    assert sentences(["a", "b"], [1.0, 1.0], known) == ["a and b are hard to distinguish (correlation -0.995)"]
