"""Errors of the instruments and joint centres that residuals do not contain, and their effect on the parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.space.preparation import SpatialMotion, SpatialTrial, move_segments
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain

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
    whole = np.zeros(result.design.shape[-1])
    whole[: len(base)] = base
    effects: list[tuple[str, FloatArray, SpatialMotion | None, float]] = [
        (name, wrench, None, 0.0) for name, wrench in _list_plate_errors(trial.filtered[result.samples] @ base, sd)
    ]
    plain = trial.rows @ base
    for name, motion, size in _list_motion_errors(trial, sd):
        changed = trial.lowpass(trial.build_rows(motion, trial.settings.gravity) @ base - plain)[result.samples]
        effects.append((name, -changed * (size / _STEP), motion, size / _STEP))
    wrenches = np.stack([wrench * result.weights for _, wrench, _, _ in effects], axis=-1)
    responses = result.response(wrenches).T
    modes = [
        ErrorMode(name, response, motion, size)
        for (name, _, motion, size), response in zip(effects, responses, strict=True)
    ]
    return (ErrorMode("gain", sd.gain * whole), *modes)


def sum_modes(modes: tuple[ErrorMode, ...], size: int) -> FloatArray:
    """Return the covariance (size, size) of the first ``size`` parameters due to independent modes."""
    matrix = np.array([mode.parameters[:size] for mode in modes]).reshape(-1, size)
    return np.asarray(matrix.T @ matrix)


def make_exact() -> SpatialCalibration:
    """Return the calibration of exact instruments."""
    return SpatialCalibration(**{each.name: 0.0 for each in fields(SpatialCalibration)})


def _list_plate_errors(wrench: FloatArray, sd: SpatialCalibration) -> Iterator[tuple[str, FloatArray]]:
    """Yield the name of each error of the plate, and the change (R, 6) of the measured wrench with it."""
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


def _list_motion_errors(trial: SpatialTrial, sd: SpatialCalibration) -> Iterator[tuple[str, SpatialMotion, float]]:
    """Yield name, motion after a small step, and standard deviation of each error of cameras and joint centres."""
    recorded = trial.recorded
    yield "lengths", recorded.motion.scale(1 + _STEP), sd.lengths
    for axis in (0, 2):
        yield "tilt", recorded.motion.rotate(so3.exp(_STEP * np.eye(3)[axis])), sd.tilt
    for k, joint in enumerate(recorded.chain.joints):
        if not np.isfinite(joint.covariance).all():
            continue
        variance, directions = np.linalg.eigh(_project_covariance(recorded.chain, k))
        for size, direction in zip(np.sqrt(np.maximum(variance, 0.0)), directions.T, strict=True):
            joints = list(recorded.chain.joints)
            joints[k] = replace(joint, centre=joint.centre + _STEP * direction)
            chain = replace(recorded.chain, joints=tuple(joints))
            motion = move_segments(chain, recorded.centred, recorded.rotation, recorded.omega, recorded.alpha)
            yield "centre", motion, float(size)


def _project_covariance(chain: SpatialChain, k: int) -> FloatArray:
    """Return the covariance (3, 3) of a joint's centre, m², without displacements along axes of hinges.

    Such displacements do not change the motion: if the origin of a segment is displaced along the axis of its hinge,
    the joints on the segment are displaced by the opposite amount in its frame.
    """
    joint = chain.joints[k]
    axes = [joint.first_axis] if joint.kind == "hinge" else []
    if joint.parent and chain.joints[joint.parent - 1].kind == "hinge":
        before = chain.joints[joint.parent - 1]
        axes.append(before.offset.T @ before.first_axis)
    across = null_space(np.array(axes).reshape(-1, 3), rcond=1e-3)
    projection = across @ across.T
    return np.asarray(projection @ joint.covariance @ projection)
