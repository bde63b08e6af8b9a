"""Errors of the instruments and of the joint centres that no residual shows, and their effect on the parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.space.motion import SpatialMotion, segment_motion
from mocap_id.dynamics.space.trial import SpatialTrial
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint

_STEP = 1e-4  # relative, m or rad: step of numerical derivatives


@dataclass(frozen=True)
class SpatialCalibration:
    """Standard deviations of the instruments' errors; the defaults are those of the stage.

    Parameters
    ----------
    gain : float
        Relative error of all components of the plate's wrench alike.
    moments : float
        Relative error of its moments alone.
    force, moment : float
        Constant errors of Fy, N, and of taux and tauz, N·m, which are not separable from the first parameters.
    position : float
        Error of the plate's position, each axis, m.
    yaw : float
        Error of the plate's direction about the vertical, rad.
    lengths : float
        Relative error of all distances between markers.
    tilt : float
        Tilt between the cameras' frame and gravity about each horizontal axis, rad.
    """

    gain: float = 0.01
    moments: float = 0.01
    force: float = 5.0
    moment: float = 0.5
    position: float = 0.005
    yaw: float = 0.005
    lengths: float = 0.003
    tilt: float = 0.005


@dataclass(frozen=True)
class ErrorMode:
    """One standard deviation of one error.

    Parameters
    ----------
    name : str
        Field of :class:`SpatialCalibration`, or ``centre``.
    parameters : (b + k + 1,) array
        Change of the fit's parameters, in the order of :attr:`Fit.covariance`.
    motion : SpatialMotion or None
        The motion after one numerical step of the error; None for errors of the plate.
    size : float
        Standard deviation in units of this step.
    """

    name: str
    parameters: FloatArray
    motion: SpatialMotion | None = None
    size: float = 0.0


def error_modes(trial: SpatialTrial, found: Fit, base: FloatArray, sd: SpatialCalibration) -> tuple[ErrorMode, ...]:
    """Propagate the errors through the fit.

    Parameters
    ----------
    trial : SpatialTrial
    found : Fit
    base : (b,) array
        Base parameters.
    sd : SpatialCalibration
    """
    whole = np.zeros(found.design.shape[-1])
    whole[: len(base)] = base
    effects: list[tuple[str, FloatArray, SpatialMotion | None, float]] = [
        (name, wrench, None, 0.0) for name, wrench in _of_plate(trial.filtered[found.samples] @ base, sd)
    ]
    plain = trial.rows @ base
    for name, motion, size in _of_motion(trial, sd):
        changed = trial.lowpass(trial.rows_of(motion, trial.settings.gravity) @ base - plain)[found.samples]
        effects.append((name, -changed * (size / _STEP), motion, size / _STEP))
    wrenches = np.stack([wrench * found.weights for _, wrench, _, _ in effects], axis=-1)
    responses = found.response(wrenches).T
    modes = [
        ErrorMode(name, response, motion, size)
        for (name, _, motion, size), response in zip(effects, responses, strict=True)
    ]
    return (ErrorMode("gain", sd.gain * whole), *modes)


def covariance_of(modes: tuple[ErrorMode, ...], size: int) -> FloatArray:
    """Return the covariance (size, size) of the first parameters from independent modes."""
    matrix = np.array([mode.parameters[:size] for mode in modes]).reshape(-1, size)
    return np.asarray(matrix.T @ matrix)


def no_errors() -> SpatialCalibration:
    """Return the calibration of exact instruments."""
    return SpatialCalibration(**{each.name: 0.0 for each in fields(SpatialCalibration)})


def _of_plate(wrench: FloatArray, sd: SpatialCalibration) -> Iterator[tuple[str, FloatArray]]:
    """Yield the change (R, 6) of the measured wrench with each error of the plate."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    none = np.zeros_like(force)
    yield "moments", np.hstack([none, sd.moments * moment])
    for component, size in ((1, sd.force), (3, sd.moment), (5, sd.moment)):
        constant = np.zeros_like(wrench)
        constant[:, component] = size
        yield ("force" if component == 1 else "moment"), constant
    for axis in np.eye(3):
        yield "position", np.hstack([none, sd.position * np.cross(axis, force)])
    up = np.array([0.0, sd.yaw, 0.0])
    yield "yaw", np.hstack([np.cross(up, force), np.cross(up, moment)])


def _of_motion(trial: SpatialTrial, sd: SpatialCalibration) -> Iterator[tuple[str, SpatialMotion, float]]:
    """Yield the motion after one step of each error of the cameras and of the joint centres, and the error's size."""
    recorded = trial.recorded
    yield "lengths", recorded.motion.scale(1 + _STEP), sd.lengths
    for axis in (0, 2):
        yield "tilt", recorded.motion.rotate(so3.exp(_STEP * np.eye(3)[axis])), sd.tilt
    for k, joint in enumerate(recorded.chain.joints):
        if not np.isfinite(joint.covariance).all():
            continue
        variance, directions = np.linalg.eigh(_without_slides(recorded.chain, k))
        for size, direction in zip(np.sqrt(np.maximum(variance, 0.0)), directions.T, strict=True):
            moved = replace(joint, centre=joint.centre + _STEP * direction)
            chain = _with_joint(recorded.chain, k, moved)
            motion = segment_motion(chain, recorded.centred, recorded.rotation, recorded.omega, recorded.alpha)
            yield "centre", motion, float(size)


def _without_slides(chain: SpatialChain, k: int) -> FloatArray:
    """Return the covariance (3, 3) of a joint's centre without the directions of hinges, m².

    The origin of a segment may slide along the axis of its hinge, and the joints on the segment slide back: this
    changes no motion.
    """
    joint = chain.joints[k]
    axes = [joint.first_axis] if joint.kind == "hinge" else []
    if joint.parent and chain.joints[joint.parent - 1].kind == "hinge":
        before = chain.joints[joint.parent - 1]
        axes.append(before.offset.T @ before.first_axis)
    across = null_space(np.array(axes).reshape(-1, 3), rcond=1e-3)
    projection = across @ across.T
    return np.asarray(projection @ joint.covariance @ projection)


def _with_joint(chain: SpatialChain, k: int, joint: SpatialJoint) -> SpatialChain:
    joints = list(chain.joints)
    joints[k] = joint
    return replace(chain, joints=tuple(joints))
