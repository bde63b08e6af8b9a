"""Rigid bodies with measured poses, from poses.parquet, and the prior of their inertial parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex, find_complete_rows
from mocap_id.dynamics.body_prior import BodyPrior, build_even_prior, build_table_prior, split_torso
from mocap_id.dynamics.chain_parameters import measure_relative_pose, merge_segments
from mocap_id.dynamics.cutoffs import Cutoffs
from mocap_id.dynamics.measured_motion import (
    USUAL,
    BodyPoses,
    JointGap,
    close_gaps,
    fill_gaps,
    filter_motion,
    measure_gaps,
)
from mocap_id.dynamics.point_grid import PointGrid, build_grid
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare
from mocap_id.kinematics.cluster_poses import LEAST_MARKERS
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.validation import find_spans
from mocap_id.store import Table

_LEAST_RESIDUAL = 1e-4  # m, smallest residual in the weights
_OFTEN = 0.8  # smallest share of the samples with a known pose, so that the fit has enough samples


@dataclass(frozen=True)
class MeasuredBodies:
    """Rigid bodies and their poses."""

    names: tuple[str, ...]  # names of the bodies
    poses: BodyPoses  # poses with short gaps in time bridged; joints whose two sides do not separate are pinned
    observed: BoolArray  # (T,) samples in which every pose was measured
    gap: dict[int, JointGap]  # gap between the two sides of each joint between two bodies, by joint, from 0
    markers: tuple[dict[str, list[float]], ...]  # positions of the markers of each body in its axes, m, by label
    residual: tuple[float, ...]  # rms distance of the markers of each body from these positions, m
    used: tuple[int, ...]  # indices of the bodies in poses.parquet, from 0
    # standard deviation in one direction, m, of the joints that are located by the poses and not by the joint fit:
    # ankles of feet that move
    placed: dict[int, float]

    @property
    def loose(self) -> list[int]:
        """Joints, from 0, whose two sides separate, the joint with the largest acceleration first."""
        return sorted((j for j, gap in self.gap.items() if not gap.pinned), key=lambda j: -self.gap[j].above_noise)

    def grid(self, points: tuple[int, int]) -> PointGrid:
        """Return a grid of ``points`` (across, along) point masses around the joints and markers of each body."""
        count = len(self.names)
        body = np.repeat(np.arange(count), [len(each) for each in self.markers])
        local = np.array([position for each in self.markers for position in each.values()])
        ends = self.poses.centroid[: count - 1].copy()
        for joint in self.poses.joints:
            ends[self.poses.body[joint]] = self.poses.centres[joint]
        return build_grid(ends, body, local, points)


def find_measured_bodies(context: Context, recorded: TrialData) -> Iterator[MeasuredBodies]:
    """Yield the measured bodies, with short gaps bridged, for each possible division of the person into bodies.

    Pelvis and trunk may be two bodies or one. A division is possible if every segment is in a body with a known pose.
    """
    table, camera = context.table("poses.parquet"), context.tree("skin.h5").facts["camera_sd_m"]
    segments = [set(body["segments"]) for body in table.facts["bodies"]]
    usable = [k for k in range(len(segments)) if _has_pose(table, k, recorded)]
    several = [k for k in usable if len(segments[k]) > 1]
    single = [k for k in usable if k not in several]
    divisions = [single]
    for whole in several:
        parts = [k for k in usable if k != whole and segments[k] and segments[k] <= segments[whole]]
        divisions.append([k for k in usable if k not in parts])
    for used in divisions:
        if set().union(*(segments[k] for k in used)) == set(range(len(recorded.centres) + 1)):
            yield bridge_gaps(read_bodies(table, recorded.centres, used, camera))


def _has_pose(table: Table, k: int, recorded: TrialData) -> bool:
    """Return whether body ``k`` has a known pose in at least 80 % of the samples with known joint states.

    Except for the base, the body needs markers at more than two positions, because two points follow only the skin.
    """
    visible = table[f"markers_{k + 1}"][find_complete_rows(recorded.ddq)] >= LEAST_MARKERS
    if not len(visible) or float(np.mean(visible)) < _OFTEN:
        return False
    body = table.facts["bodies"][k]
    return 0 in body["segments"] or count_positions(as_complex(np.array(list(body["markers"].values())))) > 2


def bridge_gaps(bodies: MeasuredBodies) -> MeasuredBodies:
    """Return the bodies with short gaps in time bridged, and with the gaps between the two sides of each joint."""
    poses, observed = fill_gaps(bodies.poses)
    return replace(
        bodies, poses=poses, observed=observed, gap=measure_gaps(poses, np.ones(len(poses.time), dtype=bool))
    )


def pin_joints(bodies: MeasuredBodies) -> MeasuredBodies:
    """Return bodies with bridged gaps, now pinned at the joints whose two sides do not separate."""
    pinned = [joint for joint, each in bodies.gap.items() if each.pinned]
    return replace(bodies, poses=close_gaps(bodies.poses, pinned))


def read_bodies(table: Table, centres: FloatArray, used: Sequence[int], camera: float = 0.0) -> MeasuredBodies:
    """Return bodies of poses.parquet as measured: gaps are not bridged, joints not pinned, and ``gap`` is empty.

    Parameters
    ----------
    centres : (n, 2) array
        Joint centres in the axes of the previous segment, m.
    used : sequence of int
        Indices of the bodies; together, they contain every segment of the chain once.
    camera : float
        Standard deviation of the cameras' white noise in each coordinate of a marker, m.
    """
    bodies = [table.facts["bodies"][k] for k in used]
    owner = {segment: k for k, body in enumerate(bodies) for segment in body["segments"]}
    local = [np.array(list(body["markers"].values())) for body in bodies]
    spread = [np.sum((positions - positions.mean(axis=0)) ** 2) for positions in local]
    noise = [max(body["residual_m"], _LEAST_RESIDUAL) ** 2 for body in bodies]

    def series(name: str) -> FloatArray:
        return table.stack([f"{name}_{k + 1}" for k in used])

    before, after, placed = centres.copy(), np.zeros_like(centres), {}
    for body in bodies:
        if "joint_m" in body:
            joint = min(body["segments"]) - 1
            (before[joint], after[joint]), placed[joint] = body["joint_m"], float(body["joint_sd_m"])
    poses = BodyPoses(
        time=table["time"],
        position=np.stack([series("x"), series("y")], axis=-1),
        angle=series("angle"),
        centroid=np.array([positions.mean(axis=0) for positions in local]),
        information=np.array([[len(p) / n, s / n] for p, s, n in zip(local, spread, noise, strict=True)]),
        body=np.array([owner[k] for k in range(len(centres) + 1)], dtype=np.int64),
        centres=before,
        shift=np.array([_find_shift(bodies[owner[k + 1]], k + 1) for k in range(len(centres))]),
        beyond=after,
        camera=camera**2 * np.array([[1 / len(p), 1 / s] for p, s in zip(local, spread, strict=True)]),
    )
    return MeasuredBodies(
        names=tuple(str(body["name"]) for body in bodies),
        poses=poses,
        observed=find_complete_rows(poses.angle),
        gap={},
        markers=tuple(body["markers"] for body in bodies),
        residual=tuple(float(body["residual_m"]) for body in bodies),
        used=tuple(used),
        placed=placed,
    )


def _find_shift(body: Mapping[str, Any], segment: int) -> list[float]:
    """Return the shift of the joint before a segment, m; it is zero unless this is the first segment of the body."""
    shift: list[float] = body.get("joint_shift_m", [0.0, 0.0])
    return shift if segment == min(body["segments"]) else [0.0, 0.0]


def make_body_prior(
    bodies: MeasuredBodies, q: FloatArray, movement: Movement, table: ReferenceBody, mass: float
) -> BodyPrior:
    """Return the prior of the bodies' parameters from the reference body, or with equal masses if there is none.

    Parameters
    ----------
    q : (T, n) array
        Joint angles of the chain, rad.
    movement : Movement
        Movement whose usable samples give the mean positions of the bodies.
    table : ReferenceBody
        Reference body with the chain; its parameters are NaN if there is none.
    mass : float
        Mass of the person, kg.
    """
    poses, reference, samples = bodies.poses, table.parameters, movement.free
    times = np.array(find_spans(movement))
    if not np.isfinite(reference).all():
        return replace(build_even_prior(mass, poses.centroid), spans=times)
    of_segment = reference.reshape(-1, 4)
    mean = np.zeros((len(bodies.names), 4))
    for body in range(len(bodies.names)):
        own = np.flatnonzero(poses.body == body)
        if len(own):
            mean[body] = merge_segments(poses.centres, q, samples, own) @ of_segment[own].reshape(-1)
    last = int(poses.body[-1])
    for body in np.setdiff1d(np.arange(len(bodies.names)), poses.body):
        mean[last], mean[body] = split_torso(mean[last], *measure_relative_pose(poses, int(body), last, samples), mass)
    free = int(poses.body.max()) + 1 < len(bodies.names)
    return replace(build_table_prior(mean.reshape(-1), str(table.table), others=free), spans=times)


def prepare_bodies(
    bodies: MeasuredBodies, recorded: TrialData, settings: FitSettings, prior: BodyPrior, cutoffs: Cutoffs = USUAL
) -> PreparedTrial:
    """Return the trial prepared with the motion of the bodies, filtered at ``cutoffs``, not of the chain."""
    moved = replace(recorded, measured=filter_motion(bodies.poses, cutoffs), observed=bodies.observed)
    return prepare(moved, settings, prior)
