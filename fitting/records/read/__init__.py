"""Files of laboratories as records: named channels in SI on a uniform time axis."""
