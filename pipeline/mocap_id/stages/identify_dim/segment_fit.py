"""The fit on measured poses: bands, prior, parameters of the bodies, and what they say of the chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.bands import ChosenBands, held_out_cost
from mocap_id.dynamics.fold import Fold, centre_response, fold, in_base
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.identify import Identification, identify
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.loose_prior import BodyPrior
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.pose_error import PoseEffect, PoseErrors, SlidingBody, pose_effect, sliding_body
from mocap_id.dynamics.predict import Noise, shown_noise
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.reference_term import deviations
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.left_out import LeftOut, chosen_bands
from mocap_id.stages.identify_dim.measured_bodies import MeasuredBodies, loose_prior, with_prior
from mocap_id.stages.identify_dim.rivals import Rivals
from mocap_id.stages.identify_dim.validation import Validation

_BENT, _BENT_SD = "hip", 0.01  # m
_CORRELATED = 0.12  # s, over which residuals on measured poses stay correlated


@dataclass(frozen=True)
class SegmentFit:
    """A trial identified on the measured poses of its bodies.

    Parameters
    ----------
    bodies : MeasuredBodies
    prepared : Prepared
        On the bodies' motion.
    found : Identification
        Full parameters of the bodies.
    in_chain : Identification
        The pinned chain's, with base and full parameters that follow from the bodies'.
    prior : BodyPrior
    bands : ChosenBands
    rivals : Rivals
        Bodies from tables, as parameters of these bodies.
    chain_reference : (4(n + 1),) array
        The chosen table's body on the chain.
    prior_share : (b,) array
        How much of each base parameter's precision is the prior's, 0 … 1.
    folded : Fold
    grid : PointGrid
    validation : Validation
    centre_sd : (n,) array
        Standard deviation of each joint's centre in one direction, m; its gap is a part of it.
    effect : PoseEffect
        Effect of those errors of the poses that repeat with the movement.
    """

    bodies: MeasuredBodies
    prepared: Prepared
    found: Identification
    in_chain: Identification
    prior: BodyPrior
    bands: ChosenBands
    rivals: Rivals
    chain_reference: FloatArray
    prior_share: FloatArray
    folded: Fold
    grid: PointGrid
    validation: Validation
    centre_sd: FloatArray
    effect: PoseEffect

    def noise(self) -> Noise:
        """Errors beside those of the parameters."""
        held, found = self.validation.held_out, self.found
        if held is not None:
            residual, share = np.where(held.samples[:, None], held.measured - held.wrench, np.nan), 0.0
        else:
            measured = self.prepared.measured(found.fit.offset) - (found.plate_bias or 0.0) * np.array([1.0, 0.0, 0.0])
            residual = self._on_fit(measured - self.prepared.rows @ found.base)
            seconds = float(found.fit.in_fit.sum()) / self.prepared.recorded.rate
            share = len(found.base) / max(3 * seconds / _CORRELATED, 1.0)
        return shown_noise(
            self.prepared,
            found,
            residual,
            centre_sd=self.centre_sd,
            of_poses=self.effect.torque,
            parameters=share,
        )

    def filtered(self, parameters: FloatArray) -> FloatArray:
        """(T, 3) wrench of bodies with these parameters after the fit's low-pass; NaN off the fit's samples."""
        return self._on_fit(self.prepared.filtered @ parameters)

    @property
    def filtered_measured(self) -> FloatArray:
        """(T, 3) measured wrench after the fit's low-pass, less the plate's bias; NaN off the fit's samples."""
        return filtered_measured(self.prepared, self.found)

    @property
    def facts(self) -> dict[str, Any]:
        """What was chosen, and why."""
        return {
            "bands_hz": dict(zip(("x", "y", "angle"), self.bands.bands, strict=True)),
            "bands_why": self.bands.why,
            "bodies": list(self.bodies.names),
            "used": list(self.bodies.used),
            "prior": self.prior.source,
            "prior_share": self.prior_share.tolist(),
        }

    def _on_fit(self, wrench: FloatArray) -> FloatArray:
        return np.where(self.found.fit.in_fit[:, None], wrench, np.nan)


def fit_segments(
    context: Context,
    ways: Sequence[MeasuredBodies],
    prepared: Prepared,
    movement: Movement,
    *,
    pinned: Identification,
    tables: Rivals,
) -> SegmentFit:
    """Identify the bodies on their measured poses.

    Parameters
    ----------
    context : Context
    ways : sequence of MeasuredBodies
        The bodies in every way to count them; the one that predicts left-out repetitions best is used.
    prepared : Prepared
        On the pinned chain.
    movement : Movement
    pinned : Identification
        Of the pinned chain.
    tables : Rivals
        Bodies from tables, on the chain.
    """
    settings, recorded, gate, reference = context.settings, prepared.recorded, movement.free, tables.chosen.parameters
    mass = float(pinned.full[::4].sum()) if tables.chosen.mass is None else tables.chosen.mass
    bodies, prior, bands = _best_way(ways, prepared, movement, tables.chosen, mass)
    ready = with_prior(bodies, recorded, prepared.settings, prior, bands.bands)
    found = identify(
        ready,
        gate,
        grid := bodies.grid(settings.grid),
        prior.mean,
        KinematicError.none(recorded.q.shape[1]),
        consistency=settings.consistency or "cone",
        reference_sd=settings.reference_sd,
    )
    effect = pose_effect(ready, found.fit, found.base, PoseErrors(bodies.poses, _sliding(context, bodies), bands.bands))
    found, centres = _with_effect(found, effect), _centre_covariance(context, bodies)
    usual = deviations(reference, settings.reference_sd)
    folded = fold(bodies.poses, recorded.q, found.fit.in_fit, reference, usual)
    in_chain, share = _in_chain(prepared, pinned, found, folded, centres)
    return SegmentFit(
        bodies=bodies,
        prepared=ready,
        found=found,
        in_chain=in_chain,
        prior=prior,
        bands=bands,
        rivals=_of_bodies(tables, lambda table: loose_prior(bodies, recorded.q, gate, table, mass).mean),
        chain_reference=reference,
        prior_share=share,
        folded=folded,
        grid=grid,
        validation=validation.validate(ready, movement, found, np.zeros((len(recorded.time), 3))),
        centre_sd=np.sqrt(np.einsum("jkk->j", centres) / 2),
        effect=effect,
    )


