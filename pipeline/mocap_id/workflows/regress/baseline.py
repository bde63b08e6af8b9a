"""The baseline: a JSON file that a person can read and whose tolerances can be edited."""

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
    "`mocap-id regress` fails where a number moves by more than its tolerance. `tolerances` holds your own, by "
    "patterns of names such as `lengths_m.*` or `s01/dynamics.*`; the last that fits counts, and an update keeps them."
)


@dataclass(frozen=True)
class Baseline:
    """Expected results of trials.

    Parameters
    ----------
    trials : mapping
        Trial → name of a quantity → quantity.
    tolerances : mapping
        Pattern of ``NAME`` or ``TRIAL/NAME`` → tolerance, in the quantity's unit.
    product : str
        Version of this program that computed them.
    """

    trials: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    product: str = __version__

    def tolerance(self, trial: str, name: str, usual: float) -> float:
        """Return the tolerance of a number: the user's, or else the usual one."""
        own = [
            value
            for pattern, value in self.tolerances.items()
            if fnmatchcase(name, pattern) or fnmatchcase(f"{trial}/{name}", pattern)
        ]
        return own[-1] if own else usual

    @classmethod
    def read(cls, file: Path) -> Baseline:
        """Read the file.

        Raises
        ------
        RecordingError
            The file is missing, or is not a baseline.
        """
        try:
            data = json.loads(file.read_text("utf-8"))
            if (data["schema"], data["version"]) != (_SCHEMA, _VERSION):
                raise ValueError(f"it says {data['schema']!r}, version {data['version']!r}")
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
            raise RecordingError(f"{file}: cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            message = f"not a baseline of version {_VERSION} ({error}): expected what `regress --update` writes"
            raise RecordingError(f"{file}: {message}") from error

    def write(self, file: Path) -> None:
        """Write the file completely or not at all; StoreError if it cannot be written."""
        trials = {
            trial: {name: _plain(one) for name, one in quantities.items()} for trial, quantities in self.trials.items()
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


def rounded(value: Value) -> Value:
    """Return a value with the precision of the file."""
    return value if value is None or isinstance(value, str) else float(f"{value:.{_DIGITS}g}")


def _plain(one: Quantity) -> dict[str, Any]:
    if isinstance(one.value, str):
        return {"value": one.value}
    return {"value": rounded(one.value), "tolerance": rounded(one.tolerance), "unit": one.unit}
