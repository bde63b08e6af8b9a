"""Analysis specific to a movement: segment names, repetitions, chair contact, reference body (thesis ch. 5, 6)."""
