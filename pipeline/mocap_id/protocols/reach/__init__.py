"""What a person can reach: ranges of the joints, reachable volume, its surface, heights and tasks (thesis 7.2)."""
