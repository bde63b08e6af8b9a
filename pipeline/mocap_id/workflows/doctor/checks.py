"""All checks of ``mocap-id doctor``."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from mocap_id import runner
from mocap_id.config import load
from mocap_id.errors import MocapIdError
from mocap_id.simulation import Options, simulate
from mocap_id.workflows.doctor.finding import Finding
from mocap_id.workflows.doctor.machine import machine
from mocap_id.workflows.doctor.packages import dependencies

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
OPENSIM = "MOCAP_ID_OPENSIM_PYTHON"
"""Environment variable: path of a Python that has the `opensim` package."""


def check_installation(folder: Path, *, full: bool = False) -> Iterator[Finding]:
    """Run all checks.

    Parameters
    ----------
    folder : Path
        The working folder.
    full : bool
        Also simulate a small trial and run the whole pipeline on it, in a temporary folder.
    """
    yield from dependencies()
    yield from machine(folder)
    yield browser()
    yield opensim(folder)
    if full:
        yield small_trial()


def browser() -> Finding:
    """Look for Chromium, with which the tests view a report."""
    found = next((path for path in map(shutil.which, _BROWSERS) if path), None)
    return Finding("Chromium (optional)", "ok", found or "no Chromium found; only the report's own tests need it")


def opensim(folder: Path) -> Finding:
    """Look for a Python with OpenSim, which the tests of the exports use."""
    named = os.environ.get(OPENSIM)
    python = Path(named) if named else folder / ".venv-opensim" / "bin" / "python"
    if python.is_file():
        return Finding("OpenSim (optional)", "ok", str(python))
    if named:
        return Finding(
            "OpenSim (optional)", "warn", f"{OPENSIM} names {named}, which is not a file", f"correct {OPENSIM}"
        )
    return Finding("OpenSim (optional)", "ok", "not found; only the exports' own tests need it")


def small_trial() -> Finding:
    """Simulate a trial of a robot's joint and run it from recording to report."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mocap-id-doctor-") as place:
        try:
            options = Options(seed=1, repetitions=2, rate=100.0, analog_rate=500.0)
            outcome = runner.run(load(Path(simulate("robot", Path(place) / "trial", options))))
            level = outcome.summary()["verdict"]["level"]
        except MocapIdError as error:
            return Finding("small trial", "fail", str(error).partition("\n")[0], "please report it")
        except Exception as error:  # noqa: BLE001  a broken installation may raise anything
            what = str(error).partition("\n")[0]
            return Finding("small trial", "fail", f"{type(error).__name__}: {what}", "please report it")
        whole = (outcome.folder / "report.html").is_file()
    found = f"simulated and run in {time.perf_counter() - start:.1f} s, verdict {level}"
    if level == "refused" or not whole:
        return Finding("small trial", "fail", found, "please report it")
    return Finding("small trial", "ok", found)
