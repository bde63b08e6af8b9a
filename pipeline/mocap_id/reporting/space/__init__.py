"""Report of a trial in space: summary, tables, figures and player."""
