"""The importer's side: run an FMU, and check whether it runs here."""
