"""Plan measurements: sensors and states that would separate effects."""
