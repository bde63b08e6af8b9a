"""Cautions about times in which an angle or a pose is not given."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.estimation import BRIDGE_LIMIT, FRAMEWISE
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.verdict import Reason


def gap_reasons(
    missing: BoolArray, time: FloatArray, names: Sequence[str], quantity: str, settings: UkfSmoothSettings
) -> tuple[Reason, ...]:
    """Return a caution for every joint or segment whose angle or pose has gaps.

    Parameters
    ----------
    missing : (F, K) bool array
        Frames without the quantity.
    time : (F,) array
        s.
    names : sequence of str, length K
        Names of the joints or segments.
    quantity : {"angle", "pose"}
    settings : UkfSmoothSettings
    """
    reasons = []
    for name, lost in zip(names, missing.T, strict=True):
        if not lost.any():
            continue
        gaps = find_runs(lost)
        longest = max(gaps, key=lambda gap: gap.stop - gap.start)
        seconds = np.count_nonzero(lost) * (time[-1] - time[0]) / max(len(time) - 1, 1)
        where = "throughout" if lost.all() else f"{len(gaps)} times, longest from {time[longest.start]:.2f} s"
        message = f"the {quantity} of the {name} is not given for {seconds:.2f} s ({where}): {_limit(settings)}."
        reasons.append(Reason("gap", message, float(seconds), 0.0))
    return tuple(reasons)


def _limit(settings: UkfSmoothSettings) -> str:
    """Return why an angle is not given, with advice."""
    if settings.method == "encoder":
        return "the encoder's record does not cover this time. Record longer, or leave it out with `window:`"
    limit = f"its standard deviation would exceed {settings.angle_sd_limit:g} rad"
    if settings.method in FRAMEWISE:
        limit = f"`{settings.method}`, which bridges up to {BRIDGE_LIMIT:g} s, leaves a gap"
    return (
        f"its markers are missing, or do not fit the chain, for so long that {limit}. Fill or relabel them, or leave "
        "this time out with `window:`"
    )
