"""Python and the packages that mocap-id asks for: there, new enough, and they load."""

from __future__ import annotations

import importlib
import platform
import re
from collections.abc import Iterator
from importlib import metadata

from mocap_id import __version__
from mocap_id.workflows.doctor.check import Check, release

_PACKAGE = "mocap-id"
_LEAST_PYTHON = "3.11"
_MODULES = {"ruamel-yaml": "ruamel.yaml", "ruamel.yaml": "ruamel.yaml"}  # whose name is not that of its package
_REQUIREMENT = re.compile(r"(?P<name>[\w.\-]+)\s*(?:\(?>=\s*(?P<least>[\w.]+)\)?)?")


def dependencies() -> Iterator[Check]:
    """Python, mocap-id itself, and every package that it requires."""
    yield _python()
    try:
        wanted = metadata.requires(_PACKAGE) or []
    except metadata.PackageNotFoundError:
        yield Check(
            _PACKAGE,
            "warn",
            f"{__version__}, not installed as a package: what it requires cannot be looked up",
            "install it: pip install .",
        )
        return
    yield Check(_PACKAGE, "ok", __version__)
    for requirement in wanted:
        match = _REQUIREMENT.match(requirement)
        if match and "extra ==" not in requirement:
            yield package(match["name"], match["least"])


def _python() -> Check:
    there = platform.python_version()
    if release(there) >= release(_LEAST_PYTHON):
        return Check("Python", "ok", there)
    return Check("Python", "fail", there, f"use Python {_LEAST_PYTHON} or later")


def package(name: str, least: str | None) -> Check:
    """One package: installed, at least this version, and it can be imported."""
    advice = f"pip install '{name}{f'>={least}' if least else ''}'"
    try:
        there = metadata.version(name)
    except metadata.PackageNotFoundError:
        return Check(name, "fail", "not installed", advice)
    if least and release(there) < release(least):
        return Check(name, "fail", f"{there}, at least {least} is needed", advice)
    try:
        importlib.import_module(_MODULES.get(name.lower(), name.replace("-", "_")))
    except Exception as error:  # noqa: BLE001  a broken package may raise anything while it loads
        what = str(error).partition("\n")[0]
        return Check(name, "fail", f"{there} does not load ({type(error).__name__}: {what})", f"reinstall it: {advice}")
    return Check(name, "ok", there)
