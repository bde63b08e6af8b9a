"""How a trial run ended, with the summary that it left."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mocap_id.errors import Refused
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.reporting.summary_schema import ReasonEntry
from mocap_id.workflows.parallel import NOT_RUN, TrialRun

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from mocap_id.reporting.results.trial_entries import TrialEntry


@dataclass(frozen=True, kw_only=True)
class TrialOutcome:
    """How a trial run ended."""

    run: TrialRun
    summary: Mapping[str, Any] | None  # content of summary.json; None for a trial that failed

    @property
    def level(self) -> Any:
        """Level of the verdict, or ``failed`` or ``not run`` where there is no verdict."""
        if self.summary is not None:
            return self.summary["verdict"]["level"]
        return "not run" if self.run.exit_code == NOT_RUN else "failed"

    @property
    def codes(self) -> list[str]:
        """Codes of the verdict's reasons."""
        return [str(reason["code"]) for reason in self.value("verdict", "reasons") or ()]

    def value(self, *keys: str) -> Any:
        """Return an entry of the summary by the keys that lead to it; None where the summary does not have it."""
        entry: Any = self.summary
        for key in keys:
            entry = (entry or {}).get(key)
        return entry

    def metres(self, *keys: str) -> float | None:
        """Return an entry of the summary that is in millimetres."""
        value = self.value(*keys)
        return None if value is None else value / 1e3

    def entry(self, name: str, about: str, report: str) -> TrialEntry:
        """Return how the trial ended for a page; `report` is the path of its own report, which a failed one lacks."""
        from mocap_id.reporting.results.trial_entries import TrialEntry  # noqa: PLC0415  it loads the page's templates

        reasons = [ReasonEntry(**reason) for reason in self.value("verdict", "reasons") or ()]
        link = None if self.summary is None else report
        return TrialEntry(name, about, self.level, reasons, self.run.published, link)


def read_summary(folder: Path, run: TrialRun) -> Mapping[str, Any] | None:
    """Return the content of summary.json; None for a trial that failed, whose file may be of an earlier run."""
    if run.exit_code not in (0, Refused.exit_code):
        return None
    summary: Mapping[str, Any] = json.loads((folder / SUMMARY_FILE).read_text("utf-8"))
    return summary
