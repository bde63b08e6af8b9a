"""A result of a command: a JSON document, tables and other files, which are written together or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id.errors import StoreError
from mocap_id.store import hash_bytes
from mocap_id.store.atomic import write_files
from mocap_id.store.folder import describe_conflict

if TYPE_CHECKING:
    from mocap_id.reporting.results.columns import ResultTable


@dataclass(frozen=True)
class CommandResult:
    """The output of a command: a JSON document (``file``), tables and other files."""

    kind: str  # kind of the result, such as ``study``; the schema of the document is ``mocap-id/<kind>``
    file: str  # name of the JSON document
    content: Mapping[str, Any]  # content of the document after the keys for schema and version; without NaN
    # Tables by name; each is written as CSV and Parquet.
    tables: Mapping[str, ResultTable] = field(default_factory=dict)
    # Function that returns the other files, such as page and figures, by name. It is called once.
    other_files: Callable[[], Mapping[str, bytes]] = dict
    hashed: bool = False  # whether the document ends with the hash of every other file
    # Names of what the result is made from, and hashes that identify it; the document contains them.
    made_from: Mapping[str, Sequence[str]] | None = None
    indent: int = 1  # indentation of the document
    end: str = "\n"  # last characters of the document

    @cached_property
    def files(self) -> dict[str, bytes]:
        """All files except the document, by name."""
        files = {}
        for name, table in self.tables.items():
            files[f"{name}.csv"] = table.csv()
            files[f"{name}.parquet"] = table.parquet(self.kind)
        return {**files, **self.other_files()}

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """Content of the JSON document, including schema, version and, if requested, the hashes of all other files."""
        head = {"schema": f"mocap-id/{self.kind}", "version": 1, **self.content}
        head |= {} if self.made_from is None else {"made_from": self.made_from}
        return head | {"files": {name: hash_bytes(file) for name, file in self.files.items()}} if self.hashed else head

    def write(self, folder: Path) -> tuple[str, ...]:
        """Write all files, or none if one cannot be written; return their names, the document first.

        Raises
        ------
        StoreError
            The folder cannot be written, or contains this document, made from something else.
        """
        before = None if self.made_from is None else _read_made_from(folder / self.file)
        if before is not None and self.made_from is not None and not {*before["hashes"]} & {*self.made_from["hashes"]}:
            names = (", ".join(each["names"]) for each in (before, self.made_from))
            raise StoreError(describe_conflict(folder / self.file, *names))
        text = json.dumps(self.document, indent=self.indent, ensure_ascii=False, allow_nan=False) + self.end
        write_files(folder, {**self.files, self.file: text.encode()})
        return (self.file, *self.files)


def _read_made_from(file: Path) -> Mapping[str, Sequence[str]] | None:
    """Return from what an existing document was made; None if it does not say so."""
    try:
        found = json.loads(file.read_text("utf-8"))["made_from"]
        return {key: [str(text) for text in found[key]] for key in ("names", "hashes")}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def make_text_file(lines: Iterable[str]) -> bytes:
    """Return lines as the content of a text file."""
    return "".join(f"{line}\n" for line in lines).encode()
