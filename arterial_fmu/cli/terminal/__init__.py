"""Terminal, options and progress, shared by all commands."""
