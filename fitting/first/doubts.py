"""Doubts about a recording before any model: clocks, zeros and units that no single channel reveals; and about a first
model, where it misses the recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from solver.quantities.units import INFLOW, MMHG, of_signal

from ..records import limits
from ..records.alignment.beats import Beats
from .estimates import FirstEstimate, beats_in_period, foot, later, radius_at, smooth, speeds, stroke
from .fitted import Delay
from .options import HUMAN, by_stroke, mass_by_period

_TOGETHER = 0.1  # of the period: pressure and flow of one place rise within less of each other
_DIASTOLE = (0.7, 0.9)  # of the beat from the foot of the flow on, where a valve is closed
_EMPTY = 0.25  # of the systolic pressure: no artery falls lower
_BACKWARD = 0.05  # of the peak flow: more than that does not flow back into a heart
# of the peak flow: a flow above _REST late in diastole that stays the same within _STEADY has a wrong zero. Of the 253
# flows in the included networks, simulated without noise, none above _REST changes by less than 0.028
_REST, _STEADY = 0.04, 0.015
_ABOVE = 1.005  # times the mean pressure at the root: higher means get a note
# of that mean, lost on the way, in animals from so many kg on. Large arteries lose 1 %; virtual pigs, sheep and dogs up
# to 1.5 %, a baby of 4 kg 2 %, a rabbit of 3 kg 3.7 %, a rat of 0.3 kg 6 %: judgement
LOST, SMALL = 0.05, 10.0
_MANY = 6.0  # times the usual resistance or a sixth of it: L/min read as mL/s is 17 times, a carotid 8 to 20 times
_USUAL = 1.1 * MMHG / 1e-6  # [Pa s/m³] of a human: 95 mmHg over 5 L/min; as mass^(-3/4)


def doubts(
    beats: Beats, root: str, R: FirstEstimate, Z: FirstEstimate, mass: float | None, sites: list[str]
) -> Iterator[str]:
    """Sentences. root : the channel of the pressure there. R : the total resistance, Z : the impedance at the root.
    mass : of the animal [kg], None if it is not stated."""
    if (n := beats_in_period(beats)) > 1:
        yield (
            f"the period of {beats.T:.3g} s contains {n} beats, but delays and other notes count it as one; give "
            f'--period "{beats.T / n:.3g} s".'
        )
    yield from _ventricle(beats, root)
    yield from _clocks(beats, root)
    yield from _flow_of_another_place(beats, root, Z)
    yield from _zero_of_flow(beats)
    yield from _size(R.value, beats.T, mass)
    for site in sites:
        if (
            f"{site}.P" not in beats.values
            and (alone := f"{site}.R") in beats.values
            and f"{site}.Q" not in beats.values
        ):
            yield (
                f"of {alone}, a radius at a site without pressure, only the delay is used; if its place is that "
                f'of {root}, name it so (--map "TITLE={root.removesuffix("P")}R").'
            )
    pressures = (root, *(f"{site}.P" for site in sites if f"{site}.P" in beats.values))
    means = {channel: float(beats.mean(channel).mean()) for channel in pressures}
    yield from means_along(means, root, by_stroke(stroke(beats)).mass)


def means_along(means: Mapping[str, float], root: str, mass: float) -> Iterator[str]:
    """A sentence for each site whose mean pressure is above that of the root, or lower than large arteries make it.

    means : [Pa] by channel, that of the root among them. mass : of the animal [kg].
    """
    for channel, lost in lost_on_the_way(means, root, mass).items():
        yield (
            f"the mean of {channel} is {lost / MMHG:.2g} mmHg below that of {root}, more than large arteries lose: the "
            f"zero or the height of a sensor is off (calibrate --free {channel}.zero), or the artery is narrowed "
            "between them."
        )
    for channel, there in means.items():
        if there > _ABOVE * means[root]:
            yield (
                f"the mean of {channel} is {(there - means[root]) / MMHG:.2g} mmHg above that of {root}, against the "
                f"flow: the zero or the height of a sensor is off; with several flows, calibrate --free {channel}.zero "
                "finds it."
            )


def lost_on_the_way(means: Mapping[str, float], root: str, mass: float) -> dict[str, float]:
    """By channel, the mean pressure [Pa] that is lost on the way from the root, if large arteries lose less.

    Friction makes it L Q/R⁴, or mass^(-1/2) with lengths, flows and radii that go with mass^(1/4), mass^(3/4) and
    mass^(3/8). Arguments as of :func:`means_along`.
    """
    most = LOST * max(1.0, (SMALL / mass) ** 0.5) * means[root]
    return {channel: means[root] - there for channel, there in means.items() if means[root] - there > most}


@dataclass(frozen=True)
class ChannelComparison:
    """A channel of the record compared with the model: means, pulses and the rms of the difference [SI]."""

    channel: str
    mean: tuple[float, float]
    pulse: tuple[float, float]
    rms: float


def means_apart(row: ChannelComparison) -> str:
    """A sentence if the model misses the mean of a channel by more than half its pulse; "" if not."""
    unit, shown = of_signal(row.channel)
    if abs(row.mean[1] - row.mean[0]) <= limits.BEYOND * row.pulse[0]:
        return ""
    measured, model = (f"{shown * mean:.3g} {unit}" for mean in row.mean)
    return (
        f"the mean of {row.channel} is {measured}, and {model} in the model, more than half a pulse apart: the model "
        "does not hold there; correct the network, or leave the channel out."
    )


def undivided(tube: str) -> str:
    """A sentence on a branch that takes nearly all of the flow, or nearly none."""
    return (
        f"behind {tube} the flow is divided as unevenly as the fit allows: the recording does not tell the branches "
        "apart, and their radii and the mean pressures behind them may be far off. Measure a flow there, or remove the "
        "branch from the file and calibrate."
    )


def late_flow(delay: Delay, root: str) -> str:
    """A sentence if the inflow is late."""
    late, feet = delay.late, delay.feet
    before, after = (f"{x / MMHG:.2g}" for x in (delay.before, delay.after))
    side, other = ("late", "A meter with a low-pass") if late > 0.0 else ("early", "A damped catheter")
    return (
        f"{INFLOW} seems {1e3 * abs(late):.3g} ms {side} against {root} ({1e3 * abs(feet):.3g} ms from foot to foot): "
        f"with this delay the model misses the pulsation of {root} by {after} mmHg rms, without it by {before}. "
        f"{other}, or a sensor at another place, looks alike. The numbers were fitted with the delay, which the "
        "network file has only as a comment: the file as it is misses more. discover tests it."
    )


def _clocks(beats: Beats, root: str) -> Iterator[str]:
    late = later(foot(smooth(beats, root), beats.T) - foot(smooth(beats, INFLOW), beats.T), beats.T)
    if abs(late) > _TOGETHER * beats.T:
        yield (
            f"{root} rises {1e3 * abs(late):.0f} ms {'after' if late > 0.0 else 'before'} {INFLOW}, and at one place "
            "both rise together: one of the two is of another clock or another place; shift the times of its file "
            f'(--with "FILE=SHIFT"), or give --filter "{INFLOW}=delay {-1e3 * late:.0f} ms" to the other commands.'
        )


def _flow_of_another_place(beats: Beats, root: str, Z: FirstEstimate) -> Iterator[str]:
    found = speeds(beats, root, Z)
    if found and not found.agree:
        measured = radius_at(beats, root)
        yield (
            f"by the impedance and the mean of {measured} waves run at {found.by_flow:.3g} m/s, by the slope of {root} "
            f"against {measured} at {found.by_wall:.3g} m/s: {INFLOW} is not the flow through that place, or a unit or "
            f"gain is wrong. The model does not use {measured}; if it is of another place than {root}, give its site "
            "another name."
        )


def _ventricle(beats: Beats, root: str) -> Iterator[str]:
    low, high = (float(x) / MMHG for x in (beats.mean(root).min(), beats.mean(root).max()))
    if low < _EMPTY * high:
        yield (
            f"{root} falls from {high:.3g} to {low:.3g} mmHg in each beat, as a ventricle's pressure does, or one that "
            "is not told from that of the air; an artery keeps its pressure, and the resistance needs its level: "
            "leave out the column of a ventricle."
        )


def _zero_of_flow(beats: Beats) -> Iterator[str]:
    Q = smooth(beats, INFLOW)
    Q = np.roll(Q, -round(foot(Q, beats.T) / beats.T * len(Q)))
    first, last = (int(part * len(Q)) for part in _DIASTOLE)
    rest, change = float(Q[first:last].mean()), float(np.ptp(Q[first:last]))
    unit, shown = of_signal(INFLOW)
    if rest < -_BACKWARD * (Q.max() - rest):
        yield (
            f"{INFLOW} is {shown * rest:.3g} {unit} late in diastole, when nothing flows back through a closed valve: "
            "the zero of the meter is off, and the resistance with it; add what is missing to the column."
        )
    if rest > _REST * (Q.max() - rest) and change < _STEADY * (Q.max() - rest):
        yield (
            f"{INFLOW} is constant at {shown * rest:.3g} {unit} late in diastole. The flow of an artery falls with the "
            "pressure then, and that of the aorta is zero: the zero of the meter is probably off, and the resistance "
            "with it; subtract it from the column."
        )


def _size(R: float, T: float, mass: float | None) -> Iterator[str]:
    """A sentence if R [Pa·s/m³] is far from that of the mass [kg], or of all masses between that of the heart period T
    [s] and a human's: hearts of one species beat at rates that differ by a factor of 3."""
    masses = (mass_by_period(T), HUMAN) if mass is None else (mass,)
    times = [R / (_USUAL * (each / HUMAN) ** -0.75) for each in masses]
    if max(times) > 1.0 / _MANY and min(times) < _MANY:
        return
    nearest, factor = min(zip(masses, times, strict=True), key=lambda each: abs(np.log(each[1])))
    other = ", or the mass (--mass) another" if mass is not None else ", or the animal another (--mass)"
    yield (
        f"the total resistance is {factor:.2g} times that of an animal of {nearest:.3g} kg: the unit of {INFLOW} may "
        f"be wrong (L/min read as mL/s: 17 times), the flow that of a branch alone{other}."
    )
