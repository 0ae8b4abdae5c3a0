"""The inflow's name, for the modules that still look for it here; it lives in :mod:`solver.units`."""

from solver.units import INFLOW as INFLOW
