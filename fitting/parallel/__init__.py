"""Processes, threads and clusters that share independent tasks."""
