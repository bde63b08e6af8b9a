"""The page, tables and figures of a study of curls (thesis 8.3, figure 8.5)."""
