"""Identification with measured poses, check of scales, and comparison with the pinned chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import BaseSet
from mocap_id.dynamics.consistency import PointGrid
from mocap_id.dynamics.identification import ChosenCutoffs, Identification, LeftOutPrediction, choose_cutoffs, identify
from mocap_id.dynamics.instrument_errors import (
    KinematicError,
    PlanarCalibration,
    PoseEffect,
    PoseErrors,
    ScaleCause,
    propagate_calibration,
    propagate_pose_errors,
    propagate_slides,
)
from mocap_id.dynamics.measured_motion import ChainMap, map_to_chain, propagate_centres, propagate_to_base
from mocap_id.dynamics.prediction import PredictionNoise, estimate_residual_noise
from mocap_id.dynamics.preparation import PreparedTrial, SampledWrench
from mocap_id.dynamics.priors import BodyPrior, compute_reference_sd
from mocap_id.dynamics.scale_check import check_scales, find_body_ratios
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.trial_data import ReferenceBodies, describe_errors
from mocap_id.stages.identify_dim.validation import (
    MeasuredBodies,
    estimate_centre_errors,
    make_body_prior,
    make_predictor,
    prepare_bodies,
    validate,
)
from mocap_id.verdict import Reason

_PERSON, _ROBOT = 0.005, 0.001  # m: standard deviation of a plate's position under a person, and under a bolted robot
_LEAST_JOINTS = 2  # ankle and knee, because the ratios of a person need a shank


def read_calibration(context: Context) -> PlanarCalibration:
    """Return the standard deviations of the errors of scale of plate and cameras, from the settings."""
    settings: IdentifyDimSettings = context.settings
    position = settings.plate_position_sd_m
    if position is None:
        position = _ROBOT if context.trial.protocol == "robot-joint" else _PERSON
    return PlanarCalibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
        position=position,
        mass=context.trial.subject.mass,
        mass_sd=settings.subject_mass_sd_kg,
    )


def check_and_calibrate(
    context: Context,
    prepared: PreparedTrial,
    movement: Movement,
    found: Identification,
    reference: FloatArray,
    *,
    chain: tuple[BaseSet, ChainMap] | None = None,
    unsmoothed: PreparedTrial | None = None,
) -> Identification:
    """Return the identification with the result of the check of scales, and with errors of scale in its covariance.

    If the check suspects an error, the covariance contains the error at the size that the check has estimated.
    ``reference`` (4(n + 1),) are the full parameters of the reference body with the chain; without one (NaN), there is
    no check. For measured poses, ``chain`` are the base parameters of the chain and the map from the bodies to them,
    and ``unsmoothed`` is the trial with nearly unfiltered poses for the check, because the low-pass of the fit reduces
    accelerations.
    """
    usual = read_calibration(context)
    mass = float(found.full[::4].sum())
    mass_sd = float(np.sqrt(found.covariance[::4, ::4].sum() if chain else found.covariance[0, 0]))
    whole = {0, 1, 2} <= set(prepared.settings.components)
    scales = None
    if whole and np.isfinite(reference).all() and len(prepared.recorded.centres) >= _LEAST_JOINTS:
        base, matrix = prepared.base, None
        if chain is not None:
            base, matrix = chain[0], (chain[1].matrix, chain[1].constant)
        ratios = find_body_ratios(base, prepared.recorded.centres, reference, mass, usual, chain=matrix)
        scales = check_scales(unsmoothed or prepared, movement.free, found, ratios)
    sd = {
        "gain": usual.estimate_gain_error(mass, mass_sd) if 1 in prepared.settings.components else usual.gain,
        "moments": usual.moments,
        "position": prepared.recorded.position_sd or usual.position,
        "lengths": usual.lengths,
        "tilt": usual.tilt,
    }
    if scales is not None:
        sd |= {name: max(sd.get(name, 0.0), abs(scales.causes[name].value)) for name in scales.suspects}
    return found.add_calibration(propagate_calibration(prepared, found.fit, found.base, sd), scales)


def explain_scales(out: Findings, found: Identification, given: float | None, *, stands: bool) -> None:
    """Add a caution about suspected errors of scale, and a note if the user has not given the mass ``given``, kg.

    ``stands`` says whether the plates or a balance board measure a standing person.
    """
    scales = found.scales
    if given is None and (stands or scales is not None):
        out.reasons.append(ON_TRUST)
    if scales is None or not scales.suspects:
        return
    suspects = [(name, _describe_cause(name, scales.causes[name])) for name in scales.suspects[:3]]
    first, certain = scales.causes[suspects[0][0]], len(scales.suspects) == 1
    if certain:
        text = f"{suspects[0][1]}. {_CHECK[suspects[0][0]]}"
    else:
        either = "; or ".join(sentence for _, sentence in suspects)
        text = f"the data do not determine which of these is wrong: {either}. Check them in this order"
    text += ". The standard deviations of the parameters contain an error of this size"
    out.say("scale-error" if certain else "scales-contradict", text, first.value, first.limit)


ON_TRUST = Reason(
    "scale-on-trust",
    "the mass of the person is not given, so the gain of all channels of the plate cannot be checked: the scale of "
    "forces, torques and parameters is assumed to be right, with the standard deviation `identify-dim: {plate_gain_sd: "
    "…}`. Weigh the person and give `subject: {mass: …}` to check it",
    level="ok",
)


def _describe_cause(name: str, cause: ScaleCause) -> str:
    """Return a text with the error and the size that it has if only this cause is wrong."""
    value, sd = cause.value, cause.sd
    factor = max(1.0 + value, 0.05)  # of the inertial forces
    percent = 100 * (factor**-0.5 - 1.0 if name == "inertia" else value)
    size = f"{abs(percent):.0f} % too {'large' if percent > 0 else 'small'}"
    if name == "inertia":
        return (
            f"the frame rate in the file is {size} (inertial forces are {factor:.2f} ± {sd:.2f} times "
            "those computed from the accelerations)"
        )
    size += f" (± {100 * sd:.1f} %)"
    sentences = {
        "moments": f"the plate's moments are {size}",
        "vertical gain": f"the gain of the plate's vertical force is {size}",
        "vertical force": f"the plate's vertical force has a constant error of {value:+.0f} ± {sd:.0f} N",
        "position": f"the plate is {1e3 * abs(value):.0f} ± {1e3 * sd:.0f} mm away from its position in the file",
        "lengths": f"distances between markers are {size}",
        "tilt": f"the cameras' axes are tilted by {np.degrees(value):.1f}° ± {np.degrees(sd):.1f}° against gravity",
        "gain": f"all components of the plate's wrench are {size}",
    }
    return sentences[name]


_CHECK = {
    "inertia": "Compare the rates in the file (`POINT:RATE`, `ANALOG:RATE`) with the rates of the recording system",
    "moments": "Check the calibration matrix of the plate and the units of its moments",
    "vertical gain": "Check the calibration matrix and the amplifier of the plate's vertical channels",
    "vertical force": "Zero the plate without load before the trial, and check that no other object is on it",
    "position": "Measure the corners of the plate again",
    "lengths": "Calibrate the cameras again, and check the length of the wand in their software",
    "tilt": "Set the origin and axes of the cameras again with a vertical axis",
    "gain": "Compare the plate with a known weight, and check `subject: {mass: …}`",
}


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
    prior_share: FloatArray  # (b,) share of the precision of each base parameter that comes from the prior, 0 … 1
    chain_map: ChainMap  # map from parameters of the bodies to parameters of the chain
    grid: PointGrid  # point masses of the bodies
    left_out: LeftOutPrediction | str  # predictions of left-out repetitions, or why there are none
    # (n,) standard deviation of each joint centre in one direction, relative to the markers around it, m
    centre_sd: FloatArray
    effect: PoseEffect  # effect of the errors of the poses that are the same in every repetition

    def noise(self) -> PredictionNoise:
        """Return the errors of predicted wrench and torques, except those from errors of the parameters."""
        left_out, found = self.left_out, self.found
        if not isinstance(left_out, str):
            residual = np.where(left_out.samples[:, None], left_out.measured - left_out.wrench, np.nan)
            share = 0.0
        else:
            measured = self.prepared.measured(found.fit.offset) - (found.plate_bias or 0.0) * np.array([1.0, 0.0, 0.0])
            residual = np.where(found.fit.in_fit[:, None], measured - self.prepared.rows @ found.base, np.nan)
            seconds = float(found.fit.in_fit.sum()) / self.prepared.recorded.rate
            share = len(found.base) / max(3 * seconds / _CORRELATED, 1.0)
        return estimate_residual_noise(
            self.prepared, found, residual, centre_sd=self.centre_sd, of_poses=self.effect.torque, parameters=share
        )


def fit_segments(
    context: Context,
    bodies: MeasuredBodies,
    prepared: PreparedTrial,
    movement: Movement,
    *,
    pinned: Identification,
    tables: ReferenceBodies,
) -> SegmentFit:
    """Return the identification of the bodies with their measured poses.

    The bodies are pinned at the joints that hold. ``pinned`` is the identification of the pinned chain, and ``tables``
    are the reference bodies with the chain.
    """
    settings, recorded, reference = context.settings, prepared.recorded, tables.chosen.parameters
    mass = float(pinned.full[::4].sum()) if tables.chosen.mass is None else tables.chosen.mass
    prior = make_body_prior(bodies, recorded.q, movement, tables.chosen, mass)
    cutoffs = choose_cutoffs(make_predictor(prepared, movement, bodies, prior))
    ready = prepare_bodies(bodies, recorded, prepared.settings, prior, cutoffs.bands)
    found = identify(
        ready,
        movement.free,
        grid := bodies.grid(settings.grid),
        prior.mean,
        KinematicError.none(recorded.q.shape[1]),
        consistency=settings.consistency or "cone",
        reference_sd=settings.reference_sd,
    )
    own, angles = slice(found.fit.base), recorded.q[found.fit.in_fit]

    # errors of the poses; markers that are not in skin.h5 have the variance of the body's residual
    skin = context.tree("skin.h5")
    size = dict(zip(skin.texts("markers/name"), skin.numbers("markers/variance"), strict=True))
    joints, slides = len(bodies.poses.centres), []
    for body, markers in enumerate(bodies.markers):
        usual = bodies.residual[body] ** 2 / 2
        variance = np.array([size.get(label, usual) for label in markers])
        segments = np.flatnonzero(bodies.poses.body == body).tolist()
        near = {joint for k in segments for joint in (k - 1, k) if 0 <= joint < joints}
        slides.append(propagate_slides(np.array([*markers.values()]), variance, tuple(sorted(near)) or (joints - 1,)))
    effect = propagate_pose_errors(ready, found.fit, found.base, PoseErrors(bodies.poses, tuple(slides), cutoffs.bands))
    covariance = found.covariance + effect.parameters[own] @ effect.parameters[own].T
    found = replace(found, covariance=covariance, base_sd=np.sqrt(np.diag(covariance)))

    # errors of scale
    usual_sd = compute_reference_sd(reference, settings.reference_sd)
    chain_map = map_to_chain(bodies.poses, recorded.q, found.fit.in_fit, reference, usual_sd)
    plain = prepare_bodies(bodies, recorded, prepared.settings, prior, _UNSMOOTHED)
    on_chain = (prepared.base, chain_map)
    found = check_and_calibrate(context, ready, movement, found, reference, chain=on_chain, unsmoothed=plain)
    centre_covariance, centre_sd = estimate_centre_errors(context, bodies, angles)

    # the chain's parameters from those of the bodies, and the share of their precision that comes from the prior
    covariance = propagate_to_base(chain_map, prepared.base, found.covariance)
    residual = propagate_to_base(chain_map, prepared.base, found.residual_covariance)
    chain = chain_map.apply(found.full)
    moved = propagate_centres(prepared.base, recorded.centres, np.nanmean(angles, axis=0), chain)
    covariance = covariance + np.einsum("bjx,jxy,cjy->bc", moved, centre_covariance, moved)
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

    # the reference bodies with parameters of these bodies; NaN without a reference body
    def convert(table: ReferenceBody) -> ReferenceBody:
        return replace(table, parameters=make_body_prior(bodies, recorded.q, movement, table, mass).mean)

    chosen = convert(tables.chosen)
    if not np.isfinite(reference).all():
        chosen = replace(chosen, parameters=np.full(len(chosen.parameters), np.nan))
    return SegmentFit(
        bodies=bodies,
        prepared=ready,
        found=found,
        in_chain=in_chain,
        prior=prior,
        cutoffs=cutoffs,
        references=ReferenceBodies(chosen, tuple(convert(each) for each in tables.every)),
        prior_share=np.clip(share, 0.0, 1.0),
        chain_map=chain_map,
        grid=grid,
        left_out=validate(ready, movement, found, np.zeros((len(recorded.time), 3))),
        centre_sd=centre_sd,
        effect=effect,
    )


def filter_measured(prepared: PreparedTrial, found: Identification) -> FloatArray:
    """Return the filtered measured wrench (T, 3) without the plate's bias; NaN outside the samples of the fit."""
    used = np.flatnonzero(found.fit.in_fit)
    out = np.full((len(prepared.recorded.time), 3), np.nan)
    out[used] = prepared.filtered_measured(used, prepared.recorded.time[used] - found.fit.offset)
    out[:, 0] -= found.plate_bias or 0.0
    return out


