"""The weights of a network record: the noise of its channels, and of the inflow through the response of a member."""

from __future__ import annotations

from collections.abc import Mapping

from ...records.alignment.beats import Beats
from ...records.channels.noise import Target, target
from ...records.channels.variability import BeatVariation
from ..fit import Array, Member
from ..hypothesis import rewired
from ..unknown import parameter_values
from ..zeros import apart
from .bench_observation import meter, sense
from .simulator import Simulator, linear_response, varying


def weighted(
    beats: Beats, simulator: Simulator, member: Member, error: Array, known: BeatVariation | None = None,
    known_at: Mapping[str, float] | None = None,
) -> tuple[Target, Array, BeatVariation | None, Mapping[str, float]]:  # fmt: skip
    """The weighted data of a record at a member, the response (K+1, m) to the inflow's noise, and that to beats that
    differ, with its parameters.

    error : (K+1, m) of the model. known : the last response to beats that differ, with the parameters known_at, kept
    for a member with effects. How much of the changes is noise of the meter does not depend on the effect that is
    tested: if one that the mean pressure refutes called them noise, no hypothesis would have to fit the mean.
    """
    names, T, K = simulator.names, simulator.T, simulator.K
    network = rewired(simulator.network, member.terms)
    values, _ = apart(parameter_values(member.unknowns, network, member.x), network)
    at = {name: float(value) for name, value in values.items()}
    H = sense(member, names, linear_response(network, names, T, K, at), T, means=False)
    H = H / meter(member, len(H), T)[0][:, None]  # a slow meter hides more noise of the true inflow
    variation, variation_at = known, known_at or {}
    if known is None or not member.terms:
        variation, variation_at = varying(beats, network, names, K, at), at
    return target(beats, names, H, error, variation), H[: K + 1], variation, variation_at
