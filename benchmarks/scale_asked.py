"""What was asked of time and memory, and what was found: a part of benchmarks/scale.py."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scale_lengths import STAGES, fitted_time
from scale_many import APART, DASK, ONE, TWO
from scale_starts import AGAIN, EARLIER, PERSON, RUN

POWER, MEMORY, LONG, SHARE, OVERHEAD = 1.05, 400.0, 1000.0, 0.9, 1.1
WHOLE, OF_BEFORE, SHORT, NOTHING, EACH = 3.5, 0.42, 2.2, 0.3, 1.2


def asked(parts: Mapping[str, Any]) -> list[list[str]]:
    """Rows: what, asked, found; of the parts that were measured."""
    return [row for name, rows in _ROWS.items() if name in parts for row in rows(parts[name])]


def _frames(part: Any) -> Iterator[list[str]]:
    found = {name: fitted_time(part, "frames", name) for name in (*STAGES, "run")}
    for what, powers in (
        ("power of frames, every length", {name: one.all for name, one in found.items()}),
        ("the same, the larger half", {name: one.larger for name, one in found.items()}),
    ):
        known = {name: value for name, value in powers.items() if value is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            told = f"{known[worst]:.2f} ({worst})" + (f"; `run` {known['run']:.2f}" if worst != "run" else "")
            yield [what, f"≤ {POWER}", told + held(known[worst] <= POWER)]
    longest = max(part, key=lambda one: one["wanted"]["frames"])
    peak = longest["whole"]["peak"]
    yield [f"memory, {longest['wanted']['frames']:,} frames", f"≤ {LONG:.0f} MB", f"{peak:.0f} MB" + held(peak <= LONG)]


def _dense(part: Any) -> Iterator[list[str]]:
    peak = part[0]["whole"]["peak"]
    yield ["memory, 30 s at 480 Hz of 50 markers", f"≤ {MEMORY:.0f} MB", f"{peak:.0f} MB" + held(peak <= MEMORY)]


def _batch(part: Any) -> Iterator[list[str]]:
    wall = {name: way["wall"] for name, way in part["ways"].items()}
    two, best = (wall[ONE] / (2 * wall[name]) for name in (TWO, APART))
    share, dask = two / best, wall[DASK] / wall[TWO]
    yield ["two workers, of twice one's speed", f"≥ {SHARE}", f"{two:.2f}" + held(two >= SHARE)]
    yield [
        "the same, of what this machine can",
        f"≥ {SHARE}",
        f"{share:.2f} (it can {best:.2f})" + held(share >= SHARE),
    ]
    each = wall[TWO] / part["trials"]
    yield ["a trial of a batch, two workers", f"≤ {EACH} s", f"{each:.2f} s" + held(each <= EACH)]
    yield ["Dask by processes", f"≤ {OVERHEAD}", f"{dask:.2f}" + held(dask <= OVERHEAD)]


def _starts(part: Any) -> Iterator[list[str]]:
    spent = part["spent"]
    for name, most in ((RUN, WHOLE), (PERSON, SHORT), (AGAIN, NOTHING)):
        if name in spent:
            wall = spent[name]["wall"]
            yield [f"{name}, a whole process", f"≤ {most:g} s", f"{wall:.2f} s" + held(wall <= most)]
    if EARLIER in spent:
        ratio = spent[RUN]["cpu"] / spent[EARLIER]["cpu"]
        yield [
            "processor time of `run`, of an earlier commit's",
            f"≤ {OF_BEFORE}",
            f"{ratio:.2f}" + held(ratio <= OF_BEFORE),
        ]


def held(yes: bool) -> str:
    """Whether what was asked is held."""
    return "" if yes else ", **not held**"


_ROWS = {"frames": _frames, "dense": _dense, "batch": _batch, "starts": _starts}
