"""Networks in other formats: openBF's YAML, and tables with one row per vessel.

An importer makes the sections of a network file: dicts of texts with units, as in TOML.
"""
