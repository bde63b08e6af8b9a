"""Files of a report."""

from __future__ import annotations

from typing import Literal, TypeAlias

PdfFonts: TypeAlias = Literal["type-3", "truetype"]
"""Font type of the text in a PDF."""

SUMMARY_FILE, PAGE_FILE, CAPTIONS_FILE = "summary.json", "report.html", "figures/captions.md"
FILES: tuple[str, ...] = (SUMMARY_FILE, PAGE_FILE)
"""Files of every report; figures for papers are only written on request."""
COHORT, COHORT_PAGE = "cohort", "cohort.html"
"""Value of ``subject`` in the rows about all people of a study, which no person may have as id; file of its page."""
