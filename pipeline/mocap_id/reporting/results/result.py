"""A result of a command: a JSON document, tables and other files, which are written together or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id.store import hash_bytes
from mocap_id.store.atomic import write_files
from mocap_id.store.ownership import Owner, check_owner, store_owner

if TYPE_CHECKING:
    from mocap_id.reporting.results.columns import ResultTable


@dataclass(frozen=True)
class Result:
    """The output of a command: a JSON document (``file``), tables and other files."""

    kind: str  # kind of the result, such as ``study``; the schema of the document is ``mocap-id/<kind>``
    file: str  # name of the JSON document
    content: Mapping[str, Any]  # content of the document after the keys for schema and version; without NaN
    # Tables by name; each is written as CSV and Parquet.
    tables: Mapping[str, ResultTable] = field(default_factory=dict)
    # Function that returns the other files, such as page and figures, by name. It is called once.
    other_files: Callable[[], Mapping[str, bytes]] = dict
    hashed: bool = False  # whether the document ends with the hash of every other file
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
        return head | {"files": {name: hash_bytes(file) for name, file in self.files.items()}} if self.hashed else head

    def write(self, folder: Path, owner: Owner) -> tuple[str, ...]:
        """Write all files, or none if one cannot be written; return their names, the document first.

        Raises
        ------
        StoreError
            The folder cannot be written, or contains this document of another ``owner``.
        """
        check_owner(folder, owner, self.file)
        text = json.dumps(self.document, indent=self.indent, ensure_ascii=False, allow_nan=False) + self.end
        write_files(folder, {**self.files, self.file: text.encode()})
        store_owner(folder, owner, self.file)
        return (self.file, *self.files)


def make_text_file(lines: Iterable[str]) -> bytes:
    """Return lines as the content of a text file."""
    return "".join(f"{line}\n" for line in lines).encode()
