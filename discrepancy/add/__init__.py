"""Add what no effect of the catalogue explains: learned laws, tables of sources."""
