"""FMUs that need no Python."""
