"""Log of all runs of a trial, in its run folder."""

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
"""Name of the log in the run folder."""

_NO_VERDICT = "no verdict yet"
_LARGEST = 1_000_000  # bytes; a longer log is cut to its newer half


@contextlib.contextmanager
def keep_log(folder: Path, trial: str, files: Mapping[str, Path]) -> Iterator[logging.Logger]:
    """Collect log messages and warnings, and append them to the log of the run folder at the end of the run.

    Nothing is written to a folder without other files, and a log that cannot be written causes no error. Instead of the
    names of the user ``files``, which may identify a person, the log contains their YAML keys. The logger that is
    yielded is for messages that go only to the log.
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
            path = folder / RUN_LOG
            unsafe = path.is_symlink() or (path.exists() and not path.is_file())  # a link may lead out of the folder
            if not unsafe and (path.exists() or any(file.is_file() for file in folder.iterdir())):
                with path.open("a", encoding="utf-8") as stream:
                    stream.write("".join(lines.lines))
                if path.stat().st_size > _LARGEST:
                    kept = path.read_bytes()[-_LARGEST // 2 :]
                    replace_together(folder, {RUN_LOG: kept[kept.find(b"\n") + 1 :]})


def summarise_verdict(folder: Path) -> str:
    """Return the verdict in a run folder and the codes of its reasons, as a line of the log."""
    try:
        verdict = json.loads(plain_files.read_bytes(folder / "summary.json"))["verdict"]
    except (OSError, ValueError, KeyError, TypeError):
        return _NO_VERDICT
    codes = [reason["code"] for reason in verdict["reasons"] if reason.get("level") != "ok"]
    return ": ".join([f"verdict {verdict['level']}", *([", ".join(codes)] if codes else [])])


def read_last_failure(folder: Path) -> str | None:
    """Return the message of the last line in the log if the last run failed, or else None."""
    try:
        lines = plain_files.read_bytes(folder / RUN_LOG, links=False).decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    message = lines[-1].partition(" ")[2] if lines else "verdict"
    return None if message.startswith(("verdict", _NO_VERDICT)) else message


class _Lines(logging.Handler):
    """Log handler that collects lines with time stamps."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        super().__init__(logging.INFO)
        self.lines: list[str] = []
        self._keys = {name: key for key, path in files.items() for name in (str(path), path.name)}

    def emit(self, record: logging.LogRecord) -> None:
        stamp = datetime.datetime.fromtimestamp(record.created, datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        message = " ".join(record.getMessage().split())
        for name, key in self._keys.items():
            message = message.replace(name, key)
        level = "" if record.levelno <= logging.INFO else f"{record.levelname.lower()}: "
        self.lines.append(f"{stamp} {level}{message}\n")
