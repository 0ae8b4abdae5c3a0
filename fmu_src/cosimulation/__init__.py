"""The arteries as a co-simulation component, without FMI."""
