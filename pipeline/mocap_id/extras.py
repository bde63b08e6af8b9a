"""Import of packages that are installed only with an extra of mocap-id, such as ``mocap-id[cluster]``."""

from __future__ import annotations

import importlib
from typing import Any

from mocap_id.errors import ConfigError


def optional(module: str, extra: str, purpose: str) -> Any:
    """Import a module that belongs to an optional package.

    Raises ConfigError if the package is not installed; the message contains the command that installs it.

    Parameters
    ----------
    module : str
        Name of the module.
    extra : str
        Extra of mocap-id that installs the package.
    purpose : str
        Function or command that needs the module, for the message.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{error.name} is not installed, but {purpose} needs it: pip install 'mocap-id[{extra}]'"
        ) from error
