"""The bodies of the dynamics on their own measured poses: which joints give way, cut-offs, prior, the way back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.bands import Bands
from mocap_id.dynamics.fold import gather, relative
from mocap_id.dynamics.grid import PointGrid, segment_grid
from mocap_id.dynamics.loose_prior import BodyPrior, even_prior, table_prior, without_others
from mocap_id.dynamics.lowpass import known
from mocap_id.dynamics.measured_motion import USUAL, BodyPoses, Gap, bridged, gaps, measured_motion, pinned
from mocap_id.dynamics.prepare import FitSettings, Prepared, Recorded, prepare
from mocap_id.kinematics.cluster_poses import LEAST_MARKERS
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context
from mocap_id.store import Table

_LEAST_RESIDUAL = 1e-4  # m
_OFTEN = 0.8  # of the samples: a body that is seen less would leave too few to identify on


@dataclass(frozen=True)
class MeasuredBodies:
    """Bodies with their poses, ready to be used.

    Parameters
    ----------
    names : tuple of str
    poses : BodyPoses
        Short gaps bridged; pinned at the joints that hold.
    observed : (T,) bool array
        Samples on which every pose was measured.
    gap : dict of int to Gap
        By the joint, from 0.
    markers : tuple of mapping
        Of each body: label to place in its frame, m.
    residual : tuple of float
        rms distance of each body's markers from their places, m.
    used : tuple of int
        Their places in poses.parquet, from 0.
    """

    names: tuple[str, ...]
    poses: BodyPoses
    observed: BoolArray
    gap: dict[int, Gap]
    markers: tuple[dict[str, list[float]], ...]
    residual: tuple[float, ...]
    used: tuple[int, ...]

    @property
    def loosest(self) -> float:
        """Largest acceleration of a joint's gap, m/s²."""
        return max((gap.acceleration for gap in self.gap.values() if np.isfinite(gap.acceleration)), default=0.0)

    def recorded(self, recorded: Recorded, bands: Bands) -> Recorded:
        """The trial with the bodies' motion in the place of the chain's."""
        return replace(recorded, measured=measured_motion(self.poses, bands), observed=self.observed)

    def grid(self, points: tuple[int, int]) -> PointGrid:
        """Point masses over each body's joints and markers."""
        count = len(self.names)
        body = np.repeat(np.arange(count), [len(each) for each in self.markers])
        local = np.array([place for each in self.markers for place in each.values()])
        ends = self.poses.centroid[: count - 1].copy()
        for joint in self.poses.joints:
            ends[self.poses.body[joint]] = self.poses.centres[joint]
        return segment_grid(ends, body, local, points)


def measured_bodies(context: Context, recorded: Recorded) -> tuple[MeasuredBodies, ...]:
    """The bodies of poses.parquet, in every way to count them; none where a segment of the chain has no pose.

    A body of several segments can take their place: pelvis and trunk count as two or as one.
    """
    table = context.table("poses.parquet")
    every = [k for k in range(len(table.facts["bodies"])) if _often_seen(table, k, recorded)]
    many = [k for k in every if len(table.facts["bodies"][k]["segments"]) > 1]
    single = [k for k in every if k not in many]
    ways = [single, *([k for k in every if not _part_of(table.facts["bodies"], k, whole)] for whole in many)]
    return tuple(made_ready(read_bodies(table, recorded.centres, way)) for way in ways if _whole(table, recorded, way))


def _often_seen(table: Table, body: int, recorded: Recorded) -> bool:
    """Whether a body's pose is known in most of the samples in which the chain's states are."""
    states = known(recorded.ddq)
    seen = table[f"markers_{body + 1}"][states] >= LEAST_MARKERS
    return bool(len(seen)) and float(np.mean(seen)) >= _OFTEN


def _part_of(bodies: Sequence[Mapping[str, Any]], body: int, whole: int) -> bool:
    """Whether a body is a part of the whole one."""
    own = bodies[body]["segments"]
    return body != whole and bool(own) and set(own) <= set(bodies[whole]["segments"])


