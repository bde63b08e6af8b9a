"""Results of studies: tables with declared columns, files that are written together, and the page of a study."""
