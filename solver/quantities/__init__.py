"""Numbers with units: fields of dataclasses, units, numbers in files and in sentences."""
