"""The variables of an FMU and their description."""
