"""A record cut into beats."""
