"""Add terms beyond the effects of the catalogue: learned laws, tables of sources."""
