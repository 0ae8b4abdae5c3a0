"""The presentation of reports: style, figures, tables and page templates."""
