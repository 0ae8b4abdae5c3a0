"""Unknowns: coordinates of a search with their priors, the values that follow from them, and intervals; the zeros of
sensors among them.

An unknown is one number x, 0 at the network's own values, that moves one variable or several together
(:class:`solver.quantities.coordinate.Coordinate`): ``scale`` nominal exp(step x), ``shift`` nominal + step x. Several
unknowns may move one variable; their scales multiply and their shifts add.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np
from scipy.special import ndtri, stdtrit

from solver.laws.catalogue import ZERO, zero_of
from solver.network.description import Channel, Network
from solver.quantities.coordinate import SCALE, Coordinate
from solver.quantities.quantity import Quantity

from ..results.estimate import Estimate

Array = np.ndarray
T = TypeVar("T")
Reach = tuple[float, float]  # lower and upper reach of an interval, in standard deviations

_ANYTHING = 10.0  # half an interval of a logarithm: a wider one carries no information
_TINY = 1e-30  # an imaginary step of x
WIDER = 2.0  # width of starts relative to priors: starts vary more than animals
ANYWHERE = 5.0  # the same without a prior, relative to the default one
WIDEST = 1.0  # of a logarithm, whatever its prior: at ten times its length or more a network is slow, and no animal's
TAILS = 15.0  # degrees of freedom of the priors of a hypothesis
# stated spreads: a parameter of one artery or outlet that is farther from the common value is no deviation of its
# subject. Simulated with ten arteries and six outlets (36 parameters): of subjects with the stated spreads 0.06 % have
# one, with 1.5 times these 2 %, with 2.5 times 6 %; with this limit alone, 0.2, 24 and 98 %
OUTLIER = 4.0
_ZEROS = {"P": 700.0, "Q": 2e-6, "R": 2e-4}  # the sd of the prior of a zero: 5 mmHg, 2 mL/s, 0.2 mm


@dataclass(frozen=True)
class Unknown(Coordinate):
    """A coordinate and its prior about 0.

    prior_sd : standard deviation of x, or None. typical_sd : of the default prior; the unit of x for unknowns without
    prior and for finite differences. group : unknowns of one group share the width of their priors, which is estimated
    from the record, or is 1 if ``stated``. apart : an outlier, a group of its own. of_size : the size of an effect,
    with a prior uniform on a logarithmic scale.
    """

    prior_sd: float | None = 1.0
    typical_sd: float = 1.0
    group: str = ""
    stated: bool = False
    apart: bool = False
    of_size: bool = False

    def set_apart(self) -> Unknown:
        """The same unknown as an outlier."""
        return replace(self, group=f"{self.name} alone", apart=True)

    def within(self, spreads: float) -> Unknown:
        """The same within this number of standard deviations of its prior."""
        if self.prior_sd is None or not math.isfinite(spreads):
            return self
        most = spreads * self.prior_sd
        return replace(self, low=max(self.low, -most), high=min(self.high, most))

    @property
    def variables(self) -> tuple[str, ...]:
        """The names of the variables that it moves."""
        return tuple(variable for variable, _ in self.moves)


def with_prior(coordinate: Coordinate, prior_sd: float | None, of_size: bool = False) -> Unknown:
    """A coordinate with its prior."""
    return Unknown(**vars(coordinate), prior_sd=prior_sd, of_size=of_size)


def bounds(unknowns: Sequence[Coordinate]) -> tuple[Array, Array]:
    """(p,) lowest and highest x."""
    return np.array([u.low for u in unknowns]), np.array([u.high for u in unknowns])


def free(unknowns: Sequence[Coordinate]) -> Array:
    """(p,) True if the bounds differ."""
    return np.array([u.low < u.high for u in unknowns], bool)


def absent(unknowns: Sequence[Coordinate]) -> Array:
    """(p,) x at the network's own values, or the value of unknowns with equal bounds."""
    return np.clip(np.zeros(len(unknowns)), *bounds(unknowns))


def finite_steps(unknowns: Sequence[Unknown], x: Array, step: float) -> Array:
    """(p,) steps of finite differences at x, ``step`` typical sizes long, away from an upper bound."""
    steps = step * np.array([u.typical_sd for u in unknowns])
    return np.where(x + steps > bounds(unknowns)[1], -steps, steps)


