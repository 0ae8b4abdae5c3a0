"""From measured pressure and radius to a parameter set that the FMU confirms."""