ASKED_FOR = "asked for"
"""Reason in the facts of dynamics.h5 if the pinned chain is used because of the setting `motion: chain`."""
_CLOCKS_APART = 0.005  # s, largest difference; 5 ms changes a base parameter of a person by a fifth or more


def compare_motions(
    prepared: PreparedTrial, pinned: Identification, movement: Movement, segments: SegmentFit, threshold: float
) -> dict[str, Any]:
    """Return the fact ``pins``: errors of chain and measured poses on the same samples, after the same low-pass.

    ``prepared`` and ``pinned`` are the trial on the pinned chain and its identification. There is no centre of pressure
    up to the vertical force ``threshold``, N.
    """
    on_chain = validate(prepared, movement, pinned, np.zeros((len(prepared.recorded.time), 3)))
    on_bodies, lowpass = segments.left_out, segments.prepared.lowpass
    offset = pinned.fit.total_offset if pinned.fit.offset_known else None
    if isinstance(on_chain, str) or isinstance(on_bodies, str):
        why = on_bodies if isinstance(on_bodies, str) else None
        return {"why": why, "chain": None, "segments": None, "clock_offset_s": offset}
    model, measured = lowpass(on_chain.wrench), lowpass(on_chain.measured)
    both = on_chain.samples & on_bodies.samples & np.isfinite(model).all(axis=1)
    return {
        "why": None,
        "samples": int(both.sum()),
        "chain": describe_errors(model, measured, both, threshold),
        "segments": describe_errors(on_bodies.filtered, on_bodies.filtered_measured, both, threshold),
        "clock_offset_s": offset,
    }


