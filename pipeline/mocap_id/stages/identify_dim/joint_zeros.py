"""Pose in which the joint angles are zero: the fact ``zeros`` of phases.parquet.

The columns ``theta_j`` of states.parquet are zero where two segment lines are parallel. These lines follow the markers,
so they are not anatomical and change with the segments. The zeros here are the values of ``theta_j`` in a pose.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.protocols.posture import Posture, find_standing_phases
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.trial_data import read_joint_names
from mocap_id.stages.trial_keys import StaticTrial
from mocap_id.store import Table
from mocap_id.store.views import joint_columns
from mocap_id.verdict import Reason

_STILL = np.radians(2.0)  # largest standard deviation of a joint angle in a still pose


def find_zeros(context: Context, posture: Posture | None) -> tuple[list[dict[str, Any]], tuple[Reason, ...]]:
    """Return the zero of every joint for JSON, in the order of the joints, and cautions about the static pose.

    Raises
    ------
    RecordingError
        The times under ``static:`` are outside the states.
    """
    states, names, static = context.table("states.parquet"), read_joint_names(context), context.trial.static
    time = states["time"]
    seen = joint_columns(states, "observed", len(names)).astype(np.bool_)
    q = np.where(seen, joint_columns(states, "theta", len(names)), np.nan)
    known: dict[str, tuple[FloatArray, FloatArray]] = {}
    reasons: list[Reason] = []
    if posture is not None:
        phases = find_standing_phases(posture)
        if phases:
            known["standing"] = _average(states, q, phases)
    if isinstance(static, StaticTrial):
        pose = context.tree("chain.h5").facts["static"]
        known["static"] = np.array(pose["theta"], dtype=np.float64), np.array(pose["sd_theta"], dtype=np.float64)
    elif static is not None:
        inside = np.flatnonzero((time >= static[0]) & (time <= static[1]))
        if len(inside) < 2:
            raise RecordingError(
                f"static: no motion is known from {static[0]:g} to {static[1]:g} s; the used part of the recording is "
                f"{time[0]:g} to {time[-1]:g} s. Give times in this part, or change `window:`"
            )
        known["static"] = _average(states, q, [slice(int(inside[0]), int(inside[-1]) + 1)])
        known_angles = np.isfinite(q[inside])
        spread = [
            float(np.std(angle[shown])) if shown.any() else 0.0
            for angle, shown in zip(q[inside].T, known_angles.T, strict=True)
        ]
        moved = max(spread)
        if moved > _STILL:
            text = (
                f"the person does not stand still from {static[0]:g} to {static[1]:g} s: the angle of the "
                f"{names[spread.index(moved)]} has a standard deviation of {np.degrees(moved):.1f}°, so the zero of "
                "the joint angles is uncertain. Give a still part in `static:`, or leave it out"
            )
            reasons.append(Reason("static-moves", text, moved, float(_STILL)))
    zeros: list[dict[str, Any]] = []
    for j, name in enumerate(names):
        source = next((each for each in ("static", "standing") if each in known and np.isfinite(known[each][0][j])), "")
        value, sd = (float(each[j]) for each in known[source]) if source else (0.0, 0.0)
        mean = np.nanmean(q[:, j]) if np.isfinite(q[:, j]).any() else value
        value += 2 * np.pi * round((mean - value) / (2 * np.pi))
        known_sd = sd if np.isfinite(sd) else None  # some methods give states without standard deviations
        zeros.append({"joint": name, "source": source or "segment line", "zero": float(value), "sd": known_sd})
    hidden = [each["joint"] for each in zeros if static is not None and each["source"] != "static"]
    if hidden:
        text = (
            f"the markers in the static pose do not show the angle of: {', '.join(hidden)}. The zero of these joints "
            "is not that of `static:`. Give a static pose in which the markers of all segments are visible"
        )
        reasons.append(Reason("static-hidden", text, float(len(hidden)), 0.0))
    return zeros, tuple(reasons)


def _average(states: Table, q: FloatArray, phases: list[slice]) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the angles (T, n) over the means of some phases, (n,) rad, and its standard deviation.

    The standard deviation contains the difference between the phases, or that within a single phase, and the standard
    deviation of the states, which a mean does not reduce.
    """
    known = f"sd_theta_{q.shape[1]}" in states.names
    sd = joint_columns(states, "sd_theta", q.shape[1]) if known else np.full(q.shape, np.nan)
    mean, own, between = np.full((3, q.shape[1]), np.nan)
    for j, angle in enumerate(q.T):
        seen = [phase for phase in phases if np.isfinite(angle[phase]).any()]
        if not seen:
            continue
        each = [float(np.nanmean(angle[phase])) for phase in seen]
        mean[j] = np.mean(each)
        between[j] = np.std(each, ddof=1) / np.sqrt(len(each)) if len(each) > 1 else np.nanstd(angle[seen[0]])
        own[j] = np.sqrt(np.mean(np.concatenate([sd[phase, j][np.isfinite(angle[phase])] ** 2 for phase in seen])))
    return mean, np.hypot(own, between)
