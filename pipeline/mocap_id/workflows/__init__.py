"""Work around single trials: simulated recordings with exact truth."""
