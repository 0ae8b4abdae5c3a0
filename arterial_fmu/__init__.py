"""The command ``arterial-fmu``: the door to everything else, which imports nothing from it."""
