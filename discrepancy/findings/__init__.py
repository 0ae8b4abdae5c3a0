"""The findings of a study as plain frozen data."""
