"""Figures of reachable workspaces and of prescriptions (thesis chapter 7), one file each."""
