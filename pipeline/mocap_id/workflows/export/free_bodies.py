"""A second OpenSim model for trials identified on measured poses, with the motion of its free bodies.

The chain's model has pin joints and cannot represent these bodies, which separate at the joints. Here every body has a
planar joint to the ground and no joint to another body. Inverse dynamics then gives the force and the moment that each
body requires; the torque of a joint is the moment about its centre of these forces on the bodies beyond it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.motion import PlanarMotion
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS
from mocap_id.store import Table
from mocap_id.store.views import Skeleton
from mocap_id.workflows.export.files import ExportFiles, free_model_file, free_poses_file, model_file, torques_file
from mocap_id.workflows.export.inertia import about_centre
from mocap_id.workflows.export.model import (
    coordinate_element,
    gravity,
    marker_elements,
    object_set,
    planar_body,
    planar_joint,
)
from mocap_id.workflows.export.motions import sampled
from mocap_id.workflows.export.names import joint_names, legal
from mocap_id.workflows.export.xml import Element, document, element, numbers, remark
from mocap_id.workflows.moving_bodies import MovingBodies, on_measured_poses
from mocap_id.workflows.run_folder import RunFolder

_COORDINATES = ("rz", "tx", "ty")  # OpenSim's order in a planar joint


@dataclass(frozen=True)
class FreeBodies:
    """K free bodies with their motion and parameters.

    Parameters
    ----------
    names : tuple of str
        OpenSim's names of the bodies.
    joints : tuple of str
        OpenSim's names of the chain's n joints.
    time : (T,) array
        s.
    moving : MovingBodies
    parameters : (K, 4) array
        m, mx, my, Izz about the origin of each body's frame.
    """

    names: tuple[str, ...]
    joints: tuple[str, ...]
    time: FloatArray
    moving: MovingBodies
    parameters: FloatArray

    @property
    def motion(self) -> PlanarMotion:
        """Motion of the bodies."""
        return self.moving.motion

    @property
    def coordinates(self) -> list[str]:
        """Names of the coordinates: angle, x and y of every body."""
        return [f"{name}_{each}" for name in self.names for each in _COORDINATES]

    @cached_property
    def speed(self) -> FloatArray:
        """(T, K, 2) velocities of the frames' origins, m/s, on which no force depends."""
        return np.asarray(np.gradient(self.motion.origin, self.time, axis=0))

    @property
    def parted(self) -> list[int]:
        """Indices of the joints between two bodies."""
        return np.flatnonzero(np.isfinite(self.motion.joint).any(axis=(0, 2))).tolist()

    def beyond(self, joint: int) -> str:
        """Return the names of the bodies beyond a joint."""
        return ", ".join(name for name, carried in zip(self.names, self.motion.beyond[joint], strict=True) if carried)


def free_bodies(run: RunFolder) -> FreeBodies | None:
    """Return the free bodies of a run; None if it was identified on the chain, or not at all."""
    chain, found, poses = run.tree("chain.h5"), run.tree("dynamics.h5"), run.artefacts.get("poses.parquet")
    chosen = run.facts("dynamics.h5").get("motion") or {}
    if chain is None or found is None or not isinstance(poses, Table) or not chosen.get("used"):
        return None
    skeleton, cutoffs = Skeleton.from_tree(chain), chosen["bands_hz"]
    bands = (float(cutoffs["x"]), float(cutoffs["y"]), float(cutoffs["angle"]))
    moving = on_measured_poses(poses, skeleton.centres, chosen["used"], bands, gravity(run))
    return FreeBodies(
        names=tuple(legal(moving.skeleton.segments, taken=("ground",)).values()),
        joints=joint_names(skeleton),
        time=poses["time"],
        moving=moving,
        parameters=found.numbers("bodies/value", (-1, len(PLANAR_PARAMETERS))),
    )


