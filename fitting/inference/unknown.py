"""What a network calibration looks for: unknowns, their priors, and the parameters that follow from them.

An unknown is one number x, 0 at the network's own values, that moves one parameter or several together:

    scale   value = nominal exp(x)             parameters that cannot be negative (E, phi0, R0, nu, R2 …)
    shift   value = nominal + x unit           parameters that may change sign (R_t, phiNL, ENL, P_venous)

A shift is counted in the parameter's own unit (R_t, P_venous), but for phiNL in s, as phiNL/phi0, and for ENL as ENL/E,
both at the network's own phi0 and E: that is how the paper compares segments. Several unknowns may move one
parameter ("all.E" and "CA.E"); their scales multiply and their shifts add up.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as t_distribution

from solver.network import Network

Array = np.ndarray

# Standard deviations of x (ours; the paper gives no spread between animals): 20 % on E and phi0, 1 % on R0,
# 30 % on phiNL/phi0 (of 1 s where that is smaller), 0.2 on R_t. All others 30 %: of the value, or of the quantity's
# typical size where it may change sign.
PRIOR_SD: Mapping[str, float] = {"E": 0.2, "phi0": 0.2, "R0": 0.01, "R_t": 0.2}
_OTHER_SD = 0.3
_ANYTHING = 10.0  # half an interval of a logarithm: a factor e^20 from end to end says nothing
_RATIOS: Mapping[str, tuple[str, str]] = {"phiNL": ("phi0", "s"), "ENL": ("E", "1")}  # shifted as a ratio to these


@dataclass(frozen=True)
class Unknown:
    """One number to be found, and the parameters that it moves.

    name : as asked for ("all.E"). parameters : FMU variable names. kind : "scale" or "shift".
    steps : change of each parameter's value (shift) or logarithm (scale) per unit of x. unit : of x.
    prior_sd : standard deviation of the Gaussian prior on x about 0, or None. typical_sd : the default prior's; the
    size of x against which a datum without prior is judged. low, high : the x that the allowed ranges leave.
    """

    name: str
    parameters: tuple[str, ...]
    kind: str
    steps: tuple[float, ...]
    unit: str
    prior_sd: float | None
    typical_sd: float
    low: float
    high: float


def parse_unknown(text: str, network: Network) -> Unknown:
    """The unknown of a text TARGET.PARAMETER[:PRIOR].

    TARGET : "all" (every segment, or every outlet, that has the parameter), names joined by "+" ("CA+FA"), "fluid" or
    "network". PARAMETER : "E", "phi0" …, "outlet.R_t" …. PRIOR : its standard deviation (0.1), or "none".
    Raises ValueError for a name that the network has not, a prior that is not positive, or a value 0 to be scaled.
    """
    name, colon, prior = (part.strip() for part in text.partition(":"))
    target, dot, key = name.partition(".")
    known = network.parameter_quantities()
    if target == "all":
        names = [f"{s.name}.{key}" for s in network.segments if f"{s.name}.{key}" in known]
    else:
        names = [f"{part.strip()}.{key}" for part in target.split("+")]
    _check_names(name, names, known, network.name)
    nominal = network.parameters()
    quantity = known[names[0]]
    shift = quantity.low < 0.0
    last = key.rpartition(".")[2]
    steps, unit = _steps(names, last, nominal, quantity.unit) if shift else ((1.0,) * len(names), "1")
    typical = PRIOR_SD.get(last, _OTHER_SD)
    if last == "phiNL":
        typical *= max(1.0, *(abs(nominal[each] / step) for each, step in zip(names, steps, strict=True)))
    elif shift and last not in PRIOR_SD and last not in _RATIOS:
        typical *= quantity.nominal
    ends = [
        _range(each, nominal[each], step, known[each].low, known[each].high, shift)
        for each, step in zip(names, steps, strict=True)
    ]
    prior_sd = _prior(name, prior) if colon else typical
    low, high = max(low for low, _ in ends), min(high for _, high in ends)
    kind = "shift" if shift else "scale"
    return Unknown(name, tuple(names), kind, steps, unit, prior_sd, prior_sd or typical, low, high)


def parse_unknowns(texts: Iterable[str | Unknown], network: Network) -> tuple[Unknown, ...]:
    """The unknowns of some texts, checked against a network. Raises ValueError as :func:`parse_unknown`."""
    unknowns = tuple(parse_unknown(text, network) if isinstance(text, str) else text for text in texts)
    if not unknowns:
        raise ValueError('unknowns: none given; name at least one parameter to find, such as "all.E".')
    moved: dict[tuple[str, ...], str] = {}
    for unknown in unknowns:
        same = tuple(sorted(unknown.parameters))
        if same in moved:
            raise ValueError(f"unknowns {moved[same]} and {unknown.name} move the same parameters; keep one of them.")
        moved[same] = unknown.name
    return unknowns


def parameter_values(unknowns: Sequence[Unknown], network: Network, x: Array) -> dict[str, Array]:
    """Values [SI] of all the parameters that move, by FMU variable name; x : (…, p) gives arrays (…,).

    Where several unknowns move one parameter, it is clipped to its allowed range.
    """
    nominal, known = network.parameters(), network.parameter_quantities()
    moves = _moves(unknowns, np.asarray(x, float))
    values = {}
    for name, (kind, move) in moves.items():
        value = nominal[name] * np.exp(move) if kind == "scale" else nominal[name] + move
        values[name] = np.clip(value, known[name].low, known[name].high)
    return values


def parameter_intervals(
    unknowns: Sequence[Unknown], network: Network, x: Array, covariance: Array, dof: float = math.inf
) -> dict[str, tuple[float, float]]:
    """95 % interval [SI] of every parameter that moves, within its allowed range.

    covariance : (p, p) of x; dof : its degrees of freedom (Student's t).
    """
    nominal, known = network.parameters(), network.parameter_quantities()
    width, result = quantile(dof), {}
    for name, (kind, move) in _moves(unknowns, np.asarray(x, float)).items():
        row = np.array([dict(zip(u.parameters, u.steps, strict=True)).get(name, 0.0) for u in unknowns])
        half = width * math.sqrt(max(float(row @ covariance @ row), 0.0))
        ends = np.array([float(move) - half, float(move) + half])
        low, high = known[name].low, known[name].high
        if kind == "shift":
            low, high = np.clip(nominal[name] + ends, low, high)
        elif half < _ANYTHING:
            low, high = np.clip(nominal[name] * np.exp(ends), low, high)
        result[name] = (float(low), float(high))
    return result


def quantile(dof: float) -> float:
    """Half a 95 % interval in standard deviations, by Student's t."""
    return float(t_distribution.ppf(0.975, dof))


def _moves(unknowns: Sequence[Unknown], x: Array) -> dict[str, tuple[str, Array]]:
    """Change of each parameter's logarithm (scale) or value (shift), summed over the unknowns."""
    moves: dict[str, tuple[str, Array]] = {}
    for i, unknown in enumerate(unknowns):
        for name, step in zip(unknown.parameters, unknown.steps, strict=True):
            before = moves[name][1] if name in moves else 0.0
            moves[name] = (unknown.kind, before + step * x[..., i])
    return moves


def _check_names(unknown: str, names: Sequence[str], known: Iterable[str], network: str) -> None:
    known = list(known)
    if not names:
        keys = sorted({each.partition(".")[2] for each in known})
        close = difflib.get_close_matches(unknown.partition(".")[2], keys, n=1, cutoff=0.4)
        hint = f"did you mean all.{close[0]}?" if close else f"use all. with one of {', '.join(keys)}."
        raise ValueError(f"unknown {unknown}: no segment or outlet of network {network} has this parameter; {hint}")
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f"did you mean {close[0]}?" if close else 'write it as "all.E", "CA.phi0" or "CA.outlet.R_t".'
            raise ValueError(f"unknown {unknown}: {name} is not a parameter of network {network}; {hint}")
        if names.count(name) > 1:
            raise ValueError(f"unknown {unknown}: {name} occurs twice; name it once.")


def _prior(name: str, text: str) -> float | None:
    if text == "none":
        return None
    try:
        sd = float(text)
    except ValueError:
        sd = math.nan
    if not (math.isfinite(sd) and sd > 0.0):
        raise ValueError(
            f'unknown {name}: prior {text!r} must be a positive standard deviation or none, as in "{name}:0.1".'
        )
    return sd


def _steps(names: Sequence[str], key: str, nominal: Mapping[str, float], unit: str) -> tuple[tuple[float, ...], str]:
    """Change of each shifted parameter per unit of x, and the unit of x."""
    if key not in _RATIOS:
        return (1.0,) * len(names), unit
    reference, unit = _RATIOS[key]
    steps = tuple(nominal[f"{name.rpartition('.')[0]}.{reference}"] for name in names)
    for name, step in zip(names, steps, strict=True):
        if step == 0.0:
            segment = name.rpartition(".")[0]
            raise ValueError(
                f"unknown {name}: {segment}.{reference} is 0, and {key} is sought as a ratio to it; "
                f"give {segment}.{reference} a value above 0 in the network."
            )
    return steps, unit


def _range(name: str, nominal: float, step: float, low: float, high: float, shift: bool) -> tuple[float, float]:
    """The x that keep one parameter in its allowed range."""
    if shift:
        return (low - nominal) / step, (high - nominal) / step
    if nominal <= 0.0:
        raise ValueError(
            f"unknown {name}: it is {nominal:g} in the network, which no factor can change; start from a value above 0."
        )
    return math.log(low / nominal) if low > 0.0 else -math.inf, math.log(high / nominal)
