"""Identification with measured poses: cut-offs, prior, and parameters of the bodies and of the chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.body_prior import BodyPrior
from mocap_id.dynamics.chain_parameters import ChainMap, map_to_chain, propagate_centres, propagate_to_base
from mocap_id.dynamics.cutoffs import ChosenCutoffs, choose_cutoffs, score_left_out
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.point_grid import PointGrid
from mocap_id.dynamics.pose_error import PoseEffect, PoseErrors, SlidingBody, propagate_pose_errors, propagate_slides
from mocap_id.dynamics.prediction import PredictionNoise, estimate_residual_noise
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.reference_prior import compute_reference_sd
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.joint_positions import compute_centre_covariance, compute_position_sd
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, make_body_prior, prepare_bodies
from mocap_id.stages.identify_dim.model_selection import RepetitionPredictor
from mocap_id.stages.identify_dim.reference_bodies import ReferenceBodies
from mocap_id.stages.identify_dim.scales import check_and_calibrate
from mocap_id.stages.identify_dim.validation import Validation

_UNSMOOTHED = (10.0, 10.0, 10.0)  # Hz, cut-offs that leave the movement unchanged
_CORRELATED = 0.12  # s, correlation time of residuals with measured poses


@dataclass(frozen=True)
class SegmentFit:
    """Identification of a trial with the measured poses of its bodies."""

    bodies: MeasuredBodies  # bodies with their poses
    prepared: PreparedTrial  # trial with the motion of the bodies
    found: Identification  # identification of the full parameters of the bodies
    in_chain: Identification  # base and full parameters of the chain, computed from the bodies' parameters
    prior: BodyPrior  # prior of the bodies' parameters
    cutoffs: ChosenCutoffs  # cut-offs of the poses
    references: ReferenceBodies  # reference bodies, with parameters of these bodies
    chain_reference: FloatArray  # parameters of the chosen reference body with the chain
    prior_share: FloatArray  # (b,) share of the precision of each base parameter that comes from the prior, 0 … 1
    chain_map: ChainMap  # map from parameters of the bodies to parameters of the chain
    grid: PointGrid  # point masses of the bodies
    validation: Validation  # predictions of left-out repetitions
    # (n,) standard deviation of each joint centre in one direction, relative to the markers around it, m
    centre_sd: FloatArray
    effect: PoseEffect  # effect of the errors of the poses that are the same in every repetition

    def noise(self) -> PredictionNoise:
        """Return the errors of predicted wrench and torques, except those from errors of the parameters."""
        left_out, found = self.validation.held_out, self.found
        if left_out is not None:
            residual = np.where(left_out.samples[:, None], left_out.measured - left_out.wrench, np.nan)
            share = 0.0
        else:
            measured = self.prepared.measured(found.fit.offset) - (found.plate_bias or 0.0) * np.array([1.0, 0.0, 0.0])
            residual = self._on_fit(measured - self.prepared.rows @ found.base)
            seconds = float(found.fit.in_fit.sum()) / self.prepared.recorded.rate
            share = len(found.base) / max(3 * seconds / _CORRELATED, 1.0)
        return estimate_residual_noise(
            self.prepared,
            found,
            residual,
            centre_sd=self.centre_sd,
            of_poses=self.effect.torque,
            parameters=share,
        )

    def filtered(self, parameters: FloatArray) -> FloatArray:
        """Return the filtered wrench (T, 3) of bodies with the given parameters; NaN outside the samples of the fit."""
        return self._on_fit(self.prepared.filtered @ parameters)

    @property
    def facts(self) -> dict[str, Any]:
        """JSON facts about cut-offs, bodies, prior and the condition number of the regressor of all bodies."""
        return {
            "bands_hz": dict(zip(("x", "y", "angle"), self.cutoffs.bands, strict=True)),
            "bands_why": self.cutoffs.why,
            "bodies": list(self.bodies.names),
            "used": list(self.bodies.used),
            "prior": self.prior.source,
            "prior_share": self.prior_share.tolist(),
            "bodies_condition_number": self.found.fit.condition,
            "bodies_condition_number_scaled": self.found.fit.condition_scaled,
        }

    def _on_fit(self, wrench: FloatArray) -> FloatArray:
        return np.where(self.found.fit.in_fit[:, None], wrench, np.nan)


def fit_segments(
    context: Context,
    body_sets: Sequence[MeasuredBodies],
    prepared: PreparedTrial,
    movement: Movement,
    *,
    pinned: Identification,
    tables: ReferenceBodies,
) -> SegmentFit:
    """Return the identification of the bodies with their measured poses.

    Parameters
    ----------
    body_sets : sequence of MeasuredBodies
        Divisions of the person; the division that predicts left-out repetitions best is used.
    pinned : Identification
        Identification of the pinned chain.
    tables : ReferenceBodies
        Reference bodies with the chain.
    """
    settings, recorded, reference = context.settings, prepared.recorded, tables.chosen.parameters
    mass = float(pinned.full[::4].sum()) if tables.chosen.mass is None else tables.chosen.mass
    bodies, prior, cutoffs = _choose_bodies(body_sets, prepared, movement, tables.chosen, mass)
    ready = prepare_bodies(bodies, recorded, prepared.settings, prior, cutoffs.bands)
    found = _identify_bodies(context, ready, movement, prior, grid := bodies.grid(settings.grid))
    effect = propagate_pose_errors(
        ready, found.fit, found.base, PoseErrors(bodies.poses, _describe_skin(context, bodies), cutoffs.bands)
    )
    found, angles = _add_effect(found, effect), recorded.q[found.fit.in_fit]
    usual = compute_reference_sd(reference, settings.reference_sd)
    chain_map = map_to_chain(bodies.poses, recorded.q, found.fit.in_fit, reference, usual)
    plain = prepare_bodies(bodies, recorded, prepared.settings, prior, _UNSMOOTHED)
    on_chain = (prepared.base, chain_map)
    found = check_and_calibrate(context, ready, movement, found, reference, chain=on_chain, unsmoothed=plain)
    in_chain, share = _convert_to_chain(
        prepared, pinned, found, chain_map, compute_centre_covariance(context, bodies, angles)
    )
    return SegmentFit(
        bodies=bodies,
        prepared=ready,
        found=found,
        in_chain=in_chain,
        prior=prior,
        cutoffs=cutoffs,
        references=_convert_references(
            tables, lambda table: make_body_prior(bodies, recorded.q, movement, table, mass).mean
        ),
        chain_reference=reference,
        prior_share=share,
        chain_map=chain_map,
        grid=grid,
        validation=validation.validate(ready, movement, found, np.zeros((len(recorded.time), 3))),
        centre_sd=compute_position_sd(context, bodies, angles),
        effect=effect,
    )


def _identify_bodies(
    context: Context, ready: PreparedTrial, movement: Movement, prior: BodyPrior, grid: PointGrid
) -> Identification:
    """Return the identification of the bodies; its covariance does not contain errors of the poses."""
    return identify(
        ready,
        movement.free,
        grid,
        prior.mean,
        KinematicError.none(ready.recorded.q.shape[1]),
        consistency=context.settings.consistency or "cone",
        reference_sd=context.settings.reference_sd,
    )


def _convert_references(tables: ReferenceBodies, mean: Callable[[ReferenceBody], FloatArray]) -> ReferenceBodies:
    """Return the reference bodies with their parameters replaced by ``mean(body)``; NaN without a reference body."""
    every = tuple(replace(each, parameters=mean(each)) for each in tables.every)
    chosen = mean(tables.chosen)
    known = np.isfinite(tables.chosen.parameters).all()
    return ReferenceBodies(replace(tables.chosen, parameters=np.where(known, chosen, np.nan)), every)


def _choose_bodies(
    body_sets: Sequence[MeasuredBodies], prepared: PreparedTrial, movement: Movement, table: ReferenceBody, mass: float
) -> tuple[MeasuredBodies, BodyPrior, ChosenCutoffs]:
    """Return the bodies that best predict left-out repetitions with usual cut-offs, their prior and best cut-offs."""
    candidates = []
    for bodies in body_sets:
        prior = make_body_prior(bodies, prepared.recorded.q, movement, table, mass)
        candidates.append((bodies, prior, RepetitionPredictor(prepared, movement, bodies, prior)))
    bodies, prior, predictor = min(
        reversed(candidates), key=lambda each: score_left_out(each[2].predict_on_poses(USUAL))
    )
    return bodies, prior, choose_cutoffs(predictor.predict_on_poses)


def filter_measured(prepared: PreparedTrial, found: Identification) -> FloatArray:
    """Return the filtered measured wrench (T, 3) without the plate's bias; NaN outside the samples of the fit."""
    used = np.flatnonzero(found.fit.in_fit)
    out = np.full((len(prepared.recorded.time), 3), np.nan)
    out[used] = prepared.filtered_measured(used, prepared.recorded.time[used] - found.fit.offset)
    out[:, 0] -= found.plate_bias or 0.0
    return out


