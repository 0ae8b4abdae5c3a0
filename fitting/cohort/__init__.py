"""Cohorts: individual wall fits and their joint statistics."""