def explain_motion(out: Findings, facts: Mapping[str, Any]) -> None:
    """Add reasons about the gaps of joints and the clock offset, from the facts of dynamics.h5."""
    motion = facts["motion"]
    loose = {name: gap for name, gap in (motion.get("joints") or {}).items() if not gap["pinned"]}
    asked_for = motion["source"] == "chain" and motion["why"] == ASKED_FOR
    if loose and (asked_for or motion["source"] == "segments"):
        listed = ", ".join(f"{name} {1e3 * gap['gap_m']:.1f} mm" for name, gap in loose.items())
        observation = f"the two sides of a joint separate by more than the noise (rms): {listed}"
        largest = max(gap["gap_m"] for gap in loose.values())
        if asked_for:
            out.say(
                "pinned-joint-gives-way",
                f"{observation}, and `identify-dim: {{motion: chain}}` pins this joint. The masses then move "
                "differently from the model, in the same way in every repetition, so the standard deviations of "
                "parameters and torques are too small. Remove the setting to use the measured pose of every segment",
                largest,
            )
        else:
            out.say(
                "joint-gives-way",
                f"{observation}. The dynamics therefore use the measured pose of every segment; lengths and angles "
                "still come from the chain. Set `identify-dim: {motion: chain}` to use the chain",
                largest,
                level="ok",
            )

    # the clock offsets of the fits without each of the repetitions
    offsets = np.asarray((facts.get("held_out") or {}).get("clock_offset_s") or [], dtype=np.float64)
    apart = float(np.ptp(offsets)) if len(offsets) > 1 else 0.0
    if apart > _CLOCKS_APART:
        out.say(
            "clocks-disagree",
            f"the clock offset between cameras and plate depends on the repetitions it is estimated from: it differs "
            f"by {1e3 * apart:.0f} ms, expected at most {1e3 * _CLOCKS_APART:.0f} ms. One of the clocks drifts, or "
            "the model does not fit the movement: check the synchronisation of cameras and plate",
            apart,
            _CLOCKS_APART,
        )


