"""Provenance of an artefact, stored in Parquet schema metadata, HDF5 attributes and the records of stages."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

from mocap_id import __version__
from mocap_id.verdict import Level, Reason

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Facts

PREFIX = "mocap-id."
"""Prefix of every key of this program in a file's metadata."""


@dataclass(frozen=True)
class Origin:
    """The computation that made an output: stage, settings and inputs.

    Parameters
    ----------
    stage, stage_version
        Name and version of the stage.
    parameters : mapping
        The stage's effective settings and the trial keys that it reads; file names without folders.
    inputs : mapping of str to str
        Cache key of every artefact that was read, and hash of every user file.
    key : str
        Cache key: hash of all fields above.
    seconds : float
        Duration of the computation; not part of the key.
    product : str
        Version of mocap-id.
    """

    stage: str
    stage_version: int
    parameters: Mapping[str, Any]
    inputs: Mapping[str, str]
    key: str
    seconds: float
    product: str = __version__


@dataclass(frozen=True)
class Provenance:
    """Everything that a file stores beside its data."""

    schema: str
    schema_version: int
    origin: Origin
    facts: Facts
    reasons: tuple[Reason, ...]

    def encode(self) -> dict[str, str]:
        """Return the provenance as strings by key; nested values are JSON."""
        return {
            PREFIX + "schema": self.schema,
            PREFIX + "schema_version": str(self.schema_version),
            PREFIX + "stage": self.origin.stage,
            PREFIX + "stage_version": str(self.origin.stage_version),
            PREFIX + "product": self.origin.product,
            PREFIX + "parameters": dumps(self.origin.parameters),
            PREFIX + "inputs": dumps(self.origin.inputs),
            PREFIX + "key": self.origin.key,
            PREFIX + "seconds": repr(float(self.origin.seconds)),
            PREFIX + "facts": dumps(self.facts),
            PREFIX + "reasons": _encoded(self.reasons),
        }

    @classmethod
    def decode(cls, strings: Mapping[str, str]) -> Provenance:
        """Read a provenance from the strings of :meth:`encode`.

        Raises
        ------
        AttributeError, KeyError, RecursionError, TypeError, ValueError
            A key is missing or malformed.
        """
        text = {key.removeprefix(PREFIX): value for key, value in strings.items() if key.startswith(PREFIX)}
        origin = Origin(
            stage=text["stage"],
            stage_version=int(text["stage_version"]),
            parameters=_mapping(text["parameters"]),
            inputs=_mapping(text["inputs"]),
            key=text["key"],
            seconds=float(text["seconds"]),
            product=text["product"],
        )
        return cls(
            schema=text["schema"],
            schema_version=int(text["schema_version"]),
            origin=origin,
            facts=_mapping(text["facts"]),
            reasons=_reasons(text["reasons"]),
        )


def json_round_trip(facts: Facts, reasons: Iterable[Reason]) -> tuple[Facts, tuple[Reason, ...]]:
    """Return facts and reasons as they would be read from a file; TypeError where a fact is not a JSON value."""
    return _mapping(dumps(facts)), _reasons(_encoded(reasons))


def _encoded(reasons: Iterable[Reason]) -> str:
    return dumps([reason.as_dict() for reason in reasons])


def _mapping(text: str) -> dict[str, Any]:
    """Read a JSON object."""
    found = json.loads(text)
    if not isinstance(found, dict):
        raise TypeError(f"expected an object, found {type(found).__name__}")
    plain(found)  # raises RecursionError for a file with values nested too deep to process
    return found


def _reasons(text: str) -> tuple[Reason, ...]:
    """Read reasons from a JSON list; TypeError where a field has the wrong type."""
    reasons = tuple(Reason.from_dict(reason) for reason in json.loads(text))
    for reason in reasons:
        sound = isinstance(reason.code, str) and isinstance(reason.message, str) and reason.level in get_args(Level)
        if not sound or any(not isinstance(number, int | float | None) for number in (reason.value, reason.limit)):
            raise TypeError(f"expected a reason, found {str(reason)[:80]}")
    return reasons


def dumps(value: Any) -> str:
    """Return canonical JSON: sorted keys, no spaces, numpy values as plain values, NaN and infinities as null."""
    return json.dumps(plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def plain(value: Any) -> Any:
    """Return a value in JSON types; a non-finite number becomes None, which means "could not be determined".

    Raises
    ------
    TypeError
        The value cannot be expressed in JSON.
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case dict() | Mapping():  # a dict is recognised faster
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array or a number of numpy, which a run with nothing to do does not import
        return plain(value.tolist())
    raise TypeError(f"facts and parameters hold JSON values only, not {type(value).__name__}: {value!r}")
