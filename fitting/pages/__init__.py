"""What reports look like: style, figures, tables and page templates."""
