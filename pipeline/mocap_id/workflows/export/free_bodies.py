"""A second OpenSim model, with the motion of its free bodies, for trials identified on measured poses.

The model of the chain has pin joints and cannot represent these bodies, which separate at the joints. In this second
model, every body has a planar joint to the ground and no joint to another body. Inverse dynamics then gives the force
and the moment that each body requires for its motion. The torque of a joint is the moment of these forces on all bodies
beyond it, about the joint's centre.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, PlanarMotion
from mocap_id.store import Table
from mocap_id.store.views import Skeleton
from mocap_id.workflows.export.files import (
    FREE_MODEL,
    FREE_POSES,
    MODEL,
    TORQUES,
    ExportFiles,
    name_bodies,
    name_joints,
)
from mocap_id.workflows.export.opensim_model import (
    LEAST_RANGE,
    format_dynamics_setup,
    format_model,
    place_markers,
    planar_joint,
    read_gravity,
)
from mocap_id.workflows.export.opensim_parts import Element, body_element, convert_planar_inertia, coordinate_element
from mocap_id.workflows.export.opensim_tables import format_motion
from mocap_id.workflows.moving_bodies import MovingBodies, read_measured_bodies
from mocap_id.workflows.run_folder import RunFolder

_COORDINATES = ("rz", "tx", "ty")  # OpenSim's order in a planar joint


@dataclass(frozen=True)
class _FreeBodies:
    """K free bodies with their motion at T times and their parameters."""

    names: tuple[str, ...]  # of the bodies in OpenSim
    joints: tuple[str, ...]  # names of the chain's n joints in OpenSim
    time: FloatArray  # (T,) s
    moving: MovingBodies
    parameters: FloatArray  # (K, 4) m, mx, my, Izz about the origin of each body's frame

    @property
    def motion(self) -> PlanarMotion:
        """Motion of the bodies."""
        return self.moving.motion

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates: angle, x and y of every body."""
        return [f"{name}_{each}" for name in self.names for each in _COORDINATES]

    @property
    def parted_joints(self) -> list[int]:
        """Indices of the joints between two bodies."""
        return np.flatnonzero(np.isfinite(self.motion.joint).any(axis=(0, 2))).tolist()


def _read_free_bodies(run: RunFolder) -> _FreeBodies | None:
    """Return the free bodies of a run; None if it was identified on the chain, or not at all."""
    chain, identified, poses = run.tree("chain.h5"), run.tree("dynamics.h5"), run.artefacts.get("poses.parquet")
    chosen = run.facts("dynamics.h5").get("motion") or {}
    if chain is None or identified is None or not isinstance(poses, Table) or not chosen.get("used"):
        return None
    skeleton, cutoffs = Skeleton.from_tree(chain), chosen["bands_hz"]
    bands = (float(cutoffs["x"]), float(cutoffs["y"]), float(cutoffs["angle"]))
    moving = read_measured_bodies(poses, skeleton, chosen, bands, read_gravity(run))
    return _FreeBodies(
        names=name_bodies(moving.skeleton.segments),
        joints=name_joints(skeleton),
        time=poses["time"],
        moving=moving,
        parameters=identified.numbers("bodies/value", (-1, len(PLANAR_PARAMETERS))),
    )


