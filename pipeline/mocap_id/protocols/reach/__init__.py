"""What a person can reach: ranges of the joints, reachable volume, its surface, heights and targets (thesis 7.2)."""
