"""The measurement chain: the transfer function of a sensor from the true output to the recorded channel."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ..quantities.coordinate import SCALE, SHIFT, Coordinate
from ..quantities.quantity import Quantity
from ..quantities.units import SIGNAL_UNITS
from .effect import Array, Described, Effect, SearchSpec, Values


class Sensor(Effect):
    """An effect of a channel: y = H(ω) x, and an offset.

    Its unknowns in a search may differ from the numbers of the catalogue, which may be undefined if it is absent.
    """

    owner = "channel"
    places = ("channel",)

    reach: ClassVar[Mapping[str, tuple[float, float]]] = {}  # x of a search, default ±30

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        """The unknowns of a search for it in a channel."""
        kind = SCALE if self.search.scales else SHIFT
        found = []
        for key, q in self.searched(place).items():
            step, nominal = self.search.typical.get(key, q.nominal), self.neutral[key] if self.search.scales else 0.0
            low, high = self.reach.get(key, (-30.0, 30.0))
            name = f"{place}.{key}"
            found.append(Coordinate(name, kind, ((name, step),), low, high, q.unit, step, nominal))
        return tuple(found)

    def searched(self, channel: str) -> Mapping[str, Quantity]:
        """The unknowns of a search by key; default: the terms."""
        return self.terms

    def transfer(self, values: Values, omega: Array) -> Array:
        """H : (n,) at omega : (n,) [rad/s]; ``values`` by the keys of a search."""
        return np.ones(np.shape(omega))

    def offset(self, values: Values) -> Array | float:
        """The offset added to the mean; ``values`` by the keys of a search."""
        return 0.0

    def frequency(self, values: Mapping[str, float]) -> float:
        """The lowest characteristic frequency [Hz] of a fault; 0 if it has none. ``values`` as in :meth:`transfer`.

        A record cannot show a frequency beyond half the sampling rate: sampled N times per beat, the coefficients of a
        flow with a kink, which fall as 1/k², are larger by the factor 1 + (πk/N)²/3 + …, like those of an undamped
        sensor with a resonance at √3/π = 0.55 of the sampling rate.
        """
        return 0.0

    def delay(self, values: Mapping[str, float]) -> float | None:
        """The delay [s] of the channel, for a sensor that is a pure delay; ``values`` as in the catalogue."""
        return None

    def corner(self, values: Mapping[str, float]) -> float | None:
        """The corner frequency [Hz] of a sensor that is a low-pass without resonance; ``values`` as in `delay`."""
        return None

    def as_terms(self, values: Mapping[str, float]) -> dict[str, float]:
        """Convert the unknowns of a search to the catalogue's numbers."""
        return dict(values)

    def as_coordinates(self, terms: Values) -> Values:
        """Convert the catalogue's numbers to the unknowns of a search."""
        return terms

    def observe(self, terms: Values, X: Array, omega: Array) -> Array:
        """Fourier coefficients X : (..., n) of a channel at omega : (n,) after the sensor."""
        values = self.as_coordinates(terms)
        return X * self.transfer(values, omega) + np.where(omega == 0.0, self.offset(values), 0.0)


class ChannelLag(Sensor):
    name = "channel_lag"
    equation = "y(t) = x(t - lag)"
    terms = {"lag": Quantity("s", "delay of the channel", -1.0, 1.0, nominal=1e-3, display="ms")}
    neutral = {"lag": 0.0}
    search = SearchSpec(typical={"lag": 3e-3})
    signature = "one channel only: phase linear in frequency"
    confusable = ("wall_viscosity", "stress_relaxation")
    separator = "calibration of the sensor"

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        """On a bench only P against R is known, so the lag cannot be negative."""
        found = super().coordinates(network, place, bench)
        return tuple(replace(c, low=0.0) for c in found) if bench else found

    def delay(self, values: Mapping[str, float]) -> float | None:
        return values["lag"]

    def transfer(self, values: Values, omega: Array) -> Array:
        return np.exp(-1j * omega * values["lag"])


class ChannelGain(Sensor):
    name = "channel_gain"
    equation = "y(t) = g x(t)"
    terms = {"gain": Quantity("1", "gain g of the channel", 1e-3, 1e3)}
    neutral = {"gain": 1.0}
    search = SearchSpec(typical={"gain": 0.03}, scales=True)
    signature = "one channel only: scales mean and pulse"
    confusable = ("wall_stiffness",)
    separator = "calibration of the sensor"

    def transfer(self, values: Values, omega: Array) -> Array:
        return values["gain"] * np.ones(np.shape(omega))


