"""Reaches of one arm: ranges of the joints, reachable volume and surface, heights and targets (thesis 7.2)."""
