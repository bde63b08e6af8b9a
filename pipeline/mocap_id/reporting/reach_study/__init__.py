"""The page, tables and figures of a reach study (thesis table 7.1, figures 7.3 and 7.4)."""
