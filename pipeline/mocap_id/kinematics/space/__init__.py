"""Chains in space from marker trajectories: rigid bodies, segments and joints (9.1)."""
