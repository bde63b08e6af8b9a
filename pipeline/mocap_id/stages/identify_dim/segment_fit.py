"""Measured bodies and the joints at which they are pinned, identification with their poses, and check of scales."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, as_complex, find_complete_rows
from mocap_id.dynamics.cautions import check_scales, find_body_ratios
from mocap_id.dynamics.consistency import PointGrid, build_grid
from mocap_id.dynamics.fit import Fit, fit, number_parts, shorten_rests
from mocap_id.dynamics.identification import (
    Cutoffs,
    Identification,
    LeftOutPrediction,
    choose_cutoffs,
    identify,
    predict_left_out,
)
from mocap_id.dynamics.instrument_errors import (
    KinematicError,
    PlanarCalibration,
    ScaleCause,
    propagate_calibration,
    propagate_pose_errors,
    propagate_slides,
)
from mocap_id.dynamics.measured_motion import (
    USUAL,
    BodyPoses,
    ChainMap,
    JointGap,
    PoseFilter,
    close_gaps,
    differentiate_gaps,
    fill_gaps,
    filter_motion,
    map_to_chain,
    measure_gaps,
    measure_relative_pose,
    measure_stretch,
    merge_segments,
    propagate_centres,
    propagate_to_base,
)
from mocap_id.dynamics.prediction import PredictionNoise, estimate_residual_noise
from mocap_id.dynamics.preparation import FitSettings, LowPass, PreparedTrial, SampledWrench, TrialData, prepare
from mocap_id.dynamics.priors import (
    BodyPrior,
    build_even_prior,
    build_table_prior,
    compute_reference_sd,
    split_torso,
)
from mocap_id.dynamics.regressor import BaseSet, CompressedProblem
from mocap_id.geometry import planar
from mocap_id.kinematics.clusters import BENDS_M, LEAST_MARKERS, REMAINING
from mocap_id.kinematics.joint import count_positions
from mocap_id.protocols.body_names import ReferenceBody
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.dynamics_artefacts import find_spans, validate
from mocap_id.stages.identify_dim.trial_data import ReferenceBodies, describe_errors, read_plate_position_sd
from mocap_id.store import Table
from mocap_id.store.artefacts import Skeleton
from mocap_id.verdict import Reason

_RATE = 50.0  # Hz; smallest reduced rate
_SKIN = 0.05  # m/s², rms acceleration of a gap above the noise that skin often causes; it reaches twice as much
_CLEARLY = 0.2  # clear decrease of the cost, the sum of the logarithms of errors of Fx, Fy, tauz: 7 % of each
_SURELY = 0.1  # m/s², rms acceleration of a gap that skin does not cause
_STRETCHED = 0.5  # stretch above the noise of a hip that surely gives way, in limits of the noise: 1.12 limits in all
_STRETCHED_SKIN = 7.0  # 1/s², the same, relative to the rms distance of the markers from rigid bodies due to skin

Predictor: TypeAlias = Callable[[Cutoffs], LeftOutPrediction | None]
"""Function of :func:`make_predictor`."""


def make_predictor(prepared: PreparedTrial, movement: Movement, bodies: MeasuredBodies, prior: BodyPrior) -> Predictor:
    """Return a function that predicts each repetition by a model fitted to the other repetitions.

    The function filters the measured poses with the cut-offs that it is given; None if it cannot predict. Its later
    calls use the clock offset and weights of the first call. ``prepared`` is the trial on the pinned chain.
    """
    recorded, poses = prepared.recorded, bodies.poses
    step = max(1, int(recorded.rate / _RATE))
    some = slice(None, None, step)
    smooth = LowPass(_RATE / 4, recorded.rate) if step > 1 else (lambda signal: signal)
    series = np.concatenate([poses.position, poses.angle[..., None]], axis=-1)
    series = np.stack([smooth(series[:, k]) for k in range(series.shape[1])], axis=1)[some]
    thinned = TrialData(
        time=recorded.time[some],
        q=recorded.q[some],
        dq=recorded.dq[some],
        ddq=recorded.ddq[some],
        ddq_sd=recorded.ddq_sd[some],
        observed=bodies.observed[some],
        wrench=smooth(recorded.wrench)[some],
        centres=recorded.centres,
        external=tuple(replace(each, wrench=smooth(each.wrench)[some]) for each in recorded.external),
        averaged=recorded.averaged,
    )
    filtered = PoseFilter(replace(poses, time=poses.time[some], position=series[..., :2], angle=series[..., 2]))
    free = movement.free[some].copy()
    usable = np.flatnonzero(free & np.isfinite(thinned.dq).all(axis=1))
    free[usable[~shorten_rests(thinned.dq[usable])]] = False
    spans, part = find_spans(movement), np.zeros(len(recorded.time), dtype=np.int64)
    part = (number_parts(recorded.time, np.array(spans)) if len(spans) > 1 else part)[some]
    first: Fit | None = None

    def predict(cutoffs: Cutoffs) -> LeftOutPrediction | None:
        nonlocal first
        ready = prepare(replace(thinned, measured=filtered.motion(cutoffs)), prepared.settings, prior)
        found = fit(ready, free, first)
        first = first or found
        return predict_left_out(ready, free, found, part, CompressedProblem.free_solution)

    return predict


def pin_joints_that_hold(
    bodies: MeasuredBodies, predict_with: Callable[[MeasuredBodies], Predictor], hip: int | None = None
) -> MeasuredBodies:
    """Return the bodies, so far without pins, pinned at all joints but those whose two sides surely separate.

    A gap above the noise of the cameras may be a gap of the joint or skin that slides. If the joint holds, its pin
    makes the motion and the parameters more accurate, most of all the torques; the gap of a joint that does not hold
    is missing in the motion of the masses, and left-out repetitions are predicted worse with the pin. All joints are
    therefore pinned first. Then each joint is opened, the largest gap first, and stays open if left-out repetitions
    are predicted clearly better with the same bodies, prior and search of cut-offs. A gap that is smaller than those
    that skin often causes needs more. If no repetition can be left out, the gap alone decides.

    The ``hip``, a joint from 0, is open, whatever the left-out repetitions say, if the distance from the knee on the
    shank to the hip on the trunk changes surely: skin of the thigh, which causes most gaps, does not change it. The
    left-out repetitions often do not show such a hip, because other parameters of the bodies replace the missing
    motion.
    """
    opened = [joint for joint in bodies.loose if joint == hip and _stretches(bodies, joint)]

    def close_others(*joints: int) -> BodyPoses:
        return close_gaps(bodies.poses, [joint for joint in bodies.poses.joints if joint not in joints])

    def predict(*joints: int) -> float:
        return choose_cutoffs(predict_with(replace(bodies, poses=close_others(*joints))))[2]

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


_LEAST_RESIDUAL = 1e-4  # m, smallest residual in the weights
_OFTEN = 0.8  # smallest share of the samples with a known pose, so that the fit has enough samples


@dataclass(frozen=True)
class MeasuredBodies:
    """Rigid bodies and their poses."""

    names: tuple[str, ...]
    poses: BodyPoses  # poses with short gaps in time bridged; joints whose two sides do not separate are pinned
    observed: BoolArray  # (T,) samples in which every pose was measured
    gap: dict[int, JointGap]  # gap between the two sides of each joint between two bodies, by joint, from 0
    markers: tuple[dict[str, list[float]], ...]  # positions of the markers of each body in its axes, m, by label
    residual: tuple[float, ...]  # rms distance of the markers of each body from these positions, m
    used: tuple[int, ...]  # indices of the bodies in poses.parquet, from 0
    # standard deviation in one direction, m, of the joints that are located by the poses and not by the joint fit:
    # ankles of feet that move
    placed: dict[int, float]

    @property
    def loose(self) -> list[int]:
        """Joints, from 0, whose two sides separate, the joint with the largest acceleration first."""
        return sorted((j for j, gap in self.gap.items() if not gap.pinned), key=lambda j: -self.gap[j].above_noise)


def find_measured_bodies(context: Context, recorded: TrialData) -> Iterator[MeasuredBodies]:
    """Yield the measured bodies, with short gaps bridged, for each possible division of the person into bodies.

    Pelvis and trunk may be two bodies or one. Every segment must be in a body whose pose is known in at least 80 % of
    the samples with known joint states. Except for the base, the body needs markers at more than two positions, because
    two points follow only the skin.
    """
    table, camera = context.table("poses.parquet"), context.tree("skin.h5").facts["camera_sd_m"]
    known, usable = find_complete_rows(recorded.ddq), []
    segments = [set(body["segments"]) for body in table.facts["bodies"]]
    for k, body in enumerate(table.facts["bodies"]):
        visible = table[f"markers_{k + 1}"][known] >= LEAST_MARKERS
        if not len(visible) or float(np.mean(visible)) < _OFTEN:
            continue
        if 0 in segments[k] or count_positions(as_complex(np.array(list(body["markers"].values())))) > 2:
            usable.append(k)
    several = [k for k in usable if len(segments[k]) > 1]
    divisions = [[k for k in usable if k not in several]]
    for whole in several:
        parts = [k for k in usable if k != whole and segments[k] and segments[k] <= segments[whole]]
        divisions.append([k for k in usable if k not in parts])
    for used in divisions:
        if set().union(*(segments[k] for k in used)) == set(range(len(recorded.centres) + 1)):
            yield bridge_gaps(read_bodies(table, recorded.centres, used, camera))


def bridge_gaps(bodies: MeasuredBodies) -> MeasuredBodies:
    """Return the bodies with short gaps in time bridged, and with the gaps between the two sides of each joint."""
    poses, observed = fill_gaps(bodies.poses)
    gap = measure_gaps(poses, np.ones(len(poses.time), dtype=bool))
    return replace(bodies, poses=poses, observed=observed, gap=gap)


def pin_joints(bodies: MeasuredBodies) -> MeasuredBodies:
    """Return bodies with bridged gaps, now pinned at the joints whose two sides do not separate."""
    pinned = [joint for joint, each in bodies.gap.items() if each.pinned]
    return replace(bodies, poses=close_gaps(bodies.poses, pinned))


def read_bodies(table: Table, centres: FloatArray, used: Sequence[int], camera: float = 0.0) -> MeasuredBodies:
    """Return bodies of poses.parquet as measured: gaps are not bridged, joints not pinned, and ``gap`` is empty.

    ``centres`` (n, 2) are in the axes of the previous segment, m. The bodies ``used``, from 0, contain together every
    segment of the chain once. ``camera`` is the standard deviation of the cameras' white noise in a coordinate, m.
    """
    bodies = [table.facts["bodies"][k] for k in used]
    owner = {segment: k for k, body in enumerate(bodies) for segment in body["segments"]}
    local = [np.array(list(body["markers"].values())) for body in bodies]
    spread = [np.sum((positions - positions.mean(axis=0)) ** 2) for positions in local]
    noise = [max(body["residual_m"], _LEAST_RESIDUAL) ** 2 for body in bodies]

    def series(name: str) -> FloatArray:
        return table.stack([f"{name}_{k + 1}" for k in used])

    before, after, shift, placed = centres.copy(), np.zeros_like(centres), np.zeros((len(centres), 2)), {}
    for body in bodies:
        joint = min(body["segments"], default=0) - 1  # the joint before the first segment of the body
        if "joint_m" in body:
            (before[joint], after[joint]), placed[joint] = body["joint_m"], float(body["joint_sd_m"])
        if joint >= 0:
            shift[joint] = body.get("joint_shift_m", [0.0, 0.0])
    poses = BodyPoses(
        time=table["time"],
        position=np.stack([series("x"), series("y")], axis=-1),
        angle=series("angle"),
        centroid=np.array([positions.mean(axis=0) for positions in local]),
        information=np.array([[len(p) / n, s / n] for p, s, n in zip(local, spread, noise, strict=True)]),
        body=np.array([owner[k] for k in range(len(centres) + 1)], dtype=np.int64),
        centres=before,
        shift=shift,
        beyond=after,
        camera=camera**2 * np.array([[1 / len(p), 1 / s] for p, s in zip(local, spread, strict=True)]),
    )
    return MeasuredBodies(
        names=tuple(str(body["name"]) for body in bodies),
        poses=poses,
        observed=find_complete_rows(poses.angle),
        gap={},
        markers=tuple(body["markers"] for body in bodies),
        residual=tuple(float(body["residual_m"]) for body in bodies),
        used=tuple(used),
        placed=placed,
    )


def make_body_prior(
    bodies: MeasuredBodies, q: FloatArray, movement: Movement, table: ReferenceBody, mass: float
) -> BodyPrior:
    """Return the prior of the bodies' parameters from a reference body ``table``, or even masses if it is NaN.

    The usable samples of ``movement`` and the joint angles ``q`` (T, n), rad, give the mean positions of the bodies.
    ``mass`` is the person's, kg.
    """
    poses, reference, samples = bodies.poses, table.parameters, movement.free
    times = np.array(find_spans(movement))
    if not np.isfinite(reference).all():
        return replace(build_even_prior(mass, poses.centroid), spans=times)
    of_segment = reference.reshape(-1, 4)
    mean = np.zeros((len(bodies.names), 4))
    for body in range(len(bodies.names)):
        own = np.flatnonzero(poses.body == body)
        if len(own):
            mean[body] = merge_segments(poses.centres, q, samples, own) @ of_segment[own].reshape(-1)
    last = int(poses.body[-1])
    for body in np.setdiff1d(np.arange(len(bodies.names)), poses.body):
        mean[last], mean[body] = split_torso(mean[last], *measure_relative_pose(poses, int(body), last, samples), mass)
    free = int(poses.body.max()) + 1 < len(bodies.names)
    return replace(build_table_prior(mean.reshape(-1), str(table.table), others=free), spans=times)


def prepare_bodies(
    bodies: MeasuredBodies, recorded: TrialData, settings: FitSettings, prior: BodyPrior, cutoffs: Cutoffs = USUAL
) -> PreparedTrial:
    """Return the trial prepared with the motion of the bodies, filtered at ``cutoffs``, not of the chain."""
    moved = replace(recorded, measured=filter_motion(bodies.poses, cutoffs), observed=bodies.observed)
    return prepare(moved, settings, prior)


_BENT = "hip"  # joint before a trunk that may bend
_OWN = 0.25  # smallest share of the variance of a centre that does not come from the previous joint
_ORDERS = (1.0, 0.5)  # standard deviations of the coefficients of first and second order, relative to σ
_LARGEST = 0.01  # m/rad: largest σ divided by half the arc; people's hips shift by about a centimetre in two radians
_SHAPED = 1e-6  # smallest size of a measured shape, relative to the largest shape
_STILL = 1e-9  # rad, smallest half of an arc
_SAMPLES = 500  # approximate number of samples used


def estimate_centre_errors(context: Context, bodies: MeasuredBodies, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return covariance (n, 2, 2), m², and standard deviation (n,) in one direction, m, of the joint centres.

    The covariance, relative to the previous joint, is from the joint fit and contains the error of the previous centre.
    The standard deviation, relative to the markers around the joint, does not; the ankles of moving feet have those of
    :mod:`mocap_id.kinematics.clusters`. Both include motion between both sides of the joint, for the joint angles ``q``
    (T, n) in the samples of the fit, rad.

    At the hip, they include the effect of a bending trunk. If the pelvis rotates relative to the trunk, the joint fit
    estimates a centre between hip and lumbar spine, with small residuals, but the marker next to the hip moves relative
    to the trunk. If the hip moves in the same way and in phase with its angle, this motion divided by the change of the
    angle estimates the error of the centre. The shift of the joint corrects a part of it.
    """
    tree = context.tree("chain.h5")
    skeleton, residual = Skeleton(tree), tree.numbers("markers/residual")
    loose = {joint: gap for joint, gap in bodies.gap.items() if not gap.pinned}
    moving = np.zeros(q.shape[1]) + estimate_hidden_gaps(bodies.poses, [*loose])
    for joint, gap in loose.items():
        moving[joint] += gap.size**2 / 8
        own = np.flatnonzero(skeleton.marker_segment == joint + 1)
        if skeleton.joints[joint] == _BENT:
            nearest = own[np.argmin(np.linalg.norm(skeleton.local[own], axis=1))]
            moving[joint] += (REMAINING * residual[nearest] / np.nanstd(q[:, joint])) ** 2
    alone = remove_previous_errors(np.einsum("jkk->j", skeleton.covariance) / 2)
    for joint, sd in bodies.placed.items():
        alone[joint] = sd**2
    return skeleton.covariance + moving[:, None, None] * np.eye(2), np.asarray(np.sqrt(alone + moving))


