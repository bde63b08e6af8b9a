"""A comparison as JSON and as a CSV table."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id.errors import ConfigError
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.compare.comparing import Comparison
from mocap_id.workflows.compare.difference import Difference


def check_format(file: Path) -> None:
    """ConfigError where a table cannot be written under this name."""
    if file.suffix.lower() != ".csv":
        raise ConfigError(f"--out: {file}: expected a file name that ends in .csv")


def write(rows: tuple[Difference, ...], file: Path) -> None:
    """Write rows as CSV.

    Raises
    ------
    ConfigError
        The name does not end in .csv.
    StoreError
        The file cannot be written.
    """
    check_format(file)
    columns = list(Difference.__dataclass_fields__)
    text = pd.DataFrame([asdict(row) for row in rows], columns=columns).to_csv(index=False, lineterminator="\n")
    with explained(file):
        file.parent.mkdir(parents=True, exist_ok=True)
    replace_together(file.parent, {file.name: text.encode()})


def as_json(found: Comparison, rows: tuple[Difference, ...]) -> dict[str, Any]:
    """The comparison with some of its rows."""
    return {
        "schema": "mocap-id/compare",
        "version": 1,
        "a": {"trial": found.a.name, "folder": str(found.a.path)},
        "b": {"trial": found.b.name, "folder": str(found.b.path)},
        "identical": found.identical,
        "differences": [asdict(row) for row in rows],
    }
