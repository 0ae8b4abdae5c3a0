"""Estimates from pressure and flow at the root without a model of the network: R, C, Z_c, delays, the reflection time.
They come from mean beats as waves: their harmonics above the noise, and the foot of the upstroke.

Where there are two methods for a number, their difference is its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from solver.errors import InputError
from solver.network.description import Fluid
from solver.quantities.units import INFLOW, MMHG, of_signal

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients, derivative, resample, without_high

_POINTS = 2048  # a beat, to resolve a foot to less than a millisecond
_HIGHEST = 40  # harmonic
_NOISE, _SMALL = 3.0, 0.01  # standard deviations, and fraction of the largest harmonic: thresholds for a harmonic
_BACK = 0.3  # of the period before the steepest rise: search range for the end of diastole
FEET = 0.01  # of the period: by which a delay between feet may be off
_LATEST = 0.1  # of the period: the largest delay of a meter; beyond it the clocks differ (:mod:`fitting.first.doubts`)
_BEGUN = (0.1, 0.3)  # of the rise: the part extrapolated to the foot


def heard(beats: Beats, name: str, small: float = _SMALL) -> Array:
    """The harmonics k >= 1 of a channel's mean beat above its noise : (K,) of k.

    small : fraction of the largest harmonic, below which one is ignored.
    """
    size = np.abs(coefficients(beats.mean(name)))[: _HIGHEST + 1]
    noise = np.zeros(len(size))
    if beats.n_beats > 1:
        noise = np.sqrt(beats.covariance((name,))[: _HIGHEST + 1, 0, 0].real)
    loud = (size > _NOISE * noise) & (size > small * size[1:].max())
    return np.flatnonzero(loud)[int(loud[0]) :]


def smooth(beats: Beats, name: str, most: int | None = None, wave: Array | None = None) -> Array:
    """The mean beat with the harmonics up to the last that is heard, or ``most``, on many points : (n,).

    wave : (N,) instead of the mean beat, such as that before a known filter.
    """
    most = int(max(heard(beats, name), default=1)) if most is None else most
    return without_high(resample(beats.mean(name) if wave is None else wave, _POINTS), most)


def late(beats: Beats, root: str, wave: Array | None = None) -> float:
    """The delay [s] of inlet.Q against the pressure at the same place, foot to foot; 0 if it may be none, or is so
    large that the clocks differ.

    wave : (N,) of inlet.Q before known filters; default: as recorded.
    """
    T = beats.T
    found = later(foot(smooth(beats, INFLOW, wave=wave), T) - foot(smooth(beats, root), T), T)
    return found if max(FEET * T, T / beats.N) < abs(found) < _LATEST * T else 0.0


def foot(x: Array, T: float) -> float:
    """The start of the upstroke [s]: the line through 10 to 30 % of the rise meets the end-diastolic level.

    x : (n,) one beat of period T [s]. This is the method of intersecting tangents (Y. C. Chiu et al., Am. Heart J. 121
    (1991) 1460) with the tangent at the start of the rise, before the arrival of reflected waves.
    """
    rise, start = _rise(x, T)
    first, last = (int(np.argmax(rise > part * rise.max())) for part in _BEGUN)
    t = np.arange(first, last + 1)
    slope, at_start = np.polyfit(t, rise[t], 1) if len(t) > 1 else (rise[first] / max(first, 1), 0.0)
    return float((start - at_start / slope) * T / len(x))


def steepest_foot(x: Array, T: float) -> float:
    """The same [s] with the tangent at the steepest point of the rise."""
    rise, start = _rise(x, T)
    slope = np.gradient(rise)
    i = int(np.argmax(slope[: int(np.argmax(rise)) + 1]))
    return float((start + i - rise[i] / slope[i]) * T / len(x))


def later(t: float, T: float) -> float:
    """A time difference [s] within half a period of 0."""
    return (t + 0.5 * T) % T - 0.5 * T


def _rise(x: Array, T: float) -> tuple[Array, int]:
    """The beat from the end of diastole on, above the level there : (n,), and the sample where that is."""
    steep = int(np.argmax(derivative(x, T)))
    before = (steep - np.arange(int(_BACK * len(x)))) % len(x)
    start = int(before[np.argmin(x[before])])
    return np.roll(x, -start) - x[start], start


_VENOUS = 5.0 * MMHG  # uncertainty of an assumed venous pressure
_LEAST = 0.2  # smallest relative standard deviation, as both methods may share an error
_ROUGH = 0.4  # the same for a reflection time, as waves return from many places
# [s], by which one sensor may be late against another: a catheter filled with fluid, of natural frequency f, delays a
# foot by some 0.2/f, 7 to 17 ms for f of 30 to 12 Hz, and a manometer at its tip by nothing; records do not tell which
_SENSORS = 6e-3
_RETURN = 0.08  # of the period: a usual reflection time, if none is found
_HIGH = (3, 10)  # harmonics whose impedance is near Z_c
_EARLY = 0.5  # of its rise: until then the flow enters vessels without reflection
_CLOSED = 0.05  # of its peak: below that flow, the valve is closed
_SPEEDS = 2.0  # times another estimate of the wave speed, or half of it: of another place
_MOST_BEATS = 8  # in a period
# of the pulsation of the inflow, at every n-th harmonic of a period with n beats; a period of one beat has at most half
# of it at every second harmonic (inlets and arteries of the included networks; one small branch 0.7)
_REPEATED = 0.9
_C = "total compliance C"
_DECAY = (0.3, 0.98)  # of diastole: where pressure decays alike everywhere


@dataclass(frozen=True)
class FirstEstimate:
    """One number: value in its SI unit, relative standard deviation (of its logarithm), and how it was found."""

    name: str
    value: float
    unit: str
    error: float
    how: str


def sites(beats: Beats) -> list[str]:
    """The sites of a record but inlets and outlets, in the record's order."""
    places = (name.rpartition(".")[0] for name in beats.values)
    return list(dict.fromkeys(place for place in places if place != "inlet" and "." not in place))


