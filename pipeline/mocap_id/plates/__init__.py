"""Checks of force plates: which plates are under the feet or a chair, where they are, and when they fail.

Sign convention: all forces are those of the ground (or chair) on the body, not of the body on the plate.

Many functions have these arguments. A docstring describes an argument only if it differs from this list.

positions : (F, M, 3) array
    Markers, lab axes with Z up, m; NaN where not visible.
rate : float
    Frames per second.
samples : sequence of PlateSamples
    Wrench of every plate at the marker times; NaN where missing.
"""
