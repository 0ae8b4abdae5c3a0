"""A first model from a recording: estimates from its mean beat, and the smallest network with its sites."""
