"""The batch's table: one row a trial, whatever came of it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mocap_id.config import Trial
from mocap_id.errors import Refused
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.store import Column, TableSchema
from mocap_id.workflows.batch.finding import Unreadable
from mocap_id.workflows.performing import NOT_RUN, Performed

BATCH = TableSchema(
    "batch.parquet",
    1,
    (
        Column("trial", "str", "", "name of the trial"),
        Column("file", "str", "", "its YAML file, seen from the table's folder"),
        Column("folder", "str", "", "its run folder, likewise"),
        Column("verdict", "str", "", "ok, caution, refused, failed, or not run after another one's failure"),
        Column("codes", "str", "", "codes of the verdict's reasons"),
        Column("exit_code", "int64", "1", "what `mocap-id run` would have ended with"),
        Column("message", "str", "", "why it failed, was refused or not run, without names of recordings"),
        Column("computed", "bool", "", "whether any stage had to be computed"),
        Column("seconds", "float64", "s", "that the trial took in this batch"),
        Column("segments", "Int64", "1", "number of segments with the base"),
        Column("confidence", "float64", "1", "chance that the segments are right"),
        Column("missing_fraction", "float64", "1", "of the marker samples"),
        Column("reprojection", "float64", "m", "rms distance between measured and predicted markers"),
        Column("marker_sd", "float64", "m", "standard deviation of a marker coordinate"),
        Column("mass", "float64", "kg", "that was identified"),
        Column("condition_number", "float64", "1", "of the regressor over the samples of the fit"),
        Column("clock_offset", "float64", "s", "plates after cameras"),
        Column("cop_rms", "float64", "m", "modelled less measured centre of pressure"),
        Column("repetitions", "Int64", "1", "that were found"),
    ),
)


def row(trial: Trial, done: Performed, base: Path) -> dict[str, Any]:
    """A trial's row.

    Parameters
    ----------
    trial : Trial
    done : Performed
    base : Path
        The table's folder.
    """
    told = done.exit_code in (0, Refused.exit_code)
    summary = json.loads((trial.out / SUMMARY_FILE).read_text("utf-8")) if told else None
    failed = "not run" if done.exit_code == NOT_RUN else "failed"
    return {
        "trial": trial.name,
        "file": _seen_from(base, trial.file),
        "folder": _seen_from(base, trial.out),
        "verdict": failed if summary is None else summary["verdict"]["level"],
        "codes": "" if summary is None else ", ".join(one["code"] for one in summary["verdict"]["reasons"]),
        "exit_code": done.exit_code,
        "message": done.published or "",
        "computed": done.computed,
        "seconds": done.seconds,
        **({} if summary is None else _numbers(summary)),
    }


def unreadable_row(one: Unreadable, base: Path) -> dict[str, Any]:
    """The row of a file that is no trial's."""
    return {
        "trial": one.file.stem,
        "file": _seen_from(base, one.file),
        "folder": "",
        "verdict": "failed",
        "codes": "",
        "exit_code": one.error.exit_code,
        "message": str(one.error).replace(str(one.file), one.file.name),
        "computed": False,
        "seconds": 0.0,
    }


def _numbers(summary: Mapping[str, Any]) -> dict[str, Any]:
    segments, markers, noise, dynamics, repetitions = (
        summary.get(key) or {} for key in ("segments", "markers", "noise", "dynamics", "repetitions")
    )
    reprojection = markers.get("reprojection_rms_mm")
    return {
        "segments": segments.get("count"),
        "confidence": segments.get("confidence"),
        "missing_fraction": markers.get("missing_fraction"),
        "reprojection": None if reprojection is None else reprojection / 1e3,
        "marker_sd": noise.get("marker_sd_m"),
        "mass": dynamics.get("mass_kg"),
        "condition_number": dynamics.get("condition_number"),
        "clock_offset": dynamics.get("clock_offset_s"),
        "cop_rms": dynamics.get("cop_rms_m"),
        "repetitions": len(repetitions) if isinstance(repetitions, list) else None,
    }


def _seen_from(base: Path, path: Path) -> str:
    try:
        return os.path.relpath(path, base)
    except ValueError:  # on another drive
        return str(path)
