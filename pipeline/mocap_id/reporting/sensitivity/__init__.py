"""The page and the tornado diagram of a sensitivity study."""
