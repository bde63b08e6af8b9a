"""Stored refusals: a stage that has refused some inputs would refuse them again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mocap_id import plain_files
from mocap_id.errors import Refused
from mocap_id.store.atomic import converting_errors, replace_together

_FILE = ".mocap-id/refusal.json"


def store_refusal(folder: Path, stage: str, key: str, refused: Refused) -> None:
    """Store that the stage has refused the computation with the cache key ``key``, and why.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    reason = {"code": refused.code, "message": refused.message, "value": refused.value, "limit": refused.limit}
    text = json.dumps({"stage": stage, "key": key, "refused": reason}, indent=1)
    replace_together(folder, {_FILE: text.encode()})


def read_refusal(folder: Path, stage: str, key: str) -> Refused | None:
    """Return the stored refusal of the computation with the cache key ``key``; None if it was not refused."""
    try:
        found: dict[str, Any] = json.loads(plain_files.read(folder / _FILE, links=False))
        refused = Refused(**found["refused"]) if (found["stage"], found["key"]) == (stage, key) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return refused if refused is not None and isinstance(refused.message, str) else None


def forget_refusal(folder: Path) -> None:
    """Delete the stored refusal, so that the stage is computed again."""
    with converting_errors(folder / _FILE):
        (folder / _FILE).unlink(missing_ok=True)
