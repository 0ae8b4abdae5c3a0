"""Show that the gap shrinks: free runs of the FMU. A name that held-out beats do not confirm is withdrawn."""
