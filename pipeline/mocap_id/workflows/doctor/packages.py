"""Checks of Python and the required packages: installed, recent enough, importable."""

from __future__ import annotations

import importlib
import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from typing import Literal

from mocap_id import __version__
from mocap_id.errors import first_line

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

    Examples
    --------
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
