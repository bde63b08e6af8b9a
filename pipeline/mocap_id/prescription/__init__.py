"""What a person can reach, and the spring that gives most of it back (thesis chapter 7); numpy, scipy, numba."""
