"""A study's tables as files: CSV for spreadsheets, Parquet with units, and study.json, which says what they hold."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from mocap_id import __version__
from mocap_id.config.study import Study
from mocap_id.reporting.cohort.material import PAGE_FILE
from mocap_id.store import Table, TableSchema, hash_bytes
from mocap_id.store.parquet import arrow, columns_of
from mocap_id.store.provenance import PREFIX
from mocap_id.workflows.study.cases import Case
from mocap_id.workflows.study.columns import TABLES
from mocap_id.workflows.study.trials_table import codes, level

DOCUMENT = "study.json"


def table_files(
    frames: Mapping[str, pd.DataFrame], schemas: Mapping[str, TableSchema] = TABLES, kind: str = "study"
) -> dict[str, bytes]:
    """CSV and Parquet of each table; in CSV what is missing is empty, in Parquet NaN."""
    files = {}
    for name, frame in frames.items():
        whole = arrow(Table.from_frame(schemas[name], frame))
        files[f"{name}.csv"] = csv(whole)
        files[f"{name}.parquet"] = parquet(whole, schemas[name], kind)
    return files


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
        "page": PAGE_FILE,
        "subjects": {
            subject: [case.trial.name for case in cases if case.subject == subject] for subject in study.subjects
        },
        "trials": [_trial(case) for case in cases],
        "tables": {name: table_document(TABLES[name], frame) for name, frame in frames.items()},
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


def table_document(schema: TableSchema, frame: pd.DataFrame) -> dict[str, Any]:
    """Rows of a table, and units and meanings of its columns."""
    return {
        "rows": len(frame),
        "columns": [
            {"name": column.name, "unit": column.unit, "meaning": column.meaning}
            for column in columns_of(schema, list(frame.columns))
        ],
    }


def csv(whole: pa.Table) -> bytes:
    """A table as CSV; what is missing is empty."""
    stream = io.BytesIO()
    pyarrow.csv.write_csv(pa.table(dict(_without_nan(whole))), stream)
    return stream.getvalue()


def _without_nan(whole: pa.Table) -> Iterator[tuple[str, Any]]:
    for name in whole.column_names:
        column = whole.column(name)
        if pa.types.is_floating(column.type):
            column = pc.if_else(pc.is_nan(column), pa.scalar(None, column.type), column)
        yield name, column


def parquet(whole: pa.Table, schema: TableSchema, kind: str = "study") -> bytes:
    """A table as Parquet, which says of what kind it is, by which schema and product."""
    told = {"schema": f"{kind}/{schema.file}", "schema_version": str(schema.version), "product": __version__}
    stream = io.BytesIO()
    named = whole.replace_schema_metadata({f"{PREFIX}{key}": text for key, text in told.items()})
    pyarrow.parquet.write_table(named, stream)
    return stream.getvalue()
