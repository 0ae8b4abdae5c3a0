"""Name the missing effect: candidates, their evidence, and the verdict."""
