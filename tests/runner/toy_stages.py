"""Three small stages with real artefacts, which read numbers from a text file, select some and report them."""

from __future__ import annotations

import json

import numpy as np

from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.trial_keys import TrialKeys
from mocap_id.store import Document, Table
from mocap_id.store.provenance import EVENTS, SEGMENTS
from mocap_id.verdict import Reason


class ReadSettings(Settings):
    gain: float = 1.0
    unused: float = 0.0


class CutSettings(Settings):
    length: int = 2


def read(context: Context) -> Outputs:
    """Numbers of a text file, one a line."""
    numbers = np.array([float(line) for line in context.trial.recording.markers.read_text().split()])
    columns = {c.name: context.settings.gain * numbers for c in EVENTS.columns[:5]}
    beside = {"complete": np.ones(len(numbers), dtype=bool), "why": np.full(len(numbers), "", dtype=object)}
    note = Reason("noted", "a note from the first stage", level="ok")
    return (Table(EVENTS, columns | beside, {"count": len(numbers)}, (note,)),)


def cut(context: Context) -> Outputs:
    kept = context.table("events.parquet")["start"][: context.settings.length]
    labels = np.array([f"M{k}" for k in range(len(kept))], dtype=object)
    segment, reason = np.ones(len(kept), dtype=np.int64), np.full(len(kept), "", dtype=object)
    return (Table(SEGMENTS, {"marker": labels, "segment": segment, "residual": kept, "reason": reason}),)


def tell(context: Context) -> Outputs:
    refused = context.refused
    every = dict.fromkeys(reason for artefact in context.inputs.values() for reason in artefact.reasons)
    reasons = [reason.as_dict() for reason in every]
    if refused is not None:
        reasons.append(Reason(refused.code, refused.message, refused.value, refused.limit, "refused").as_dict())
    level = "refused" if refused else "ok"
    summary = {
        "verdict": {"level": level, "reasons": reasons},
        "inputs": sorted(context.inputs),
        "time_s": sorted(context.seconds or {}),
    }
    return Document("summary.json", json.dumps(summary).encode()), Document("report.html", level.encode())


STAGES = (
    Stage("read", 1, (), ("events.parquet",), ("recording", "window"), ReadSettings, read, "Read."),
    Stage("cut", 1, ("events.parquet",), ("segments.parquet",), (), CutSettings, cut, "Cut."),
    Stage(
        "tell",
        1,
        ("events.parquet", "segments.parquet"),
        ("summary.json", "report.html"),
        tuple(TrialKeys.model_fields),
        Settings,
        tell,
        "Tell.",
    ),
)
