"""Sizes of hidden effects: fixed ranges, from hardly visible to typical or above, d' about 1 to 1000 at 40 dB."""

from __future__ import annotations

# smallest and largest size (see Effect), and the share of cases with the opposite sign
BENCH_SIZES: dict[str, tuple[float, float, float]] = {
    "wall_viscosity": (3e-5, 0.03, 0.0),
    "nonlinear_wall_viscosity": (0.02, 1.4, 0.6),
    "nonlinear_elasticity": (0.1, 5.0, 0.0),
    "stress_relaxation": (5e-4, 0.3, 0.0),
    "external_pressure": (300.0, 1.5e4, 0.5),
    "channel_lag": (1e-4, 1e-2, 0.0),
    "channel_gain": (1e-3, 0.2, 0.5),
    "channel_offset": (0.02, 2.0, 0.5),
    "catheter_resonance": (0.01, 0.1, 0.0),
    "fractional_viscosity": (0.01, 1.0, 0.0),
    "cubic_rate": (0.02, 2.0, 0.0),
    "strain_viscosity": (0.3, 30.0, 0.0),
    "coulomb": (1e-5, 3e-3, 0.0),
    "varying_tone": (1e-3, 0.05, 0.0),
}
NETWORK_SIZES: dict[str, tuple[float, float, float]] = {
    "wall_viscosity": (1e-5, 0.02, 0.0),
    "nonlinear_wall_viscosity": (5e-3, 1.4, 0.6),
    "nonlinear_elasticity": (0.02, 5.0, 0.0),
    "stress_relaxation": (2e-4, 0.1, 0.0),
    "external_pressure": (1.0, 1500.0, 0.5),
    "wall_stiffness": (3e-4, 0.5, 0.5),
    "taper": (3e-3, 0.4, 0.7),
    "fluid_friction": (3e-3, 2.0, 0.0),
    "velocity_profile": (0.01, 0.33, 0.0),
    "unsteady_friction": (3e-3, 1.0, 0.0),
    "terminal_reflection": (3e-4, 0.4, 0.5),
    "terminal_compliance": (1e-4, 0.2, 0.0),
    "side_branch": (2e-3, 0.3, 0.0),
    "stenosis": (0.05, 100.0, 0.0),
    "junction_loss": (0.01, 1.0, 0.0),
    "channel_lag": (1e-5, 0.01, 0.0),
    "channel_gain": (3e-4, 0.1, 0.5),
    "channel_offset": (3e-4, 0.2, 0.5),
    "catheter_resonance": (7e-3, 0.07, 0.0),
    "fractional_viscosity": (0.01, 1.0, 0.0),
    "cubic_rate": (5e-3, 0.5, 0.0),
    "strain_viscosity": (0.1, 20.0, 0.0),
    "coulomb": (1e-6, 3e-4, 0.0),
    "varying_tone": (1e-3, 0.05, 0.0),
    "swinging_outlet": (1e-3, 0.3, 0.0),
    "inflow_bent": (1e-3, 0.2, 0.5),
    "inflow_rectified": (5e-3, 1.0, 0.0),
}
SOFTEST = 0.6  # of E, that a softer wall lacks
POSITIVE_RATIO = 0.5  # φ_NL/φ0 of the positive sign ends here, as in the paper: beyond, the upstroke stiffens at once

RADIUS_GAIN = 0.01  # a radius pulsates by a few per cent of its mean, so that a gain shows a hundred times more