class ChannelOffset(Sensor):
    name = "channel_offset"
    equation = "y(t) = x(t) + o"
    terms = {"offset": Quantity("signal", "offset o of the channel, in the unit of its signal", -1e6, 1e6)}
    neutral = {"offset": 0.0}
    reach = {"offset": (-1e3, 1e3)}
    signature = "one channel only: shifts the mean"
    confusable = ("external_pressure",)
    separator = "calibration of the sensor"

    def searched(self, channel: str) -> Mapping[str, Quantity]:
        signal = channel.rpartition(".")[2]
        size = {"P": 400.0, "Q": 1e-6, "R": 1e-4}[signal]
        return {"offset": replace(self.terms["offset"], unit=SIGNAL_UNITS[signal], nominal=size)}

    def offset(self, values: Values) -> Array | float:
        return values["offset"]


# Start points of a search: the misfit has many local minima in the resonance
_NATURAL_FREQUENCIES, _DAMPINGS = (8.0, 10.0, 12.0, 15.0, 18.0, 22.0, 27.0, 33.0, 40.0), (0.1, 0.35, 1.2)


class CatheterResonance(Sensor):
    """A search uses a = 2ζ/ω_n (slow) and b = 1/ω_n² (resonance): both are 0 for a perfect sensor, where
    f_n diverges."""

    name = "catheter_resonance"
    equation = "Y/X = 1/(1 + 2iζ f/f_n - (f/f_n)²); f_n = 0 means none"
    terms = {
        "f_n": Quantity("Hz", "natural frequency f_n of the catheter (0: no resonance)", 0.0, 1e5, nominal=10.0),
        "zeta": Quantity("1", "damping ratio zeta of the catheter", 0.0, 100.0),
    }
    neutral = {"f_n": 0.0, "zeta": 1.0}
    # f_n of at least 5 Hz: below 7 Hz no damping makes a catheter usable (R. M. Gardner, Anesthesiology 54, 1981, 227),
    # and a slower resonance would stand for any of the arteries that the model lacks
    reach = {"slow": (0.0, 100.0), "resonance": (0.0, 10.0)}
    search = SearchSpec(
        typical={"slow": 5e-3, "resonance": 1e-4},
        starts=tuple(
            (2.0 * zeta / (2.0 * math.pi * f_n) / 5e-3, (2.0 * math.pi * f_n) ** -2.0 / 1e-4)
            for f_n in _NATURAL_FREQUENCIES
            for zeta in _DAMPINGS
        ),
    )
    signature = "one channel only: resonance near f_n"
    confusable = ("wall_viscosity",)
    separator = "calibration of the sensor"

    def searched(self, channel: str) -> Mapping[str, Quantity]:
        return {
            "slow": Quantity("s", "2 zeta/omega_n", 0.0, math.inf),
            "resonance": Quantity("s^2", "1/omega_n^2", 0.0, math.inf),
        }

    def transfer(self, values: Values, omega: Array) -> Array:
        return 1.0 / (1.0 + 1j * omega * values["slow"] - omega**2 * values["resonance"])

    def corner(self, values: Mapping[str, float]) -> float | None:
        """That of the slower pole of an overdamped sensor, f_n (ζ - √(ζ² - 1))."""
        zeta = values["zeta"]
        return values["f_n"] * (zeta - math.sqrt(zeta * zeta - 1.0)) if zeta > 1.0 else None

    def frequency(self, values: Mapping[str, float]) -> float:
        """That of the slower pole: 1/(a + √(a² - 4b)) · 2 if the sensor is overdamped, else 1/√b, over 2π."""
        a, b = values["slow"], values["resonance"]
        per = 0.5 * (a + math.sqrt(a * a - 4.0 * b)) if a * a > 4.0 * b else math.sqrt(b)
        return math.inf if per == 0.0 else 1.0 / (2.0 * math.pi * per)

    def as_terms(self, values: Mapping[str, float]) -> dict[str, float]:
        """f_n [Hz] and ζ; for a first-order sensor, ζ = 50 represents the overdamped limit."""
        slow, resonance = values["slow"], values["resonance"]
        b = max(resonance, (slow / 100.0) ** 2, 1e-12)
        return {"f_n": 1.0 / (2.0 * math.pi * math.sqrt(b)), "zeta": slow / (2.0 * math.sqrt(b))}

    def as_coordinates(self, terms: Values) -> Values:
        natural = 2.0 * np.pi * np.asarray(terms["f_n"], float)
        per = np.divide(1.0, natural, out=np.zeros_like(natural), where=natural > 0.0)
        return {"slow": 2.0 * np.asarray(terms["zeta"]) * per, "resonance": per * per}


