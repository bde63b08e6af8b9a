"""Checks of an installation: what mocap-id needs, what is optional, and how to repair what is missing."""

from __future__ import annotations

import compileall
import importlib
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

import h5py
import numba
import numpy as np
import pandas as pd

from mocap_id import __version__, runner
from mocap_id.config import load
from mocap_id.errors import MocapIdError, first_line
from mocap_id.estimation import filter_kernels, smooth
from mocap_id.estimation.encoders import estimate_encoder_noise, smooth_encoder
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.space import smooth_in_space
from mocap_id.geometry.planar import marker_positions
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
OPENSIM = "MOCAP_ID_OPENSIM_PYTHON"
"""Environment variable: path of a Python that has the `opensim` package."""


def check_installation(folder: Path, *, simulate: Callable[[Path], Path] | None = None) -> Iterator[Finding]:
    """Run all checks, for a working folder, and yield their findings.

    ``simulate`` writes a small trial to a new folder, on which the whole pipeline is run, and returns its YAML file.
    """
    yield from check_packages()

    yield check_threads()
    yield check_compiler()
    yield check_cache()
    yield check_space(folder)
    yield from check_files(folder)

    browser = next((path for path in map(shutil.which, _BROWSERS) if path), None)
    found = browser or "no Chromium found; only the tests of the report need it"
    yield Finding("Chromium (optional)", "ok", found)
    yield find_opensim(folder)
    if simulate is not None:
        yield run_small_trial(simulate)


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


_SPACE, _LEAST_SPACE = 2e9, 1e8  # bytes: for a long trial with its report; for a short trial
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_WRITABLE = "set NUMBA_CACHE_DIR to a writable folder"
_RATE = 100.0  # Hz, rate of the trial that is filtered to compile the filter


def check_threads() -> Finding:
    """Check that linear algebra uses one thread, because more threads slow down computations with small matrices."""
    set_to = {name: os.environ.get(name, "") for name in _THREADS}
    found = ", ".join(f"{name} is {value or 'not set'}" for name, value in set_to.items())
    if all(value == "1" for value in set_to.values()):
        return Finding("linear algebra", "ok", "one thread")
    return Finding("linear algebra", "warn", found, "unset both, or set both to 1: mocap-id is faster with one thread")


def check_compiler() -> Finding:
    """Check that numba compiles."""
    try:
        doubled = numba.njit(lambda x: 2.0 * x)(21.0)
    except Exception as error:  # noqa: BLE001  a compiler without its library may raise anything
        return _report_broken("compiler", error, "numba llvmlite")
    if doubled != 42.0:
        return Finding("compiler", "fail", f"compiled code gives {doubled}, not 42", "reinstall it: pip install numba")
    return Finding("compiler", "ok", f"numba {numba.__version__} compiles")


def check_cache() -> Finding:
    """Check that the filter's compiled code can be cached between runs."""
    folders = {
        Path(each.stats.cache_path)
        for each in vars(filter_kernels).values()
        if hasattr(each, "stats") and getattr(each.stats, "cache_path", None)
    }
    if not folders:
        found = "there is no folder for the compiled code, so every run compiles again (about 10 s)"
        return Finding("compiled code", "warn", found, _WRITABLE)
    read_only = [folder for folder in sorted(folders) if folder.is_dir() and not os.access(folder, os.W_OK)]
    if read_only:
        return Finding("compiled code", "warn", f"{read_only[0]} is not writable", _WRITABLE)
    return Finding("compiled code", "ok", f"kept in {min(folders)}")


def check_space(folder: Path) -> Finding:
    """Check that the working folder has enough free space."""
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free"
    if free < _LEAST_SPACE:
        return Finding("disk", "fail", found, "free some space: a trial takes 10 to 500 MB")
    if free < _SPACE:
        return Finding("disk", "warn", found, "free some space: a long trial takes up to 500 MB")
    return Finding("disk", "ok", found)


def check_files(folder: Path) -> Iterator[Finding]:
    """Check that the folder is writable, and write and read HDF5 and Parquet files there."""
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".mocap-id-doctor-") as place:
            yield Finding("working folder", "ok", "can be written")
            for name, package, is_kept in (("HDF5", "h5py", _keeps_hdf5), ("Parquet", "pyarrow", _keeps_parquet)):
                try:
                    kept = is_kept(Path(place))
                except Exception as error:  # noqa: BLE001  the user needs any message of the library
                    yield _report_broken(name, error, package)
                    continue
                if kept:
                    yield Finding(name, "ok", "a written file is read back correctly")
                else:
                    found = "a written file is not read back correctly"
                    yield Finding(name, "fail", found, f"reinstall it: pip install {package}")
    except OSError as error:
        found = f"{folder} cannot be written ({error.strerror or error})"
        advice = "change its permissions, or choose another folder for every trial with `out:`"
        yield Finding("working folder", "fail", found, advice)


def _keeps_hdf5(folder: Path) -> bool:
    values = np.array([0.1, np.nan, -3.0])
    with h5py.File(folder / "doctor.h5", "w") as file:
        file["values"] = values
    with h5py.File(folder / "doctor.h5") as file:
        return np.array_equal(np.asarray(file["values"]), values, equal_nan=True)


def _keeps_parquet(folder: Path) -> bool:
    table = pd.DataFrame({"value": [0.1, np.nan, -3.0], "marker": pd.Categorical(["A", "B", "A"])})
    table.to_parquet(folder / "doctor.parquet")
    return pd.read_parquet(folder / "doctor.parquet").equals(table)


