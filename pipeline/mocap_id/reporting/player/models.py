"""Bokeh's objects as its script reads them, without Bokeh's own Python classes.

Those take longer to import and to fill in than everything that they describe takes to draw. What is not said here is
what Bokeh takes for granted; tests hold every name and value against its classes.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import bokeh
import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Model:
    """One of Bokeh's objects; another that holds it, too, refers to it.

    Parameters
    ----------
    name : str
        Of Bokeh's class.
    attributes : dict
        What differs from its defaults: numbers, texts, lists, maps, and other objects.
    """

    name: str
    attributes: Mapping[str, Any]


def model(name: str, /, **attributes: Any) -> Model:
    """An object of this class with these attributes."""
    return Model(name, attributes)


def column(name: str) -> dict[str, str]:
    """A property of a glyph that a column of its source holds."""
    return {"type": "field", "field": name}


def value(fixed: float | str | None) -> dict[str, Any]:
    """A property of a glyph that is the same for all rows."""
    return {"type": "value", "value": fixed}


def source(columns: Mapping[str, Sequence[str] | ArrayLike], name: str | None = None) -> Model:
    """A table of texts (sequences) and of numbers (arrays), which goes by ``name`` in the page's script."""
    entries = [[key, _numbers(held) if isinstance(held, np.ndarray) else held] for key, held in columns.items()]
    return model("ColumnDataSource", data={"type": "map", "entries": entries}, **({"name": name} if name else {}))


def glyph(data: Model, shape: Model) -> Model:
    """What is drawn of a table."""
    return model("GlyphRenderer", data_source=data, glyph=shape)


def document(title: str, roots: Sequence[Model]) -> tuple[dict[str, Any], list[str]]:
    """The document, ready for JSON, and the ids of its roots.

    Ids count from one, in the order in which the objects are met.
    """
    ids: dict[Model, str] = {}

    def told(one: Any) -> Any:
        if isinstance(one, Mapping):
            return {key: told(held) for key, held in one.items()}
        if isinstance(one, list | tuple):
            return [told(held) for held in one]
        if not isinstance(one, Model):
            return one
        if one in ids:
            return {"id": ids[one]}
        ids[one] = f"p{len(ids) + 1}"
        return {"type": "object", "name": one.name, "id": ids[one], "attributes": told(one.attributes)}

    whole = {"version": bokeh.__version__, "title": title, "roots": told(roots)}
    return whole, [ids[root] for root in roots]


def _numbers(values: np.ndarray[Any, Any]) -> dict[str, Any]:
    """An array as Bokeh packs one: little-endian, compressed, in letters; the time of packing is left out."""
    little = values.astype(values.dtype.newbyteorder("<"))
    packed = gzip.compress(little.tobytes(), compresslevel=2, mtime=1)  # 0 would let the platform show
    return {
        "type": "ndarray",
        "array": {"type": "bytes", "data": base64.b64encode(packed).decode("ascii")},
        "shape": list(values.shape),
        "dtype": values.dtype.name,
        "order": "little",
    }
