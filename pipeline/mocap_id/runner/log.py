"""What a trial's runs have done, line by line, beside its artefacts: for the day somebody asks."""

from __future__ import annotations

import contextlib
import datetime
import json
import logging
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path

from mocap_id import __version__, plain_files
from mocap_id.errors import StoreError
from mocap_id.store.atomic import replace_together

RUN_LOG = "run.log"
"""In the run folder."""

_NO_VERDICT = "no verdict yet"
_LARGEST = 1_000_000  # bytes; of a longer log the newer half stays


@contextlib.contextmanager
def run_log(folder: Path, trial: str, files: Mapping[str, Path]) -> Iterator[logging.Logger]:
    """Gather what is logged, warnings included, and append it to the folder's log when the run is over.

    Nothing is written into a folder in which the run has left nothing else, nor where it cannot be: a log is no reason
    to fail. Call it only while holding the folder's lock.

    Parameters
    ----------
    folder : Path
        The run folder.
    trial : str
        Its name.
    files : mapping
        The user's files by their key in the YAML, by which the log calls them: their own names may tell who moved.

    Yields
    ------
    Logger
        For what belongs into the log alone.
    """
    lines = _Lines(files)
    every, own = logging.getLogger("mocap_id"), logging.Logger("mocap_id.run", logging.INFO)
    every.addHandler(lines)
    own.addHandler(lines)
    own.info("%s: mocap-id %s, Python %s, %s", trial, __version__, platform.python_version(), platform.system())
    try:
        yield own
    except BaseException as error:
        own.info("%s: %s", type(error).__name__, error)
        raise
    finally:
        every.removeHandler(lines)
        with contextlib.suppress(OSError, StoreError):
            _append(folder, lines.text())


def verdict_line(folder: Path) -> str:
    """The verdict that stands in a run folder, with its codes."""
    try:
        verdict = json.loads(plain_files.read(folder / "summary.json"))["verdict"]
    except (OSError, ValueError, KeyError, TypeError):
        return _NO_VERDICT
    codes = [reason["code"] for reason in verdict["reasons"] if reason.get("level") != "ok"]
    return ": ".join([f"verdict {verdict['level']}", *([", ".join(codes)] if codes else [])])


def last_failure(folder: Path) -> str | None:
    """How the last run of a folder ended, if not with a verdict or as it was asked to."""
    try:
        lines = plain_files.read(folder / RUN_LOG, links=False).decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    said = lines[-1].partition(" ")[2] if lines else "verdict"
    return None if said.startswith(("verdict", _NO_VERDICT)) else said


class _Lines(logging.Handler):
    """Stamped lines, kept until they are asked for."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        super().__init__(logging.INFO)
        self._lines: list[str] = []
        self._called = {written: key for key, path in files.items() for written in (str(path), path.name)}

    def emit(self, record: logging.LogRecord) -> None:
        stamp = datetime.datetime.fromtimestamp(record.created, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        message = " ".join(record.getMessage().split())
        for written, key in self._called.items():
            message = message.replace(written, key)
        level = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        self._lines.append(f"{stamp} {level}{message}\n")

    def text(self) -> str:
        return "".join(self._lines)


def _append(folder: Path, text: str) -> None:
    path = folder / RUN_LOG
    if path.is_symlink() or (path.exists() and not path.is_file()):
        return  # not ours: it would lead out of the folder
    if not path.exists() and not any(file.is_file() for file in folder.iterdir()):
        return
    with path.open("a", encoding="utf-8") as stream:
        stream.write(text)
    if path.stat().st_size > _LARGEST:
        kept = path.read_bytes()[-_LARGEST // 2 :]
        replace_together(folder, {RUN_LOG: kept[kept.find(b"\n") + 1 :]})
