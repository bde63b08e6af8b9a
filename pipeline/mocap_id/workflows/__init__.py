"""Workflows that combine many trials, or use the results of finished ones."""
