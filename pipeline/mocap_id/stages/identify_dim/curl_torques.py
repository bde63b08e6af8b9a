"""Torques about the elbow in curls: total torque, torque of the device, and torque of the person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.allometry import look_up_arm
from mocap_id.protocols.curl.elbow_torque import ElbowTorque, Mass, SegmentMotion, compute_elbow_torque
from mocap_id.stages.base import Context
from mocap_id.stages.curl_keys import Body
from mocap_id.stages.device import DeviceFile
from mocap_id.store.spatial_views import SegmentPoses, SpatialSkeleton

_ADDED_SD, _TABLE_SD = 0.02, 0.15  # relative standard deviation of a mass: weighed, and from a table


@dataclass(frozen=True)
class CurlTorques:
    """Torques about the elbow's axis; ``device`` and ``person`` are NaN if the trial has no file of a device."""

    total: ElbowTorque
    device: ElbowTorque
    person: ElbowTorque

    def columns(self) -> dict[str, FloatArray]:
        """Return the torques and their standard deviations as columns of dynamics.parquet."""
        columns: dict[str, FloatArray] = {}
        for suffix, one in (("", self.total), ("_device", self.device), ("_person", self.person)):
            columns |= {f"elbow_torque{suffix}": one.torque, f"sd_elbow_torque{suffix}": one.sd}
        return columns

    def leave_out(self, unknown: BoolArray) -> CurlTorques:
        """Return the torques with NaN in the samples ``unknown`` (T,)."""
        parts = (self.total, self.device, self.person)
        return CurlTorques(
            *(ElbowTorque(*(np.where(unknown, np.nan, each) for each in (one.torque, one.sd))) for one in parts)
        )


def compute_curl_torques(
    context: Context, poses: SegmentPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> CurlTorques | str:
    """Return the torques about the elbow's axis, or a text that says why they are unknown.

    The torque of the person is the total torque minus the torque of the device.
    """
    total = _compute_total_torque(context, poses, skeleton, axis)
    if isinstance(total, str):
        return total
    keys, angles = context.trial.curl, context.table("angles.parquet")
    if keys.device is None:
        unknown = np.full(len(poses.time), np.nan)
        return CurlTorques(total, ElbowTorque(unknown, unknown), ElbowTorque(unknown, unknown))
    file = DeviceFile.model_validate(keys.device)
    angle_sd = np.hypot(angles["sd_elbow_flexion"], angles["constant_sd_elbow_flexion"])
    device = ElbowTorque(*file.torque(file.sealed, angles["elbow_flexion"], angles["delbow_flexion"], angle_sd))
    return CurlTorques(total, device, ElbowTorque(total.torque - device.torque, np.hypot(total.sd, device.sd)))


def _compute_total_torque(
    context: Context, poses: SegmentPoses, skeleton: SpatialSkeleton, axis: FloatArray
) -> ElbowTorque | str:
    """Return the total torque about the elbow's axis, or a text that says why it is unknown."""
    keys, subject, table = context.trial.curl, context.trial.subject, context.table("poses.parquet")
    carried = [name for name in ("forearm", "hand") if name in poses.segments]
    if "forearm" not in carried:
        return "no segment is the forearm"
    if subject.mass is None and (keys.forearm is None or keys.hand is None):
        return "the inertia of forearm and hand is unknown; give `subject: {mass: …}`, or `curl: {forearm: …, hand: …}`"
    segments = []
    for name in carried:
        k = poses.segments.index(name)
        loads = [body for body in keys.loads.values() if body.segment == name or "hand" not in carried]
        own = _make_own_bodies(context, skeleton, name, alone="hand" not in carried)
        omega, alpha = (table.stack([f"{name}_{rate}_{axis}" for axis in "xyz"]) for rate in ("omega", "alpha"))
        bodies = [*own, *(_make_mass(body, _ADDED_SD) for body in loads)]
        segments.append(
            SegmentMotion(poses.origin[:, k], poses.rotation[:, k], omega, alpha, table[f"sd_{name}_alpha"], bodies)
        )
    tilt = float(np.nanmedian(table["sd_forearm_rotation"]))
    return compute_elbow_torque(poses.time, axis, segments, tilt=tilt)


def _make_own_bodies(context: Context, skeleton: SpatialSkeleton, name: str, *, alone: bool) -> list[Mass]:
    """Return the body of a segment, from the user or from the table by the person's mass and the segment's length.

    If the chain has no hand (``alone``), the result also contains the body of the hand, at the end of the forearm.
    """
    keys, subject = context.trial.curl, context.trial.subject
    length = skeleton.lengths.get("forearm", (np.nan, np.nan))[0]
    bodies = []
    for segment in (name, "hand") if alone else (name,):
        below = np.array([0.0, -length, 0.0]) if alone and segment == "hand" else np.zeros(3)
        given = keys.forearm if segment == "forearm" else keys.hand
        if given is not None:
            mass = _make_mass(given, _ADDED_SD)
        else:
            share = look_up_arm("forearm" if segment == "forearm" else "hand", subject.sex)
            own = length if segment == "forearm" else length * share.length / look_up_arm("forearm", subject.sex).length
            weight = share.mass * (subject.mass or np.nan)
            across = weight * (share.gyration * own) ** 2
            mass = Mass(weight, np.array([0.0, -share.centre * own, 0.0]), np.array([across, 0.0, across]), _TABLE_SD)
        bodies.append(Mass(mass.mass, mass.centre + below, mass.inertia, mass.relative_sd))
    return bodies


def _make_mass(body: Body, relative_sd: float) -> Mass:
    return Mass(body.mass, np.array(body.centre), np.array(body.inertia), relative_sd)