def remove_previous_errors(relative: FloatArray) -> FloatArray:
    """Return the variance (n,) of each joint centre, m², from its variance relative to the previous centre."""
    own = np.zeros(len(relative))  # at most the relative variance of the next centre, which includes it
    for joint, (variance, following) in enumerate(zip(relative, [*relative[1:], np.inf], strict=True)):
        own[joint] = min(max(variance - (own[joint - 1] if joint else 0.0), _OWN * variance), following)
    return own


def estimate_hidden_gaps(poses: BodyPoses, loose: Sequence[int]) -> FloatArray:
    """Return the variance (n,) of each joint centre due to gaps that the joint fit hides, m² in each coordinate.

    ``loose`` are the joints, from 0, that may have a gap. Each gap also moves the centres of the neighbouring joints.
    """
    joints, variance = poses.joints, np.zeros(len(poses.centres))
    samples = np.flatnonzero(find_complete_rows(poses.angle))
    samples = samples[:: max(1, len(samples) // _SAMPLES)]
    if not len(samples) or not loose:
        return variance
    angle = poses.angle[samples]
    flat, spread = differentiate_gaps(poses, joints, angle)
    weight = np.linalg.inv(spread @ np.swapaxes(flat, 1, 2))  # (t, 2j, 2j) weight of the gaps
    sides = (angle[:, poses.body[[joint + side for joint in joints]]] for side in (0, 1))
    before, after = (np.stack([planar.rotate(each, axis) for axis in np.eye(2)], axis=-1) for each in sides)
    design = np.zeros((len(samples), len(joints), 2, len(joints), 4))  # columns: dn and df of every joint
    for row in range(len(joints)):
        design[:, row, :, row] = np.concatenate([-before[:, row], after[:, row]], axis=-1)
    rows = design.reshape(len(samples), 2 * len(joints), -1)
    weighted = np.swapaxes(rows, 1, 2) @ weight
    normal = np.sum(weighted @ rows, axis=0)
    mean = np.stack([before, after], axis=-2).reshape(len(samples), len(joints), 2, 4) / 2  # mean of the two sides
    for row in (joints.index(joint) for joint in loose):
        shapes, size = _estimate_gap(
            np.einsum("tji,tj->ti", before[:, row], poses.measure_gap(joints[row])[samples]),
            np.einsum("tji,tjk->tik", before[:, row], after[:, row]),
            angle[:, poses.body[joints[row] + 1]] - angle[:, poses.body[joints[row]]],
        )
        gaps = weighted[:, :, 2 * row : 2 * row + 2] @ (before[:, row] @ shapes)
        moved = -size * np.linalg.solve(normal, np.sum(gaps, axis=0)).reshape(len(joints), 4, -1)
        variance[joints] += np.mean(np.sum((mean @ moved) ** 2, axis=(2, 3)), axis=0) / 2
    return variance


def _estimate_gap(gap: FloatArray, turned: FloatArray, angle: FloatArray) -> tuple[FloatArray, float]:
    """Return the S shapes (T, 2, S) of a gap for σ = 1, and σ, m, estimated from the measured gap.

    The measured gap (T, 2) and R(θ) (T, 2, 2) are in the axes of the body before the joint; ``angle`` (T,) is θ, rad.
    """
    half = max(float(np.ptp(angle)) / 2, _STILL)
    x = (angle - angle.min()) / half - 1
    orders = np.polynomial.chebyshev.chebvander(x, len(_ORDERS))[:, 1:] * _ORDERS
    shapes = (orders[:, None, None, :] * np.eye(2)[:, :, None]).reshape(len(angle), 2, -1)
    rows = np.concatenate([np.broadcast_to(-np.eye(2), turned.shape), turned], axis=-1).reshape(-1, 4)
    every = np.column_stack([shapes.reshape(len(rows), -1), gap.reshape(-1)])
    left = every - rows @ np.linalg.lstsq(rows, every)[0]
    basis, size, _ = np.linalg.svd(left[:, :-1], full_matrices=False)
    share = float(np.sum(size**2))
    if share <= 0.0:
        return shapes, 0.0
    seen = basis[:, size > _SHAPED * size[0]].T @ left[:, -1]
    return shapes, min(float(np.sqrt(np.sum(seen**2) / share)), _LARGEST * half)


_LEAST_JOINTS = 2  # ankle and knee, because the ratios of a person need a shank


def read_calibration(context: Context) -> PlanarCalibration:
    """Return the standard deviations of the errors of scale of plate and cameras, from the settings."""
    settings: IdentifyDimSettings = context.settings
    return PlanarCalibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
        position=read_plate_position_sd(context),
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

    If the check suspects an error, the covariance contains the error at the size that the check has estimated. Without
    a ``reference`` body with the chain (NaN), there is no check. For measured poses, ``chain`` are the base parameters
    of the chain and the map from the bodies to them, and ``unsmoothed`` is the trial with nearly unfiltered poses for
    the check, because the low-pass of the fit reduces accelerations.
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
        causes, suspects = scales
        sd |= {name: max(sd.get(name, 0.0), abs(causes[name].value)) for name in suspects}
    return found.add_calibration(propagate_calibration(prepared, found.fit, found.base, sd), scales)


def explain_scales(out: Findings, found: Identification, given: float | None, *, stands: bool) -> None:
    """Add a caution about suspected errors of scale, and a note if no mass, kg, is ``given``.

    The note is added if the person ``stands`` on plates or a board, or if the scales were checked.
    """
    causes, suspects = found.scales or ({}, ())
    if given is None and (stands or found.scales is not None):
        out.reasons.append(ON_TRUST)
    if not suspects:
        return
    sentences = [_describe_cause(name, causes[name]) for name in suspects[:3]]
    first, certain = causes[suspects[0]], len(suspects) == 1
    if certain:
        text = f"{sentences[0]}. {_CHECK[suspects[0]]}"
    else:
        text = f"the data do not determine which of these is wrong: {'; or '.join(sentences)}. Check them in this order"
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
class BodyFit:
    """Identification of a trial with the measured poses of its bodies."""

    prepared: PreparedTrial  # trial with the motion of the bodies
    found: Identification  # identification of the full parameters of the bodies
    in_chain: Identification  # base and full parameters of the chain, computed from the bodies' parameters
    prior: BodyPrior  # prior of the bodies' parameters
    bands: Cutoffs  # cut-offs of x, y and angle of the poses, Hz
    bands_why: str  # reason for this choice
    references: ReferenceBodies  # reference bodies, with parameters of these bodies
    prior_share: FloatArray  # (b,) share of the precision of each base parameter that comes from the prior, 0 … 1
    grid: PointGrid  # point masses around the joints and markers of each body
    left_out: LeftOutPrediction | str  # predictions of left-out repetitions, or why there are none
    # base parameters (f, b) of the chain and clock offsets (f,), s, of the f models of these predictions
    held_out: tuple[FloatArray, FloatArray] | None
    noise: PredictionNoise  # errors of predicted wrench and torques, except those from errors of the parameters


def fit_bodies(
    context: Context,
    bodies: MeasuredBodies,
    prepared: PreparedTrial,
    movement: Movement,
    *,
    pinned: Identification,
    tables: ReferenceBodies,
) -> BodyFit:
    """Return the identification of the bodies, pinned at the joints that hold, with their measured poses.

    ``pinned`` is the identification of the pinned chain, and ``tables`` are the reference bodies with the chain.
    """
    settings, recorded, reference = context.settings, prepared.recorded, tables.chosen.parameters
    mass = float(pinned.full[::4].sum()) if tables.chosen.mass is None else tables.chosen.mass
    prior = make_body_prior(bodies, recorded.q, movement, tables.chosen, mass)
    bands, bands_why, _ = choose_cutoffs(make_predictor(prepared, movement, bodies, prior))
    ready = prepare_bodies(bodies, recorded, prepared.settings, prior, bands)
    count = len(bodies.names)
    ends = bodies.poses.centroid[: count - 1].copy()
    for joint in bodies.poses.joints:
        ends[bodies.poses.body[joint]] = bodies.poses.centres[joint]
    owner = np.repeat(np.arange(count), [len(each) for each in bodies.markers])
    local = np.array([position for each in bodies.markers for position in each.values()])
    grid = build_grid(ends, owner, local, settings.grid)
    found = identify(
        ready,
        movement.free,
        grid,
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
        slide = propagate_slides(np.array([*markers.values()]), variance)
        slides.append((slide, tuple(sorted(near)) or (joints - 1,)))
    moves, of_poses = propagate_pose_errors(ready, found.fit, found.base, bodies.poses, sliding=slides, bands=bands)
    covariance = found.covariance + moves[own] @ moves[own].T
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

    # left-out repetitions, from whose residuals the errors of predictions follow; without them, those of the fit
    left_out, held_out = validate(ready, movement, found, np.zeros((len(recorded.time), 3))), None
    if not isinstance(left_out, str):
        full = np.array([chain_map.apply(each) for each in left_out.base])
        held_out = full @ prepared.base.regrouping.T, left_out.offset
        rest, absorbed = np.where(left_out.samples[:, None], left_out.measured - left_out.wrench, np.nan), 0.0
    else:
        measured = ready.measured(found.fit.offset) - (found.plate_bias or 0.0) * np.array([1.0, 0.0, 0.0])
        rest = np.where(found.fit.in_fit[:, None], measured - ready.rows @ found.base, np.nan)
        seconds = float(found.fit.in_fit.sum()) / ready.recorded.rate
        absorbed = len(found.base) / max(3 * seconds / _CORRELATED, 1.0)
    return BodyFit(
        prepared=ready,
        found=found,
        in_chain=in_chain,
        prior=prior,
        bands=bands,
        bands_why=bands_why,
        references=ReferenceBodies(chosen, tuple(convert(each) for each in tables.every)),
        prior_share=np.clip(share, 0.0, 1.0),
        grid=grid,
        left_out=left_out,
        held_out=held_out,
        noise=estimate_residual_noise(ready, found, rest, centre_sd=centre_sd, of_poses=of_poses, parameters=absorbed),
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
    prepared: PreparedTrial, pinned: Identification, movement: Movement, bodies: BodyFit, threshold: float
) -> dict[str, Any]:
    """Return the fact ``pins``: errors of the pinned chain and of measured poses, after the same low-pass."""
    on_chain = validate(prepared, movement, pinned, np.zeros((len(prepared.recorded.time), 3)))
    on_bodies, lowpass = bodies.left_out, bodies.prepared.lowpass
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

    ``dynamics`` are the columns of dynamics.parquet, of which the torque is interpolated at the encoder's times.
    """
    file = context.trial.encoder
    if file is None or "tau_1" not in dynamics:
        return None
    matched, log = context.table("encoder.parquet").facts, recording.read_encoder(file)
    if matched.get("why") is not None or log.torque is None:
        return None
    measured = matched["sign"] * log.torque
    model = SampledWrench(dynamics["time"], dynamics["tau_1"][:, None])
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
