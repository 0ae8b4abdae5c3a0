"""What was measured: recordings, their beats, and the noise of both."""
