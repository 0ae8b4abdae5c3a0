"""Prepare a network record: the problem of its beats, with the error of the solver and the noise of its channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.network.description import Network
from solver.periodic.harmonic_balance import NoSteadyState
from solver.quantities.units import INFLOW

from ...records.alignment.beats import Beats
from ...records.channels.inflow import inflow
from ...records.channels.noise import check_flow_driven, harmonics_above_noise, pulses, solver_error
from ...records.limits import MAX_HARMONICS
from ..fit import Member
from ..hypothesis import Calibrated, possible
from ..runs import Runs
from .network import NetworkProblem
from .simulator import HARMONICS_BEYOND, Simulator, started

STEP_DT = 1e-3  # s, if there is no harmonic balance
_FEWEST = 80  # steps in a beat, at least
_REPEATS = 3.0  # times the tolerance of the steps: accepted difference of beats after more than two


def network_problem(
    beats: Beats, network: Network, names: Sequence[str] | None = None, runs: Runs | None = None,
    prior: Calibrated | None = None, accuracy: float = 0.0,
) -> NetworkProblem:  # fmt: skip
    """The problem of a record with inlet.Q and some outputs of the network. prior : from a calibration. accuracy : the
    stated error of the network at every harmonic, as a fraction of a channel's pulsation.

    Raises ValueError if they do not match, or if the network breaks down with this inflow.
    """
    check_flow_driven(network)
    runs, known = runs or Runs(), network.output_units()
    chosen = tuple(names or (n for n in beats.values if n != INFLOW and n in known))
    K = harmonics_above_noise(beats, chosen, min(MAX_HARMONICS, (beats.N - 1) // 2))
    settings = Settings(dt=min(STEP_DT, beats.T / max(_FEWEST, 4 * K)), tolerance=3e-5)
    drive = inflow(beats, settings.dt, network)
    time = beats.T * np.arange(200) / 200.0
    start = float(time[np.argmin(np.abs(drive(time)))])
    simulator = Simulator(network, drive, beats.T, chosen, K, settings, start, resolved=_REPEATS * settings.tolerance,
                          beyond=HARMONICS_BEYOND)  # fmt: skip
    try:
        simulator, X = started(simulator, runs)
    except NoSteadyState as why:
        raise InputError(
            f"{INFLOW}: {1e6 * drive(time).mean():.4g} mL/s on average is more than the arteries of {network.name} can "
            f"carry; check the unit of its column, or the network."
        ) from why
    error = solver_error(X, started(simulator.finer(), runs)[1], pulses(beats, chosen))
    return NetworkProblem.of(beats, simulator, Member((), (), np.zeros(0)), error, possible(network, prior),
                             accuracy=accuracy)  # fmt: skip