def compare_torque(context: Context, dynamics: Mapping[str, FloatArray]) -> dict[str, Any] | None:
    """Return the difference of the model's torque from the torque in the encoder file; None if one of them is missing.

    The result has ``bias`` and ``sd``, N·m, ``r2`` and the number of ``samples``. ``dynamics`` are the columns of
    dynamics.parquet. The model's torque is interpolated at the encoder's times, with the clock offset of ukf-smooth.
    """
    file = context.trial.encoder
    if file is None or "tau_1" not in dynamics:
        return None
    matched, log = context.table("encoder.parquet").facts, recording.read_encoder(file)
    if matched.get("why") is not None or log.torque is None:
        return None
    measured = matched["sign"] * log.torque
    model = SampledWrench.of(dynamics["time"], dynamics["tau_1"][:, None])
    off = model(log.time + matched["clock_offset_s"])[:, 0] - measured
    both = np.isfinite(off)
    if np.count_nonzero(both) < 2 or not np.ptp(measured[both]) > 0.0:
        return None
    return {
        "bias": float(np.mean(off[both])),
        "sd": float(np.std(off[both])),
        "r2": 1.0 - float(np.mean(off[both] ** 2)) / float(np.var(measured[both])),
        "samples": int(np.count_nonzero(both)),
    }
