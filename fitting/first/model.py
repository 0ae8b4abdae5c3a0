"""A first model of a recording: the smallest network that holds its sites, with numbers read off the recording.

With the impedance Z_c at the root, the wave speed c and the time t through a tube that takes a share s of the flow,

    A = ρ c s/Z_c,   L = c t,   E = 2 ρ c² (1 - η²) R0/h,   C_tube = A L/(ρ c²) = s t/Z_c

so that junctions are matched, and what the tubes store depends on times and Z_c alone; where the radius of a stretch
was measured, A is that. A Windkessel at each end takes its share of the rest: R1 is the impedance of its tube,
R1 + R2 = R/s less the friction of the tubes, C = s (C - Σ C_tube).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver.errors import InputError
from solver.files import loads
from solver.linear import waveforms
from solver.network import Fluid, Network
from solver.units import INFLOW, MMHG

from ..records.beats import Beats
from ..records.spectral import coefficients, resample
from . import text
from .estimates import Found, compliance, delay, impedance, reflection_time, resistance, root_pressure, sites
from .species import Typical, typical
from .stretches import Stretch, parents, stretches
from .tubes import Tube, made, windkessel
from .waves import heard

Array = np.ndarray

VENOUS = 5.0 * MMHG  # as in the bundled network human
_MOST = 0.7  # of the compliance: what the tubes may have
_RADIUS, _MEASURED, _SPEED = 0.25, 0.05, 0.3  # relative standard deviations: of a typical R, a measured R, a typical c
_DISTANCE = 0.1  # the same of a length that is given
_USUAL = (2.0, 20.0)  # wave speeds of arteries [m/s]
_SAMPLES = 200  # a beat, of the comparison


@dataclass(frozen=True)
class Shown:
    """A channel of the record beside that of the model: means, pulses and the rms of the difference [SI]."""

    channel: str
    mean: tuple[float, float]
    pulse: tuple[float, float]
    rms: float


@dataclass(frozen=True)
class FirstModel:
    """network : as the file ``text`` describes it. found : the numbers it rests on. shown : record against model, small
    waves about the mean pressure. notes : what is doubtful, one sentence each."""

    network: Network
    text: str
    found: tuple[Found, ...]
    shown: tuple[Shown, ...]
    notes: tuple[str, ...]


def first_model(
    beats: Beats,
    like: str = "human",
    *,
    mass: float | None = None,
    P_venous: float = VENOUS,
    distances: Mapping[str, float] | None = None,
    paths: Sequence[str] = (),
) -> FirstModel:
    """The first model of a recording with inlet.Q and a pressure at the root, and P, Q or R at other sites.

    like : species whose typical aorta stands for what is not measured, mass : of the body [kg]. P_venous [Pa].
    distances : of sites from the root, along the vessels [m]; they give the wave speed. paths : "Ao,CA" and "Ao,FA",
    which sites lie behind one another; by default all do, in the order of their delays.
    Raises ValueError, one sentence that says what is needed.
    """
    channel = root_pressure(beats)
    root = channel.removesuffix(".P").replace("inlet", "")
    R = resistance(beats, channel, P_venous)
    C = compliance(beats, channel, P_venous, R.value)
    Z = impedance(beats, channel)
    delays = {site: delay(beats, channel, site) for site in sites(beats) if site != root}
    echo = reflection_time(beats, channel, Z.value)
    times = {site: found.value for site, found in delays.items()}
    most = _MOST * C.value * Z.value
    alone = min(echo.value / 2.0, most) if echo.value > 0.0 else most
    tubes = stretches(beats, root, parents(paths, root, times), times, alone)
    usual = typical(like, mass)
    notes = [] if delays else _notes_alone(echo, most)
    c, area, radius = _speed_and_area(beats, root, Z, usual, delays, distances or {})
    if not _USUAL[0] <= c.value <= _USUAL[1]:
        notes.append(
            f"a wave speed of {c.value:.3g} m/s is not an artery's; give --distance, a radius or another --like."
        )
    walls = [_wall(beats, root, tube, c.value, area, usual) for tube in tubes]
    stored = sum(wall.stretch.time / wall.Z for wall in walls)
    if stored > _MOST * C.value * (1.0 + 1e-9):
        notes.append(
            f"by their delays the tubes would store {stored / C.value:.0%} of the compliance; all are made shorter, so "
            f"that they store {_MOST:.0%}: look at the delays."
        )
        shorter = _MOST * C.value / stored
        walls = [_wall(beats, root, replace(t, time=shorter * t.time), c.value, area, usual) for t in tubes]
    rest = C.value - min(stored, _MOST * C.value)
    P = float(beats.mean(channel).mean())
    notes += [
        f"the mean of {site}.P is {(there - P) / MMHG:.2g} mmHg above that of {channel}, against the flow: the zero "
        "or the height of a sensor is off."
        for site in delays
        if f"{site}.P" in beats.values and (there := float(beats.mean(f"{site}.P").mean())) > P
    ]
    found = (R, C, Z, *delays.values(), echo, c, radius)
    ends = {tube.stretch.name: windkessel(tube, walls, R.value, rest) for tube in walls if tube.stretch.end}
    file = text.network_file(
        text.Source(Path(beats.source).name, beats.sha256, like, usual.source, beats.T, P, P_venous, _inflow(beats)),
        found, root, walls, ends, notes,
    )  # fmt: skip
    network = loads(file, f"first model of {beats.source}")
    return FirstModel(network, file, found, _shown(beats, network), tuple(notes))


def _notes_alone(echo: Found, most: float) -> list[str]:
    """What is said of the length of the one tube of a record without other sites."""
    if 0.0 < echo.value / 2.0 <= most:
        return []
    return [
        f"the reflection time of {1e3 * echo.value:.3g} ms does not fit the compliance: the tube has the length that "
        f"stores {_MOST:.0%} of it."
    ]


def _speed_and_area(
    beats: Beats, root: str, Z: Found, usual: Typical, delays: Mapping[str, Found], distances: Mapping[str, float]
) -> tuple[Found, float, Found]:
    """Wave speed c, area of a tube with all of the flow [m²], and its radius, with Z_c = ρ c/A.

    From a distance and a delay follows c; from a measured radius, A; the other from Z_c. Without either, ln c and ln A
    are moved from what is typical in proportion to their variances till they give Z_c.
    """
    unknown = sorted(set(distances) - set(delays))
    if unknown:
        raise InputError(
            f"--distance: {unknown[0]} is no site beside the root; the record has {', '.join(delays) or 'none'}."
        )
    rho, measured = Fluid().rho, f"{root}.R"
    if distances:
        site = max(distances, key=lambda name: distances[name])
        c = distances[site] / delays[site].value
        error = float(np.hypot(_DISTANCE, delays[site].error))
        speed = Found("wave speed c", c, "m/s", error, f"the distance to {site} over the delay")
        how, R_error = "Z_c and c", float(np.hypot(error, Z.error)) / 2.0
    elif measured in beats.values:
        A = np.pi * float(beats.mean(measured).mean()) ** 2
        error = float(np.hypot(Z.error, 2.0 * _MEASURED))
        speed = Found("wave speed c", float(Z.value * A / rho), "m/s", error, f"Z_c and mean {measured}")
        how, R_error = f"mean of {measured}", _MEASURED
    else:
        off = float(np.log(Z.value * np.pi * usual.R**2 / (rho * usual.c)))
        part = _SPEED**2 / (_SPEED**2 + (2.0 * _RADIUS) ** 2)
        speed = Found("wave speed c", usual.c * float(np.exp(part * off)), "m/s", _SPEED, "Z_c and a typical aorta")
        how, R_error = f"Z_c and a typical aorta ({1e3 * usual.R:.3g} mm, {usual.c:.3g} m/s)", _RADIUS
    area = rho * speed.value / Z.value
    return speed, area, Found("radius at the mean pressure", float(np.sqrt(area / np.pi)), "m", R_error, how)


def _wall(beats: Beats, root: str, stretch: Stretch, c: float, area: float, usual: Typical) -> Tube:
    """The tube of a stretch; its radius is that which was measured at its ends, else follows from its flow."""
    ends = ("" if stretch.parent else root, stretch.site)
    radii = [float(beats.mean(f"{site}.R").mean()) for site in ends if f"{site}.R" in beats.values]
    area = np.pi * float(np.prod(radii)) ** (2.0 / len(radii)) if radii else area * stretch.share
    return made(stretch, c, area, usual)


def _inflow(beats: Beats) -> Array:
    """Complex harmonics of the mean inflow that stand above its noise : (K+1,) [m³/s]."""
    kept = heard(beats, INFLOW)
    X = coefficients(beats.mean(INFLOW))[: kept[-1] + 1]
    return np.where(np.isin(np.arange(len(X)), [0, *kept]), X, 0.0)


def _shown(beats: Beats, network: Network) -> tuple[Shown, ...]:
    """The channels but the inflow against the network under the measured inflow, linearised at its mean pressure."""
    wave = waveforms(network, resample(beats.mean(INFLOW), _SAMPLES), beats.T)
    rows = []
    for name in beats.values:
        if name in wave:
            x, y = resample(beats.mean(name), _SAMPLES), wave[name]
            rows.append(
                Shown(
                    name,
                    (float(x.mean()), float(y.mean())),
                    (float(np.ptp(x)), float(np.ptp(y))),
                    float(np.sqrt(np.mean((x - y) ** 2))),
                )
            )
    return tuple(rows)
