"""A second OpenSim model, with the motion of its free bodies, for trials identified on measured poses.

The model of the chain has pin joints and cannot represent these bodies, which separate at the joints. In this second
model, every body has a planar joint to the ground and no joint to another body. Inverse dynamics then gives the force
and the moment that each body requires for its motion. The torque of a joint is the moment of these forces on all bodies
beyond it, about the joint's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.store import Table
from mocap_id.store.views import Skeleton
from mocap_id.workflows.export.files import (
    FREE_MODEL,
    FREE_POSES,
    MODEL,
    TORQUES,
    ExportFiles,
    opensim_bodies,
    opensim_joints,
)
from mocap_id.workflows.export.opensim_model import (
    LEAST_RANGE,
    body_element,
    convert_planar_inertia,
    coordinate_element,
    format_dynamics_setup,
    format_model,
    place_markers,
    planar_joint,
    read_gravity,
)
from mocap_id.workflows.export.opensim_tables import add_motion
from mocap_id.workflows.identified_trial import MovingBodies, read_measured_bodies
from mocap_id.workflows.run_folder import RunFolder

_COORDINATES = ("rz", "tx", "ty")  # OpenSim's order in a planar joint


@dataclass(frozen=True)
class _FreeBodies:
    """K free bodies with their motion at T times and their parameters."""

    names: tuple[str, ...]  # of the bodies in OpenSim
    joints: tuple[str, ...]  # names of the chain's n joints in OpenSim
    parted: list[int]  # indices of the joints between two bodies
    time: FloatArray  # (T,) s
    moving: MovingBodies
    parameters: FloatArray  # (K, 4) m, mx, my, Izz about the origin of each body's frame

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates: angle, x and y of every body."""
        return [f"{name}_{each}" for name in self.names for each in _COORDINATES]


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
        names=opensim_bodies(moving.skeleton.segments),
        joints=opensim_joints(skeleton),
        parted=np.flatnonzero(np.isfinite(moving.motion.joint).any(axis=(0, 2))).tolist(),
        time=poses["time"],
        moving=moving,
        parameters=identified.numbers("bodies/value", (-1, len(PLANAR_PARAMETERS))),
    )


def export_free_poses(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free_poses.mot`` with all coordinates of free bodies, degrees and m; nothing without them."""
    bodies = _read_free_bodies(run)
    if bodies is not None:
        values = _join_columns(np.degrees(bodies.moving.motion.angle), bodies.moving.motion.origin)
        file, title = run.name + FREE_POSES, "poses of the bodies"
        add_motion(out, file, title, bodies.coordinates, values, time=bodies.time, in_degrees=True)


def export_free_states(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free_states.sto``, ``_free_accelerations.sto`` and ``_free_joints.sto`` (joint centres).

    A note says that the torques and the modelled wrench belong to this motion. Without free bodies, nothing is added.
    """
    bodies = _read_free_bodies(run)
    if bodies is None:
        return
    motion, time, parted = bodies.moving.motion, bodies.time, bodies.parted
    paths = [f"/jointset/{name}_pose/{name}_{each}" for name in bodies.names for each in _COORDINATES]
    velocity = np.gradient(motion.origin, time, axis=0)  # of the origins; no force depends on it
    states = np.hstack([_join_columns(motion.angle, motion.origin), _join_columns(motion.omega, velocity)])
    labels = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    add_motion(out, f"{run.name}_free_states.sto", "states of the bodies", labels, states, time=time)
    accelerations = _join_columns(motion.alpha, motion.acceleration)
    file, title = f"{run.name}_free_accelerations.sto", "accelerations of the bodies"
    add_motion(out, file, title, bodies.coordinates, accelerations, time=time)
    centres = motion.joint[:, parted].reshape(len(time), -1)
    labels = [f"{bodies.joints[j]}_{axis}" for j in parted for axis in "xy"]
    add_motion(out, f"{run.name}_free_joints.sto", "centres of the joints", labels, centres, time=time)
    out.note(
        f"sto: torques and modelled wrench belong to bodies on their measured poses ({run.name}_free_states.sto), "
        f"not to the chain ({run.name}_states.sto)"
    )


def export_free_model(run: RunFolder, out: ExportFiles) -> None:
    """Add ``<trial>_free.osim`` and ``<trial>_free_id.xml`` with a note; nothing without free bodies."""
    bodies = _read_free_bodies(run)
    if bodies is None:
        return
    motion, skeleton = bodies.moving.motion, bodies.moving.skeleton
    comments = [
        "The bodies on which the trial was identified. They have no joints between them: each moves as its markers "
        "were measured. For each body, inverse dynamics gives the required force (tx, ty) and the required moment "
        "about the origin of its frame (rz)."
    ]
    # How the torque of each joint follows from the forces on the bodies.
    others = run.facts("dynamics.h5").get("external") or ()
    less = ", minus the moment of chair and sensors on them" if others else ""
    for j in bodies.parted:
        beyond = [name for name, is_beyond in zip(bodies.names, motion.beyond[j], strict=True) if is_beyond]
        comments.append(
            f"Torque of {bodies.joints[j]}: the moment, about its centre in {run.name}_free_joints.sto, of the "
            f"forces that these bodies require together: {', '.join(beyond)}{less}."
        )
    # The joints between the ground and each body; their default values are the first known pose of the body.
    joints = []
    for k, name in enumerate(bodies.names):
        poses = _join_columns(motion.angle[:, [k]], motion.origin[:, [k]])
        known = poses[np.isfinite(poses).all(axis=1)]
        first = known[0] if len(known) else np.zeros(3)
        coordinates = [
            coordinate_element(f"{name}_{each}", float(value), (-LEAST_RANGE, LEAST_RANGE))
            for each, value in zip(_COORDINATES, first, strict=True)
        ]
        joints.append(planar_joint(f"{name}_pose", name, coordinates))
    elements = [
        body_element(name, convert_planar_inertia(block))
        for name, block in zip(bodies.names, bodies.parameters, strict=True)
    ]
    markers = list(place_markers(run, bodies.names, skeleton.markers, skeleton.segment, skeleton.local))
    parts = {"bodies": elements, "joints": joints, "markers": markers}
    out.files[run.name + FREE_MODEL] = format_model(run, "the plane frame", comments, **parts)
    setup = format_dynamics_setup(run, (FREE_MODEL, FREE_POSES, "_opensim_free_id.sto"))
    out.files[f"{run.name}_free_id.xml"] = setup
    out.note(
        f"osim: this trial was identified on the measured poses of its bodies, which separate at the joints. "
        f"{run.name}{MODEL} is the chain of pin joints: its inverse dynamics does not give {run.name}{TORQUES}. "
        f"{run.name}{FREE_MODEL} has these bodies without joints between them: the torque of a joint is the moment, "
        "about its centre, of the forces that the bodies beyond it require"
    )


def _join_columns(angle: FloatArray, position: FloatArray) -> FloatArray:
    """Return angles (T, K) and positions (T, K, 2) of K bodies as columns (T, 3K), body by body."""
    return np.concatenate([angle[..., None], position], axis=-1).reshape(len(angle), -1)
