"""Predicted wrench, centre of pressure and torques with standard deviations, and their agreement with measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, find_complete_rows
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import (
    ModelError,
    compute_scale_variance,
    estimate_model_error,
    propagate_to_torques,
)
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import (
    PLANAR_PARAMETERS,
    WRENCH_COMPONENTS,
    composite_inertia,
    determines_rows,
    sum_external,
    torque_regressor,
    variance,
)

_MOMENT = WRENCH_COMPONENTS.index("tauz")  # always fitted if torques are predicted, because of the moments of inertia
_UNSEEN = 2.0  # error of Fx divided by that of Fy, if no sensor measures Fx; with plates, this ratio is 0.7 to 2


@dataclass(frozen=True)
class Prediction:
    """A model's wrench, centre of pressure and joint torques, with standard deviations."""

    # wrench, wrench_sd: (T, 3) Fx, Fy, tauz of the ground, N and N·m: the wrench that the motion requires minus the
    # measured external wrenches
    wrench: FloatArray
    wrench_sd: FloatArray
    # cop, cop_sd: (T,) centre of pressure, m; NaN where the body does not load the plate
    cop: FloatArray
    cop_sd: FloatArray
    # torque, torque_sd: (T, n) joint torques, N·m
    torque: FloatArray
    torque_sd: FloatArray
    # torque_lasting_sd, torque_noise_sd: (T, n) two parts of `torque_sd`, N·m, without errors of scale. The first is
    # from parameters and geometry, whose error is persistent: nearly the same in the whole trial. The second is from
    # noise of the motion.
    torque_lasting_sd: FloatArray
    torque_noise_sd: FloatArray
    # columns (Fx, Fy, tauz, cop_x, tau_1 …) that are NaN, because they depend on parameters that the fitted components
    # do not determine
    undetermined: tuple[str, ...]

    def replace_torques(self, other: Prediction) -> Prediction:
        """Return a copy with the torques, and their standard deviations, of another prediction."""
        return replace(
            self,
            torque=other.torque,
            torque_sd=other.torque_sd,
            torque_lasting_sd=other.torque_lasting_sd,
            torque_noise_sd=other.torque_noise_sd,
        )


@dataclass(frozen=True)
class PredictionNoise:
    """Errors of a model's wrench and torques that are not due to its parameters."""

    wrench: FloatArray  # (T, 3, 3) covariance of the wrench, N² and (N·m)²
    # torque, torque_lasting: (T, n) variances of the torques from noise of the motion, and from errors of the geometry
    # that recur with the movement, (N·m)²
    torque: FloatArray
    torque_lasting: FloatArray


def predict(prepared: PreparedTrial, result: Identification, noise: PredictionNoise, threshold: float) -> Prediction:
    """Predict wrench, centre of pressure (NaN where Fy is at most ``threshold``, N) and joint torques at every sample.

    If Fy and tauz were fitted, the base parameters determine all these series. Otherwise, the series without a
    determined value are NaN, and ``undetermined`` lists them.
    """
    base, own = result.base, result.residual_covariance
    full_torque = torque_regressor(prepared.motion, prepared.regressor)
    placed = np.isfinite(prepared.motion.joint).any(axis=(0, 2))
    determined = _find_determined(prepared.regressor, prepared)
    torque_determined = _find_determined(full_torque, prepared) & placed
    rows = np.where(determined[:, None], prepared.rows, np.nan)
    torque_rows = np.where(torque_determined[:, None], full_torque[:, :, prepared.base.kept], np.nan)
    # the external wrenches reduce the ground's wrench (T, 3) and the torques (T, n)
    recorded = prepared.recorded
    segment = np.array([each.segment for each in recorded.external], dtype=np.int64)
    external = prepared.external(result.fit.offset)
    wrenches = np.stack(external, axis=-1) if external else np.zeros((len(recorded.time), 3, 0))
    joints = np.arange(1, recorded.q.shape[1] + 1)
    elsewhere, relieved = sum_external(prepared.motion.jacobian, joints, wrenches, segment)
    wrench, torque = rows @ base - elsewhere, torque_rows @ base - relieved
    cop_rows = centre_of_pressure_rows(rows, wrench, threshold)
    cop_own = centre_of_pressure_rows(np.broadcast_to(np.eye(3), (len(wrench), 3, 3)), wrench, threshold)
    lasting = variance(torque_rows, own) + noise.torque_lasting
    of_scale = 0.0 if result.calibration is None else compute_scale_variance(prepared, base, result.calibration)
    unknown = [name for name, known in zip(WRENCH_COMPONENTS, determined, strict=True) if not known]
    if {"Fy", "tauz"} & set(unknown):
        unknown.append("cop_x")
    unknown += [f"tau_{j}" for j, known in enumerate(torque_determined, start=1) if not known]
    return Prediction(
        wrench=wrench,
        wrench_sd=np.sqrt(variance(rows, own) + np.einsum("tkk->tk", noise.wrench)),
        cop=centre_of_pressure(wrench, threshold),
        cop_sd=np.sqrt(variance(cop_rows, own) + _propagate_covariance(cop_own[:, None], noise.wrench)[:, 0]),
        torque=torque,
        torque_sd=np.sqrt(lasting + noise.torque + of_scale),
        torque_lasting_sd=np.sqrt(lasting),
        torque_noise_sd=np.sqrt(noise.torque),
        undetermined=tuple(unknown),
    )


