"""A study: a record, the network that it is compared with, and what of the record is kept from every fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fitting.beats import Beats, align
from fitting.records import Record
from fitting.units import INFLOW
from solver.network import Network
from solver.report import output_variables

from . import thresholds
from .bench import Bench, bench
from .name import Naming, name
from .network import NetworkProblem, network_problem
from .simulator import Tell
from .terms import Term, candidates


class Unusable(ValueError):
    """The record cannot be compared with this model; the message says why and what to do."""


@dataclass(frozen=True)
class Study:
    """kind : "bench" (P and R of one ``site``) or "network". fitted, held_out : beats. problem : of the fitted ones."""

    kind: str
    site: str | None
    network: Network
    fitted: Beats
    held_out: Beats
    problem: Bench | NetworkProblem
    terms: tuple[Term, ...]


def prepare(record: Record, network: Network, period: float | None = None, tell: Tell = lambda _: None) -> Study:
    """Cut the record into beats, keep the last quarter of them apart, and set up the comparison.

    Raises Unusable if the record cannot be used with this network.
    """
    try:
        beats = align(record, period)
    except ValueError as error:
        raise Unusable(str(error)) from None
    if beats.n_beats < thresholds.FEWEST_BEATS:
        raise Unusable(
            f"{record.path}: {beats.n_beats} beats are too few; record at least {thresholds.FEWEST_BEATS}, so that "
            f"some can be kept apart to judge by."
        )
    held = max(2, math.floor(thresholds.HELD_OUT * beats.n_beats))
    fitted, kept = beats.select(range(beats.n_beats - held)), beats.select(range(beats.n_beats - held, beats.n_beats))
    try:
        if INFLOW in record.channels:
            problem: Bench | NetworkProblem = network_problem(fitted, network, channels(record, network), tell)
            terms = candidates(network, problem.signals)
            return Study("network", None, network, fitted, kept, problem, terms)
        site = bench_site(record, network)
        problem = bench(fitted, network, site)
        return Study("bench", site, network, fitted, kept, problem, candidates(network, problem.signals, site))
    except Unusable:
        raise
    except (ValueError, ArithmeticError) as error:
        raise Unusable(str(error)) from None


def judge(
    record: Record, network: Network, period: float | None = None, tell: Tell = lambda _: None
) -> tuple[Study, Naming]:
    """Find and name, without FMU or files: what the bank of hidden effects calls. Raises Unusable."""
    study = prepare(record, network, period, tell)
    return study, name(study.problem, study.terms)


def channels(record: Record, network: Network) -> tuple[str, ...]:
    """The recorded outputs of the network. Raises Unusable if there is none, or one that the network has not."""
    known = output_variables(network)[0]
    names = tuple(n for n in record.channels if n != INFLOW)
    foreign = [n for n in names if n not in known]
    if foreign or not names:
        sites = ", ".join(site.name for site in network.sites)
        what = f"its channel {foreign[0]} is no output of" if foreign else f"it has no channel but {INFLOW} of"
        raise Unusable(
            f"{record.path}: {what} network {network.name} (sites {sites}); use the network that was recorded, add "
            f"the site to it, or leave the channel out."
        )
    return names


def bench_site(record: Record, network: Network) -> str:
    """The segment whose P and R a bench record holds. Raises Unusable if it holds anything else."""
    sites = list(dict.fromkeys(n.rpartition(".")[0] for n in record.channels))
    both = [s for s in sites if {f"{s}.P", f"{s}.R"} <= set(record.channels)]
    if len(sites) != 1 or not both:
        raise Unusable(
            f"{record.path}: it has no {INFLOW}, and not P and R of one site alone ({', '.join(record.channels)}); "
            f"record the inflow for a comparison with a network, or P and R of one site for one with its wall."
        )
    segments = {site.name: site.segment for site in network.sites}
    segment = segments.get(sites[0], sites[0])
    if segment not in [s.name for s in network.segments] or segment != sites[0]:
        raise Unusable(
            f"{record.path}: network {network.name} has no segment {sites[0]}; name the channels after the segment "
            f"that was measured ({', '.join(s.name for s in network.segments)})."
        )
    return sites[0]