def _add_effect(found: Identification, effect: PoseEffect) -> Identification:
    """Return the identification with the effect of pose errors added to its covariance."""
    own = slice(found.fit.base)
    covariance = found.covariance + effect.parameters[own] @ effect.parameters[own].T
    return replace(found, covariance=covariance, base_sd=np.sqrt(np.diag(covariance)))


def _describe_skin(context: Context, bodies: MeasuredBodies) -> tuple[SlidingBody, ...]:
    """Return the skin motion of each body; markers that are not in skin.h5 have the variance of the body's residual."""
    skin = context.tree("skin.h5")
    size = dict(zip(skin.texts("markers/name"), skin.numbers("markers/variance"), strict=True))
    joints = len(bodies.poses.centres)
    found = []
    for body, markers in enumerate(bodies.markers):
        own = np.flatnonzero(bodies.poses.body == body)
        usual = bodies.residual[body] ** 2 / 2
        variance = np.array([size.get(label, usual) for label in markers])
        near = {joint for k in own.tolist() for joint in (k - 1, k) if 0 <= joint < joints}
        found.append(propagate_slides(np.array(list(markers.values())), variance, tuple(sorted(near)) or (joints - 1,)))
    return tuple(found)


def _convert_to_chain(
    prepared: PreparedTrial, pinned: Identification, found: Identification, chain_map: ChainMap, centres: FloatArray
) -> tuple[Identification, FloatArray]:
    """Return the identification of the chain from that of the bodies, and ``prior_share`` of :class:`SegmentFit`."""
    own, recorded = slice(found.fit.base), prepared.recorded
    covariance = propagate_to_base(chain_map, prepared.base, found.covariance)
    residual = propagate_to_base(chain_map, prepared.base, found.residual_covariance)
    chain = chain_map.apply(found.full)
    mean = np.nanmean(recorded.q[found.fit.in_fit], axis=0)
    moved = propagate_centres(prepared.base, recorded.centres, mean, chain)
    covariance = covariance + np.einsum("bjx,jxy,cjy->bc", moved, centres, moved)
    rows = prepared.base.regrouping @ chain_map.matrix
    design = found.fit.design.reshape(-1, found.fit.design.shape[-1])
    gained = np.linalg.inv(design.T @ design + found.fit.prior_precision)
    by_prior = (gained @ found.fit.prior_precision @ gained)[own, own]
    whole = np.einsum("bp,pq,bq->b", rows, gained[own, own], rows)
    share = np.einsum("bp,pq,bq->b", rows, by_prior, rows) / np.where(whole > 0.0, whole, np.nan)
    in_chain = replace(
        pinned,
        base=prepared.base.regrouping @ chain,
        base_sd=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        residual_covariance=residual,
        solution=replace(pinned.solution, full=chain, masses=np.full(len(pinned.solution.masses), np.nan)),
    )
    return in_chain, np.clip(share, 0.0, 1.0)