def estimate_chain_noise(
    prepared: PreparedTrial, result: Identification, correlation: FloatArray, centre_sd: FloatArray | None = None
) -> PredictionNoise:
    """Return the errors of the wrench and torques of a pinned chain, due to accelerations and geometry.

    The standard deviations of the accelerations determine how the noise varies over time, and ``correlation`` (T, n, n)
    how it is correlated between the joints. The plate determines the magnitude of the noise
    (:mod:`mocap_id.dynamics.instrument_errors`) and the part of the wrench's error that is independent of the
    accelerations. The noise of the torques is scaled like that of tauz, because torques are moments. Errors of the
    geometry are added only to the torques: for the wrench, the fitted parameters compensate these errors. ``centre_sd``
    (n,), m, are the standard deviations of the centres of joints that may not be perfect pins.
    """
    recorded, base = prepared.recorded, result.base
    needed = np.where(_find_determined(prepared.regressor, prepared)[:, None], prepared.rows, np.nan) @ base
    noise = correlation * recorded.ddq_sd[:, :, None] * recorded.ddq_sd[:, None, :]
    # derivatives with respect to the accelerations, for the body whose regrouped parameters are zero
    mass, mx, my, inertia = prepared.base.expand(base).reshape(-1, len(PLANAR_PARAMETERS)).T
    first = np.column_stack([mx, my])
    wrench_gain, torque_gain = composite_inertia(recorded.q, recorded.centres, mass, first, inertia)
    # the model's error in each component; if it cannot be estimated, it follows from the states alone
    residual, of_states = prepared.measured(result.fit.offset) - needed, _propagate_covariance(wrench_gain, noise)
    found = [estimate_model_error(residual[:, k], of_states[:, k], result.fit.in_fit, recorded.rate) for k in range(3)]
    usual = ModelError(0.0, 1.0, max((error.overall for error in found if error is not None), default=1.0))
    errors = [error or usual for error in found]
    wrench_gain *= np.sqrt([error.scale for error in errors])[:, None]
    torque_gain *= np.sqrt(errors[_MOMENT].overall)
    steady = np.diag([error.steady for error in errors])
    geometry = propagate_to_torques(prepared, base, result.error, result.response)
    if centre_sd is not None:
        geometry = geometry + _propagate_centres(prepared, result.full, centre_sd)
    return PredictionNoise(
        wrench=wrench_gain @ noise @ np.swapaxes(wrench_gain, 1, 2) + steady,
        torque=_propagate_covariance(torque_gain, noise),
        torque_lasting=geometry,
    )


def estimate_residual_noise(
    prepared: PreparedTrial,
    result: Identification,
    residual: FloatArray,
    *,
    centre_sd: FloatArray,
    of_poses: FloatArray,
    parameters: float = 0.0,
) -> PredictionNoise:
    """Return the errors of the wrench and torques of a model on measured poses, estimated from residuals.

    ``residual`` (T, 3) is the measured minus the modelled wrench without the low-pass of the fit, if possible of
    left-out repetitions; NaN in all other samples. The variance of the plate's white noise is subtracted here.
    ``parameters`` is the fraction of the squared residual that the fit has absorbed. ``centre_sd`` (n,), m, are the
    standard deviations of the joint centres, whose effect on the torque is proportional to the force through the joint.
    ``of_poses`` (T, n) is the variance of the torques from errors of the poses that recur with the movement, (N·m)².
    """
    recorded, size = prepared.recorded, len(prepared.regressor)
    alone = 0 not in recorded.measures  # no sensor measures Fx
    residual = residual[:, [1, 1, 2]] if alone else residual
    valid = find_complete_rows(residual)
    correlation = np.corrcoef(residual[valid].T)
    nothing = np.zeros(size)
    errors = [estimate_model_error(residual[:, k], nothing, valid, recorded.rate) for k in range(3)]
    spread = np.array([np.var(residual[valid, k]) if e is None else e.steady for k, e in enumerate(errors)])
    spread = spread + np.mean(residual[valid], axis=0) ** 2
    covariance = correlation * np.sqrt(np.outer(spread, spread)) / max(1.0 - parameters, 0.1)
    if alone:
        covariance[0, 1:] = covariance[1:, 0] = 0.0
        covariance[0, 0] *= _UNSEEN**2
    jacobian = prepared.motion.jacobian
    moment = np.einsum("tcj,cd,tdj->tj", jacobian, covariance, jacobian)
    return PredictionNoise(
        wrench=np.broadcast_to(covariance, (size, 3, 3)),
        torque=moment,
        torque_lasting=_propagate_centres(prepared, result.base, centre_sd) + of_poses,
    )


