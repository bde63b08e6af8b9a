"""Commands on many trials, on the results of finished trials, on recordings or on the installation.

After ``from mocap_id import workflows``, a workflow is imported when it is first used, for example in
``workflows.regress.compare_runs(…)``, so that no command has to wait for all of them.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mocap_id.workflows import (
        batch,
        code_lookup,
        doctor,
        export,
        figures,
        parallel,
        regress,
        run_folder,
        study,
        transfer,
    )

__all__ = [
    "batch",
    "code_lookup",
    "doctor",
    "export",
    "figures",
    "parallel",
    "regress",
    "run_folder",
    "study",
    "transfer",
]


def __getattr__(name: str) -> ModuleType:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")
