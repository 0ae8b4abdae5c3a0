"""Forward models: bench, network, and the simulations that they share."""
