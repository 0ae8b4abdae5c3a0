"""The scheme's code recorded as array programs, which the compiled engine runs (:mod:`~solver.tracing.native`)."""
