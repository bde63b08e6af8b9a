"""Packages that are installed only with an extra of mocap-id, such as ``mocap-id[cluster]``."""

from __future__ import annotations

import importlib
from typing import Any

from mocap_id.errors import ConfigError


def optional(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
    extra : str
        The extra that installs it.
    purpose : str
        What needs it, for the message.

    Raises
    ------
    ConfigError
        It is not installed; the message has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed, but {purpose} needs it: pip install 'mocap-id[{extra}]'"
        ) from error
