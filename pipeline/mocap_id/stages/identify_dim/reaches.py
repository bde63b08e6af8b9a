"""Reaches of a trial: events.parquet with one row for each reach, and facts on ranges, volume, surface and heights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.protocols.reach.reachable_set import compute_reach_surface, find_visited_region
from mocap_id.protocols.reach.reaches import Reach, compute_level_heights, find_reaches, locate_body_targets
from mocap_id.protocols.reach.workspace import (
    ANGLES,
    HELD,
    AngleRange,
    RecordedArm,
    UnknownReach,
    Volume,
    compute_workspace,
    find_usable_samples,
    get_angle,
    measure_arm,
    measure_ranges,
)
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.events import make_arm_events
from mocap_id.store import Table
from mocap_id.store.views import MeasuredPoses, SpatialAngles, SpatialSkeleton
from mocap_id.verdict import Reason

_LEAST_RANGE = np.radians(2.0)  # smallest range of an angle that moves
_CLEARLY = 0.005  # m, least distance by which the hand is beyond its known ends while the arm is not measured
_PATH = 600  # approximate number of points of the path of the wrist
_NO_REGION = "the visited postures have no volume in joint space: an angle hardly moves independently of the others"


def find_reach_events(context: Context) -> Table:
    """Return events.parquet of a trial with `protocol: reach`."""
    angles = SpatialAngles.from_table(context.table("angles.parquet"))
    poses = MeasuredPoses.from_table(context.table("poses.parquet"))
    chain = context.tree("chain.h5")
    skeleton = SpatialSkeleton.from_tree(chain)
    ranges = measure_ranges(angles, poses, skeleton=chain.facts.get("frames") == "skeleton")
    facts: dict[str, Any] = {"why": "", "ranges": {}}
    for name, own in ranges.items():
        low, high, low_sd, high_sd, spread = np.degrees(
            [own.low, own.high, own.low_sd, own.high_sd, own.width_sd]
        ).tolist()
        width = high - low
        facts["ranges"][name] = {
            "low_deg": low,
            "high_deg": high,
            "range_deg": width,
            "interval_deg": [max(width - NORMAL_95 * spread, 0.0), width + NORMAL_95 * spread],
            "low_sd_deg": low_sd,
            "high_sd_deg": high_sd,
            "used_share": own.used_share,
        }
    reaches: tuple[Reach, ...] = ()
    try:
        arm = measure_arm(angles, poses, skeleton, context.trial.subject.height)
        reaches = find_reaches(angles.time, arm)
        misses: dict[str, list[float]] = {}
        for one in reaches:
            if one.target != "none":
                misses.setdefault(one.target, []).append(one.miss)
        # path of the wrist, arm at its furthest reach and targets, for the view on the page
        known = np.flatnonzero(arm.measured & np.isfinite(arm.wrists).all(axis=1))
        if not len(known):
            raise UnknownReach("no frame has markers of the whole arm")
        far = known[np.argmax(np.linalg.norm(arm.wrists[known], axis=1))]
        path = arm.wrists[known[:: max(len(known) // _PATH, 1)]]
        facts |= {
            "lengths_m": {"upper_arm": float(np.linalg.norm(arm.arm.elbow)), "forearm": arm.arm.forearm},
            "arm_length_m": arm.arm.length,
            "shoulder_m": arm.shoulder.tolist(),
            "glide_m": arm.glide.tolist(),
            "view": {
                "path_m": path.round(3).tolist(),
                "arm_m": np.stack([np.zeros(3), arm.elbows[far], arm.wrists[far]]).round(3).tolist(),
                "targets_m": {name: place.round(3).tolist() for name, place in locate_body_targets(arm).items()},
            },
            "heights": _measure_heights(angles.time, arm),
            "tasks": {
                name: {"count": len(each), "best_miss_m": min(each), "median_miss_m": float(np.median(each))}
                for name, each in misses.items()
            },
        }
        facts |= _compute_volumes(angles, poses, arm, ranges)
    except UnknownReach as unknown:
        facts["why"] = str(unknown)
    reasons = (Reason("no-reach", f"the reachable volume is unknown: {facts['why']}"),) if facts["why"] else ()
    return make_arm_events("reach", [asdict(one) | {"miss_m": one.miss} for one in reaches], facts, reasons)


def _measure_heights(time: FloatArray, arm: RecordedArm) -> dict[str, Any]:
    """Return the highest and lowest position of the wrist, and the levels that the middle of the hand reached.

    They are None if the hand was probably higher or lower, or at this level, only while the arm is not measured.
    """
    rank = max(round(HELD / float(np.median(np.diff(time)))), 1)
    ends = {}
    for name, path in (("wrist", arm.wrists), ("palm", arm.palms)):
        for side, sign in (("high", 1.0), ("low", -1.0)):
            height = sign * path[:, 1]
            seen = np.sort(height[arm.measured & np.isfinite(height)])
            hidden = height[~arm.measured & np.isfinite(height)]
            end = float(seen[-rank]) if len(seen) >= rank else np.nan
            ends[name, side] = sign * end, bool(np.any(hidden > end + _CLEARLY))
    highest, lowest = (None if beyond else end for end, beyond in (ends["wrist", "high"], ends["wrist", "low"]))
    palm, beyond = ends["palm", "high"]
    return {
        "highest_m": highest,
        "lowest_m": lowest,
        "highest_share": None if highest is None else highest / arm.arm.length,
        "lowest_share": None if lowest is None else lowest / arm.arm.length,
        "levels": {
            name: True if palm >= height else None if beyond else False
            for name, height in compute_level_heights(arm).items()
        },
    }


def _compute_volumes(
    angles: SpatialAngles, poses: MeasuredPoses, arm: RecordedArm, ranges: Mapping[str, AngleRange]
) -> dict[str, Any]:
    """Return facts on the reachable volume and surface, within the box of the ranges and within the visited region.

    Raises
    ------
    UnknownReach
        An angle has no range, or the elbow bends the wrong way.
    """
    still = [name for name in ANGLES if name not in ranges or ranges[name].high - ranges[name].low < _LEAST_RANGE]
    if still:
        names = " and ".join(name.replace("_", " ") for name in still)
        raise UnknownReach(f"{names} change by less than {np.degrees(_LEAST_RANGE):.0f}° where they are defined")
    flexion = ranges["elbow_flexion"]
    if flexion.low + flexion.high < 0:
        raise UnknownReach(
            f"the elbow bends backwards (flexion from {np.degrees(flexion.low):.0f}° to "
            f"{np.degrees(flexion.high):.0f}°), as if it were the arm of the other side: correct `side:`"
        )
    usable = np.logical_and.reduce([find_usable_samples(angles, poses, name) for name in ANGLES])
    postures = np.stack([get_angle(angles, name, usable) for name in ANGLES], axis=1)
    limits = np.array([(ranges[name].low, ranges[name].high) for name in ANGLES])
    region = find_visited_region(postures, limits)
    found = compute_workspace(arm, ranges, region)
    surfaces = {"box": compute_reach_surface(arm.arm, limits)}
    if region is not None:
        surfaces["visited"] = compute_reach_surface(arm.arm, region.limits, region.planes)

    # the part of the box between the recorded postures
    visited: dict[str, Any] = dict.fromkeys(("volume_m3", "interval_m3", "share"))
    visited |= {"meaning": _NO_REGION, "why": _NO_REGION}
    if found.visited is not None and region is not None:
        share = found.visited.volume / found.box.volume
        visited = _describe_volume(found.visited) | {
            "share": share,
            "why": None,
            "meaning": (
                "In the box, every angle has its whole range at all values of the other angles. The postures between "
                f"the recorded postures reach {100 * share:.0f} % of its volume; whether the rest can be reached is "
                "unknown. The true volume is between both volumes, nearer to the box if the angles can be combined "
                "more freely."
            ),
        }
    directions = {"theta_deg": surfaces["box"].polar, "psi_deg": surfaces["box"].azimuth}
    radii = {
        f"{name}_m": [[round(r, 3) if np.isfinite(r) else None for r in row] for row in one.radius.tolist()]
        for name, one in surfaces.items()
    }
    return {
        **_describe_volume(found.box),
        "sd_m3": found.sd,
        "relative_volume": found.relative(arm.arm),
        "sources": found.sources,
        "box_deg": {
            name.split("_")[1]: np.degrees(pair).tolist() for name, pair in zip(ANGLES, found.limits, strict=True)
        },
        "visited": visited,
        "surface": {name: one.areas for name, one in surfaces.items()},
        "mesh": {name: np.degrees(each).round(2).tolist() for name, each in directions.items()} | radii,
    }


def _describe_volume(one: Volume) -> dict[str, Any]:
    return {
        "volume_m3": one.volume,
        "interval_m3": list(one.interval),
        "discretisation_m3": one.discretisation,
        "convergence_m3": list(one.convergence),
    }
