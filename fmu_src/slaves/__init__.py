"""The pythonfmu slaves."""
