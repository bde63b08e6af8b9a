"""Import of packages that are installed only with an extra of mocap-id, such as ``mocap-id[cluster]``."""

from __future__ import annotations

import importlib
from typing import Any

from mocap_id.errors import ConfigError


def optional(module: str, extra: str, purpose: str) -> Any:
    """Import a module of an optional package, which an extra of mocap-id installs.

    ``purpose`` is the function or command that needs the module. Raises ConfigError if the package is not installed;
    the message contains the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed, but {purpose} needs it: pip install 'mocap-id[{extra}]'"
        ) from error
