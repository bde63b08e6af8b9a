"""Left-out repetitions, predicted quickly on thinned samples: which cut-offs suit a trial, and whether pins do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import IntArray
from mocap_id.dynamics.bands import Bands, ChosenBands, choose_bands, held_out_cost
from mocap_id.dynamics.fit import Fit, determined, fit
from mocap_id.dynamics.folds import parts
from mocap_id.dynamics.held_out import HeldOut, hold_out
from mocap_id.dynamics.loose_prior import BodyPrior
from mocap_id.dynamics.lowpass import LowPass
from mocap_id.dynamics.measured_motion import USUAL, PoseFilter
from mocap_id.dynamics.prepare import MEASURED_CUTOFF, Prepared, Recorded, prepare
from mocap_id.dynamics.solve import Compressed
from mocap_id.protocols.movement import Movement
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies

_RATE = 50.0  # Hz; samples are thinned to no less
_CLEARLY = 0.3  # of the sum of logarithms of Fx, Fy, tauz: 10 % of each


class LeftOut:
    """A trial's repetitions, each predicted from the others.

    Parameters
    ----------
    prepared : Prepared
        On the pinned chain.
    movement : Movement
    bodies : MeasuredBodies
    prior : BodyPrior
        Of the bodies.
    """

    def __init__(self, prepared: Prepared, movement: Movement, bodies: MeasuredBodies, prior: BodyPrior) -> None:
        recorded, poses = prepared.recorded, bodies.poses
        step = max(1, int(recorded.rate / _RATE))
        some = slice(None, None, step)
        smooth = LowPass(_RATE / 4, recorded.rate) if step > 1 else (lambda signal: signal)
        series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)
        series = np.stack([smooth(series[:, k]) for k in range(series.shape[1])], axis=1)[some]
        self._recorded = Recorded(
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
        self._seen, self._gate, self._part = (
            bodies.observed[some],
            movement.free[some],
            _parts(prepared, movement)[some],
        )
        self._settings, self._prior = prepared.settings, prior
        self._first: Fit | None = None
        self._found: dict[Bands, HeldOut | None] = {}

    def on_poses(self, bands: Bands) -> HeldOut | None:
        """Predictions on the measured poses with some cut-offs; later calls use clock and weights of the first."""
        if bands not in self._found:
            moved = replace(self._recorded, measured=self._poses.motion(bands), observed=self._seen)
            ready = prepare(moved, self._settings, self._prior)
            found = fit(ready, self._gate, self._first)
            self._first = self._first or found
            self._found[bands] = self._held(ready, found)
        return self._found[bands]

    def on_chain(self) -> HeldOut | None:
        """Predictions on the pinned chain, in the band of the poses."""
        cutoff = self._settings.cutoff or MEASURED_CUTOFF
        ready = prepare(self._recorded, replace(self._settings, cutoff=cutoff))
        return self._held(ready, fit(ready, self._gate)) if determined(ready, self._gate) else None

    def _held(self, ready: Prepared, found: Fit) -> HeldOut | None:
        return hold_out(ready, self._gate, found, self._part, Compressed.free_solution)


def chosen_bands(left_out: LeftOut) -> ChosenBands:
    """Cut-offs with which left-out repetitions are predicted best."""
    return choose_bands(left_out.on_poses)


def poses_preferred(left_out: LeftOut) -> bool:
    """Whether the pinned chain does not predict left-out repetitions clearly better than measured poses.

    In doubt the poses are preferred: their intervals hold whether the joints give way or not.
    """
    return held_out_cost(left_out.on_poses(USUAL)) <= held_out_cost(left_out.on_chain()) + _CLEARLY


def _parts(prepared: Prepared, movement: Movement) -> IntArray:
    """The repetition of each sample, for leaving one out."""
    spans, time = validation.spans(movement), prepared.recorded.time
    return parts(time, np.array(spans)) if len(spans) > 1 else np.zeros(len(time), dtype=np.int64)
