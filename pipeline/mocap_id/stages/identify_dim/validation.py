"""Cross-validation, choice of cut-offs and pins, and the measured bodies and joint positions that it needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray, as_complex, find_complete_rows
from mocap_id.dynamics.consistency import PointGrid, build_grid
from mocap_id.dynamics.fit import Fit, fit, number_parts, shorten_rests
from mocap_id.dynamics.identification import (
    Cutoffs,
    Identification,
    LeftOutPrediction,
    choose_cutoffs,
    predict_left_out,
)
from mocap_id.dynamics.least_squares import CompressedProblem
from mocap_id.dynamics.measured_motion import (
    USUAL,
    BodyPoses,
    JointGap,
    PoseFilter,
    close_gaps,
    differentiate_gaps,
    fill_gaps,
    filter_motion,
    measure_gaps,
    measure_relative_pose,
    measure_stretch,
    merge_segments,
)
from mocap_id.dynamics.prediction import agreement, centre_of_pressure
from mocap_id.dynamics.preparation import FitSettings, LowPass, PreparedTrial, TrialData, prepare
from mocap_id.dynamics.priors import BodyPrior, build_even_prior, build_table_prior, split_torso
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.geometry import planar
from mocap_id.kinematics.cluster_poses import BENDS_M, LEAST_MARKERS, REMAINING
from mocap_id.kinematics.joint import count_positions
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.stages.base import Context, Findings
from mocap_id.store import Table
from mocap_id.store.views import Skeleton

SERIES = (*WRENCH_COMPONENTS, "cop_x")
"""Compared quantities, in the order of the columns of `dynamics.parquet`."""
_JUDGED = ("Fy", "tauz", "cop_x")
_FAR = 1.5  # times the error within the fit; expected with fewer than three independent observations per parameter
_NOTICEABLE = 1e-4  # share of the measured variance; with a smaller mean square error, the model is practically exact


def validate(
    prepared: PreparedTrial, movement: Movement, found: Identification, model: FloatArray
) -> LeftOutPrediction | str:
    """Return predictions of each repetition by a model fitted to the other repetitions, or why there are none.

    ``model`` (T, 3) is the wrench of the model of the whole fit; a component with only NaN is not predicted.
    """
    spans = find_spans(movement)
    if len(spans) < 2:
        many = "no repetition was found" if not spans else "only one repetition was found"
        return f"{many}, and at least two are needed to predict one from the others"
    part = number_parts(prepared.recorded.time, np.array(spans))
    left_out = predict_left_out(prepared, movement.free, found.fit, part, found.refit)
    if left_out is None:
        return "no subset of the repetitions determines the parameters"
    determined, samples = np.isfinite(model).any(axis=0), left_out.samples.copy()
    judged = np.flatnonzero(samples)
    samples[judged[~shorten_rests(prepared.recorded.dq[judged])]] = False
    return replace(left_out, samples=samples, wrench=np.where(determined, left_out.wrench, np.nan))


def describe_validation(
    movement: Movement,
    left_out: LeftOutPrediction | str,
    model: FloatArray,
    reference: FloatArray,
    *,
    measured: FloatArray,
    threshold: float,
    filtered: bool = False,
) -> dict[str, Any]:
    """Return the errors for left-out repetitions, and those of the whole fit and the reference body for these samples.

    ``model``, ``reference`` and ``measured`` (T, 3) are the wrenches of model, reference body and plate, N and N·m,
    with clock offset and bias of the whole fit corrected. There is no centre of pressure up to the vertical force
    ``threshold``, N. If these arrays are ``filtered`` by the fit's low-pass, the filtered predictions are compared, and
    the facts also contain ``unfiltered`` and ``inside``.
    """
    repetitions = len(find_spans(movement))
    if isinstance(left_out, str):
        nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s", "inside"))
        return {"repetitions": repetitions, **nothing, "why": left_out}
    samples = left_out.samples

    def compare(wrench: FloatArray, with_: FloatArray) -> dict[str, Any]:
        pressures = centre_of_pressure(wrench, threshold), centre_of_pressure(with_, threshold)
        pairs = [*zip(wrench.T, with_.T, strict=True), pressures]
        errors = {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}
        return {name: None if error is None else asdict(error) for name, error in errors.items()}

    inside: dict[str, float] | None = None
    if filtered:
        # shares of the samples in their 95 % intervals, whose widths come from the errors in the other repetitions
        predicted = left_out.filtered, left_out.filtered_measured
        cop = centre_of_pressure(predicted[0], threshold) - centre_of_pressure(predicted[1], threshold)
        series = np.column_stack([predicted[0] - predicted[1], cop])
        seen = [k for k in range(series.shape[1]) if np.isfinite(series[samples, k]).any()]
        series = series[:, seen]
        within = np.full(series.shape, np.nan)
        for k in np.unique(left_out.part[samples]):
            own, others = samples & (left_out.part == k), samples & (left_out.part != k)
            if others.any():
                sd = np.sqrt(np.nanmean(series[others] ** 2, axis=0))
                within[own] = np.where(np.isfinite(series[own]), np.abs(series[own]) <= NORMAL_95 * sd, np.nan)
        if not np.isnan(within).all():
            inside = dict(zip([SERIES[k] for k in seen], np.nanmean(within, axis=0).tolist(), strict=True))
    else:
        predicted = left_out.wrench, left_out.measured
    return {
        "repetitions": repetitions,
        "folds": len(left_out.base),
        "samples": int(samples.sum()),
        "model": compare(*predicted),
        "unfiltered": compare(left_out.wrench, left_out.measured) if filtered else None,
        "in_sample": compare(model, measured),
        "reference": compare(reference, measured) if np.isfinite(reference[samples]).any() else None,
        "clock_offset_s": left_out.offset.tolist(),
        "inside": inside,
        "why": None,
    }


def explain_validation(out: Findings, found: Mapping[str, Any]) -> None:
    """Add cautions about the model, from the facts of :func:`describe_validation`."""
    if found["model"] is None:
        return
    # rms errors; NaN if unknown, so that comparisons with it are false
    rms: list[dict[str, float]] = []
    for kind in ("model", "in_sample", "reference"):
        errors = [found[kind] and found[kind][name] for name in SERIES]
        values = [float(np.hypot(each["bias"], each["sd"])) if each else float("nan") for each in errors]
        rms.append(dict(zip(SERIES, values, strict=True)))
    own, within, table = rms
    worse = {k: own[k] / table[k] for k in _JUDGED if own[k] > table[k]}
    noticeable = [k for k in SERIES if found["model"][k] is not None and found["model"][k]["r2"] < 1 - _NOTICEABLE]
    far = {k: own[k] / within[k] for k in noticeable if own[k] > _FAR * within[k] > 0.0}

    def list_ratios(ratios: Mapping[str, float]) -> str:
        words = {"cop_x": "the centre of pressure"}
        return ", ".join(f"{ratio:.2f} ({words.get(name, name)})" for name, ratio in ratios.items())

    if worse:
        out.say(
            "held-out-worse",
            "the model does not predict left-out repetitions better than the reference body from height and mass: "
            f"the ratio of the errors is {list_ratios(worse)}. This recording does not allow an individual model "
            "of these quantities: errors of markers, loose joints or limbs without markers are larger than the "
            "difference between the person and the reference body",
            max(worse.values()),
            1.0,
        )
    if far:
        out.say(
            "held-out-far",
            "the model predicts left-out repetitions much worse than fitted repetitions: the ratio of the errors "
            f"is {list_ratios(far)}. The parameters depend on peculiarities of single repetitions",
            max(far.values()),
            _FAR,
        )


def find_spans(movement: Movement) -> list[tuple[float, float]]:
    """Return the times of the first and last known event of each repetition that has a known event, s."""
    spans = []
    for each in movement.repetitions:
        events = (each.start, each.seat_off, each.stand, each.seat_on, each.end)
        known = [time for time in events if np.isfinite(time)]
        if known:
            spans.append((min(known), max(known)))
    return spans


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

    ``prepared`` is the trial on the pinned chain, ``prior`` that of the parameters of ``bodies``. The function predicts
    with measured poses filtered by the cut-offs that it is given; None if this is impossible. Its later calls use the
    clock offset and weights of the first call.
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
        return choose_cutoffs(predict_with(replace(bodies, poses=close_others(*joints)))).cost

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

    names: tuple[str, ...]  # names of the bodies
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

    def grid(self, points: tuple[int, int]) -> PointGrid:
        """Return a grid of ``points`` (across, along) point masses around the joints and markers of each body."""
        count = len(self.names)
        body = np.repeat(np.arange(count), [len(each) for each in self.markers])
        local = np.array([position for each in self.markers for position in each.values()])
        ends = self.poses.centroid[: count - 1].copy()
        for joint in self.poses.joints:
            ends[self.poses.body[joint]] = self.poses.centres[joint]
        return build_grid(ends, body, local, points)


def find_measured_bodies(context: Context, recorded: TrialData) -> Iterator[MeasuredBodies]:
    """Yield the measured bodies, with short gaps bridged, for each possible division of the person into bodies.

    Pelvis and trunk may be two bodies or one. A division is possible if every segment is in a body with a known pose:
    in at least 80 % of the samples with known joint states. Except for the base, the body needs markers at more than
    two positions, because two points follow only the skin.
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
    return replace(
        bodies, poses=poses, observed=observed, gap=measure_gaps(poses, np.ones(len(poses.time), dtype=bool))
    )


