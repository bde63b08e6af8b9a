"""A refusal as it is remembered: what a stage refused once it would refuse again, for the same reason."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mocap_id import plain_files
from mocap_id.errors import Refused
from mocap_id.store.atomic import explained, replace_together

_FILE = ".mocap-id/refusal.json"


def remember(folder: Path, stage: str, key: str, refused: Refused) -> None:
    """Note which computation was refused, and why.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    told = {"code": refused.code, "message": refused.message, "value": refused.value, "limit": refused.limit}
    text = json.dumps({"stage": stage, "key": key, "refused": told}, indent=1)
    replace_together(folder, {_FILE: text.encode()})


def remembered(folder: Path, stage: str, key: str) -> Refused | None:
    """The refusal of this very computation, if it was refused; None where that is not known."""
    try:
        found: dict[str, Any] = json.loads(plain_files.read(folder / _FILE, links=False))
        refused = Refused(**found["refused"]) if (found["stage"], found["key"]) == (stage, key) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    return refused if refused is not None and isinstance(refused.message, str) else None


def forget_refusal(folder: Path) -> None:
    """Have the stage asked again."""
    with explained(folder / _FILE):
        (folder / _FILE).unlink(missing_ok=True)
