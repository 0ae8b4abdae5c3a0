"""Show that the gap shrinks: free runs of the FMU."""