def _of_bodies(tables: Rivals, mean: Callable[[ReferenceBody], FloatArray]) -> Rivals:
    """Tables of people as parameters of the bodies; NaN where none applies."""
    every = tuple(replace(each, parameters=mean(each)) for each in tables.every)
    chosen = mean(tables.chosen)
    known = np.isfinite(tables.chosen.parameters).all()
    return Rivals(replace(tables.chosen, parameters=np.where(known, chosen, np.nan)), every)


def _best_way(
    ways: Sequence[MeasuredBodies], prepared: Prepared, movement: Movement, table: ReferenceBody, mass: float
) -> tuple[MeasuredBodies, BodyPrior, ChosenBands]:
    """The way to count the bodies that predicts left-out repetitions best at usual cut-offs; its prior and cut-offs."""
    tried = []
    for way in ways:
        prior = loose_prior(way, prepared.recorded.q, movement.free, table, mass)
        prior = replace(prior, spans=np.array(validation.spans(movement)))
        tried.append((way, prior, LeftOut(prepared, movement, way, prior)))
    way, prior, left_out = min(reversed(tried), key=lambda each: held_out_cost(each[2].on_poses(USUAL)))
    return way, prior, chosen_bands(left_out)


def filtered_measured(prepared: Prepared, found: Identification) -> FloatArray:
    """(T, 3) measured wrench after the fit's low-pass, less the plate's bias; NaN off the fit's samples."""
    used = np.flatnonzero(found.fit.in_fit)
    out = np.full((len(prepared.recorded.time), 3), np.nan)
    out[used] = prepared.filtered_measured(used, prepared.recorded.time[used] - found.fit.offset)
    out[:, 0] -= found.plate_bias or 0.0
    return out


def _with_effect(found: Identification, effect: PoseEffect) -> Identification:
    """The identification with the errors of the poses added to its covariance."""
    own = slice(found.fit.base)
    covariance = found.covariance + effect.parameters[own] @ effect.parameters[own].T
    return replace(found, covariance=covariance, base_sd=np.sqrt(np.diag(covariance)))


def _sliding(context: Context, bodies: MeasuredBodies) -> tuple[SlidingBody, ...]:
    """How the markers of each body slide: as the skin model says, those of no moving segment by their residual."""
    skin: Any = context.tree("skin.h5").data["markers"]
    size = dict(zip(map(str, skin["name"]), np.asarray(skin["variance"], dtype=np.float64), strict=True))
    joints = len(bodies.poses.centres)
    found = []
    for body, markers in enumerate(bodies.markers):
        own = np.flatnonzero(bodies.poses.body == body)
        usual = bodies.residual[body] ** 2 / 2
        variance = np.array([size.get(label, usual) for label in markers])
        near = {joint for k in own.tolist() for joint in (k - 1, k) if 0 <= joint < joints}
        found.append(sliding_body(np.array(list(markers.values())), variance, tuple(sorted(near)) or (joints - 1,)))
    return tuple(found)


def _centre_covariance(context: Context, bodies: MeasuredBodies) -> FloatArray:
    """(n, 2, 2) of the joints' centres, m²: the joint fit's, the gap, and where the joint is in bodies that deform.

    A hip that gives way has a torso above it whose pelvis bends on the trunk. The joint fit then finds a centre between
    the hip and the lumbar spine, off by about a centimetre, and no residual shows it.
    """
    joints: Any = context.tree("chain.h5").data["joints"]
    covariance = np.array(joints["covariance"], dtype=np.float64)
    names = [str(name) for name in joints.get("name", ())]
    for joint, gap in bodies.gap.items():
        if names[joint : joint + 1] == [_BENT] and not gap.pinned:
            covariance[joint] += _BENT_SD**2 * np.eye(2)
        covariance[joint] += gap.centre_variance * np.eye(2)
    return covariance


def _in_chain(
    prepared: Prepared, pinned: Identification, found: Identification, folded: Fold, centres: FloatArray
) -> tuple[Identification, FloatArray]:
    """The chain's base and full parameters from the bodies', and the prior's share of each base parameter."""
    own, recorded = slice(found.fit.base), prepared.recorded
    covariance = in_base(folded, prepared.base, found.covariance)
    residual = in_base(folded, prepared.base, found.residual_covariance)
    chain = folded.chain(found.full)
    mean = np.nanmean(recorded.q[found.fit.in_fit], axis=0)
    moved = centre_response(prepared.base, recorded.centres, mean, chain)
    covariance = covariance + np.einsum("bjx,jxy,cjy->bc", moved, centres, moved)
    rows = prepared.base.regrouping @ folded.matrix
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
        full=chain,
        masses=np.full(len(pinned.masses), np.nan),
    )
    return in_chain, np.clip(share, 0.0, 1.0)