def _propagate_centres(prepared: PreparedTrial, full: FloatArray, centre_sd: FloatArray) -> FloatArray:
    """Return the variance (T, n) of the torques due to errors of the joint centres, which are levers of the force."""
    distal = np.repeat(prepared.motion.beyond, len(PLANAR_PARAMETERS), axis=1)  # (n, 4K)
    force = np.einsum("tcp,jp->tjc", prepared.regressor[:, :2], distal * full)
    return np.asarray(centre_sd**2 * np.sum(force**2, axis=2))


def _find_determined(regressor: FloatArray, prepared: PreparedTrial) -> BoolArray:
    """Return a mask (k,) of the rows of a full regressor (T, k, p) that the base parameters determine."""
    rows = (regressor[:, k] for k in range(regressor.shape[1]))
    return np.array([determines_rows(each, prepared.base) for each in rows], dtype=np.bool_)


def _propagate_covariance(gain: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance (T, k) of linear functions with gains (T, k, n) of errors with covariance (T, n, n)."""
    return np.asarray(np.maximum(np.einsum("tki,tij,tkj->tk", gain, covariance, gain, optimize=True), 0.0))


@dataclass(frozen=True)
class Agreement:
    """Difference between model and measurement over some samples."""

    # bias, sd: mean and standard deviation of model minus measurement
    bias: float
    sd: float
    r2: float  # fraction of the measurement's variance that the model explains


def centre_of_pressure(wrench: FloatArray, threshold: float) -> FloatArray:
    """Return x (...), m, where the force of a wrench (..., 3) crosses y = 0; NaN where Fy is at most ``threshold``."""
    vertical = wrench[..., 1]
    loaded = vertical > threshold
    return np.where(loaded, wrench[..., 2] / np.where(loaded, vertical, 1.0), np.nan)


def centre_of_pressure_rows(rows: FloatArray, wrench: FloatArray, threshold: float) -> FloatArray:
    """Return the derivative (..., b) of the centre of pressure by the parameters of a wrench with rows (..., 3, b)."""
    cop = centre_of_pressure(wrench, threshold)
    vertical = np.where(np.isfinite(cop), wrench[..., 1], np.nan)
    return (rows[..., 2, :] - cop[..., None] * rows[..., 1, :]) / vertical[..., None]


def agreement(model: FloatArray, measured: FloatArray, samples: BoolArray) -> Agreement | None:
    """Compare two series (T,) over the marked samples in which both have values; return None for fewer than two."""
    both = samples & np.isfinite(model) & np.isfinite(measured)
    if both.sum() < 2:
        return None
    error, reference = (model - measured)[both], measured[both]
    spread = float(np.sum((reference - reference.mean()) ** 2))
    r2 = 1.0 - float(np.sum(error**2)) / spread if spread > 0.0 else float("nan")
    return Agreement(float(error.mean()), float(error.std()), r2)


LEAST_MARKERS = 2  # least number of common markers with which a body is registered
LEAST_SPREAD = 0.02  # m: least rms distance of common markers from their centroid that determines the orientation


@dataclass(frozen=True)
class BodyFrames:
    """The joints and markers that define the frames of a trial's bodies."""

    segments: tuple[str, ...]  # names of the K bodies, base first
    centres: FloatArray  # (n, 2) centre of each joint in the frame of the body before it, m; NaN where unknown
    between: IntArray  # (n, 2) bodies before and after each joint; the body of arms and head has no joint
    markers: tuple[str, ...]  # labels of the markers
    segment: IntArray  # (M,) body of each marker
    local: FloatArray  # (M, 2) markers in the body's frame, m

    @property
    def jointed(self) -> IntArray:
        """Bodies beyond a joint: neither the base nor the body of arms and head, which is not rigid."""
        return np.unique(self.between[:, 1])


@dataclass(frozen=True)
class Registration:
    """Transformation of the frames of K bodies from one trial to another: a point c becomes R(angle) c + shift."""

    angle: FloatArray  # (K,) rotation, rad; 0 for the base, whose frame is the plane frame in both trials
    shift: FloatArray  # (K, 2) translation, m; for the base, the displacement of the feet
    markers: IntArray  # (K,) number of common markers
    residual: FloatArray  # (K,) rms distance of the common markers after registration, m; NaN without common markers
    mirrored: FloatArray  # (K,) residual for the mirrored body, m; close to `residual` if the markers are collinear
    spread: FloatArray  # (K,) rms distance of the common markers from their centroid, m
    # (n,) distance between the two trials' positions of each joint, relative to the markers of the body before it, m;
    # NaN where unknown
    joint: FloatArray


def register_bodies(there: BodyFrames, here: BodyFrames) -> Registration:
    """Return the registration of the bodies of the trial ``there`` to the same bodies of the trial ``here``.

    It is NaN for a body with fewer than two markers that both trials have, except for the base.
    """
    count = len(here.segments)
    angle, shift = np.zeros(count), np.zeros((count, 2))
    markers, residual = np.zeros(count, dtype=np.int64), np.full(count, np.nan)
    mirrored, spread = np.full(count, np.nan), np.zeros(count)
    for k in range(count):
        # coordinates (k, 2), m, of the markers that both trials have on the body, in each trial's frame
        old, new = ({name: i for i, name in enumerate(of.markers) if of.segment[i] == k} for of in (there, here))
        both = [name for name in old if name in new]
        before, after = there.local[[old[name] for name in both]], here.local[[new[name] for name in both]]
        markers[k] = len(before)
        if k == 0:
            # Markers of the base are on the feet or on the plate, where they do not move. A marker counts as on the
            # feet if its displacement is closer to that of the ankle than to zero. If none is, all markers are used.
            # The displacement of the feet affects only the mass of the foot.
            ankle, displaced = here.centres[0] - there.centres[0], after - before
            on_feet = np.linalg.norm(displaced - ankle, axis=1) <= np.linalg.norm(displaced, axis=1)
            used = displaced[on_feet if on_feet.any() else ~on_feet]
            shift[k] = np.median(used, axis=0) if both else ankle
            residual[k] = _compute_rms(used - shift[k])
            continue
        if len(before) < LEAST_MARKERS:
            angle[k], shift[k] = np.nan, np.nan
            continue
        angle[k], shift[k], residual[k] = _register(before, after)
        spread[k] = _compute_rms(before - before.mean(axis=0))
        mirrored[k] = _register(before * [-1.0, 1.0], after)[2]
    below = there.between[:, 0]
    moved = [_rotate(angle[k], centre) + shift[k] for k, centre in zip(below, there.centres, strict=True)]
    joint = np.linalg.norm(np.reshape(moved, (-1, 2)) - here.centres, axis=1)
    return Registration(angle, shift, markers, residual, mirrored, spread, joint)


def transfer_parameters(full: FloatArray, registration: Registration) -> FloatArray:
    """Return the full parameters (4K,), base first, in the frames of the other trial."""
    moved = []
    for block, angle, shift in zip(full.reshape(-1, 4), registration.angle, registration.shift, strict=True):
        mass, first = block[0], _rotate(angle, block[1:3])
        inertia = block[3] + 2 * float(shift @ first) + mass * float(shift @ shift)
        moved.append(np.array([mass, *(first + mass * shift), inertia]))
    return np.concatenate(moved)


def transfer_covariance(covariance: FloatArray, registration: Registration) -> FloatArray:
    """Return the covariance (4K, 4K) of the transferred parameters, without errors of the registration."""
    move = np.column_stack([transfer_parameters(unit, registration) for unit in np.eye(len(covariance))])
    return np.asarray(move @ covariance @ move.T)


def _register(before: FloatArray, after: FloatArray) -> tuple[float, FloatArray, float]:
    """Fit the rigid motion from points (k, 2) to other points (k, 2); return angle, shift (2,) and rms residual."""
    middle, goal = before.mean(axis=0), after.mean(axis=0)
    a, b = before - middle, after - goal
    angle = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    return angle, goal - _rotate(angle, middle), _compute_rms(_rotate(angle, a) - b)


def _rotate(angle: float, points: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _compute_rms(distances: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(distances**2, axis=-1)))) if len(distances) else float("nan")