def _whole(table: Table, recorded: Recorded, used: Sequence[int]) -> bool:
    """Whether every segment of the chain is in one of the bodies."""
    segments = {segment for k in used for segment in table.facts["bodies"][k]["segments"]}
    return segments == set(range(len(recorded.centres) + 1))


def made_ready(bodies: MeasuredBodies) -> MeasuredBodies:
    """The bodies with short gaps bridged and the joints that hold pinned."""
    poses, observed = bridged(bodies.poses)
    gap = gaps(poses, np.ones(len(poses.time), dtype=bool))
    held = [joint for joint, each in gap.items() if each.pinned]
    return replace(bodies, poses=pinned(poses, held), observed=observed, gap=gap)


def read_bodies(table: Table, centres: FloatArray, used: Sequence[int]) -> MeasuredBodies:
    """Bodies of poses.parquet as they were measured: gaps neither bridged nor pinned.

    Parameters
    ----------
    table : Table
    centres : (n, 2) array
        Joint centres in the segment before, m.
    used : sequence of int
        The bodies to take, which together hold every segment of the chain once.
    """
    bodies = [table.facts["bodies"][k] for k in used]
    owner = {segment: k for k, body in enumerate(bodies) for segment in body["segments"]}
    local = [np.array(list(body["markers"].values())) for body in bodies]
    spread = [np.sum((places - places.mean(axis=0)) ** 2) for places in local]
    noise = [max(body["residual_m"], _LEAST_RESIDUAL) ** 2 for body in bodies]

    def series(name: str) -> FloatArray:
        return table.stack([f"{name}_{k + 1}" for k in used])

    poses = BodyPoses(
        time=table["time"],
        position=np.stack([series("x"), series("y")], axis=-1),
        angle=series("angle"),
        centroid=np.array([places.mean(axis=0) for places in local]),
        information=np.array([[len(p) / n, s / n] for p, s, n in zip(local, spread, noise, strict=True)]),
        body=np.array([owner[k] for k in range(len(centres) + 1)], dtype=np.int64),
        centres=centres,
    )
    return MeasuredBodies(
        names=tuple(str(body["name"]) for body in bodies),
        poses=poses,
        observed=known(poses.angle),
        gap={},
        markers=tuple(body["markers"] for body in bodies),
        residual=tuple(float(body["residual_m"]) for body in bodies),
        used=tuple(used),
    )


def loose_prior(
    bodies: MeasuredBodies, q: FloatArray, samples: BoolArray, table: ReferenceBody, mass: float
) -> BodyPrior:
    """The prior of the bodies: around the table's body where one applies, else around an even share of the mass.

    Parameters
    ----------
    bodies : MeasuredBodies
    q : (T, n) array
        The chain's angles, rad.
    samples : (T,) bool array
        Samples that give the bodies' mean place.
    table : ReferenceBody
        On the chain; NaN where none applies.
    mass : float
        Of the whole body, kg.
    """
    poses, reference = bodies.poses, table.parameters
    if not np.isfinite(reference).all():
        return even_prior(mass, poses.centroid)
    of_segment = reference.reshape(-1, 4)
    mean = np.zeros((len(bodies.names), 4))
    for body in range(len(bodies.names)):
        own = np.flatnonzero(poses.body == body)
        if len(own):
            mean[body] = gather(poses.centres, q, samples, own) @ of_segment[own].reshape(-1)
    last = int(poses.body[-1])
    for body in np.setdiff1d(np.arange(len(bodies.names)), poses.body):
        mean[last], mean[body] = without_others(mean[last], *relative(poses, int(body), last, samples), mass)
    free = int(poses.body.max()) + 1 < len(bodies.names)
    return table_prior(mean.reshape(-1), str(table.table), others=free)


def with_prior(
    bodies: MeasuredBodies, recorded: Recorded, settings: FitSettings, prior: BodyPrior, bands: Bands = USUAL
) -> Prepared:
    """The trial made ready on the bodies' motion."""
    return prepare(bodies.recorded(recorded, bands), settings, prior)
