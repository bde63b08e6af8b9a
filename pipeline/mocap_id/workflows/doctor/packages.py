"""Checks of Python and the required packages: installed, recent enough, importable."""

from __future__ import annotations

import importlib
import platform
import re
from collections.abc import Iterator
from importlib import metadata

from mocap_id import __version__
from mocap_id.workflows.doctor.finding import Finding, release

_PACKAGE = "mocap-id"
_LEAST_PYTHON = "3.11"
_MODULES = {
    "ruamel-yaml": "ruamel.yaml",
    "ruamel.yaml": "ruamel.yaml",
}  # modules that are not named after their package
_REQUIREMENT = re.compile(r"(?P<name>[\w.\-]+)\s*(?:\(?>=\s*(?P<least>[\w.]+)\)?)?")


def dependencies() -> Iterator[Finding]:
    """Check Python, mocap-id itself, and every required package."""
    yield _python()
    try:
        wanted = metadata.requires(_PACKAGE) or []
    except metadata.PackageNotFoundError:
        yield Finding(
            _PACKAGE,
            "warn",
            f"{__version__}, not installed as a package, so its requirements are unknown",
            "install it: pip install .",
        )
        return
    yield Finding(_PACKAGE, "ok", __version__)
    for requirement in wanted:
        match = _REQUIREMENT.match(requirement)
        if match and "extra ==" not in requirement:
            yield package(match["name"], match["least"])


def _python() -> Finding:
    there = platform.python_version()
    if release(there) >= release(_LEAST_PYTHON):
        return Finding("Python", "ok", there)
    return Finding("Python", "fail", there, f"use Python {_LEAST_PYTHON} or later")


def package(name: str, least: str | None) -> Finding:
    """Check that a package is installed, recent enough and importable."""
    advice = f"pip install '{name}{f'>={least}' if least else ''}'"
    try:
        there = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Finding(name, "fail", "not installed", advice)
    if least and release(there) < release(least):
        return Finding(name, "fail", f"{there}, at least {least} is needed", advice)
    try:
        importlib.import_module(_MODULES.get(name.lower(), name.replace("-", "_")))
    except Exception as error:  # noqa: BLE001  a broken package may raise anything while it loads
        what = str(error).partition("\n")[0]
        return Finding(
            name, "fail", f"{there} does not load ({type(error).__name__}: {what})", f"reinstall it: {advice}"
        )
    return Finding(name, "ok", there)
