"""The source map: where a network lacks something."""
