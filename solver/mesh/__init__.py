"""Where things are: nodes, elements, the parts of a state vector, and the sources that act there."""
