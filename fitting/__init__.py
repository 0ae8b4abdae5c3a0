"""Fits of measured pressure and radius, which give a parameter set, and its check against the FMU."""
