"""Facts and reasons about feet that move, heels that lift and a plane of motion that leans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.kinematics import PlaneFit
from mocap_id.kinematics.base_motion import BaseMotion, BaseStretch
from mocap_id.kinematics.heel_lift import find_heel_lift
from mocap_id.recording import PlateSamples, ThinnedFrames
from mocap_id.verdict import Reason

_LISTED = 5  # largest number of changes in the message; the facts contain all
_HIGH_M = 1.1  # largest height of the centre of mass


def undo_in_samples(base: BaseMotion | None, samples: Sequence[PlateSamples], time: FloatArray) -> list[PlateSamples]:
    """Return the plates' wrenches at ``time`` (F,), s, relative to a base that stands still.

    They are unchanged if ``base`` is None.
    """
    if base is None:
        return list(samples)
    moved = [base.undo_wrench(each.force, each.moment, time) for each in samples]
    return [replace(each, force=force, moment=moment) for each, (force, moment) in zip(samples, moved, strict=True)]


def undo_in_frames(base: BaseMotion | None, thinned: ThinnedFrames) -> ThinnedFrames:
    """Return thinned frames, expressed relative to a base that stands still; unchanged if ``base`` is None."""
    if base is None:
        return thinned
    positions = base.undo_positions(thinned.positions, thinned.time)
    return replace(thinned, positions=positions, samples=tuple(undo_in_samples(base, thinned.samples, thinned.time)))


def describe_motion(
    base: BaseMotion | None, still: ThinnedFrames, labels: Sequence[str], frame: PlaneFrame, plane: PlaneFit
) -> tuple[dict[str, Any], tuple[Reason, ...]]:
    """Return facts of planar.parquet and reasons about a base that moves, heels that lift and a plane that leans.

    ``base`` is the motion that was removed, None if the base is fixed. ``still`` are the frames relative to a base that
    stands still. ``frame`` is the plane's frame before the base moved.
    """
    lift = find_heel_lift(still.positions, still.time, still.rate)
    facts = {
        "base_motion": None if base is None else _list_motion(base, labels, frame),
        "heel_lift": None
        if lift is None
        else {
            "marker": labels[lift.marker],
            "about": labels[lift.about],
            "height_m": lift.height,
            "turn_deg": float(np.degrees(lift.turn)),
            "time_s": lift.time,
        },
    }
    moved = () if base is None else (_describe_base(base),)
    return facts, (*moved, *_describe_lean(plane))


def remove_explained_by_lean(reasons: Sequence[Reason], plane: PlaneFit) -> tuple[Reason, ...]:
    """Return the reasons, without `plate-misplaced` if the lean of the plane explains the force beside the feet."""
    beside = _HIGH_M * abs(np.sin(plane.lean))
    return tuple(
        each for each in reasons if each.code != "plate-misplaced" or (each.value or 0.0) - beside > (each.limit or 0.0)
    )


def _list_motion(base: BaseMotion, labels: Sequence[str], frame: PlaneFrame) -> dict[str, Any]:
    axes = frame.axes[[0, 2], :2]
    return {
        "stretches": [
            {
                "from_s": each.start,
                "to_s": each.end,
                "along_m": float(axes[0] @ each.shift),
                "across_m": float(axes[1] @ each.shift),
                "turn_deg": float(np.degrees(each.turn)),
                "misfit_m": each.misfit,
            }
            for each in base.stretches
        ],
        "markers": [labels[marker] for marker in base.feet],
        "fixed_markers": [label for label, fixed in zip(labels, base.fixed, strict=True) if fixed],
        "centre_m": base.centre.tolist(),
        "path": [
            {"time_s": float(time), "shift_m": pose[:2].tolist(), "turn_deg": float(np.degrees(pose[2]))}
            for time, pose in zip(base.knots, base.poses, strict=True)
        ],
    }


def _describe_base(base: BaseMotion) -> Reason:
    changes = list(pairwise(base.stretches))
    listed = "; ".join(_describe_change(*each) for each in changes[:_LISTED])
    rest = f"; and {len(changes) - _LISTED} more changes" if len(changes) > _LISTED else ""
    farthest = max(float(np.linalg.norm(each.shift)) for each in base.stretches)
    first = base.stretches[0]
    if not base.rigid:
        return Reason(
            "base-moved",
            f"the feet moved to another position: {listed}{rest}. They did not move together: their markers differ by "
            f"{1e3 * max(each.misfit for each in base.stretches):.0f} mm rms from a common motion. Only their mean "
            "displacement was corrected, so the joints are less exact: analyse each part alone with `window:`",
            farthest,
        )
    return Reason(
        "base-moved",
        f"the feet moved to another position: {listed}{rest}. This was corrected: markers, forces and moments are "
        f"expressed relative to the feet. x, tauz and the centre of pressure refer to the position of the feet from "
        f"{first.start:.1f} to {first.end:.1f} s.",
        farthest,
        level="ok",
    )


def _describe_change(before: BaseStretch, after: BaseStretch) -> str:
    """Return how far and when the feet moved between two stretches, as text."""
    shift, turn = 1e2 * float(np.linalg.norm(after.shift - before.shift)), float(np.degrees(after.turn - before.turn))
    rotation = f" and rotated by {abs(turn):.0f}°" if abs(turn) >= 1.0 else ""
    return f"by {shift:.1f} cm{rotation} between {before.end:.1f} and {after.start:.1f} s"


def _describe_lean(plane: PlaneFit) -> tuple[Reason, ...]:
    if plane.lean == 0:
        return ()
    lean = abs(float(np.degrees(plane.lean)))
    text = (
        f"the plane of motion leans sideways by {lean:.1f}°: the person moves at an angle to the vertical, or "
        "the cameras' vertical is wrong. Angles and lengths are measured in this plane, forces and moments in the "
        "vertical plane along it"
    )
    return (Reason("plane-leans", text, lean, level="ok"),)
