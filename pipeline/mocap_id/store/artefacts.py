"""What a stage takes and gives: tables, trees and documents, each with its schema."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from mocap_id.verdict import Reason

Facts: TypeAlias = Mapping[str, Any]
"""Numbers and choices beside the data, JSON values only; None where a quantity could not be determined."""

Node: TypeAlias = "np.ndarray[Any, Any] | str | float | int | Mapping[str, Node]"


@dataclass(frozen=True)
class Column:
    """One column of a table: its name, numpy kind and unit (``"1"`` = dimensionless, ``""`` = not a quantity)."""

    name: str
    dtype: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class TableSchema:
    """The columns of a Parquet artefact.

    ``repeated`` columns carry ``{k}`` in their name and come once per joint (``theta_{k}``) or plate (``Fx_p{k}``),
    in the order of ``k`` first, k = 1, 2, …
    """

    file: str
    version: int
    columns: tuple[Column, ...]
    repeated: tuple[Column, ...] = ()


@dataclass(frozen=True)
class TreeSchema:
    """The nodes of an HDF5 artefact: path in the file → column-like description."""

    file: str
    version: int
    nodes: tuple[Column, ...]


@dataclass(frozen=True)
class Table:
    """A Parquet artefact in memory."""

    schema: TableSchema
    frame: pd.DataFrame
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class Tree:
    """An HDF5 artefact in memory: nested names → arrays, strings, numbers."""

    schema: TreeSchema
    data: Mapping[str, Node]
    facts: Facts = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True)
class Document:
    """A file for people or other programs, written as it is."""

    file: str
    content: bytes


Artefact: TypeAlias = Table | Tree
