"""What is specific to a movement: names, repetitions, the chair, the body to compare with (ch. 5, 6)."""
