"""Identification in space, errors that residuals do not contain, prediction, and the parameters of a payload."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeAlias

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.dynamics.cautions import LEAST_LEVER, WEAK, Excitation, classify_parameters
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.identification import Identified
from mocap_id.dynamics.instrument_errors import estimate_model_error
from mocap_id.dynamics.preparation import interpolate_samples
from mocap_id.dynamics.regressor import torque_regressor, unit_covariance, variance
from mocap_id.dynamics.space.consistency import fit_semidefinite
from mocap_id.dynamics.space.preparation import (
    SpatialMotion,
    SpatialTrial,
    move_segments,
    segment_regressor,
    shift_wrench,
)
from mocap_id.geometry import so3

_STEP = 1e-4  # relative, m or rad: step of numerical derivatives


@dataclass(frozen=True)
class SpatialCalibration:
    """Standard deviations of the instruments' errors."""

    gain: float  # relative error that is common to all components of the plate's wrench
    moments: float  # additional relative error of the plate's moments
    # force, moment: constant errors of Fy, N, and of taux and tauz, N·m, which cannot be separated from the first
    # parameters
    force: float
    moment: float
    position: float  # error of the plate's position along each axis, m
    yaw: float  # error of the plate's direction about the vertical, rad
    lengths: float  # relative error of all distances between markers
    tilt: float  # tilt between the cameras' axes and gravity about each horizontal axis, rad


ErrorMode: TypeAlias = tuple[str, FloatArray, SpatialMotion | None, float]
"""Effect of one error with the size of one standard deviation.

Field of :class:`SpatialCalibration`, or ``centre`` for a joint centre; change (b + k + 1,) of the fit's parameters, in
the order of its covariance; motion after a small step of the error, None for errors of the plate; and standard
deviation of the error, divided by this step.
"""


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
        (name, response, motion, size)
        for (name, _, motion, size), response in zip(effects, result.response(wrenches).T, strict=True)
    ]
    whole = np.zeros(result.design.shape[-1])
    whole[: len(base)] = base
    return (("gain", sd.gain * whole, None, 0.0), *modes)


def make_exact() -> SpatialCalibration:
    """Return the calibration of exact instruments."""
    return SpatialCalibration(**{each.name: 0.0 for each in fields(SpatialCalibration)})


@dataclass(frozen=True)
class SpatialIdentification(Identified):
    """The identified inertial parameters of a chain in space; its base parameters are in the simple frames."""

    modes: tuple[ErrorMode, ...]  # errors that the residuals do not contain
    # constant errors of the plate's Fx and Fz, N, and tauy, N·m; empty if they were not estimated
    plate_bias: FloatArray

    @property
    def unit_covariance(self) -> FloatArray:
        """Covariance (b, b) of the base parameters for independent weighted residuals of unit variance."""
        rows = self.fit.design.reshape(-1, self.fit.design.shape[-1])
        own = slice(len(self.base))
        return unit_covariance(rows)[own, own]


def identify_parameters_in_space(
    trial: SpatialTrial, gate: BoolArray, calibration: SpatialCalibration
) -> SpatialIdentification:
    """Identify the parameters on the gated samples (eq. 4.24-4.26), in which only the plate carries the body."""
    result = fit(trial, gate)
    solution = fit_semidefinite(result.problem, trial.structure.mapping)
    base = solution.parameters[: result.base]
    modes = propagate_errors(trial, result, base, calibration)
    of_modes = np.array([mode[1] for mode in modes]).reshape(-1, len(result.covariance))
    covariance = result.covariance + np.asarray(of_modes.T @ of_modes)
    own = slice(result.base)
    sd = np.sqrt(np.diag(covariance))
    return SpatialIdentification(
        fit=result,
        base=base,
        base_sd=sd[own],
        covariance=covariance[own, own],
        residual_covariance=result.covariance[own, own],
        modes=modes,
        offset_sd=float(sd[-1]),
        plate_bias=solution.parameters[result.base :],
        solution=solution,
    )


