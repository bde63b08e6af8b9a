"""The page of a study: figures, the tables of thesis chapter 6, and the verdict of every trial in words."""
