"""Files of states and results, written whole or not at all, and how a process ends."""
