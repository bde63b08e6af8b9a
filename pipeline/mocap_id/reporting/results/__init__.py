"""Results of studies: tables with declared columns, files that are written all or none, and the page of a study."""
