"""Studies: a network or an FMU over thousands of parameter sets; which parameter matters where, and by how much."""
