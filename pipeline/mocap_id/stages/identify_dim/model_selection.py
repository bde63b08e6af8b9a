"""Choice of cut-offs, and of chain or measured poses, by predicting left-out repetitions at a reduced frame rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.cross_validation import LeftOutPrediction, predict_left_out
from mocap_id.dynamics.cutoffs import Cutoffs, choose_cutoffs, score_left_out
from mocap_id.dynamics.fit import Fit, determines_parameters, fit
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.measured_motion import USUAL, PoseFilter
from mocap_id.dynamics.preparation import MEASURED_CUTOFF, PreparedTrial, TrialData, prepare
from mocap_id.dynamics.sample_choice import number_parts, shorten_rests
from mocap_id.protocols.movement import Movement
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies

_RATE = 50.0  # Hz; smallest reduced rate
_CLEARLY = 0.3  # clear difference of the cost, the sum of the logarithms of errors of Fx, Fy, tauz: 10 % of each


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
        predicted = self._predict(ready, found)
        if cutoffs == USUAL:
            self._found[cutoffs] = predicted
        return predicted

    def predict_on_chain(self) -> LeftOutPrediction | None:
        """Predict left-out repetitions with the pinned chain at the cut-off of measured poses; None if impossible."""
        cutoff = self._settings.cutoff or MEASURED_CUTOFF
        ready = prepare(self._recorded, replace(self._settings, cutoff=cutoff))
        return self._predict(ready, fit(ready, self._free)) if determines_parameters(ready, self._free) else None

    def _predict(self, ready: PreparedTrial, found: Fit) -> LeftOutPrediction | None:
        return predict_left_out(ready, self._free, found, self._part, CompressedProblem.free_solution)


def prefers_poses(predictor: RepetitionPredictor) -> bool:
    """Return whether measured poses predict left-out repetitions about as well as the pinned chain, or better.

    In doubt, poses are used, because their intervals are also valid if the two sides of a joint separate. The chain is
    used only if it is clearly better than poses with the usual cut-offs, and better than poses with the best cut-offs.
    """
    chain = score_left_out(predictor.predict_on_chain())
    if score_left_out(predictor.predict_on_poses(USUAL)) <= chain + _CLEARLY:
        return True
    return choose_cutoffs(predictor.predict_on_poses).cost <= chain


def _number_repetitions(prepared: PreparedTrial, movement: Movement) -> IntArray:
    """Return the number (T,) of the repetition of each sample; zeros with fewer than two repetitions."""
    spans, time = validation.find_spans(movement), prepared.recorded.time
    return number_parts(time, np.array(spans)) if len(spans) > 1 else np.zeros(len(time), dtype=np.int64)
