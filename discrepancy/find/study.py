"""A study: a record, the network it is compared with, and the beats that no fit uses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtrc

from fitting.first.doubts import lost_on_the_way, means_along
from fitting.first.estimates import stroke
from fitting.first.fitted import accuracy
from fitting.first.options import by_stroke
from fitting.first.tubes import TAPERED
from fitting.inference.forward import Single
from fitting.inference.hypothesis import Calibrated, PlacedEffect, candidates
from fitting.inference.models.bench import bench
from fitting.inference.models.network_record import network_problem
from fitting.inference.runs import Runs
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.channels.noise import seam_note
from fitting.records.read.record import Record
from fitting.records.read.sensors import UnusableRecord
from fitting.wall.elastic_law import MISFIT
from fitting.wall.site_fit import fit
from solver import NonPhysicalState, NotPeriodic
from solver.errors import InputError
from solver.laws.catalogue import zero_of
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .. import thresholds

FEWEST_BEATS = round(2 / thresholds.HELD_OUT)  # so that two beats are held out, the fewest with a scatter
_SERVES = 0.5  # of the samples of the channel's best beat: with fewer, a beat is dropped
_SCATTER = 1e-7  # standard deviation over pulse: the rounding of a 24 bit converter, below the noise of any sensor


class Unusable(UnusableRecord):
    """The record cannot be compared with this model; the message says why and what to do."""

    sentence = "This record cannot be used with this model."


class Unjudged(Unusable):
    """The time limit was over before the record could be compared."""

    sentence = "The time limit was over before this record was judged."


@dataclass(frozen=True)
class Study:
    """fitted, held_out : beats. problem : of the fitted ones. warnings : sentences on the record. losses : of mean
    pressure [Pa] by channel under a first model, if they are larger than in arteries."""

    network: Network
    fitted: Beats
    held_out: Beats
    problem: Single
    terms: tuple[PlacedEffect, ...]
    warnings: tuple[str, ...] = ()
    losses: Mapping[str, float] = field(default_factory=dict)

    @property
    def site(self) -> str | None:
        """The only compared artery, if only its P and R were measured; otherwise None."""
        return self.problem.site


def prepare(
    record: Record,
    network: Network,
    period: float | None = None,
    runs: Runs | None = None,
    prior: Calibrated | None = None,
) -> Study:
    """Cut the record into beats, hold out the last quarter, and set up the comparison.

    prior : posterior of a calibration of the network.
    Raises Unusable if the record cannot be used with this network.
    """
    try:
        beats = align(record, period)
        fitted, kept, warnings = parts(beats)
        losses: dict[str, float] = {}
        if INFLOW in record.channels:
            whole = network_problem(fitted, network, channels(record, network), runs, prior, accuracy(network))
            problem: Single = whole
            doubts, losses = _means_along(beats, network)
            warnings += *seam_note(fitted, whole.signals, whole.variation), *doubts
        else:
            site = bench_site(record, network)
            problem = bench(fitted, network, site)
            warnings += other_law(fitted, network, site)
        sensors = problem.signals if problem.site else (*problem.signals, INFLOW)
        terms = candidates(network, sensors, problem.site, prior.free if prior else ())
        return Study(network, fitted, kept, problem, terms, warnings, losses)
    except Unusable:
        raise
    except (InputError, NonPhysicalState, NotPeriodic) as error:
        raise Unusable(str(error)) from None


def _means_along(beats: Beats, network: Network) -> tuple[tuple[str, ...], dict[str, float]]:
    """Doubts about the zeros of pressures under a first model, whose radii may compensate a wrong zero; and the losses
    of mean pressure [Pa] that are too large for an artery, by channel. Known zeros are subtracted; an effect that was
    added to the file may be the loss."""
    at_inlet = ["inlet", *(s.name for s in network.sites if s.segment == network.inlet.segment and s.position == 0.0)]
    pressures = [name for name in beats.values if name.endswith(".P") and name.count(".") == 1]
    root, *more = [name for name in pressures if name.removesuffix(".P") in at_inlet] or [""]
    if not (root and accuracy(network)):
        return (), {}
    means = {name: float(beats.mean(name).mean()) - zero_of(network, name) for name in pressures if name not in more}
    mass = by_stroke(stroke(beats)).mass
    terms = [*(each.terms for each in network.segments), *(each.terms for each in network.junctions)]
    added = any(each.keys() - {TAPERED} for each in terms)
    return tuple(means_along(means, root, mass)), {} if added else lost_on_the_way(means, root, mass)


def parts(beats: Beats) -> tuple[Beats, Beats, tuple[str, ...]]:
    """The fitted beats, the held-out last quarter, and warnings.

    Beats with hardly a sample of some channel are dropped. Raises Unusable if too few remain, if a channel has no
    sample at some phase in a part, or if all its beats are the same.
    """
    least = FEWEST_BEATS
    if beats.n_beats < least:
        left_out = "".join(f" Note: {text}" for text in beats.variable.said[-1:]) if beats.variable else ""
        raise Unusable(
            f"{beats.source}: {beats.n_beats} beats are too few; record at least {least}, so that some can be kept "
            f"apart to judge by.{left_out}"
        )
    there = {channel: (~np.isnan(values)).mean(axis=1) for channel, values in beats.values.items()}
    serves = {channel: share >= _SERVES * share.max() for channel, share in there.items()}
    whole = np.flatnonzero(np.all(list(serves.values()), axis=0))
    if len(whole) < least:
        worst = min(serves, key=lambda channel: int(serves[channel].sum()))
        raise Unusable(
            f"{beats.source}: {worst} lacks {1.0 - there[worst].mean():.0%} of its samples, and only {len(whole)} of "
            f"{beats.n_beats} beats have all channels, which is too few (at least {least}); read the part where "
            f"all were measured with --part, record more beats, or leave the channel out."
        )
    n_held_out = max(2, math.floor(thresholds.HELD_OUT * len(whole)))
    fitted, kept = beats.select(whole[:-n_held_out]), beats.select(whole[-n_held_out:])
    for part, label in ((fitted, "fitted"), (kept, "kept apart to judge by")):
        for channel, values in part.values.items():
            if lost := float(np.isnan(values).all(axis=0).mean()):  # phases without a sample in any beat
                raise Unusable(
                    f"{part.source}: {channel} lacks {1.0 - there[channel].mean():.0%} of its samples, and the "
                    f"{part.n_beats} beats that are {label} have none of it over {lost:.0%} of a beat; read the part "
                    f"where it was measured with --part, record more beats, or leave the channel out."
                )
    check_scatter(fitted)
    if len(whole) == beats.n_beats:
        return fitted, kept, fitted.warnings
    gaps = ", ".join(channel for channel, serving in serves.items() if not serving.all())
    left_out = f"{beats.n_beats - len(whole)} of {beats.n_beats} beats were left out for the gaps of {gaps}."
    return fitted, kept, (*beats.warnings, left_out)


def check_scatter(beats: Beats) -> None:
    """Raise Unusable if all beats of a channel are the same: there is no noise to judge a disagreement by.

    The inflow is exempt: it may be the command of a pump, which is known without noise.
    """
    for channel in beats.values:
        alike = beats.noise(channel) / float(np.ptp(beats.mean(channel)))
        if channel != INFLOW and not alike > _SCATTER:
            raise Unusable(
                f"{beats.source}: the beats of {channel} are all the same to {max(alike, 1e-16):.0e} of its pulse, so "
                f"there is no scatter to judge by; give the record as it was measured, not an averaged beat that is "
                f"repeated, nor a simulation without noise."
            )


def channels(record: Record, network: Network) -> tuple[str, ...]:
    """The recorded outputs of the network. Raises Unusable if there is none, or one that the network does not have."""
    known = network.output_units()
    names = tuple(n for n in record.channels if n != INFLOW)
    foreign = [n for n in names if n not in known]
    if foreign or not names:
        sites = ", ".join(site.name for site in network.sites)
        mismatch = f"its channel {foreign[0]} is no output of" if foreign else f"it has no channel but {INFLOW} of"
        raise Unusable(
            f"{record.path}: {mismatch} network {network.name} (sites {sites}); use the network that was recorded, add "
            f"the site to it, or leave the channel out."
        )
    return names


def bench_site(record: Record, network: Network) -> str:
    """The segment of a bench record, which has exactly its P and R. Raises Unusable for any other record."""
    sites = list(dict.fromkeys(n.rpartition(".")[0] for n in record.channels))
    lacks = [n for n in (f"{sites[0]}.P", f"{sites[0]}.R") if n not in record.channels]
    if len(sites) != 1 or lacks:
        instead = f"add {' and '.join(lacks)}" if len(sites) == 1 else "give P and R of one site alone"
        raise Unusable(
            f"{record.path}: it has {', '.join(record.channels)}, but no {INFLOW}; add {INFLOW} to compare it with the "
            f"network, or {instead} to compare one artery with its wall."
        )
    segments = {site.name: site.segment for site in network.sites}
    segment, known = segments.get(sites[0], sites[0]), [s.name for s in network.segments]
    if segment not in known or segment != sites[0]:
        raise Unusable(
            f"{record.path}: network {network.name} has no segment {sites[0]}; name the channels after the segment "
            f"that was measured ({', '.join(known)})."
        )
    return sites[0]


def other_law(beats: Beats, network: Network, site: str) -> tuple[str, ...]:
    """A warning if the evidence decides for another elastic law than the file's and a wall of that law explains P and R
    of a site within their noise (:func:`fitting.wall.site_fit.evidence`); otherwise empty.

    The wrong law is decided in 1 of 1600 recordings (measured: docs/fitting.md).
    """
    name = next((s.segment for s in network.sites if s.name == site), site)
    try:
        found = fit(beats, site, network.segment(name).h, eta=network.eta)
    except InputError:  # no wall of either law fits
        return ()
    law, own, weights = found.model.elastic, network.elastic_law, found.evidence
    decided = law != own and weights is not None and weights.decided
    if not decided or chdtrc(found.dof, found.chi2) < MISFIT:
        return ()
    return (
        f"{site}: the file's elastic law is {own}, but a wall of the {law} law explains P and R within their noise by "
        f"itself ({found.law}): what is named may only stand for the law; set "
        f'elastic_law = "{law}" in the file, fit its wall anew, and compare.',
    )
