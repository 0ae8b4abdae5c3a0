"""Channels of aligned beats: harmonics, noise and inflow."""