def precisions(unknowns: Sequence[Unknown]) -> Array:
    """(p,) precision of the priors at 0; 0 where there is none."""
    return np.array([0.0 if u.prior_sd is None else u.prior_sd**-2.0 for u in unknowns])


def penalty(prior: Array, x: Array, tails: float = TAILS) -> float:
    """-2 log of the priors: Student's t of ``tails`` degrees of freedom (∞: Gaussian) with precision ``prior`` at 0.

    An animal four standard deviations from the network file is unusual, not impossible; a Gaussian prior would turn it
    into an effect. Ten standard deviations are implausible; longer tails would explain every offset of the radius by
    R0.
    """
    square = prior * x**2
    return float(np.sum(square if math.isinf(tails) else tails * np.log1p(square / tails)))


def precision(prior: Array, x: Array, tails: float = TAILS) -> Array:
    """(p,) precision of the Gaussian that has the slope of the priors at x."""
    return np.asarray(prior / (1.0 + prior * x**2 / tails))


def starting_points(unknowns: Sequence[Unknown], starts: int, seed: int) -> Array:
    """(starts, p) x : 0, then points of a scrambled Sobol' sequence.

    x_i = 2 s_i Φ⁻¹(u_i), within its allowed range; s : standard deviation of the prior, where there is none 2.5 times
    that of the default one; 2 s is 1 at most where x is a logarithm; u : the point in the unit cube.
    """
    from scipy.stats.qmc import Sobol  # takes half a second

    p = len(unknowns)
    u = Sobol(p, seed=seed).random_base2(int(starts - 1).bit_length())[: starts - 1]
    spread = np.array([(ANYWHERE if each.prior_sd is None else WIDER) * each.typical_sd for each in unknowns])
    logarithms = [each.kind == SCALE for each in unknowns]
    spread = np.where(logarithms, np.minimum(spread, WIDEST), spread)
    x = spread * ndtri(np.clip(u, 1e-6, 1.0 - 1e-6))
    return np.clip(np.concatenate([np.zeros((1, p)), x]), *bounds(unknowns))


# --- values and intervals ---------------------------------------------------------------------------------------------


def values(unknowns: Sequence[Coordinate], x: Array, nominal: Mapping[str, float]) -> dict[str, Array]:
    """Values [SI] of all variables that move; x : (…, p) gives arrays (…,).

    A ratio to another parameter follows the factor of that parameter. nominal : values at x = 0; default those of the
    unknowns.
    """
    nominal = {variable: each.nominal for each in unknowns for variable, _ in each.moves} | dict(nominal)
    scale: dict[str, Array] = {}
    for i, each in enumerate(unknowns):
        if each.kind == SCALE:
            for variable, step in each.moves:
                scale[variable] = scale.get(variable, 0.0) + step * x[..., i]
    shift: dict[str, Array] = {}
    for i, each in enumerate(unknowns):
        if each.kind != SCALE:
            for variable, step in each.moves:
                unit = step * np.exp(scale.get(reference(each, variable), 0.0))
                shift[variable] = shift.get(variable, 0.0) + unit * x[..., i]
    names = dict.fromkeys([*scale, *shift])
    return {n: nominal[n] * np.exp(scale.get(n, 0.0)) + shift.get(n, 0.0) for n in names}


def linear(unknowns: Sequence[Coordinate], x: Array, nominal: Mapping[str, float]) -> dict[str, tuple[float, Array]]:
    """:func:`values` at x : (p,), each with its derivatives (p,) by x: exact, by imaginary steps.

    W. Squire, G. Trapp, SIAM Rev. 40 (1998) 110.
    """
    found = values(unknowns, x + _TINY * 1j * np.eye(len(x) + 1, len(x), -1), nominal)
    return {name: (float(at[0].real), at[1:].imag / _TINY) for name, at in found.items()}


def reference(unknown: Coordinate, variable: str) -> str:
    """The reference variable of a ratio; nothing for other unknowns."""
    return f"{variable.rpartition('.')[0]}.{unknown.ratio}" if unknown.ratio else ""


