"""What the joints' gaps and the clocks say of a trial, for the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mocap_id.verdict import Reason

_CLOCKS_APART = 0.005  # s; 5 ms moves a base parameter of a person by a fifth and more


def motion_reasons(facts: Mapping[str, Any]) -> tuple[Reason, ...]:
    """Reasons from the facts of dynamics.h5."""
    return (*_gives_way(facts["motion"]), *_clocks(facts.get("held_out") or {}))


def _gives_way(motion: Mapping[str, Any]) -> Iterator[Reason]:
    """Information: joints whose two sides part by more than noise."""
    loose = {name: gap for name, gap in (motion.get("joints") or {}).items() if not gap["pinned"]}
    if motion["source"] != "segments" or not loose:
        return
    listed = ", ".join(f"{name} {1e3 * gap['gap_m']:.1f} mm" for name, gap in loose.items())
    yield Reason(
        "joint-gives-way",
        f"the two sides of a joint part by more than noise (rms): {listed}. The dynamics therefore use the measured "
        "pose of every segment; lengths and angles are still those of the chain. `identify-dim: {motion: chain}` pins "
        "the joints",
        value=max(gap["gap_m"] for gap in loose.values()),
        level="ok",
    )


def _clocks(held_out: Mapping[str, Any]) -> Iterator[Reason]:
    """The clock offsets of the repetitions contradict each other."""
    offsets = np.asarray(held_out.get("clock_offset_s") or [], dtype=np.float64)
    apart = float(np.ptp(offsets)) if len(offsets) > 1 else 0.0
    if apart > _CLOCKS_APART:
        yield Reason(
            "clocks-disagree",
            f"the clock offset between cameras and plate depends on the repetitions that it is found from: it differs "
            f"by {1e3 * apart:.0f} ms, expected at most {1e3 * _CLOCKS_APART:.0f} ms. One of the clocks drifts, or the "
            "model does not follow the movement: check how cameras and plate are synchronised",
            value=apart,
            limit=_CLOCKS_APART,
        )
