"""Export of a run in space."""
