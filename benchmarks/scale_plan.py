"""What 100,000 trials would take, of what was measured: a part of benchmarks/scale.py, quoted in docs/cluster.md."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scale_many import TWO

BEGIN, END = "<!-- scale: written by benchmarks/scale.py --quote -->", "<!-- scale: end -->"
TRIALS = 100_000
CORES = (16, 64, 256)
NEEDED = ("batch", "tasks", "storage")


def plan(parts: Mapping[str, Any]) -> str:
    """Rows of what is needed, each with its formula."""
    batch, tasks, storage = (parts[name] for name in NEEDED)
    trial, memory = batch["ways"][TWO]["trial"], batch["ways"][TWO]["peak"]
    files, size = len(storage["files"]), sum(storage["files"].values()) / 1e6
    dask, finding, table = (tasks[name][-1] for name in ("dask", "finding", "table"))
    out = 1e3 * (dask["seconds"] - dask["first"]) / dask["count"]
    found, rows = (1e3 * one["seconds"] / one["count"] for one in (finding, table))
    kept = 1e3 * (table["peak"] - table["before"] + tasks["here"][-1]["peak"] - tasks["here"][-1]["before"])
    kept /= table["count"]
    lines = [
        ("| what | formula | measured | for 100,000 trials |",),
        ("| --- | --- | --- | --- |",),
        ("a trial on one core", "t", f"{trial:.1f} s", f"{TRIALS * trial / 3600:.0f} core hours"),
        *(
            (f"the whole on {cores} cores", f"N t / {cores}", "", f"{TRIALS * trial / 3600 / cores:.1f} h")
            for cores in CORES
        ),
        ("memory of a worker", "m", f"{memory:.0f} MB", f"{memory * CORES[1] / 1e3:.0f} GB for {CORES[1]} workers"),
        ("a run folder", "b", f"{size:.1f} MB", f"{TRIALS * size / 1e6:.2f} TB"),
        ("files in it", "f", f"{files}", f"{TRIALS * files / 1e6:.1f} million"),
        ("handing a trial out, by Dask", "d", f"{out:.1f} ms",
         f"{TRIALS * out / 6e4:.0f} min, at most {1e3 / out:.0f} trials/s"),
        ("finding a trial, in folders", "s", f"{found:.1f} ms", f"{TRIALS * found / 6e4:.0f} min before the first"),
        ("a row of the table", "r", f"{rows:.2f} ms", f"{TRIALS * rows / 6e4:.1f} min after the last"),
        ("memory for a trial where `batch` runs", "k", f"{kept:.1f} kB", f"{TRIALS * kept / 1e6:.1f} GB"),
        ("batch.parquet", "p", f"{table['bytes'] / table['count']:.0f} bytes a row",
         f"{TRIALS * table['bytes'] / table['count'] / 1e6:.1f} MB"),
    ]  # fmt: skip
    return "\n".join(line[0] if len(line) == 1 else "| " + " | ".join(line) + " |" for line in lines)


def quote(page: Path, text: str) -> None:
    """Put the text between the two marks of a page; ValueError where they are missing."""
    before, begin, rest = page.read_text("utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page} has no lines {BEGIN} and {END}")
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")
