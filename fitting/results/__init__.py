"""The results of fits on disk: estimates, parameter sets and their provenance."""
