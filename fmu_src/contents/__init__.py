"""The contents of each FMU and of the system of three."""
