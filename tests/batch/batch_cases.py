"""Small trials by the dozen, and one that takes its process along."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from mocap_id.recording.writer import write_trc
from swinging_link import LABELS, RATE, pendulum


def trials(folder: Path, names: Sequence[str]) -> list[Path]:
    """Trials of these names in a folder: their files."""
    folder.mkdir(parents=True, exist_ok=True)
    write_trc(folder / "link.trc", LABELS, pendulum(), RATE)
    files = [folder / f"{name}.yaml" for name in names]
    for file in files:
        file.write_text(f"trial: {file.stem}\nrecording: link.trc\n")
    return files


class Deadly:
    """A trial that ends whatever process runs it, as the system does for want of memory."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def keys(self) -> NoReturn:
        os._exit(1)

    @property
    def out(self) -> NoReturn:
        os._exit(1)
