"""Standard deviations of the joint states from camera noise and skin motion."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, interpolate_gaps
from mocap_id.dynamics.measured_motion import Stretch
from mocap_id.estimation import States
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.coloured_errors import estimate_coloured_variance
from mocap_id.estimation.lasting_errors import LastingErrors
from mocap_id.estimation.missing_markers import compute_variance_growth
from mocap_id.estimation.residual_spectrum import ResidualSpectrum
from mocap_id.kinematics import ChainState, SkinModel, angle_errors, fit_skin, skin_from_residuals

_BENT = (0.6, 2.2, 0.5)  # errors of shank, thigh and trunk, relative to the turn of a thigh that follows the hip
# errors of shank, thigh and trunk, relative to the thigh's, at a hip that gives way
_LOOSE = (0.2, 1.0, 0.2)
# angle, s², velocity, s, and acceleration of the thigh times its length, relative to the acceleration of its stretch; a
# hip that follows its angle is hidden in its centre, so the angle is less visible than the acceleration
_OF_STRETCH = (0.12, 0.4, 2.2)
_HIDDEN = (0.007, 0.02, 0.15)  # m, m/s, m/s²: largest rms that a gap of the hip hides; hips shift by about a centimetre
_AROUND = 0.3  # s, time over which a stretch is averaged
_LEAST = 50  # least number of frames with all joint angles for an estimate of skin motion

UNKNOWN = "not known"
NOISE = "noise taken for white"
SKIN = "camera noise and skin"


def estimate_skin(states: States, used_markers: FloatArray, camera: float) -> SkinModel | None:
    """Return a model of the motion of the skin under the markers; None if there are too few complete frames.

    It is valid for a chain from a joint fit of all segments. ``used_markers`` (F, M, 2) are the markers used for the
    states, plane frame, m, otherwise NaN. ``camera`` is the standard deviation of a coordinate due to camera noise, m.
    """
    chain = states.chain
    used: BoolArray = np.any(states.used, axis=0)
    complete: BoolArray = np.all(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    if np.count_nonzero(complete) < _LEAST or set(chain.segment[used]) < set(range(1, len(chain.centres) + 1)):
        return None
    points = as_complex(used_markers)
    points = points if used.all() else points[:, used]
    return fit_skin(points, chain.segment[used], _chain_state(states, used), np.flatnonzero(complete), camera)


def assume_skin(states: States, residual: FloatArray, centre_covariance: FloatArray) -> SkinModel:
    """Return a model of the skin in which all residuals of the markers in the fit of the joints are skin motion.

    ``residual`` (M,) is the rms residual of each marker, m; ``centre_covariance`` (n, 2, 2) is the covariance of the
    joint centres, m^2.
    """
    every = np.ones(len(states.chain.segment), dtype=np.bool_)
    return skin_from_residuals(_chain_state(states, every), states.chain.segment, residual, centre_covariance)


def estimate_lasting_errors(
    states: States,
    used_markers: FloatArray,
    skin: SkinModel,
    camera: float,
    spectrum: ResidualSpectrum,
    *,
    bend: tuple[int, FloatArray] | None = None,
    stretch: tuple[int, Stretch] | None = None,
) -> LastingErrors:
    """Return the variances of errors of the states that average out slowly or not at all.

    ``used_markers`` and ``camera`` are as for :func:`estimate_skin`. ``bend`` is the hip, a joint from 0, and the turn
    (F,) of the thigh if it followed the hip of a trunk that bends, rad; None if the trunk is rigid. ``stretch`` is the
    hip and the stretch of the thigh; None if it is unknown.
    """
    angles, rate = interpolate_gaps(states.mean[..., 0]), spectrum.rate
    frames, variance = angle_errors(skin, angles, rate)
    variance *= compute_variance_growth(states, used_markers, angles, frames, rate=rate, camera=camera)[..., None]
    coloured = estimate_coloured_variance(ChainResiduals(states, used_markers, rate), angles, frames, camera)
    variance = np.maximum(variance, coloured) + spectrum.oscillating_variance(frames)
    moved = np.zeros_like(variance)
    if bend is not None:
        moved = _compute_bend_variance(*bend, angles, frames, rate)
    if stretch is not None:  # a trunk that bends also stretches the thigh
        moved = np.maximum(moved, _compute_stretch_variance(*stretch, states.chain.centres, frames, rate))
    variance += moved
    return LastingErrors(camera, frames, variance)


def _compute_bend_variance(hip: int, turn: FloatArray, angles: FloatArray, frames: IntArray, rate: float) -> FloatArray:
    """Return the variance (T, n, 4) of joint angles and their derivatives due to a trunk that bends.

    The turn (F,) of the thigh, rad, has noise. A smooth function of the posture replaces it, which has derivatives.
    """
    posture = np.column_stack([angles[:, hip], angles.sum(axis=1)])
    posture -= posture.mean(axis=0)
    shapes = np.column_stack([np.ones(len(angles)), posture, posture**2, posture.prod(axis=1)])
    known = np.isfinite(turn)
    course = (shapes @ np.linalg.lstsq(shapes[known], turn[known])[0])[frames]
    course -= course.mean()
    variance = np.zeros((len(frames), angles.shape[1], 4))
    segment = np.zeros(angles.shape[1] + 1)
    segment[hip - 1 : hip + 2] = _BENT
    joint = segment[:-1] ** 2 + segment[1:] ** 2
    for order in range(4):
        variance[:, :, order] = np.outer((course**2 + np.mean(course**2)) / 2, joint)
        course = np.gradient(course, (frames[1] - frames[0]) / rate) if len(course) > 1 else np.zeros_like(course)
    return variance


def _compute_stretch_variance(
    hip: int, stretch: Stretch, centres: FloatArray, frames: IntArray, rate: float
) -> FloatArray:
    """Return the variance (T, n, 4) of joint angles and their derivatives due to a hip that gives way.

    ``centres`` (n, 2) are the joint centres, m. The chain cannot follow a gap of the hip, so the angle of the thigh is
    wrong by about the gap divided by its length: the angle in every posture, its derivatives while the gap changes.
    """
    joints, rms = len(centres), stretch.above_noise
    variance = np.zeros((len(frames), joints, 4))
    if rms == 0.0:
        return variance
    square = np.nan_to_num(stretch.acceleration**2 - stretch.noise**2, nan=rms**2)
    wide = min(round(3 * _AROUND * rate), (len(square) - 1) // 2)
    window = np.exp(-((np.arange(-wide, wide + 1) / (_AROUND * rate)) ** 2) / 2)
    nearby = np.convolve(square, window, "same") / np.convolve(np.ones(len(square)), window, "same")
    nearby = np.maximum(nearby, 0.0)[frames]
    segment = np.zeros(joints + 1)
    segment[hip - 1 : hip + 2] = _LOOSE
    joint = (segment[:-1] ** 2 + segment[1:] ** 2) / float(centres[hip] @ centres[hip])
    for order, (usual, hidden, visible) in enumerate(zip(_OF_STRETCH, _HIDDEN, stretch.visible, strict=True)):
        factor = min(usual, float(np.hypot(hidden, visible)) / rms)
        variance[:, :, order] = factor**2 * np.outer(nearby if order else np.full(len(frames), rms**2), joint)
    return variance


def _chain_state(states: States, markers: BoolArray) -> ChainState:
    """Return the chain in every frame, with the markers for which ``markers`` (M,) is true."""
    chain = states.chain
    angles = np.cumsum(interpolate_gaps(states.mean[..., 0]), axis=1)
    return ChainState(as_complex(chain.centres), as_complex(chain.local[markers]), angles)
