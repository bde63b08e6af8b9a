"""Landmarks of the body, anatomical frames of its segments, and joint angles, as the ISB defines them (Wu 2005)."""