def root_pressure(beats: Beats) -> str:
    """The channel of the pressure at the root: inlet.P, or that whose upstroke comes first.

    Raises ValueError, one sentence, if the record has no inflow or no pressure.
    """
    pressures = [name for name in beats.values if name.endswith(".P") and name.count(".") == 1]
    flows = [name for name in beats.values if name.endswith(".Q")]
    if INFLOW not in beats.values:
        other = f'; if {flows[0]} is that flow: --map "{flows[0]}={INFLOW}"' if flows else ""
        raise InputError(
            f"{beats.source}: a first model needs the flow into the root, {INFLOW}, beside a pressure there, and the "
            f"record has {', '.join(beats.values)}; record it{other}."
        )
    if not pressures:
        raise InputError(
            f"{beats.source}: a first model needs a pressure at the root, such as Ao.P, beside {INFLOW}, and the "
            f"record has {', '.join(beats.values)}; record it."
        )
    if "inlet.P" in pressures:
        return "inlet.P"
    begin = foot(smooth(beats, INFLOW), beats.T)
    return min(pressures, key=lambda name: later(foot(smooth(beats, name), beats.T) - begin, beats.T))


def beats_in_period(beats: Beats) -> int:
    """The number of similar beats in a period, if a longer one was given: more than 0.9 of the inflow's pulsation is
    then at every n-th harmonic."""
    power = np.abs(coefficients(beats.mean(INFLOW))[1:]) ** 2
    several = range(_MOST_BEATS, 1, -1)
    return next((n for n in several if power[n - 1 :: n].sum() > _REPEATED * power.sum()), 1)


def stroke(beats: Beats) -> float:
    """The volume of a beat [m³] that enters at the root."""
    return float(beats.mean(INFLOW).mean()) * beats.T / beats_in_period(beats)


def resistance(beats: Beats, root: str, P_venous: float) -> FirstEstimate:
    """R = (mean P - P_venous)/mean Q [Pa·s/m³]. Raises ValueError where one of the two is not positive."""
    P, Q = beats.mean(root).mean() - P_venous, beats.mean(INFLOW).mean()
    if not (P > 0.0 and Q > 0.0):
        (unit_P, mmHg), (unit_Q, mL) = of_signal("P"), of_signal("Q")
        raise InputError(
            f"{beats.source}: its mean pressure is {mmHg * P:.4g} {unit_P} above P_venous and its mean inflow "
            f"{mL * Q:.4g} {unit_Q}, and a resistance needs both positive; check the sign of {INFLOW} (--map "
            f'"TITLE=-{INFLOW}" turns it) and the zero of {root}, or give --venous.'
        )
    how = f"mean of {root} minus P_venous ({P_venous / MMHG:.3g} mmHg), over mean of {INFLOW}"
    return FirstEstimate("total resistance R", float(P / Q), "Pa.s/m^3", float(np.hypot(0.02, _VENOUS / P)), how)