def export_free_poses(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free_poses.mot`` with all coordinates of free bodies, degrees and m; nothing without them."""
    bodies = _read_free_bodies(run)
    if bodies is None:
        return ExportFiles()
    values = _join_columns(np.degrees(bodies.motion.angle), bodies.motion.origin)
    file, title = run.name + FREE_POSES, "poses of the bodies"
    return format_motion(file, title, bodies.coordinates, values, time=bodies.time, in_degrees=True)


def export_free_states(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free_states.sto``, ``_free_accelerations.sto`` and ``_free_joints.sto`` (joint centres).

    A note says that the torques and the modelled wrench belong to this motion. Without free bodies, nothing is
    returned.
    """
    bodies = _read_free_bodies(run)
    if bodies is None:
        return ExportFiles()
    motion, time, parted = bodies.motion, bodies.time, bodies.parted_joints
    paths = [f"/jointset/{name}_pose/{name}_{each}" for name in bodies.names for each in _COORDINATES]
    velocity = np.gradient(motion.origin, time, axis=0)  # of the origins; no force depends on it
    states = np.hstack([_join_columns(motion.angle, motion.origin), _join_columns(motion.omega, velocity)])
    labels = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    parts = format_motion(f"{run.name}_free_states.sto", "states of the bodies", labels, states, time=time)
    accelerations = _join_columns(motion.alpha, motion.acceleration)
    file, title = f"{run.name}_free_accelerations.sto", "accelerations of the bodies"
    parts += format_motion(file, title, bodies.coordinates, accelerations, time=time)
    centres = motion.joint[:, parted].reshape(len(time), -1)
    labels = [f"{bodies.joints[j]}_{axis}" for j in parted for axis in "xy"]
    parts += format_motion(f"{run.name}_free_joints.sto", "centres of the joints", labels, centres, time=time)
    note = (
        f"sto: torques and modelled wrench belong to bodies on their measured poses ({run.name}_free_states.sto), "
        f"not to the chain ({run.name}_states.sto)"
    )
    return parts + ExportFiles(notes=(note,))


def export_free_model(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free.osim`` and ``<trial>_free_id.xml`` with a note; nothing without free bodies."""
    bodies = _read_free_bodies(run)
    if bodies is None:
        return ExportFiles()
    note = (
        f"osim: this trial was identified on the measured poses of its bodies, which separate at the joints. "
        f"{run.name}{MODEL} is the chain of pin joints: its inverse dynamics does not give {run.name}{TORQUES}. "
        f"{run.name}{FREE_MODEL} has these bodies without joints between them: the torque of a joint is the moment, "
        "about its centre, of the forces that the bodies beyond it require"
    )
    setup = format_dynamics_setup(run, (FREE_MODEL, FREE_POSES, "_opensim_free_id.sto"))
    files = {run.name + FREE_MODEL: _format_bodies(run, bodies), f"{run.name}_free_id.xml": setup}
    return ExportFiles(files, (note,))


def _join_columns(angle: FloatArray, position: FloatArray) -> FloatArray:
    """Return angles (T, K) and positions (T, K, 2) of K bodies as columns (T, 3K), body by body."""
    return np.concatenate([angle[..., None], position], axis=-1).reshape(len(angle), -1)


def _format_bodies(run: RunFolder, bodies: _FreeBodies) -> bytes:
    skeleton = bodies.moving.skeleton
    inertia = [convert_planar_inertia(block) for block in bodies.parameters]
    return format_model(
        run,
        "the plane frame",
        (
            "The bodies on which the trial was identified. They have no joints between them: each moves as its markers "
            "were measured. For each body, inverse dynamics gives the required force (tx, ty) and the required moment "
            "about the origin of its frame (rz).",
            *_describe_torques(run, bodies),
        ),
        bodies=(body_element(*each) for each in zip(bodies.names, inertia, strict=True)),
        joints=_pose_joints(bodies),
        markers=place_markers(run, bodies.names, skeleton.markers, skeleton.segment, skeleton.local),
    )


def _describe_torques(run: RunFolder, bodies: _FreeBodies) -> Iterator[str]:
    """Yield a text for each joint that explains how its torque follows from the forces on the bodies."""
    others = run.facts("dynamics.h5").get("external") or ()
    less = ", minus the moment of chair and sensors on them" if others else ""
    for joint in bodies.parted_joints:
        beyond = [name for name, is_beyond in zip(bodies.names, bodies.motion.beyond[joint], strict=True) if is_beyond]
        yield (
            f"Torque of {bodies.joints[joint]}: the moment, about its centre in {run.name}_free_joints.sto, of the "
            f"forces that these bodies require together: {', '.join(beyond)}{less}."
        )


def _pose_joints(bodies: _FreeBodies) -> Iterator[Element]:
    """Yield the joint between the ground and each body; its default values are the first known pose of the body."""
    for k, name in enumerate(bodies.names):
        poses = _join_columns(bodies.motion.angle[:, [k]], bodies.motion.origin[:, [k]])
        known = poses[np.isfinite(poses).all(axis=1)]
        first = known[0] if len(known) else np.zeros(3)
        span = (-LEAST_RANGE, LEAST_RANGE)
        coordinates = [
            coordinate_element(f"{name}_{each}", float(value), span)
            for each, value in zip(_COORDINATES, first, strict=True)
        ]
        yield planar_joint(f"{name}_pose", name, coordinates)
