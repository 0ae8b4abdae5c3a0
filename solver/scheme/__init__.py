"""The scheme: from a network to a frozen :class:`~solver.scheme.model.Model`, and from a state to the next."""
