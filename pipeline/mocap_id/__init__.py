"""mocap-id: an individual's skeleton, joint states and inertial parameters from one recording.

The names in ``__all__`` are public and described in docs/python.md. Everything else is private and may change.
"""

from importlib import import_module

__version__ = "1.0.0rc1"

_MODULES = {
    "run": "interface.running",
    "open": "interface.running",
    "Run": "interface.run_result",
    "Verdict": "interface.run_result",
    "Reason": "verdict",
    "study": "interface.studies",
    "Study": "interface.studies",
    "Figure": "interface.figures",
    "simulate": "interface.simulated",
    "read": "recording.reader",
    "Recording": "recording.model",
    "Plate": "recording.model",
    "MocapIdError": "errors",
    "ConfigError": "errors",
    "RecordingError": "errors",
    "Refused": "errors",
    "NumericalError": "errors",
    "StoreError": "errors",
}
"""Module of each public name; it is imported when the name is first used."""

__all__ = ["__version__", *_MODULES]  # noqa: PLE0604  the names are texts


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
