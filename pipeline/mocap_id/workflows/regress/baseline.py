"""The baseline of a regression check: a JSON file with expected results, whose tolerances the user may edit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mocap_id import __version__
from mocap_id.errors import RecordingError
from mocap_id.store.atomic import replace_together
from mocap_id.workflows.regress.quantities import Quantity, Value

_SCHEMA = "mocap-id/baseline"
_VERSION = 1
_DIGITS = 9
_ABOUT = (
    "`mocap-id regress` fails if a number changes by more than its tolerance. `tolerances` contains your own "
    "tolerances by patterns of names, such as `lengths_m.*` or `s01/dynamics.*`; the last pattern that fits is used. "
    "An update keeps your tolerances."
)


@dataclass(frozen=True)
class Baseline:
    """Expected results of trials."""

    trials: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)  # quantities by trial and name
    # the user's tolerances by pattern of ``NAME`` or ``TRIAL/NAME``, in the unit of the quantity
    tolerances: Mapping[str, float] = field(default_factory=dict)
    product: str = __version__  # version of the program that computed the results

    def find_tolerance(self, trial: str, name: str, usual: float) -> float:
        """Return the user's tolerance of a number, or the ``usual`` tolerance if the user gives none."""
        own = [
            value
            for pattern, value in self.tolerances.items()
            if fnmatchcase(name, pattern) or fnmatchcase(f"{trial}/{name}", pattern)
        ]
        return own[-1] if own else usual

    @classmethod
    def read(cls, file: Path) -> Baseline:
        """Read a baseline.

        Raises
        ------
        RecordingError
            The file is missing, cannot be read, or is not a baseline.
        """
        try:
            data = json.loads(file.read_text("utf-8"))
            if (data["schema"], data["version"]) != (_SCHEMA, _VERSION):
                raise ValueError(f"its schema is {data['schema']!r}, version {data['version']!r}")
            trials = {
                trial: {name: Quantity(**one) for name, one in quantities.items()}
                for trial, quantities in data["trials"].items()
            }
            tolerances = {pattern: float(value) for pattern, value in data["tolerances"].items()}
            return cls(trials, tolerances, str(data["product"]))
        except FileNotFoundError as error:
            raise RecordingError(
                f"{file}: no such file: create it from the trials' current results with `--update`"
            ) from error
        except OSError as error:
            raise RecordingError(f"{file}: the file cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            message = f"not a baseline of version {_VERSION} ({error}); expected a file from `regress --update`"
            raise RecordingError(f"{file}: {message}") from error

    def write(self, file: Path) -> None:
        """Write the file completely or not at all; raise StoreError if the file cannot be written."""
        trials = {
            trial: {name: _as_json(one) for name, one in quantities.items()}
            for trial, quantities in self.trials.items()
        }
        data = {
            "schema": _SCHEMA,
            "version": _VERSION,
            "about": _ABOUT,
            "product": self.product,
            "tolerances": dict(self.tolerances),
            "trials": trials,
        }
        file = file.absolute()
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        replace_together(file.parent, {file.name: text.encode()})


def round_value(value: Value) -> Value:
    """Return a value, rounded to the precision of the baseline's file; text and None are not changed."""
    return value if value is None or isinstance(value, str) else float(f"{value:.{_DIGITS}g}")


def _as_json(one: Quantity) -> dict[str, Any]:
    if isinstance(one.value, str):
        return {"value": one.value}
    return {"value": round_value(one.value), "tolerance": round_value(one.tolerance), "unit": one.unit}
