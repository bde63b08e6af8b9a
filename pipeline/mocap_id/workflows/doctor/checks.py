"""All checks of ``mocap-id doctor``."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import MocapIdError, first_line
from mocap_id.workflows.doctor.machine import check_machine
from mocap_id.workflows.doctor.packages import Finding, check_packages

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
OPENSIM = "MOCAP_ID_OPENSIM_PYTHON"
"""Environment variable: path of a Python that has the `opensim` package."""


def check_installation(folder: Path, *, simulate: Callable[[Path], Path] | None = None) -> Iterator[Finding]:
    """Run all checks and yield their findings.

    Parameters
    ----------
    folder : Path
        The working folder.
    simulate : callable, optional
        Writes a small trial to a new folder and returns the path of its YAML file. The whole pipeline is run on it.
    """
    yield from check_packages()
    yield from check_machine(folder)
    yield find_browser()
    yield find_opensim(folder)
    if simulate is not None:
        yield run_small_trial(simulate)


def find_browser() -> Finding:
    """Return whether Chromium was found, which only the tests of the report need."""
    path = next((path for path in map(shutil.which, _BROWSERS) if path), None)
    return Finding("Chromium (optional)", "ok", path or "no Chromium found; only the tests of the report need it")


def find_opensim(folder: Path) -> Finding:
    """Return whether a Python with OpenSim was found, which only the tests of the exports need."""
    named = os.environ.get(OPENSIM)
    python = Path(named) if named else folder / ".venv-opensim" / "bin" / "python"
    if python.is_file():
        return Finding("OpenSim (optional)", "ok", str(python))
    if named:
        return Finding(
            "OpenSim (optional)", "warn", f"{OPENSIM} names {named}, which is not a file", f"correct {OPENSIM}"
        )
    return Finding("OpenSim (optional)", "ok", "not found; only the tests of the exports need it")


def run_small_trial(simulate: Callable[[Path], Path]) -> Finding:
    """Simulate a small trial, run it from recording to report, and return the finding."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mocap-id-doctor-") as folder:
        try:
            outcome = runner.run(load(simulate(Path(folder) / "trial")))
            level = outcome.summary()["verdict"]["level"]
        except Exception as error:  # noqa: BLE001  a broken installation may raise anything
            kind = "" if isinstance(error, MocapIdError) else f"{type(error).__name__}: "
            return Finding("small trial", "fail", f"{kind}{first_line(error)}", "please report it")
        has_report = (outcome.folder / "report.html").is_file()
    found = f"simulated and run in {time.perf_counter() - start:.1f} s, verdict {level}"
    if level == "refused" or not has_report:
        return Finding("small trial", "fail", found, "please report it")
    return Finding("small trial", "ok", found)
