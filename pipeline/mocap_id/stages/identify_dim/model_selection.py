"""Choice of cut-offs, and of the joints that are pinned, by predicting left-out repetitions at a reduced rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.cross_validation import LeftOutPrediction, predict_left_out
from mocap_id.dynamics.cutoffs import Cutoffs, choose_cutoffs
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.measured_motion import USUAL, BodyPoses, PoseFilter, close_gaps, measure_stretch
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, prepare
from mocap_id.dynamics.sample_choice import number_parts, shorten_rests
from mocap_id.kinematics.joint_corrections import BENDS_M
from mocap_id.protocols.movement import Movement
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies

_RATE = 50.0  # Hz; smallest reduced rate
_SKIN = 0.05  # m/s², rms acceleration of a gap above the noise that skin often causes; it reaches twice as much
_CLEARLY = 0.2  # clear decrease of the cost, the sum of the logarithms of errors of Fx, Fy, tauz: 7 % of each
_SURELY = 0.1  # m/s², rms acceleration of a gap that skin does not cause
_STRETCHED = 0.5  # stretch above the noise of a hip that surely gives way, in limits of the noise: 1.12 limits in all
_STRETCHED_SKIN = 7.0  # 1/s², the same, relative to the rms distance of the markers from rigid bodies due to skin


class RepetitionPredictor:
    """Predictor of each repetition of a trial by a model fitted to the other repetitions.

    Parameters
    ----------
    prepared : PreparedTrial
        Trial on the pinned chain.
    movement : Movement
        Repetitions and usable samples.
    bodies : MeasuredBodies
        Bodies with measured poses.
    prior : BodyPrior
        Prior of the bodies' parameters.
    """

    def __init__(self, prepared: PreparedTrial, movement: Movement, bodies: MeasuredBodies, prior: BodyPrior) -> None:
        recorded, poses = prepared.recorded, bodies.poses
        step = max(1, int(recorded.rate / _RATE))
        some = slice(None, None, step)
        smooth = LowPass(_RATE / 4, recorded.rate) if step > 1 else (lambda signal: signal)
        series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)
        series = np.stack([smooth(series[:, k]) for k in range(series.shape[1])], axis=1)[some]
        self._recorded = TrialData(
            time=recorded.time[some],
            q=recorded.q[some],
            dq=recorded.dq[some],
            ddq=recorded.ddq[some],
            ddq_sd=recorded.ddq_sd[some],
            observed=recorded.observed[some],
            wrench=smooth(recorded.wrench)[some],
            centres=recorded.centres,
            external=tuple(replace(each, wrench=smooth(each.wrench)[some]) for each in recorded.external),
            averaged=recorded.averaged,
        )
        self._poses = PoseFilter(replace(poses, time=poses.time[some], position=series[..., :2], angle=series[..., 2]))
        self._observed, self._free = bodies.observed[some], movement.free[some].copy()
        usable = np.flatnonzero(self._free & np.isfinite(self._recorded.dq).all(axis=1))
        self._free[usable[~shorten_rests(self._recorded.dq[usable])]] = False
        self._part = _number_repetitions(prepared, movement)[some]
        self._settings, self._prior = prepared.settings, prior
        self._first: Fit | None = None
        self._found: dict[Cutoffs, LeftOutPrediction | None] = {}

    def predict_on_poses(self, cutoffs: Cutoffs) -> LeftOutPrediction | None:
        """Predict left-out repetitions with measured poses filtered by ``cutoffs``; None if this is impossible.

        Later calls use the clock offset and weights of the first call. Only the prediction with the usual cut-offs is
        stored, because it is needed twice and a prediction takes as much memory as a trial.
        """
        if cutoffs in self._found:
            return self._found[cutoffs]
        moved = replace(self._recorded, measured=self._poses.motion(cutoffs), observed=self._observed)
        ready = prepare(moved, self._settings, self._prior)
        found = fit(ready, self._free, self._first)
        self._first = self._first or found
        predicted = predict_left_out(ready, self._free, found, self._part, CompressedProblem.free_solution)
        if cutoffs == USUAL:
            self._found[cutoffs] = predicted
        return predicted


def pin_joints_that_hold(
    bodies: MeasuredBodies, make_predictor: Callable[[MeasuredBodies], RepetitionPredictor], hip: int | None = None
) -> MeasuredBodies:
    """Return the bodies, pinned at all joints but those whose two sides surely separate.

    A gap above the noise of the cameras may be a gap of the joint or skin that slides. If the joint holds, its pin
    makes the motion and the parameters more accurate, most of all the torques; the gap of a joint that does not hold
    is missing in the motion of the masses, and left-out repetitions are predicted worse with the pin. All joints are
    therefore pinned first. Then each joint is opened, the largest gap first, and stays open if left-out repetitions
    are predicted clearly better with the same bodies, prior and search of cut-offs. A gap that is smaller than those
    that skin often causes needs more. If no repetition can be left out, the gap alone decides.

    A hip is open, whatever the left-out repetitions say, if the distance from the knee on the shank to the hip on the
    trunk changes surely: skin of the thigh, which causes most gaps, does not change it. The left-out repetitions often
    do not show such a hip, because other parameters of the bodies replace the missing motion.

    Parameters
    ----------
    bodies : MeasuredBodies
        Bodies without pins.
    make_predictor
        Function that returns the predictor of repetitions for bodies.
    hip : int, optional
        Number of the hip, from 0; None without a hip.
    """
    opened = [joint for joint in bodies.loose if joint == hip and _stretches(bodies, joint)]

    def close_others(*joints: int) -> BodyPoses:
        return close_gaps(bodies.poses, [joint for joint in bodies.poses.joints if joint not in joints])

    def predict(*joints: int) -> float:
        return choose_cutoffs(make_predictor(replace(bodies, poses=close_others(*joints))).predict_on_poses).cost

    pinned = predict(*opened)
    for joint in bodies.loose:
        if joint in opened:
            continue
        size = bodies.gap[joint].above_noise
        if not np.isfinite(pinned):
            opened += [joint] * (size > _SURELY)
            continue
        cost = predict(*opened, joint)
        if pinned - cost > _CLEARLY * max((_SKIN / size) ** 2, 1.0):
            opened.append(joint)
            pinned = cost
    gap = {joint: replace(each, holds=joint not in opened) for joint, each in bodies.gap.items()}
    return replace(bodies, poses=close_others(*opened), gap=gap)


def _stretches(bodies: MeasuredBodies, hip: int) -> bool:
    """Return whether the distance from the knee on the shank to the hip on the trunk shows that the hip gives way.

    The distance also changes if the knee gives way, or if the trunk bends between its markers and the hip. It is
    therefore not used if the knee has the larger gap, or if the trunk bends. Skin of shank and trunk changes it too, by
    up to 5 1/s² times the rms distance of their markers from rigid bodies.
    """
    poses, knee = bodies.poses, hip - 1
    if knee not in bodies.gap or bodies.gap[knee].above_noise > bodies.gap[hip].above_noise:
        return False
    if poses.shift is not None and np.linalg.norm(poses.shift[hip]) >= BENDS_M:
        return False
    skin = 0.0
    for body in (int(poses.body[knee]), int(poses.body[hip + 1])):
        count = len(bodies.markers[body])
        noise = 0.0 if poses.camera is None else (2 * count - 3) * poses.camera[body, 0]
        skin += max(bodies.residual[body] ** 2 - noise, 0.0)
    found = measure_stretch(poses, hip)
    return found.above_noise > max(_STRETCHED * found.noise, _STRETCHED_SKIN * float(np.sqrt(skin)))


def _number_repetitions(prepared: PreparedTrial, movement: Movement) -> IntArray:
    """Return the number (T,) of the repetition of each sample; zeros with fewer than two repetitions."""
    spans, time = validation.find_spans(movement), prepared.recorded.time
    return number_parts(time, np.array(spans)) if len(spans) > 1 else np.zeros(len(time), dtype=np.int64)
