"""The reference element [-1, 1]: nodes, weights and small matrices of the staggered spectral element.

Flow Q is a polynomial of degree N on the Gauss–Lobatto points, area A and pressure P one of degree N - 1 on the
Gauss points. N = 1 is the ordinary staggered finite volume. Reference: Canuto et al., Spectral Methods (2006), ch. 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre

Array = np.ndarray


def lobatto(N: int) -> tuple[Array, Array]:
    """The N + 1 Gauss–Lobatto points and weights, exact for degree 2N - 1."""
    c = np.zeros(N + 1)
    c[N] = 1.0
    inner = np.sort(legendre.legroots(legendre.legder(c)).real) if N > 1 else np.empty(0)
    x = np.concatenate([[-1.0], inner, [1.0]])
    return x, 2.0 / (N * (N + 1) * legendre.legval(x, c) ** 2)


def lagrange(x: Array, y: Array) -> Array:
    """Matrix (len(y), len(x)) that interpolates values at the points x to the points y."""
    difference = y[:, None, None] - x[None, None, :]
    scale = x[:, None] - x[None, :]
    np.fill_diagonal(scale, 1.0)
    factors = difference / scale[None, :, :]
    j = np.arange(len(x))
    factors[:, j, j] = 1.0
    return np.prod(factors, axis=2)


def lagrange_derivative(x: Array, y: Array) -> Array:
    """Matrix (len(y), len(x)) that differentiates the interpolant through the points x at the points y."""
    n = len(x)
    result = np.zeros((len(y), n))
    for j in range(n):
        others = [k for k in range(n) if k != j]
        for m in others:
            rest = [k for k in others if k != m]
            term = np.prod((y[:, None] - x[rest]) / (x[j] - x[rest]), axis=1) if rest else np.ones(len(y))
            result[:, j] += term / (x[j] - x[m])
    return result


@dataclass(frozen=True)
class Element:
    """Matrices of degree N. Names: lobatto points carry Q, gauss points carry A and P."""

    N: int
    x_lobatto: Array  # (N+1,)
    w_lobatto: Array  # (N+1,)
    x_gauss: Array  # (N,)
    w_gauss: Array  # (N,)
    derivative: Array  # (N, N+1)  dQ/dξ at the gauss points
    to_gauss: Array  # (N, N+1)  Q at the gauss points
    to_lobatto: Array  # (N+1, N)  A at the lobatto points, extrapolated at the ends

    # the same for rows of values, Q @ d_xi, and against the test functions

    @cached_property
    def d_xi(self) -> Array:
        """(N+1, N) dQ/dξ at the gauss points."""
        return np.ascontiguousarray(self.derivative.T)

    @cached_property
    def at_gauss(self) -> Array:
        """(N+1, N) Q at the gauss points."""
        return np.ascontiguousarray(self.to_gauss.T)

    @cached_property
    def at_lobatto(self) -> Array:
        """(N, N+1) A at the lobatto points."""
        return np.ascontiguousarray(self.to_lobatto.T)

    @cached_property
    def minus_d_test(self) -> Array:
        """(N, N+1): the product with values f at the gauss points is -∫ f dv/dξ dξ."""
        return -self.w_gauss[:, None] * self.derivative

    @cached_property
    def twice_test(self) -> Array:
        """(N, N+1): the product with values f at the gauss points is 2 ∫ f v dξ."""
        return 2.0 * self.w_gauss[:, None] * self.to_gauss

    @cached_property
    def integral(self) -> Array:
        """(N+1, N+2) ∫ from -1 to ξ of the polynomial of each lobatto point over its weight, by powers of ξ."""
        powers = np.arange(self.N + 1)
        polynomials = np.linalg.inv(self.x_lobatto[:, None] ** powers).T  # rows: coefficients of each point's
        found = np.zeros((self.N + 1, self.N + 2))
        found[:, 1:] = polynomials / (powers + 1.0)
        found[:, 0] = -(found[:, 1:] @ (-1.0) ** (powers + 1))
        return found / self.w_lobatto[:, None]

    @cached_property
    def high_degrees(self) -> Array:
        """(N+1, N+1): the product with values Q at the lobatto points is Σ q_k v_k for every polynomial v, where q_k,
        v_k are the coefficients of the Legendre polynomials of degree k > (N + 1)/2."""
        parts = np.linalg.inv(legendre.legvander(self.x_lobatto, self.N))[(self.N + 1) // 2 + 1 :]
        found: Array = parts.T @ parts
        return found


@lru_cache(maxsize=8)
def element(N: int) -> Element:
    """The reference element of degree N >= 1."""
    x, w = lobatto(N)
    xg, wg = legendre.leggauss(N)
    return Element(N, x, w, xg, wg, lagrange_derivative(x, xg), lagrange(x, xg), lagrange(xg, x))
