"""Pneumatic cylinders as springs of a joint (thesis 8.1, 9.5, 9.6)."""
