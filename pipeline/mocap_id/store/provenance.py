"""Provenance of artefacts, stored in Parquet metadata and HDF5 attributes, and records of the outputs of stages.

Artefacts store their origin themselves; documents, such as the report, cannot. A record contains the origin of a
stage's outputs and the hash of every file at the time of writing. It proves without decoding any file that the files
are unchanged, so that a run finds quickly that there is nothing to compute.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from mocap_id import __version__
from mocap_id.verdict import Level, Reason

if TYPE_CHECKING:
    from mocap_id.store.artefacts import Facts


@dataclass(frozen=True)
class Column:
    """Name, numpy type, unit and meaning of one column.

    The unit is ``"1"`` for a dimensionless quantity and ``""`` if the column is not a quantity.
    """

    name: str
    dtype: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class TableSchema:
    """The columns of a Parquet artefact.

    The names of ``repeated`` columns contain ``{k}``. They occur once per joint (``theta_{k}``) or plate (``Fx_p{k}``),
    ordered by k = 1, 2, … An ``optional`` group is present completely or not at all. A group with ``{k}`` occurs once
    for every k; a group with ``{name}`` occurs once for every segment or angle that its first column names. A ``long``
    table has a row for every frame and marker, and is a ``LongTable`` in memory.
    """

    file: str
    version: int
    columns: tuple[Column, ...]
    repeated: tuple[Column, ...] = ()
    optional: tuple[tuple[Column, ...], ...] = ()
    long: bool = False


@dataclass(frozen=True)
class TreeSchema:
    """The nodes of an HDF5 artefact. Each is described like a column; its name is its path in the file.

    A group of ``optional`` nodes is present completely or not at all.
    """

    file: str
    version: int
    nodes: tuple[Column, ...]
    optional: tuple[tuple[Column, ...], ...] = ()

    def expand_nodes(self, names: Collection[str]) -> tuple[Column, ...]:
        """Return all nodes of the schema that a tree with nodes of these names must have."""
        groups = [group for group in self.optional if any(node.name in names for node in group)]
        return self.nodes + tuple(node for group in groups for node in group)


def _read_schemas() -> Iterator[TableSchema | TreeSchema]:
    """Yield the schemas in the order of the file; an entry with nodes is a tree."""
    for file, entry in tomllib.loads(Path(__file__).with_name("schemas.toml").read_text("utf-8")).items():
        optional = tuple(_build_columns(group) for group in entry.get("optional", {}).values())
        if "nodes" in entry:
            yield TreeSchema(file, entry["version"], _build_columns(entry["nodes"]), optional)
        else:
            columns, repeated = _build_columns(entry["columns"]), _build_columns(entry.get("repeated", ()))
            yield TableSchema(file, entry["version"], columns, repeated, optional, entry.get("long", False))


def _build_columns(rows: Iterable[Any]) -> tuple[Column, ...]:
    return tuple(Column(*row) for row in rows)


SCHEMAS: dict[str, TableSchema | TreeSchema] = {schema.file: schema for schema in _read_schemas()}
"""Schemas of all artefacts by file name."""

TABLES = {file: schema for file, schema in SCHEMAS.items() if isinstance(schema, TableSchema)}
TREES = {file: schema for file, schema in SCHEMAS.items() if isinstance(schema, TreeSchema)}

PLANAR = TABLES["planar.parquet"]
WRENCH = TABLES["wrench.parquet"]
SEGMENTS = TABLES["segments.parquet"]
CHAIN = TREES["chain.h5"]
STATES = TABLES["states.parquet"]
MARKERS = TABLES["markers.parquet"]
SKIN = TREES["skin.h5"]
ENCODER = TABLES["encoder.parquet"]
POSES = TABLES["poses.parquet"]
ANGLES = TABLES["angles.parquet"]
EVENTS = TABLES["events.parquet"]
DYNAMICS_TABLE = TABLES["dynamics.parquet"]
DYNAMICS_TREE = TREES["dynamics.h5"]
PHASES = TABLES["phases.parquet"]

RISE = EVENTS.optional[0]
"""Additional columns of events.parquet for a sit-to-stand."""


PREFIX = "mocap-id."
"""Prefix of every key of this program in a file's metadata."""