def pin_joints(bodies: MeasuredBodies) -> MeasuredBodies:
    """Return bodies with bridged gaps, now pinned at the joints whose two sides do not separate."""
    pinned = [joint for joint, each in bodies.gap.items() if each.pinned]
    return replace(bodies, poses=close_gaps(bodies.poses, pinned))


def read_bodies(table: Table, centres: FloatArray, used: Sequence[int], camera: float = 0.0) -> MeasuredBodies:
    """Return bodies of poses.parquet as measured: gaps are not bridged, joints not pinned, and ``gap`` is empty.

    ``centres`` (n, 2) are the joint centres in the axes of the previous segment, m. The bodies with the indices
    ``used`` contain together every segment of the chain once. ``camera`` is the standard deviation of the cameras'
    white noise in each coordinate of a marker, m.
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
    """Return the prior of the bodies' parameters from a reference body, or with equal masses if there is none.

    ``q`` (T, n) are the joint angles of the chain, rad; the usable samples of ``movement`` give the mean positions of
    the bodies. ``table`` is the reference body with the chain, with NaN if there is none; ``mass`` is the person's, kg.
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
    """Return the errors of the joint centres, from the joint angles ``q`` (T, n) in the samples of the fit, rad.

    The results are the covariance (n, 2, 2) of each centre relative to the previous joint, m², and the standard
    deviation (n,) of each centre in one direction, relative to the markers around it, m.

    The covariance of a centre from the joint fit also contains the error of the previous centre, which the standard
    deviation does not. The ankles of moving feet have the standard deviations of
    :mod:`mocap_id.kinematics.cluster_poses`. Both results include motion between both sides of the joint. At the hip,
    it includes the effect of a bending trunk. If the pelvis rotates relative to the trunk, the joint fit estimates a
    centre between hip and lumbar spine, with small residuals, but the marker next to the hip moves relative to the
    trunk. If the hip moves in the same way and in phase with its angle, this motion divided by the change of the angle
    estimates the error of the centre. The shift of the joint (:mod:`mocap_id.kinematics.cluster_poses`) corrects a part
    of this error.
    """
    tree = context.tree("chain.h5")
    skeleton, residual = Skeleton.from_tree(tree), tree.numbers("markers/residual")
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
    """Return the variance (n,) of each joint centre, m², from its variance relative to the previous centre.

    The result for a centre is at most the relative variance of the next centre, because that includes it.
    """
    own = np.zeros(len(relative))
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
