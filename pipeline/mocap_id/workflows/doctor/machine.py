"""What the machine allows: threads, compiled code, disk, files."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import h5py
import numba
import numpy as np
import pandas as pd

from mocap_id.estimation import kernels
from mocap_id.workflows.doctor.check import Check

_ROOM, _LEAST_ROOM = 2e9, 1e8  # bytes: a long trial with its report; a short one
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def machine(folder: Path) -> Iterator[Check]:
    """Threads, compiler and its cache; the folder's room and permissions; both file formats there."""
    yield threads()
    yield compiler()
    yield compiled_code()
    yield room(folder)
    yield from files(folder)


def threads() -> Check:
    """Of the linear algebra: matrices are small here, and threads wait for each other longer than they compute."""
    set_to = {name: os.environ.get(name, "") for name in _THREADS}
    found = ", ".join(f"{name} is {value or 'not set'}" for name, value in set_to.items())
    if all(value == "1" for value in set_to.values()):
        return Check("linear algebra", "ok", "one thread")
    return Check("linear algebra", "warn", found, "unset them, or set both to 1: mocap-id is faster with one thread")


def compiler() -> Check:
    """Whether numba compiles."""
    try:
        doubled = numba.njit(lambda x: 2.0 * x)(21.0)
    except Exception as error:  # noqa: BLE001  a compiler without its library may raise anything
        what = str(error).partition("\n")[0]
        return Check("compiler", "fail", f"{type(error).__name__}: {what}", "reinstall it: pip install numba llvmlite")
    if doubled != 42.0:
        return Check("compiler", "fail", f"compiled code gives {doubled}, not 42", "reinstall it: pip install numba")
    return Check("compiler", "ok", f"numba {numba.__version__} compiles")


def compiled_code() -> Check:
    """Whether the filter's compiled code can be kept from one run to the next."""
    places = {
        Path(each.stats.cache_path)
        for each in vars(kernels).values()
        if hasattr(each, "stats") and getattr(each.stats, "cache_path", None)
    }
    if not places:
        return Check(
            "compiled code",
            "warn",
            "there is no folder to keep it in, so that every run compiles anew (about 10 s)",
            "set NUMBA_CACHE_DIR to a folder that you may write",
        )
    shut = [place for place in sorted(places) if place.is_dir() and not os.access(place, os.W_OK)]
    if shut:
        return Check(
            "compiled code",
            "warn",
            f"{shut[0]} may not be written",
            "set NUMBA_CACHE_DIR to a folder that you may write",
        )
    return Check("compiled code", "ok", f"kept in {min(places)}")


def room(folder: Path) -> Check:
    """Free space where the command was given."""
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free"
    if free < _LEAST_ROOM:
        return Check("disk", "fail", found, "make room: a trial takes 10 to 500 MB")
    if free < _ROOM:
        return Check("disk", "warn", found, "make room: a long trial takes up to 500 MB")
    return Check("disk", "ok", found)


def files(folder: Path) -> Iterator[Check]:
    """A new file in the folder, and HDF5 and Parquet there and back."""
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".mocap-id-doctor-") as place:
            yield Check("working folder", "ok", "can be written")
            yield _hdf5(Path(place) / "doctor.h5")
            yield _parquet(Path(place) / "doctor.parquet")
    except OSError as error:
        yield Check(
            "working folder",
            "fail",
            f"{folder} cannot be written ({error.strerror or error})",
            "change its permissions, or give every trial another folder with `out:`",
        )


def _hdf5(path: Path) -> Check:
    values = np.array([0.1, np.nan, -3.0])
    try:
        with h5py.File(path, "w") as file:
            file["values"] = values
        with h5py.File(path) as file:
            same = np.array_equal(np.asarray(file["values"]), values, equal_nan=True)
    except Exception as error:  # noqa: BLE001  whatever a library says, it is what the user has to know
        return _broken("HDF5", error, "h5py")
    return _round_trip("HDF5", same, "h5py")


def _parquet(path: Path) -> Check:
    table = pd.DataFrame({"value": [0.1, np.nan, -3.0], "marker": pd.Categorical(["A", "B", "A"])})
    try:
        table.to_parquet(path)
        same = pd.read_parquet(path).equals(table)
    except Exception as error:  # noqa: BLE001  whatever a library says, it is what the user has to know
        return _broken("Parquet", error, "pyarrow")
    return _round_trip("Parquet", same, "pyarrow")


def _round_trip(name: str, same: bool, package: str) -> Check:
    if same:
        return Check(name, "ok", "reads back what was written")
    return Check(name, "fail", "does not read back what was written", f"reinstall it: pip install {package}")


def _broken(name: str, error: Exception, package: str) -> Check:
    what = str(error).partition("\n")[0]
    return Check(name, "fail", f"{type(error).__name__}: {what}", f"reinstall it: pip install {package}")
