"""Sensitivity studies: a network or an FMU over thousands of parameter sets."""
