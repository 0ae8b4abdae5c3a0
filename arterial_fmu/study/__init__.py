"""Sensitivity studies: a network over thousands of parameter sets."""
