"""A first model of a recording: the smallest network with its sites, with parameters estimated from the recording.

With the impedance Z_c at the root, the wave speed c and the transit time t of a tube with a share s of the flow,

    A = ρ c s/Z_c at its start,   L = c t,   E = 2 ρ c² (1 - η²) R0/h,   C_tube = A L/(ρ c²) = t/Z

with c, R0 and Z at its middle for the last three. Arteries narrow on their way (:mod:`fitting.first.tubes`), and each
tube begins with the impedance at the end of the previous one. The compliance of the tubes depends on times and Z_c
alone. A Windkessel at each end has its share of the remaining compliance and resistance: R1 = Z at the end, R1 + R2 =
R/s minus the friction of the tubes, C = s (C - Σ C_tube). From these estimates, lengths, walls, tapers and Windkessels
are fitted to the mean beat (:mod:`fitting.first.fitted`), with side branches on the way to the farthest site while the
record is more probable with them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from solver.errors import InputError
from solver.harmonics import beat_harmonics
from solver.linear import waveforms
from solver.network.description import Fluid, Network
from solver.network.doubts import network_doubts
from solver.network.files import loads
from solver.quantities.units import INFLOW

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients, resample
from .doubts import ChannelComparison, doubts, means_apart
from .estimates import (
    FirstEstimate,
    compliances,
    delay,
    heard,
    impedance,
    radius_at,
    reflection_time,
    resistance,
    root_pressure,
    sites,
    speeds,
    stroke,
)
from .fitted import Data, Fitted, delayed, fitted
from .options import VENOUS, Typical, by_stroke, typical
from .text import ModelFile
from .tubes import Section, layouts, made, mean_speed, parents, windkessel, with_side_branch

_MOST = 0.85  # of the compliance: upper limit of the tubes
_RADIUS, _MEASURED, _SPEED = 0.25, 0.05, 0.3  # relative standard deviations: of a typical R, a measured R, a typical c
_DISTANCE = 0.1  # the same of a length that is given
_USUAL = (2.0, 20.0)  # wave speeds of arteries [m/s]
_FINEST = 1e-3  # of the largest harmonic of the inflow: smaller ones are left out of the file
_BRANCHES = 2  # side branches on the longest way, at most, because each doubles the time: judgement
_SAMPLES, _HARMONICS = 200, 40  # a beat, of the comparison
_NO_BEAT = "the model has no periodic beat under the recorded flow; its table is that of small waves about the mean."


@dataclass(frozen=True)
class FirstModel:
    """network : that of the file ``text``. found : the estimates. shown : record against model, whose beat is that of
    the file. notes : doubts, one sentence each."""

    network: Network
    text: str
    found: tuple[FirstEstimate, ...]
    shown: tuple[ChannelComparison, ...]
    notes: tuple[str, ...]


def first_model(
    beats: Beats,
    like: str | None = None,
    *,
    mass: float | None = None,
    P_venous: float = VENOUS,
    distances: Mapping[str, float] | None = None,
    paths: Sequence[str] = (),
) -> FirstModel:
    """The first model of a recording with inlet.Q and a pressure at the root, and P, Q or R at other sites.

    like : species whose typical aorta replaces missing measurements; mass : of the body [kg]. Without both, it is a
    human one scaled to the stroke volume. P_venous [Pa].
    distances : of sites from the root, along the vessels [m]; they give the wave speed. paths : "Ao,CA" and "Ao,FA",
    the sites along each path; by default one path in the order of the delays. Of two estimates of C, the model uses the
    one that fits the pressure at the root better.
    Raises ValueError, one sentence with the missing data.
    """
    channel = root_pressure(beats)
    root = channel.removesuffix(".P").replace("inlet", "")
    R = resistance(beats, channel, P_venous)
    Z = impedance(beats, channel)
    delays = {site: delay(beats, channel, site) for site in sites(beats) if site != root}
    stated = like is not None or mass is not None
    usual = typical(like or "human", mass) if stated else by_stroke(stroke(beats))
    c, area, radius = _speed_and_area(beats, channel, Z, usual, delays, distances or {})
    echo = reflection_time(beats, channel, Z.value)
    times = {site: found.value for site, found in delays.items()}
    P = float(beats.mean(channel).mean())
    notes = list(doubts(beats, channel, R, Z, usual.mass if stated else None, list(delays)))
    if not _USUAL[0] <= c.value <= _USUAL[1]:
        notes.append(
            f"a wave speed of {c.value:.3g} m/s is not an artery's; check the unit of {INFLOW}, or give a distance "
            "(--distance), another species (--like) or the body mass (--mass)."
        )
    file_of = partial(
        ModelFile, Path(beats.source).name, beats.sha256, like or "", usual.source, beats.T, P, P_venous, root,
        _inflow(beats),
    )  # fmt: skip

    def with_compliance(C: FirstEstimate, tubes: Sequence[Section]) -> ModelFile:
        walls = made(tubes, c.value, area, usual)
        stored, most, notes_here = sum(wall.section.time / wall.Z for wall in walls), _MOST * C.value, list(notes)
        if stored > most:
            notes_here.append(
                f"by the times of the waves, tubes would store {stored / C.value:.0%} of the compliance; they are made "
                f"shorter and store {_MOST:.0%}."
            )
            shorter = [replace(tube, time=tube.time * most / stored) for tube in tubes]
            walls = made(shorter, c.value, area, usual)
        peripheral = C.value - min(stored, most)
        ends = {wall.section.name: windkessel(wall, walls, R.value, peripheral) for wall in walls if wall.section.end}
        return file_of((R, C, Z, *delays.values(), echo, c, radius), walls, ends, notes_here)

    def of_layout(tubes: Sequence[Section], before: Fitted | None = None) -> _Layout | None:
        made_with = [with_compliance(C, tubes) for C in compliances(beats, channel, P_venous, R.value)]
        models = [(file, _read(file, beats)) for file in made_with]
        file, network = min(models, key=lambda each: _rms(beats, each[1], channel))
        fit = fitted(data, network, bool(distances), tubes, before)
        return None if fit is None else _Layout(tubes, network, file, fit)

    data, upstream = Data(beats, channel), parents(paths, root, times)
    plain = layouts(beats, root, upstream, times, echo.value / 2.0, area, bool(paths))
    best = min(filter(None, map(of_layout, plain)), key=lambda each: each.fit.price)
    for _ in range(_BRANCHES):
        tubes = with_side_branch(best.tubes, root)
        other = of_layout(tubes, best.fit) if tubes else None
        if other is None or other.fit.price >= best.fit.price:
            break
        best = other
    fit, lag = delayed(data, best.network, bool(distances), best.tubes, best.fit)
    return _model(best.file.adjusted(fit, lag, channel), beats)


@dataclass(frozen=True)
class _Layout:
    """Tubes, their network as estimated, the contents of its file, and the fit."""

    tubes: Sequence[Section]
    network: Network
    file: ModelFile
    fit: Fitted


def _read(file: ModelFile, beats: Beats) -> Network:
    return loads(str(file), f"first model of {beats.source}")


def _model(file: ModelFile, beats: Beats) -> FirstModel:
    """The model of a file."""
    network = _read(file, beats)
    beat = _solved(beats, network)
    found, notes = (beat, file.notes) if beat else (_small_waves(beats, network), (*file.notes, _NO_BEAT))
    comparison = tuple(_compared(beats, name, found[name]) for name in beats.values if name in found)
    notes = *notes, *filter(None, map(means_apart, comparison)), *network_doubts(network)
    return FirstModel(network, str(file), file.found, comparison, notes)


def _speed_and_area(
    beats: Beats,
    channel: str,
    Z: FirstEstimate,
    usual: Typical,
    delays: Mapping[str, FirstEstimate],
    distances: Mapping[str, float],
) -> tuple[FirstEstimate, float, FirstEstimate]:
    """Mean wave speed c of a tube, area [m²] at the start of one with all of the flow, and the radius there, with
    Z_c = ρ c/A of the start.

    A distance and a delay determine c; a measured radius determines A; the other follows from Z_c. Without either, ln c
    and ln A are shifted from typical values in proportion to their variances until they give Z_c.
    """
    unknown = sorted(set(distances) - set(delays))
    if unknown:
        raise InputError(
            f"--distance: {unknown[0]} is no site beside the root; the record has {', '.join(delays) or 'none'}."
        )
    rho, measured, local = Fluid().rho, radius_at(beats, channel), speeds(beats, channel, Z)
    if distances:
        site = max(distances, key=lambda name: distances[name])
        c = distances[site] / delays[site].value
        error = float(np.hypot(_DISTANCE, delays[site].error))
        speed = FirstEstimate("wave speed c", c, "m/s", error, f"the distance to {site} over the delay")
        at_root = c / mean_speed(1.0)
        how, R_error = "Z_c and c", float(np.hypot(error, Z.error)) / 2.0
    elif local and local.agree:
        error = float(np.hypot(Z.error, 2.0 * _MEASURED))
        at_root = local.by_flow
        speed = FirstEstimate("wave speed c", mean_speed(at_root), "m/s", error, f"Z_c and mean {measured}")
        how, R_error = f"mean of {measured}", _MEASURED
    else:
        off = float(np.log(Z.value * np.pi * usual.R**2 / (rho * usual.c)))
        part = _SPEED**2 / (_SPEED**2 + (2.0 * _RADIUS) ** 2)
        at_root = usual.c * float(np.exp(part * off))
        speed = FirstEstimate("wave speed c", mean_speed(at_root), "m/s", _SPEED, "Z_c and a typical aorta")
        how, R_error = f"Z_c and a typical aorta ({1e3 * usual.R:.3g} mm, {usual.c:.3g} m/s)", _RADIUS
    area = rho * at_root / Z.value
    return (
        speed,
        area,
        FirstEstimate("radius of the root at the mean pressure", float(np.sqrt(area / np.pi)), "m", R_error, how),
    )


def _inflow(beats: Beats) -> Array:
    """Complex harmonics of the mean inflow above its noise : (K+1,) [m³/s]."""
    kept = heard(beats, INFLOW, _FINEST)
    X = coefficients(beats.mean(INFLOW))[: kept[-1] + 1]
    return np.where(np.isin(np.arange(len(X)), [0, *kept]), X, 0.0)


def _small_waves(beats: Beats, network: Network) -> Mapping[str, Array]:
    """The outputs of a network under the measured inflow, linearised at its mean pressure : (n,) each, by name."""
    return waveforms(network, resample(beats.mean(INFLOW), _SAMPLES), beats.T)


def _rms(beats: Beats, network: Network, channel: str) -> float:
    """The rms [SI] that small waves leave of a channel."""
    return _compared(beats, channel, _small_waves(beats, network)[channel]).rms


def _solved(beats: Beats, network: Network) -> Mapping[str, Array]:
    """The outputs of the file's own beat : (n,) each, by name; none if it is not found."""
    names = [name for name in beats.values if name != INFLOW and name in network.output_units()]
    X = np.full((_HARMONICS + 1, len(names)), np.nan + 0j)
    with suppress(InputError):  # no steady state under the mean flow
        X = beat_harmonics(network, names, _HARMONICS)[0]
    if np.isnan(X).any():
        return {}
    return dict(zip(names, np.fft.irfft(X, _SAMPLES, axis=0, norm="forward").T, strict=True))


def _compared(beats: Beats, name: str, y: Array) -> ChannelComparison:
    """The mean beat of a channel against that of a model : (n,)."""
    x = resample(beats.mean(name), _SAMPLES)
    mean, pulse = ((float(measure(x)), float(measure(y))) for measure in (np.mean, np.ptp))
    return ChannelComparison(name, mean, pulse, float(np.sqrt(np.mean((x - y) ** 2))))