def measure_excitation_in_space(trial: SpatialTrial, result: SpatialIdentification, weak: float = WEAK) -> Excitation:
    """Measure the excitation of every base parameter; a relative standard deviation above ``weak`` makes it weak.

    The size of a first or second moment, with which its standard deviation is compared, is the norm of all first or
    second moments of its segment, because a single component may be zero. The size of the base's first moments is at
    least the mass times 5 cm.
    """
    segment, column = trial.base.kept // 10, trial.base.kept % 10
    order = np.where(column == 0, 0, np.where(column < 4, 1, 2))
    size = np.zeros(len(column))
    for i in range(len(size)):
        size[i] = np.linalg.norm(result.base[(segment == segment[i]) & (order == order[i])])
        if segment[i] == 0 and order[i] == 1:
            size[i] = max(size[i], LEAST_LEVER * abs(result.base[0]))
    return classify_parameters(trial.structure.names, result.fit, result.base_sd, size, weak)


_RATE = 10.0  # Hz: rate at which the effect of errors of the instruments on torques is evaluated


@dataclass(frozen=True)
class SpatialPrediction:
    """A model's wrench and joint torques in space."""

    # wrench, wrench_sd: (T, 6) force and moment of the ground about the origin of the trial's frame, N and N·m, with
    # standard deviations
    wrench: FloatArray
    wrench_sd: FloatArray
    # (T, 6) the plate's wrench, with the clock offset and the constant errors corrected, N and N·m
    measured: FloatArray
    # torque, torque_sd: (T, N) torque of each joint coordinate and its standard deviation, N·m
    torque: FloatArray
    torque_sd: FloatArray


def predict_in_space(trial: SpatialTrial, result: SpatialIdentification) -> SpatialPrediction:
    """Predict wrench and joint torques at every sample."""
    recorded, base, own = trial.recorded, result.base, result.residual_covariance
    back = shift_wrench(recorded.reference)  # from the plate's centre to the trial's origin
    bias = np.zeros(6)
    bias[list(trial.constants)] = result.plate_bias
    measured = trial.measured(result.fit.offset) - bias
    local = trial.rows @ base
    torque_rows = _compute_torque_rows(trial, recorded.motion)

    # Variances of the wrench (T, 6) and of the torques (T, N) from the standard deviations of the accelerations. The
    # wrench is linear in the accelerations, so a change of each acceleration by 1 rad/s² gives the derivative.
    of_wrench, of_torque = np.zeros((len(recorded.time), 6)), np.zeros(torque_rows.shape[:2])
    for j, beyond in enumerate(recorded.motion.beyond):
        alpha = recorded.alpha + beyond[1:, None] * recorded.motion.axis[:, j, None]
        moved = move_segments(recorded.chain, recorded.centred, recorded.rotation, recorded.omega, alpha)
        spread = recorded.alpha_sd[:, int(np.argmax(beyond)) - 1, None] ** 2
        of_wrench += spread * ((trial.build_rows(moved, trial.settings.gravity) - trial.rows) @ base) ** 2
        of_torque += spread * ((_compute_torque_rows(trial, moved) - torque_rows) @ base) ** 2

    # As in the plane, they give the course of the variances over time, and the plate gives their size
    # (:mod:`mocap_id.dynamics.instrument_errors`). The torques are scaled like the moments.
    residual = measured - local
    samples = result.fit.in_fit & find_complete_rows(residual)
    estimates = (estimate_model_error(residual[:, k], of_wrench[:, k], samples, recorded.rate) for k in range(6))
    steady, scale, overall = np.array([each or (0.0, 1.0, 1.0) for each in estimates]).T
    share = np.maximum(np.nanmean(of_wrench[:, 3:], axis=0), 1e-300)
    of_wrench = of_wrench * scale + steady
    of_torque = float(np.average(overall[3:], weights=share)) * of_torque

    # Variance of the torques from errors of instruments and joint centres: the effects of an error through the
    # parameters and through the motion are correlated and largely cancel.
    of_errors = np.full(torque_rows.shape[:2], np.nan)
    valid = np.flatnonzero(find_complete_rows(trial.regressor))
    steps = valid[:: max(1, round(recorded.rate / _RATE))]
    if len(steps):
        thin_rows = _compute_torque_rows(trial, recorded.motion.at(steps))
        total = np.zeros(thin_rows.shape[:2])
        for _, parameters, motion, size in result.modes:
            changed = thin_rows @ parameters[: len(base)]
            if motion is not None:
                moved_rows = _compute_torque_rows(trial, motion.at(steps))
                changed = changed + size * ((moved_rows - thin_rows) @ base)
            total += changed**2
        of_errors = interpolate_samples(recorded.time, valid, steps, total)

    rows = back @ trial.rows
    return SpatialPrediction(
        wrench=local @ back.T,
        wrench_sd=np.sqrt(variance(rows, own) + np.einsum("ij,tj->ti", back**2, of_wrench)),
        measured=measured @ back.T,
        torque=torque_rows @ base,
        torque_sd=np.sqrt(variance(torque_rows, own) + of_torque + of_errors),
    )