@dataclass(frozen=True)
class Origin:
    """The computation that made an output: stage, settings and inputs."""

    stage: str  # name of the stage
    stage_version: int
    # effective settings and the trial keys that the stage reads; file names without folders
    parameters: Mapping[str, Any]
    inputs: Mapping[str, str]  # cache key of every artefact that was read, and hash of every user file
    key: str  # cache key: hash of all fields above
    seconds: float  # duration of the computation, not part of the key
    product: str = __version__  # version of mocap-id


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
            PREFIX + "reasons": dumps([reason.as_dict() for reason in self.reasons]),
        }

    @classmethod
    def decode(cls, strings: Mapping[str, str]) -> Provenance:
        """Read a provenance from the strings of :meth:`encode`; raises one of :data:`INVALID_RECORD` on failure."""
        text = {key.removeprefix(PREFIX): value for key, value in strings.items() if key.startswith(PREFIX)}
        origin = Origin(
            stage=text["stage"],
            stage_version=int(text["stage_version"]),
            parameters=_read_mapping(text["parameters"]),
            inputs=_read_mapping(text["inputs"]),
            key=text["key"],
            seconds=float(text["seconds"]),
            product=text["product"],
        )
        return cls(
            schema=text["schema"],
            schema_version=int(text["schema_version"]),
            origin=origin,
            facts=_read_mapping(text["facts"]),
            reasons=_read_reasons(text["reasons"]),
        )


INVALID_RECORD = (AttributeError, KeyError, OSError, RecursionError, TypeError, ValueError)
"""Exceptions for an invalid record."""


@dataclass(frozen=True)
class Document:
    """A file of a run that is not an artefact, such as the report; it is written unchanged."""

    file: str
    content: bytes


@dataclass(frozen=True)
class Record:
    """Record of the outputs of a stage, by file name, at the time of writing."""

    origin: Origin
    documents: Mapping[str, str]  # hash of each
    artefacts: Mapping[str, tuple[int, str]]  # schema version and hash of each

    def encode(self) -> bytes:
        """Return the bytes of the record's file."""
        strings: dict[str, Any] = dict(Provenance("record", 2, self.origin, {}, ()).encode())
        checksums = {file: {"schema_version": at, "digest": digest} for file, (at, digest) in self.artefacts.items()}
        return json.dumps(strings | {"documents": self.documents, "artefacts": checksums}, indent=1).encode()

    @classmethod
    def decode(cls, content: bytes) -> Record:
        """Read a record from its bytes; raises one of :data:`INVALID_RECORD` if it is invalid."""
        strings = json.loads(content)
        documents = {str(file): str(digest) for file, digest in strings["documents"].items()}
        checksums = strings["artefacts"].items()
        if any(len(each) != 2 for _, each in checksums):
            raise ValueError("a checksum has other keys")
        artefacts = {str(file): (each["schema_version"], each["digest"]) for file, each in checksums}
        return cls(Provenance.decode(strings).origin, documents, artefacts)


def convert_as_stored(facts: Facts, reasons: Iterable[Reason]) -> tuple[Facts, tuple[Reason, ...]]:
    """Return facts and reasons as they would be read from a file; TypeError if a fact is not a JSON value."""
    return _read_mapping(dumps(facts)), _read_reasons(dumps([reason.as_dict() for reason in reasons]))


def _read_mapping(text: str) -> dict[str, Any]:
    """Read a JSON object; TypeError if the text contains another kind of value."""
    found = json.loads(text)
    if not isinstance(found, dict):
        raise TypeError(f"expected an object, found {type(found).__name__}")
    to_json_types(found)  # raises RecursionError for a file with values nested too deep to process
    return found


def _read_reasons(text: str) -> tuple[Reason, ...]:
    """Read reasons from a JSON list; TypeError if a field has the wrong type."""
    reasons = tuple(Reason.from_dict(reason) for reason in json.loads(text))
    for reason in reasons:
        sound = isinstance(reason.code, str) and isinstance(reason.message, str) and reason.level in get_args(Level)
        if not sound or any(not isinstance(number, int | float | None) for number in (reason.value, reason.limit)):
            raise TypeError(f"expected a reason, found {str(reason)[:80]}")
    return reasons


def dumps(value: Any) -> str:
    """Return canonical JSON: sorted keys, no spaces, numpy values as plain values, NaN and infinities as null."""
    return json.dumps(to_json_types(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def to_json_types(value: Any) -> Any:
    """Return a value in JSON types; a non-finite number becomes None, which means "could not be determined".

    Raises TypeError if the value cannot be expressed in JSON.
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case dict() | Mapping():  # a dict is recognised faster than a Mapping
            return {str(key): to_json_types(item) for key, item in value.items()}
        case list() | tuple():
            return [to_json_types(item) for item in value]
    if hasattr(value, "tolist"):  # an array or a number of numpy, which a run with nothing to do does not import
        return to_json_types(value.tolist())
    raise TypeError(f"facts and parameters must be JSON values, not {type(value).__name__}: {value!r}")
