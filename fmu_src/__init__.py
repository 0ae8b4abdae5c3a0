"""The FMI side: variable table, co-simulation logic, slave, modelDescription, and a driver that runs an FMU through fmpy."""

__version__ = "0.1.0"