def compliances(beats: Beats, root: str, P_venous: float, R: float) -> tuple[FirstEstimate, ...]:
    """C [m³/Pa] by two methods, or by one if diastole shows no decay.

    By the pulse: with C, a Windkessel of resistance R has the pulse of the root under its flow. It ignores Z_c and
    comes out too small where tubes are long. By the decay in diastole: C ΔP = ∫ (P - P_venous)/R - Q dt, where P falls
    by ΔP. Waves that run to and fro in diastole disturb it.
    Sources: N. Stergiopulos et al., Ann. Biomed. Eng. 22 (1994) 392; Z. Liu et al., Am. J. Physiol. 251 (1986) H588.
    """
    P, Q = beats.mean(root), beats.mean(INFLOW)
    X, omega = coefficients(Q), beats.omega * np.arange(beats.N // 2 + 1)

    def excess(log_C: float) -> float:
        return float(np.ptp(np.fft.irfft(X * R / (1.0 + 1j * omega * R * np.exp(log_C)), beats.N)) * beats.N - pulse)

    pulse, usual = float(np.ptp(P)), np.log(beats.T / R)
    if excess(usual - 10.0) < 0.0:
        largest = R * float(np.ptp(Q))
        raise InputError(
            f"{beats.source}: the pulse of {root} is {pulse / MMHG:.3g} mmHg, and that of {INFLOW} times the "
            f"resistance, mean of {root} minus P_venous over mean of {INFLOW}, is but {largest / MMHG:.3g} mmHg: "
            f"{root} is no artery, or its zero or a unit is wrong; correct it, give --venous, or leave out its column."
        )
    C = float(np.exp(brentq(excess, usual - 10.0, usual + 10.0)))
    decay = _decay(smooth(beats, root) - P_venous, smooth(beats, INFLOW), R, beats.T)
    by_pulse = f"pulse of {root} of a Windkessel under {INFLOW}"
    if decay is None:
        return (FirstEstimate(_C, C, "m^3/Pa", _ROUGH, f"{by_pulse}; diastole shows no decay"),)
    by_decay, error = f"decay of {root} in diastole", _difference(C, decay)
    value, other = (f"{x * MMHG * 1e6:.3g} mL/mmHg" for x in (C, decay))
    return (
        FirstEstimate(_C, C, "m^3/Pa", error, f"{by_pulse}; by the {by_decay}: {other}"),
        FirstEstimate(_C, decay, "m^3/Pa", error, f"{by_decay}; by the {by_pulse}: {value}"),
    )


def impedance(beats: Beats, root: str) -> FirstEstimate:
    """Z_c [Pa·s/m³] at the root: geometric mean of the estimates from the upstroke and from the high harmonics.

    ΔP/ΔQ from the foot of the flow till half its rise (R. E. Dujardin and D. N. Stone, Med. Biol. Eng. Comput. 19
    (1981) 565), and the median of |P_k/Q_k| from the third harmonic on (Nichols, O'Rourke & Vlachopoulos, McDonald's
    Blood Flow in Arteries, 6th ed. 2011), for harmonics of both above their noise.
    """
    both = np.intersect1d(heard(beats, root), heard(beats, INFLOW))
    if len(both) == 0:
        raise InputError(
            f"{beats.source}: no harmonic of both {root} and {INFLOW} is above its noise; record more beats."
        )
    high = both[both >= _HIGH[0]][: _HIGH[1]] if both[-1] >= _HIGH[0] else both[-1:]
    Z = np.abs(coefficients(beats.mean(root))[high] / coefficients(beats.mean(INFLOW))[high])
    by_harmonics = float(np.exp(np.median(np.log(Z))))
    how = f"harmonics {high[0]} to {high[-1]} of {root} and {INFLOW}: {_shown(by_harmonics)}"
    most = max(int(both[-1]), _HIGH[1])
    Q = smooth(beats, INFLOW, most)
    begin = round(foot(Q, beats.T) / beats.T * len(Q))  # of the flow
    P, Q = np.roll(smooth(beats, root, most), -begin), np.roll(Q, -begin)
    early = max(2, int(np.argmax(Q > Q[0] + _EARLY * (Q.max() - Q[0]))) + 1)
    by_upstroke = float(np.polyfit(Q[:early], P[:early], 1)[0])
    if not by_upstroke > 0.0:
        return FirstEstimate(
            "impedance Z_c", by_harmonics, "Pa.s/m^3", 2.0 * _ROUGH, f"{how}; P falls in the upstroke of Q"
        )
    Z_c = float(np.sqrt(by_upstroke * by_harmonics))
    error = max(_LEAST, _difference(by_upstroke, by_harmonics) / 2.0)
    return FirstEstimate("impedance Z_c", Z_c, "Pa.s/m^3", error, f"{how}; upstroke: {_shown(by_upstroke)}")


@dataclass(frozen=True)
class Speeds:
    """Wave speeds [m/s] at the root by its radius: by_flow = Z A/ρ, if all of the inflow passes there; by_wall that of
    Bramwell and Hill, c² = R/(2ρ) dP/dR. Source: Proc. R. Soc. B 93 (1922) 298."""

    by_flow: float
    by_wall: float

    @property
    def agree(self) -> bool:
        """Whether they may be of one place."""
        return 1.0 / _SPEEDS < self.by_flow / max(self.by_wall, np.finfo(float).tiny) < _SPEEDS


def radius_at(beats: Beats, root: str) -> str:
    """The channel of the radius where the pressure at the root is measured, by the site's name or the inlet's; "" if
    there is none."""
    here = root.removesuffix("P") + "R"
    return next((name for name in (here, "inlet.R") if name in beats.values), "")


def speeds(beats: Beats, root: str, Z: FirstEstimate) -> Speeds | None:
    """Wave speeds at the root, None without a radius there."""
    if not (measured := radius_at(beats, root)):
        return None
    P, R, rho = beats.mean(root), beats.mean(measured), Fluid().rho
    slope = float(np.polyfit(R, P, 1)[0])
    mean = float(R.mean())
    return Speeds(Z.value * np.pi * mean**2 / rho, float(np.sqrt(max(mean * slope / (2.0 * rho), 0.0))))


def delay(beats: Beats, root: str, site: str) -> FirstEstimate:
    """The delay of the upstroke at a site relative to the root [s], foot to foot: P to P, R to P, or Q to Q.

    It includes the delay of one sensor against the other, and its error includes that error.
    """
    letter = next(letter for letter in "PRQ" if f"{site}.{letter}" in beats.values)
    pair = f"{site}.{letter}", INFLOW if letter == "Q" else root
    waves = [smooth(beats, name) for name in pair]
    found, other = (
        later(method(waves[0], beats.T) - method(waves[1], beats.T), beats.T) for method in (foot, steepest_foot)
    )
    t = max(found, beats.T / beats.N)
    how = f"foot to foot, {pair[1]} to {pair[0]}; by the steepest tangents {1e3 * other:.3g} ms"
    if found < t:
        how = f"no delay detected ({1e3 * found:.2g} ms), one sample assumed"
    error = float(np.hypot(np.clip(abs(t - other) / t, _LEAST / 2.0, 1.0), _SENSORS / t))
    return FirstEstimate(f"delay to {site}", t, "s", min(error, 1.0), how)


def reflection_time(beats: Beats, root: str, Z_c: float) -> FirstEstimate:
    """The travel time of a wave to its reflection and back [s]: from the foot of the forward to that of the backward
    wave, P_± = (P ± Z_c Q)/2. Source: N. Westerhof et al., Cardiovasc. Res. 6 (1972) 648."""
    P, Q = (smooth(beats, name) for name in (root, INFLOW))
    t = later(foot((P - Z_c * Q) / 2.0, beats.T) - foot((P + Z_c * Q) / 2.0, beats.T), beats.T)
    how = f"feet of the forward and the backward wave of {root} and {INFLOW}"
    if t < beats.T / beats.N:
        how = f"the backward wave of {root} and {INFLOW} is not later, {_RETURN:.0%} of the period assumed"
        return FirstEstimate("reflection time", _RETURN * beats.T, "s", 2.0 * _ROUGH, how)
    return FirstEstimate("reflection time", float(t), "s", _ROUGH, how)


def _decay(P: Array, Q: Array, R: float, T: float) -> float | None:
    """C [m³/Pa] of the decay of P : (n,) [Pa] above the venous pressure in diastole, None where it does not fall."""
    n = len(P)
    P, Q = (np.roll(x, -round(foot(P, T) / T * n)) for x in (P, Q))
    peak = int(np.argmax(Q[: n // 2]))
    closed = peak + int(np.argmax(Q[peak:] < _CLOSED * Q.max()))
    begin, end = (closed + int(part * (n - closed)) for part in _DECAY)
    fall = P[begin] - P[end]
    C = np.sum(P[begin:end] / R - Q[begin:end]) * T / n / fall if fall > 0.0 else 0.0
    return float(C) if C > 0.0 else None


def _difference(a: float, b: float) -> float:
    return max(_LEAST, abs(float(np.log(a / b))))


def _shown(Z: float) -> str:
    return f"{Z / MMHG * 1e-6:.3g} mmHg·s/mL"
