"""Chains from marker trajectories, in the plane and (``space``) in space: bodies, segments, joints (3.2.3 to 3.2.5)."""
