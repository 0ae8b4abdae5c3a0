"""The periodic beat: harmonic balance, start states near it, and acceleration of beats."""
