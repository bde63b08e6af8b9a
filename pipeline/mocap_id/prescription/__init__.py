"""Workspaces, and springs that let a person hold as much of them as possible (thesis chapter 7)."""
