"""The page of a study: what came of every trial in plain words, the tables of chapter 6, and figures over people."""
