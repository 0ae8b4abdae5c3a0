"""Intervals and identifiability of fitted numbers."""
