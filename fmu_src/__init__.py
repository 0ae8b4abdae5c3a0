"""The FMI side: variable table, co-simulation, slave, modelDescription and documents; a driver that runs an FMU."""

__version__ = "0.2.0"