def _report_broken(name: str, error: Exception, package: str) -> Finding:
    found = f"{type(error).__name__}: {first_line(error)}"
    return Finding(name, "fail", found, f"reinstall it: pip install {package}")


def compile_everything(packages: Sequence[Path]) -> Iterator[Finding]:
    """Compile the modules in the folders ``packages``, then the numba code of a run, and yield both findings."""
    yield compile_modules(packages)
    yield compile_filter()


def compile_modules(packages: Sequence[Path]) -> Finding:
    """Write missing or outdated bytecode of the modules in the folders ``packages``, and return the finding.

    An editable installation with ``PYTHONDONTWRITEBYTECODE``, which many containers set, otherwise compiles 300 modules
    in every run, which takes 0.3 s.
    """
    written = [compileall.compile_dir(folder, quiet=2) for folder in packages]
    if all(written):
        return Finding("modules", "ok", "their bytecode is up to date")
    where = " or ".join(str(folder) for folder in packages)
    found = f"their bytecode cannot be written in {where}"
    return Finding("modules", "warn", found, "repeat as a user who may write there")


def compile_filter() -> Finding:
    """Compile and cache the code of a run by filtering a simulated arm in the plane, in space and with an encoder.

    The cache is valid for one user and one processor. Compile as the user who runs the trials, on the same machine.
    """
    start = time.perf_counter()
    time_s = np.arange(200) / _RATE
    angles = np.stack([np.sin(3.0 * time_s), np.cos(2.0 * time_s)], axis=1)
    centres, segment = np.array([[0.0, 0.0], [0.4, 0.0]]), np.array([1, 1, 2, 2])
    local = np.array([[0.1, 0.05], [0.3, -0.05], [0.1, 0.05], [0.3, -0.05]])
    smooth(marker_positions(angles, centres, segment, local), _RATE, MarkerChain(centres, segment, local))
    encoder = (time_s, angles[:, 0], 3.0 * np.cos(3.0 * time_s))
    smooth_encoder(*encoder, estimate_encoder_noise(*encoder))
    hinge = SpatialJoint("hinge", 0, np.zeros(3))
    corners = np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    chain = SpatialChain((hinge,), np.repeat([0, 1], 3), np.tile(corners, (2, 1)), np.zeros(6, dtype=np.bool_))
    rotated = corners @ np.swapaxes(hinge.rotation(angles[:, :1]), 1, 2)
    smooth_in_space(np.concatenate([np.broadcast_to(corners, rotated.shape), rotated], axis=1), _RATE, chain)
    cached = check_cache()
    if cached.level != "ok":
        return cached
    return Finding(cached.name, "ok", f"ready after {time.perf_counter() - start:.1f} s, {cached.found}")


_PACKAGE = "mocap-id"
_LEAST_PYTHON = "3.11"
_MODULES = {"ruamel-yaml": "ruamel.yaml", "ruamel.yaml": "ruamel.yaml"}
"""Modules that are not named after their package."""
_REQUIREMENT = re.compile(r"(?P<name>[\w.\-]+)\s*(?:\(?>=\s*(?P<least>[\w.]+)\)?)?")

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    name: str
    level: Level  # ``warn``: mocap-id works, but more slowly or with fewer functions; ``fail``: it does not work
    found: str  # what was found
    advice: str = ""  # what to do; empty if nothing needs to be done


def check_packages() -> Iterator[Finding]:
    """Check Python, mocap-id itself, and every required package."""
    version = platform.python_version()
    if parse_version(version) >= parse_version(_LEAST_PYTHON):
        yield Finding("Python", "ok", version)
    else:
        yield Finding("Python", "fail", version, f"use Python {_LEAST_PYTHON} or later")
    try:
        requirements = metadata.requires(_PACKAGE) or []
    except metadata.PackageNotFoundError:
        found = f"{__version__}, not installed as a package, so its requirements are unknown"
        yield Finding(_PACKAGE, "warn", found, "install it: pip install .")
        return
    yield Finding(_PACKAGE, "ok", __version__)
    for requirement in requirements:
        match = _REQUIREMENT.match(requirement)
        if match and "extra ==" not in requirement:
            yield check_package(match["name"], match["least"])


def check_package(name: str, least: str | None) -> Finding:
    """Check that a package is installed, recent enough and importable."""
    advice = f"pip install '{name}{f'>={least}' if least else ''}'"
    try:
        version = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Finding(name, "fail", "not installed", advice)
    if least and parse_version(version) < parse_version(least):
        return Finding(name, "fail", f"{version} is too old; at least {least} is needed", advice)
    try:
        importlib.import_module(_MODULES.get(name.lower(), name.replace("-", "_")))
    except Exception as error:  # noqa: BLE001  a broken package may raise anything while it loads
        found = f"{version} does not load ({type(error).__name__}: {first_line(error)})"
        return Finding(name, "fail", found, f"reinstall it: {advice}")
    return Finding(name, "ok", version)


def parse_version(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, for comparison.

    >>> parse_version("1.10.2rc1") >= parse_version("1.9")
    True
    """
    numbers = []
    for part in version.split("."):
        digits = part[: len(part) - len(part.lstrip("0123456789"))]
        if not digits:
            break
        numbers.append(int(digits))
    return tuple(numbers)
