"""The page, tables and figures of a robot study (thesis ch. 5)."""
