"""From data to numbers: unknowns with priors, forward models, searches, fits with intervals, what data determine."""
