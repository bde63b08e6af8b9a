"""Marker trajectories to a chain in space: rigid bodies, segments, joints (9.1)."""
