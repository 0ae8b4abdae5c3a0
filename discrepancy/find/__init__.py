"""Find where model and record disagree."""
