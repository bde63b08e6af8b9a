"""Damage specific to Parquet and to JSON records: columns, types, bombs, metadata."""

from __future__ import annotations

import io
import json
from collections.abc import Callable

import mutations_bytes
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

TEXTS = (
    *(
        "",
        "null",
        "[]",
        "{}",
        "0",
        "-1",
        "1e999",
        "NaN",
        "[1,2]",
        '{"a":[]}',
        '"x"',
        "true",
        "\x00",
        "ü",
        "nope",
        "9" * 5000,
    ),
    *(
        "[" * 100_000,
        "[" * 900 + "]" * 900,
        '{"a":' * 990 + "1" + "}" * 990,
        '[{"code": 1}]',
        '[{"code":"a","message":"b","x":1}]',
    ),
    *(
        '[{"code":"a","message":null}]',
        '[{"code":"a","message":"b","level":"grave"}]',
        "[[1]]",
        '{"a": 1e400}',
        "x" * 100_000,
    ),
)
META = ("schema", "schema_version", "stage", "stage_version", "parameters", "inputs", "key", "seconds", "product")
META = (*META, "content", "facts", "reasons")


def text(rng: np.random.Generator) -> str:
    """Return a problematic string."""
    return TEXTS[rng.integers(len(TEXTS))]


def named(rng: np.random.Generator) -> str:
    """Return a key of our provenance."""
    return "mocap-id." + META[rng.integers(len(META))]


def parquet_columns(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    """Remove, add, move, rename or convert columns."""
    k, what = int(rng.integers(table.num_columns)), int(rng.integers(9))
    name, column = table.column_names[k], table.column(k)
    if what == 0:
        return table.remove_column(k)
    if what == 1:
        return table.select([*reversed(range(table.num_columns))])
    if what == 2:
        names = [*table.column_names]
        names[k] = str(
            rng.choice(["", "x", "theta_0", "theta_99999999999999999999", name.upper(), names[0], "a" * 5000])
        )
        return table.rename_columns(names)
    if what == 3:
        kinds = (pa.string(), pa.float32(), pa.int8(), pa.large_string(), pa.binary(), pa.date32(), pa.decimal128(38))
        kind = kinds[rng.integers(len(kinds))]
        try:
            return table.set_column(k, name, column.cast(kind))
        except (pa.ArrowException, pa.ArrowInvalid):
            return table.set_column(k, name, pa.nulls(len(table), kind))
    if what == 4:
        return table.append_column(name, column)
    if what == 5:
        return table.set_column(k, name, pa.nulls(len(table), column.type))
    if what == 6:
        nested = pa.array([[{"a": [1, 2]}]] * len(table))
        return table.set_column(k, name, nested)
    if what == 7:
        count = int(rng.choice([3, 300, 3000]))
        more = pa.table({f"theta_{i}": pa.nulls(len(table), pa.float64()) for i in range(1, count)})
        for extra in more.column_names:
            if extra not in table.column_names:
                table = table.append_column(extra, more.column(extra))
        return table
    return table.slice(0, int(rng.integers(0, len(table) + 1)))


def parquet_metadata(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    metadata = dict(table.schema.metadata or {})
    what = int(rng.integers(5))
    if what == 0:
        metadata.pop(named(rng).encode(), None)
    elif what == 1:
        metadata[named(rng).encode()] = text(rng).encode()
    elif what == 2:
        metadata[named(rng).encode()] = rng.bytes(20)
    elif what == 3:
        metadata[b"pandas"] = text(rng).encode()
    else:
        metadata = {b"\xff\xfe": b"\xff"} | metadata
    return table.replace_schema_metadata(metadata)


def parquet_bomb(table: pa.Table, rng: np.random.Generator) -> pa.Table:
    """Return a small file with a huge number of identical rows."""
    rows = int(rng.choice([1_000_000, 20_000_000]))
    names = [name for name in table.column_names if table.schema.types[table.schema.names.index(name)] != pa.string()][
        :2
    ]
    columns = [pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, np.int8)), pa.array(["a" * 100])) for _ in names]
    return pa.table(dict(zip(names, columns, strict=True))).replace_schema_metadata(table.schema.metadata)


def _edit_parquet(data: bytearray, rng: np.random.Generator) -> None:
    if rng.random() < 0.5:
        mutations_bytes.apply(data, rng)
        return
    try:
        table = pq.read_table(io.BytesIO(bytes(data)))
    except (pa.ArrowException, OSError):
        return
    for _ in range(int(rng.integers(1, 3))):
        chance = rng.random()
        make = parquet_columns if chance < 0.55 else parquet_metadata if chance < 0.97 else parquet_bomb
        if table.num_columns:
            table = make(table, rng)
        if make is parquet_bomb:
            break  # further changes of so many rows would exhaust the memory
    stream = io.BytesIO()
    compression = str(rng.choice(["zstd", "snappy", "gzip", "none"]))
    version = str(rng.choice(["1.0", "2.6"]))
    pq.write_table(table, stream, compression=compression, version=version, data_page_version=version[0] + ".0")
    data[:] = stream.getvalue()
    if rng.random() < 0.15:
        mutations_bytes.apply(data, rng, 1)


def record(data: bytearray, rng: np.random.Generator) -> None:
    """Damage the JSON record beside the documents."""
    if rng.random() < 0.35:
        mutations_bytes.apply(data, rng)
        return
    try:
        found = json.loads(bytes(data))
    except ValueError:
        return
    documents = (
        *(
            "[]",
            "1",
            "null",
            '["../x"]',
            '{"../../x": "y"}',
            '{"a\\u0000b": "y"}',
            '{"/etc/passwd": "y"}',
            '{"": "y"}',
            '{".": ""}',
        ),
        *(
            '{"figures": "y"}',
            '{"figures/../../x": "y"}',
            '{"report.html": 5}',
            '{"lock": []}',
            '{"' + "x" * 5000 + '": "y"}',
        ),
        *(
            '{"planar.parquet": "y"}',
            '{".mocap-id/lock": "y"}',
            "[" * 50_000,
            '{"\\ud800": "y"}',
            '{"trial.yaml": "y"}',
        ),
    )
    for _ in range(int(rng.integers(1, 3))):
        key = str(rng.choice([*found])) if isinstance(found, dict) and found else "x"
        what = int(rng.integers(5))
        if not isinstance(found, dict):
            break
        if what == 0:
            found["documents"] = documents[rng.integers(len(documents))]
        elif what == 1:
            found.pop(key, None)
        elif what == 2:
            found[key] = text(rng)
        elif what == 3:
            found[key] = (None, 1, [], {}, True, 1.5)[rng.integers(6)]
        else:
            found = ([found], None, 1, "x")[rng.integers(4)]
    data[:] = json.dumps(found).encode()
    if rng.random() < 0.1:
        data[:] = text(rng).encode("utf-8", "replace")


def parquet(data: bytearray, rng: np.random.Generator) -> None:
    or_bytes(_edit_parquet, data, rng)


def or_bytes(edit: Callable[[bytearray, np.random.Generator], None], data: bytearray, rng: np.random.Generator) -> None:
    """Edit a file with its library, or damage its bytes if the library refuses."""
    try:
        edit(data, rng)
    except (ArithmeticError, AttributeError, LookupError, OSError, RuntimeError, TypeError, ValueError):
        mutations_bytes.apply(data, rng)
