"""Landmarks of the body, frames of its segments and joint angles, as the ISB defines them (Wu 2005), and its skin."""