def free_poses(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free_poses.mot`` with every coordinate of the free bodies, degrees and m."""
    bodies = free_bodies(run)
    if bodies is None:
        return ExportFiles()
    values = _columns(np.degrees(bodies.motion.angle), bodies.motion.origin)
    return sampled(
        free_poses_file(run), "poses of the bodies", bodies.coordinates, values, time=bodies.time, in_degrees=True
    )


def free_states(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free_states.sto``, ``_free_accelerations.sto`` and ``_free_joints.sto`` (joint centres).

    A note says that the torques and the modelled wrench belong to this motion.
    """
    bodies = free_bodies(run)
    if bodies is None:
        return ExportFiles()
    motion, time = bodies.motion, bodies.time
    paths = [f"/jointset/{name}_pose/{name}_{each}" for name in bodies.names for each in _COORDINATES]
    states = np.hstack([_columns(motion.angle, motion.origin), _columns(motion.omega, bodies.speed)])
    labels = [*(f"{path}/value" for path in paths), *(f"{path}/speed" for path in paths)]
    parts = sampled(f"{run.name}_free_states.sto", "states of the bodies", labels, states, time=time)
    accelerations = _columns(motion.alpha, motion.acceleration)
    file, title = f"{run.name}_free_accelerations.sto", "accelerations of the bodies"
    parts += sampled(file, title, bodies.coordinates, accelerations, time=time)
    centres = motion.joint[:, bodies.parted].reshape(len(time), -1)
    labels = [f"{bodies.joints[j]}_{axis}" for j in bodies.parted for axis in "xy"]
    parts += sampled(f"{run.name}_free_joints.sto", "centres of the joints", labels, centres, time=time)
    note = (
        f"sto: torques and modelled wrench are those of bodies on their measured poses ({run.name}_free_states.sto), "
        f"not of the chain ({run.name}_states.sto)"
    )
    return parts + ExportFiles(notes=(note,))


def free_model(run: RunFolder) -> ExportFiles:
    """Return ``<trial>_free.osim`` and ``<trial>_free_id.xml``, with a note on the limits of the chain's model."""
    bodies = free_bodies(run)
    if bodies is None:
        return ExportFiles()
    of_chain, of_bodies = model_file(run), free_model_file(run)
    note = (
        f"osim: this trial was identified on bodies that move as their markers were measured and separate at the "
        f"joints. {of_chain} is the chain of pins: its inverse dynamics does not give {torques_file(run)}. "
        f"{of_bodies} has these bodies without joints between them: the torque of a joint is the moment about its "
        "centre of the forces that the bodies beyond it require"
    )
    return ExportFiles({of_bodies: _model(run, bodies), f"{run.name}_free_id.xml": _dynamics(run)}, (note,))


def _columns(angle: FloatArray, place: FloatArray) -> FloatArray:
    """Return angle (T, K) and place (T, K, 2) as columns (T, 3K), body by body."""
    return np.concatenate([angle[..., None], place], axis=-1).reshape(len(angle), -1)


def _model(run: RunFolder, bodies: FreeBodies) -> bytes:
    skeleton = bodies.moving.skeleton
    inertia = [about_centre(block) for block in bodies.parameters]
    places = (skeleton.segment, skeleton.local)
    children = [
        remark(f"Made by mocap-id {__version__} from the trial {run.name}. Ground is the plane frame."),
        remark(
            "The bodies on which the trial was identified. They have no joints: each moves as its markers were "
            "measured. Inverse dynamics gives the force (tx, ty) and the moment about the origin of its frame (rz) "
            "that each requires."
        ),
        *(remark(text) for text in _torques(run, bodies)),
        element("length_units", text="meters"),
        element("force_units", text="N"),
        element("gravity", text=numbers([0.0, -bodies.moving.gravity, 0.0])),
        object_set("BodySet", (planar_body(*each) for each in zip(bodies.names, inertia, strict=True))),
        object_set("JointSet", _poses(bodies)),
        object_set("MarkerSet", marker_elements(run, bodies.names, skeleton.markers, places)),
    ]
    return document(element("Model", name=legal([run.name])[run.name], children=children))


def _torques(run: RunFolder, bodies: FreeBodies) -> Iterator[str]:
    """Yield how the torque of each joint follows from the forces on the bodies."""
    others = run.facts("dynamics.h5").get("external") or ()
    less = " less the moment of chair and sensors on them" if others else ""
    for joint in bodies.parted:
        yield (
            f"Torque of {bodies.joints[joint]}: the moment about its centre, which is in {run.name}_free_joints.sto, "
            f"of the forces that these require together: {bodies.beyond(joint)}{less}."
        )


def _poses(bodies: FreeBodies) -> Iterator[Element]:
    for k, name in enumerate(bodies.names):
        start = _columns(bodies.motion.angle[:, [k]], bodies.motion.origin[:, [k]])
        known = start[np.isfinite(start).all(axis=1)]
        first = known[0] if len(known) else np.zeros(3)
        yield planar_joint(
            f"{name}_pose",
            name,
            [
                coordinate_element(f"{name}_{each}", float(value))
                for each, value in zip(_COORDINATES, first, strict=True)
            ],
        )


def _dynamics(run: RunFolder) -> bytes:
    children = [
        element("model_file", text=free_model_file(run)),
        element("coordinates_file", text=free_poses_file(run)),
        element("output_gen_force_file", text=f"{run.name}_opensim_free_id.sto"),
    ]
    return document(element("InverseDynamicsTool", name=legal([run.name])[run.name], children=children))
