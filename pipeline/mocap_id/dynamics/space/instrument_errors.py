"""Errors of the instruments and joint centres that residuals do not contain, and their effect on the parameters."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.space.preparation import SpatialMotion, SpatialTrial, move_segments
from mocap_id.geometry import so3

_STEP = 1e-4  # relative, m or rad: step of numerical derivatives


@dataclass(frozen=True)
class SpatialCalibration:
    """Standard deviations of the instruments' errors, with the defaults of the stage."""

    gain: float = 0.01  # relative error that is common to all components of the plate's wrench
    moments: float = 0.01  # additional relative error of the plate's moments
    # force, moment: constant errors of Fy, N, and of taux and tauz, N·m, which cannot be separated from the first
    # parameters
    force: float = 5.0
    moment: float = 0.5
    position: float = 0.005  # error of the plate's position along each axis, m
    yaw: float = 0.005  # error of the plate's direction about the vertical, rad
    lengths: float = 0.003  # relative error of all distances between markers
    tilt: float = 0.005  # tilt between the cameras' axes and gravity about each horizontal axis, rad


@dataclass(frozen=True)
class ErrorMode:
    """Effect of one error with the size of one standard deviation."""

    name: str  # field of `SpatialCalibration`, or `centre` for a joint centre
    parameters: FloatArray  # (b + k + 1,) change of the fit's parameters, in the order of `Fit.covariance`
    motion: SpatialMotion | None = None  # motion after a small step of the error; None for errors of the plate
    size: float = 0.0  # standard deviation of the error, divided by this step


def propagate_errors(
    trial: SpatialTrial, result: Fit, base: FloatArray, sd: SpatialCalibration
) -> tuple[ErrorMode, ...]:
    """Return the effect of each error on the fit; ``sd`` are the standard deviations of the instruments' errors."""
    recorded = trial.recorded
    # errors of the plate: name, and change (R, 6) of the measured wrench
    effects: list[tuple[str, FloatArray, SpatialMotion | None, float]] = []
    measured = trial.filtered[result.samples] @ base
    force, moment = measured[:, :3], measured[:, 3:]
    none = np.zeros_like(force)
    effects.append(("moments", np.hstack([none, sd.moments * moment]), None, 0.0))
    for name, component, size in (("force", 1, sd.force), ("moment", 3, sd.moment), ("moment", 5, sd.moment)):
        constant = np.zeros_like(measured)
        constant[:, component] = size
        effects.append((name, constant, None, 0.0))
    shifts = (np.hstack([none, sd.position * np.cross(axis, force)]) for axis in np.eye(3))
    effects += [("position", shift, None, 0.0) for shift in shifts]
    up = np.array([0.0, sd.yaw, 0.0])
    effects.append(("yaw", np.hstack([np.cross(up, force), np.cross(up, moment)]), None, 0.0))

    # errors of the cameras and joint centres: name, motion after a small step, and standard deviation
    moved = [("lengths", recorded.motion.scale(1 + _STEP), sd.lengths)]
    moved += [("tilt", recorded.motion.rotate(so3.exp(_STEP * np.eye(3)[axis])), sd.tilt) for axis in (0, 2)]
    for k, joint in enumerate(recorded.chain.joints):
        if not np.isfinite(joint.covariance).all():
            continue
        # A displacement along the axis of a hinge does not change the motion: if the origin of a segment is displaced
        # along the axis of its hinge, the joints on the segment are displaced by the opposite amount in its frame.
        axes = [joint.first_axis] if joint.kind == "hinge" else []
        if joint.parent and recorded.chain.joints[joint.parent - 1].kind == "hinge":
            before = recorded.chain.joints[joint.parent - 1]
            axes.append(before.offset.T @ before.first_axis)
        across = null_space(np.array(axes).reshape(-1, 3), rcond=1e-3)
        projection = across @ across.T
        variance, directions = np.linalg.eigh(projection @ joint.covariance @ projection)
        for size, direction in zip(np.sqrt(np.maximum(variance, 0.0)), directions.T, strict=True):
            joints = list(recorded.chain.joints)
            joints[k] = replace(joint, centre=joint.centre + _STEP * direction)
            chain = replace(recorded.chain, joints=tuple(joints))
            motion = move_segments(chain, recorded.centred, recorded.rotation, recorded.omega, recorded.alpha)
            moved.append(("centre", motion, float(size)))
    plain = trial.rows @ base
    for name, motion, size in moved:
        changed = trial.lowpass(trial.build_rows(motion, trial.settings.gravity) @ base - plain)[result.samples]
        effects.append((name, -changed * (size / _STEP), motion, size / _STEP))

    wrenches = np.stack([wrench * result.weights for _, wrench, _, _ in effects], axis=-1)
    modes = [
        ErrorMode(name, response, motion, size)
        for (name, _, motion, size), response in zip(effects, result.response(wrenches).T, strict=True)
    ]
    whole = np.zeros(result.design.shape[-1])
    whole[: len(base)] = base
    return (ErrorMode("gain", sd.gain * whole), *modes)


def make_exact() -> SpatialCalibration:
    """Return the calibration of exact instruments."""
    return SpatialCalibration(**{each.name: 0.0 for each in fields(SpatialCalibration)})
