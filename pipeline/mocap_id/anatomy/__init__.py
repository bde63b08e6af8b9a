"""Landmarks of the body, frames of its segments, and the angles of the field (ISB: Wu 2005)."""
