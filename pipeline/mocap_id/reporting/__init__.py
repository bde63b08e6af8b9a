"""Summaries, tables, figures and pages of trials and studies, and the explanations of all reason codes.

The report only presents numbers that are in the artefacts. Here are the names of its files and the words that tables
and pages share; nothing is imported, because the drawing libraries take half a second to load.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

Ending: TypeAlias = Literal["ok", "caution", "refused", "failed"]
ENDINGS: dict[Ending, str] = {"ok": "good", "caution": "usable with care", "refused": "refused", "failed": "failed"}
"""Words for how a trial can end: with a level of the verdict, or as failed, without a verdict."""

PdfFonts: TypeAlias = Literal["type-3", "truetype"]
"""Font type of the text in a PDF."""

SUMMARY_FILE, PAGE_FILE, CAPTIONS_FILE = "summary.json", "report.html", "figures/captions.md"
FILES: tuple[str, ...] = (SUMMARY_FILE, PAGE_FILE)
"""Files of every report; figures for papers are only written on request."""
COHORT, COHORT_PAGE = "cohort", "cohort.html"
"""Value of ``subject`` in the rows about all people of a study, which no person may have as id; file of its page."""
