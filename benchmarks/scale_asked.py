"""What was asked of time and memory, and what was found: a part of benchmarks/scale.py."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scale_lengths import STAGES, fitted_time
from scale_many import APART, DASK, ONE, TWO
from scale_starts import AGAIN, RUN

POWER, MEMORY, SHARE, OVERHEAD, WHOLE, NOTHING = 1.05, 500.0, 0.9, 1.1, 3.0, 1.0


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
    yield ["Dask by processes", f"≤ {OVERHEAD}", f"{dask:.2f}" + held(dask <= OVERHEAD)]


def _starts(part: Any) -> Iterator[list[str]]:
    run, again = part["spent"][RUN]["wall"], part["spent"][AGAIN]["wall"]
    yield ["`run`, a whole process", f"≤ {WHOLE:g} s", f"{run:.2f} s" + held(run <= WHOLE)]
    yield ["`run` with nothing to do", f"≤ {NOTHING:g} s", f"{again:.2f} s" + held(again <= NOTHING)]


def held(yes: bool) -> str:
    """Whether what was asked is held."""
    return "" if yes else ", **not held**"


_ROWS = {"frames": _frames, "dense": _dense, "batch": _batch, "starts": _starts}
