"""Physiological indices of a calibrated network, site by site, with 95 % intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.network.coefficients import coefficients
from solver.network.description import Network

from ..inference.joint.calibration import STEP
from ..inference.models.simulator import HARMONICS_BEYOND, Simulator
from ..inference.runs import Runs
from ..inference.unknown import Array, finite_steps, parameter_values, split_zeros
from ..parallel.threads import single_threaded
from ..records.alignment.beats import Beats
from ..records.channels.inflow import inflow
from ..records.limits import MAX_HARMONICS
from ..results.estimate import Estimate
from ..wall.indices import estimates, loop_area, measured_loss, of_wall
from .network_calibration import Calibration

_TOLERANCE = 1e-6  # of the periodic beat
_SAMPLES = 8 * MAX_HARMONICS  # of a beat


@single_threaded
def network_indices(
    calibration: Calibration, network: Network, beats: Beats, settings: Settings | None = None
) -> dict[str, dict[str, Estimate]]:
    """The indices of :func:`fitting.wall.indices.indices` at every site of a calibrated network, by site and name.

    network : the calibrated one, with its values before the calibration. beats : the record, whose inflow drives it.
    settings : of the solver, default dt 1 ms. E_inc, distensibility, compliance and wave_velocity are those of the
    segment's elastic law at the site's mean radius; loss = ∮ P dA and loss_ratio are of the simulated beat.
    E_inc uses the unstressed thickness h, as the wall law does. If the record has P and R of the site, loss_measured is
    the loss of its mean beats.

    One batch of beats gives all of them at x and a small step away along each unknown; intervals are
    G C Gᵀ (delta method) with the calibration's covariance C and Student's t. They include the uncertainty of the
    unknowns only: parameters that were not fitted, h among them, count as exact.
    Raises ValueError for a network other than the calibrated one, or a record without inflow.
    """
    _check_network(calibration, network)
    steps = finite_steps(calibration.unknowns, calibration.x, STEP)
    x = np.concatenate([calibration.x[None], calibration.x + np.diag(steps)])
    values = indices_at(x, calibration, network, beats, settings)
    slope = (values[1:] - values[0]) / steps[:, None, None]
    half = calibration.quantile * np.sqrt(np.einsum("pis,pq,qis->is", slope, calibration.covariance, slope))
    result = {site.name: estimates(values[0, i], half[i]) for i, site in enumerate(network.sites)}
    for name, found in result.items():
        if {f"{name}.P", f"{name}.R"} <= set(beats.values):
            found["loss_measured"] = measured_loss(beats, name)
    return result


def indices_at(
    x: Array, calibration: Calibration, network: Network, beats: Beats, settings: Settings | None = None
) -> Array:
    """The indices of ``indices.OF_LAW`` at every site for unknowns x : (B, p) -> (B, n_sites, 7), in one batch."""
    settings = settings or Settings()
    parameters, _ = split_zeros(parameter_values(calibration.unknowns, network, x), network)
    parameters = parameters or {"fluid.rho": np.full(len(x), network.fluid.rho)}  # none moves, in so many members
    outputs = tuple(f"{site.name}.{kind}" for kind in "PR" for site in network.sites)
    alone = replace(network, channels=())  # outputs of the arteries, without sensors
    simulator = Simulator(alone, inflow(beats, settings.dt, network), beats.T, outputs, MAX_HARMONICS, settings,
                          tolerance=_TOLERANCE, beyond=HARMONICS_BEYOND)  # fmt: skip
    X = simulator.coefficients(alone, parameters, Runs())
    if np.isnan(X).any():  # the balance with the K of the search was found
        X = replace(simulator, K=calibration.harmonics).coefficients(alone, parameters, Runs())
    waves = np.fft.irfft(X, _SAMPLES, axis=1, norm="forward").swapaxes(1, 2)
    P, R = np.split(waves, 2, axis=1)
    names = [segment.name for segment in network.segments]
    wall = coefficients(network, parameters).wall.at(np.array([names.index(s.segment) for s in network.sites]))
    A = np.pi * R * R
    A_mean = np.pi * R.mean(axis=-1) ** 2
    return of_wall(wall, A_mean, loop_area(P, A), (A.min(axis=-1), A.max(axis=-1)))


def _check_network(calibration: Calibration, network: Network) -> None:
    """Raise ValueError unless the network has its values from before the calibration, to which x is relative."""
    given = network.parameters() | {
        name: float(value) for name, value in parameter_values(calibration.unknowns, network, calibration.x).items()
    }
    laws = {"network.elastic_law": network.elastic_law, "network.viscous_law": network.viscous_law}
    if laws != calibration.laws:
        raise InputError(
            f"network {network.name}: its laws ({', '.join(laws.values())}) are not those of the calibration "
            f"({', '.join(calibration.laws.values())}); give the network that was calibrated."
        )
    for name, value in {**calibration.others, **calibration.values}.items():
        if not np.isclose(given.get(name, np.nan), value, rtol=1e-12, atol=0.0):
            raise InputError(
                f"network {network.name}: with it, {name} of the calibration of {calibration.network} is "
                f"{given.get(name, np.nan):g} instead of {value:g}; give the network with the values it was calibrated "
                "from."
            )
