"""The documents inside an FMU."""