class Known(Sensor):
    """What is known of a sensor: never a candidate of a search.

    words : the pattern of a text that states its terms. refuses_neutral : why its neutral values cannot be meant.
    """

    words: ClassVar[str]
    refuses_neutral: ClassVar[str] = ""

    def searched(self, channel: str) -> Mapping[str, Quantity]:
        return {}

    def parse(self, words: str) -> Mapping[str, str] | None:
        """Its terms as texts, if ``words`` state them."""
        match = re.fullmatch(self.words, words, re.IGNORECASE)
        return match and dict(zip(self.terms, match.groups("1"), strict=True))


class KnownZero(Known):
    """The zero or the height of a sensor, known or found by a calibration; a search has :class:`ChannelOffset`."""

    name = "known_zero"
    equation = "y(t) = x(t) + zero, known"
    terms = {"zero": Quantity("signal", "known zero of the channel, in the unit of its signal", -1e6, 1e6)}
    neutral = {"zero": 0.0}
    words = r"zero\s+(.+)"  # zero 4 mmHg
    signature = "one channel only: mean"
    confusable = ("channel_offset", "external_pressure")
    separator = "calibration of the sensor"

    def offset(self, values: Values) -> Array | float:
        return values["zero"]


class KnownDelay(Known):
    """The delay of a meter, known from its data sheet or found in a recording; a search has :class:`ChannelLag`."""

    name = "known_delay"
    equation = "y(t) = x(t - delay), known"
    terms = {"delay": Quantity("s", "known delay of the channel", -1.0, 1.0, display="ms")}
    neutral = {"delay": 0.0}
    words = r"delay\s+(.+)"  # delay 20 ms
    refuses_neutral = "its delay must not be 0 s"
    signature = "one channel only: phase linear in frequency"
    confusable = ("channel_lag", "low_pass")
    separator = "calibration of the sensor"

    def transfer(self, values: Values, omega: Array) -> Array:
        return np.exp(-1j * omega * np.asarray(values["delay"], float))


_HIGHEST_ORDER = 8


class LowPass(Known):
    """A filter known from the amplifier's settings: Butterworth, causal.

    Source: S. Butterworth, On the theory of filter amplifiers, Wireless Engineer 7 (1930) 536–541.
    """

    name = "low_pass"
    equation = "Y/X = Π 1/(1 - i f/(f_c p_k)), p_k = e^{iπ(2k + n - 1)/(2n)}, k = 1 … n; f_c = 0 means none"
    how = ("low_pass_order",)
    refuses_neutral = "its frequency must be above 0 Hz"
    terms = {
        "low_pass": Quantity("Hz", "cut-off frequency f_c of the channel's known filter (0: none)", 0.0, 1e5),
        "low_pass_order": Quantity("1", "order n of that filter", 1.0, _HIGHEST_ORDER, whole=True),
    }
    neutral = {"low_pass": 0.0, "low_pass_order": 1.0}
    words = r"low-?pass\s+(.+?)(?:\s+order\s+(\d+))?"  # lowpass 10 Hz order 2; without order the first
    signature = "one channel only: damps and delays high harmonics"
    confusable = ("catheter_resonance", "channel_lag")
    separator = "settings of the amplifier"

    def transfer(self, values: Values, omega: Array) -> Array:
        cutoff, order = (np.asarray(values[key], float) for key in self.terms)
        none = cutoff <= 0.0
        s, H = 1j * omega / (2.0 * np.pi * np.where(none, 1.0, cutoff)), np.ones(np.shape(omega), complex)
        for k in range(1, _HIGHEST_ORDER + 1):
            pole = np.exp(0.5j * np.pi * (2 * k + order - 1.0) / order)
            H = H * np.where(none | (k > np.rint(order)), 1.0, 1.0 / (1.0 - s / pole))
        return H
