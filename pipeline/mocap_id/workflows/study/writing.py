"""A study's tables as files: CSV for spreadsheets, Parquet with units, and study.json, which says what they hold."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mocap_id import __version__
from mocap_id.config import Study
from mocap_id.store import TableSchema, hash_bytes
from mocap_id.store.parquet import columns_of
from mocap_id.workflows.study.cases import Case
from mocap_id.workflows.study.columns import TABLES
from mocap_id.workflows.study.trials_table import codes, level
from mocap_id.workflows.table_files import table_files as workflow_files

DOCUMENT = "study.json"
PAGE = "cohort.html"


def table_files(frames: Mapping[str, pd.DataFrame]) -> dict[str, bytes]:
    """CSV and Parquet of each table; in CSV what is missing is empty, in Parquet NaN."""
    return workflow_files(frames, TABLES, "study")


def document(
    study: Study, cases: Sequence[Case], frames: Mapping[str, pd.DataFrame], files: Mapping[str, bytes], key: str
) -> dict[str, Any]:
    """What study.json holds: how each trial went, and what every file and column is."""
    return {
        "schema": "mocap-id/study",
        "version": 1,
        "study": study.name,
        "product": __version__,
        "about": "Each table stands as CSV and as Parquet (units and meanings in the field metadata). A row of the "
        "subject `cohort` is about all people. Missing is empty in CSV and NaN in Parquet.",
        "page": PAGE,
        "subjects": {
            subject: [case.trial.name for case in cases if case.subject == subject] for subject in study.subjects
        },
        "trials": [_trial(case) for case in cases],
        "tables": {name: _table(TABLES[name], frame) for name, frame in frames.items()},
        "key": key,
        "files": {file: hash_bytes(content) for file, content in files.items()},
    }


def as_bytes(content: Mapping[str, Any]) -> bytes:
    """Strict JSON: no NaN, one final newline."""
    return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def report_of(case: Case) -> str | None:
    """Where a trial's own report is, from the study's folder; None where there is none."""
    return None if case.summary is None else f"../{case.trial.name}/report.html"


def _trial(case: Case) -> dict[str, Any]:
    return {
        "trial": case.trial.name,
        "subject": case.subject,
        "strategy": case.strategy,
        "exit_code": case.performed.exit_code,
        "verdict": level(case),
        "codes": codes(case),
        "message": case.performed.published,
        "report": report_of(case),
    }


def _table(schema: TableSchema, frame: pd.DataFrame) -> dict[str, Any]:
    return {
        "rows": len(frame),
        "columns": [
            {"name": column.name, "unit": column.unit, "meaning": column.meaning}
            for column in columns_of(schema, list(frame.columns))
        ],
    }