def parameter_values(unknowns: Sequence[Coordinate], network: Network, x: Array) -> dict[str, Array]:
    """Values [SI] of the parameters of a network that move, within their ranges; x : (…, p) gives arrays (…,)."""
    nominal, known = _numbers(network)
    moved = values(unknowns, np.asarray(x, float), nominal)
    return {n: np.clip(value, known[n].low, known[n].high) for n, value in moved.items() if n in nominal}


def _numbers(network: Network) -> tuple[dict[str, float], dict[str, Quantity]]:
    """The parameters of a network and the zeros of its outputs: their values, and their quantities."""
    return network.parameters() | zero_values(network), network.parameter_quantities() | zero_quantities(network)


def interval(
    unknowns: Sequence[Coordinate], variable: str, nominal: float, quantity: Quantity, x: Array, covariance: Array,
    quantile: float | Reach,
) -> Estimate:  # fmt: skip
    """The interval of a variable by the delta method, of its logarithm if unknowns only scale it.

    nominal : its value at x = 0. covariance : (p, p) of x. quantile : how far it goes, in standard deviations, or how
    far down and up. What is shifted as a ratio follows that number's scale, as
    in :func:`values`. Within the allowed range, which a logarithm known to a factor e^±10 or worse leaves as it is.
    """
    value, slope = linear(unknowns, x, {variable: nominal}).get(variable, (nominal, 0.0 * x))
    sd = math.sqrt(max(float(slope @ covariance @ slope), 0.0))
    below, above = (each * sd for each in (quantile if isinstance(quantile, tuple) else (quantile, quantile)))
    if nominal == 0.0 or any(u.kind != SCALE and variable in dict(u.moves) for u in unknowns):
        ends = (value - below, value, value + above)
    elif max(below, above) >= _ANYTHING * abs(value):
        ends = (-math.inf, value, math.inf)
    else:
        ends = (value * math.exp(-below / abs(value)), value, value * math.exp(above / abs(value)))
    low, value, high = (float(v) for v in np.clip(ends, quantity.low, quantity.high))
    return Estimate(value, quantity.unit, (low, high))


def parameter_intervals(
    unknowns: Sequence[Coordinate], network: Network, x: Array, covariance: Array, dof: float = math.inf
) -> dict[str, tuple[float, float]]:
    """95 % interval [SI] of every parameter that moves, within its allowed range.

    covariance : (p, p) of x; dof : its degrees of freedom (Student's t).
    """
    nominal, known = _numbers(network)
    names = dict.fromkeys(variable for u in unknowns for variable, _ in u.moves)
    half = quantile(dof)
    return {n: interval(unknowns, n, nominal[n], known[n], np.asarray(x), covariance, half).ci95 for n in names}


def quantile(dof: float) -> float:
    """Half a 95 % interval in standard deviations, by Student's t."""
    return float(stdtrit(dof, 0.975))


# --- zeros of sensors: "C.P.zero", the offset of a channel that all recordings share ----------------------------------


def zero_name(channel: str) -> str:
    """The name of a channel's zero."""
    return f"{channel}.{ZERO}"


def is_zero(name: str) -> bool:
    """Whether an unknown is the zero of a channel."""
    return name.rpartition(".")[2] == ZERO


def zero_quantities(network: Network) -> dict[str, Quantity]:
    """The zero of every output, by name."""
    return {zero_name(channel): _zero(channel.rpartition(".")[2]) for channel in network.output_units()}


@cache
def _zero(signal: str) -> Quantity:
    """The zero of a sensor of P, Q or R."""
    return replace(Channel(signal).quantities()[ZERO], nominal=_ZEROS[signal], spread=1.0)


def zero_values(network: Network) -> dict[str, float]:
    """The known zero of every output [SI], by name."""
    return {zero_name(channel): zero_of(network, channel) for channel in network.output_units()}


def split_zeros(values: Mapping[str, T], network: Network) -> tuple[dict[str, T], dict[str, T]]:
    """Values by name, parameters of the network apart from zeros of its outputs."""
    known = zero_quantities(network)
    zeros = {name: value for name, value in values.items() if name in known}
    return {name: value for name, value in values.items() if name not in known}, zeros