def _compute_torque_rows(trial: SpatialTrial, motion: SpatialMotion) -> FloatArray:
    """Return the rows (T, N, b) of the joint torques."""
    moved = motion.in_frames(trial.structure.frames)
    regressor = segment_regressor(moved, trial.settings.gravity)
    return torque_regressor(moved, regressor)[:, :, trial.base.kept]


_UNKNOWN = 1e-6  # part of a unit vector in the null space above which a parameter is not determined


BaseEstimate: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Base parameters of one trial, SI.

Base parameters (b,), ``unit_covariance`` and ``residual_covariance`` (b, b) of :class:`SpatialIdentification`, and
change (k, b) of the parameters with one standard deviation of each instrument's error.
"""


@dataclass(frozen=True)
class Payload:
    """Ten parameters of a payload."""

    # value, sd: (10,) m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin of the segment's frame and their
    # standard deviations, SI; NaN where the two trials do not determine a parameter
    value: FloatArray
    sd: FloatArray
    covariance: FloatArray  # (10, 10) covariance of the parameters

    def centre(self) -> tuple[FloatArray, FloatArray]:
        """Return the centre of mass (3,) in the segment's frame and its standard deviation (3,), m; NaN if unknown."""
        mass, moments = self.value[0], self.value[1:4]
        centre = moments / mass
        jacobian = np.column_stack([-centre / mass, np.eye(3) / mass])
        own = np.stack([self.covariance[np.ix_([0, k], [0, k])] for k in (1, 2, 3)])
        rows = jacobian[np.arange(3)[:, None], np.array([[0, 1], [0, 2], [0, 3]])]
        return centre, np.sqrt(np.einsum("ki,kij,kj->k", rows, own, rows))


def identify_payload(mapping: FloatArray, loaded: BaseEstimate, empty: BaseEstimate, segment: int) -> Payload:
    """Return the parameters of a payload fixed to one segment, 0 for the base.

    They are a weighted least-squares fit to the change of the base parameters (eq. 4.24), with the matrix ``mapping``
    (b, 10K) from the full parameters to the base parameters of both trials. Both trials must have the same instruments,
    and the same chain and base, for example because one trial names the other under ``calibration:``; ValueError is
    raised if their parameters differ. The errors of the instruments are the same in both trials, so they largely
    cancel.
    """
    (heavy, loaded_unit, loaded_residual, loaded_modes), (light, unit, residual, modes) = loaded, empty
    if loaded_modes.shape != modes.shape or loaded_modes.shape[1] != len(mapping):
        raise ValueError(
            f"the trials with and without payload have {len(heavy)} and {len(light)} base parameters and "
            "do not match; expected the same chain: give `calibration:` in one of the trials"
        )
    columns = mapping[:, 10 * segment : 10 * segment + 10]
    half = np.linalg.cholesky(np.linalg.inv(loaded_unit + unit)).T
    gain = np.linalg.pinv(half @ columns, rcond=1e-9) @ half
    change = (loaded_modes - modes) @ gain.T
    covariance = gain @ (loaded_residual + residual) @ gain.T + change.T @ change
    unknown = np.linalg.norm(null_space(columns, rcond=1e-9), axis=1) > _UNKNOWN
    value = np.where(unknown, np.nan, gain @ (heavy - light))
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return Payload(value, np.sqrt(np.diag(covariance)), covariance)
