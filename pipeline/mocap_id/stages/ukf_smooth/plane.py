"""Function of the stage ukf-smooth in the plane: joint states, marker residuals, skin motion and body poses."""

from __future__ import annotations

import math
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray, as_complex, as_xy, chunks, interpolate_gaps
from mocap_id.dynamics.measured_motion import BodyPoses, Stretch, fill_gaps, measure_stretch
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.estimation import FRAMEWISE, FilterSettings, States, smooth
from mocap_id.estimation.encoders import estimate_encoder_noise, match_encoder, smooth_encoder
from mocap_id.estimation.filter_problem import MarkerChain
from mocap_id.estimation.lasting_errors import (
    ResidualSpectrum,
    add_lasting_errors,
    compute_residual_spectrum,
    compute_variance_growth,
    estimate_camera_sd,
    estimate_coloured_variance,
)
from mocap_id.estimation.smoothing import find_rejected_segments
from mocap_id.geometry.planar import marker_positions
from mocap_id.kinematics.base_motion import find_moving_markers
from mocap_id.kinematics.chain_fit import ChainState
from mocap_id.kinematics.clusters import (
    BENDS_M,
    ClusterPose,
    HipShift,
    estimate_hip_shift,
    locate_ankle,
    measure_cluster,
)
from mocap_id.kinematics.joint import count_positions
from mocap_id.kinematics.skin_slides import SkinModel, angle_errors, fit_skin, skin_from_residuals
from mocap_id.recording.sample_checks import describe_held
from mocap_id.recording.sensor_logs import DEGREES
from mocap_id.stages import skin_motion
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.stages.ukf_smooth import UkfSmoothSettings, checks
from mocap_id.store import LongTable, Table
from mocap_id.store.artefacts import Skeleton, Trajectories
from mocap_id.store.provenance import ANGLES, ENCODER, MARKERS, POSES, STATES

_ENCODER_NOISE = "encoder noise"
_SNAP_RATIO = 2.0  # in people, the hip, which moves fastest, has 1.5 to 1.8 times the median of the joints
_ACCELERATION_SHARE = 0.75  # factor on the sd with sensors, from simulated people: the filter treats skin as noise


def ukf_smooth(context: Context) -> Outputs:
    """Return states.parquet, markers.parquet, skin.h5, encoder.parquet, poses.parquet and an empty angles.parquet."""
    settings: UkfSmoothSettings = context.settings
    tree, bad = context.tree("chain.h5"), context.table("segments.parquet").facts.get("bad_stretches", ())
    view = Trajectories(context.long("planar.parquet"), bad)
    checks.check_uniform_times(view, context.trial.trial)
    skeleton = Skeleton(tree)
    chain = MarkerChain(skeleton.centres, skeleton.marker_segment, skeleton.local)
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    moves = chain.segment > 0
    observed = np.ascontiguousarray(view.read_positions(columns[moves], axes="xy"))  # the filter would copy it
    repeated = checks.find_repeated_frames(observed)
    observed[repeated] = np.nan
    moving = MarkerChain(chain.centres, chain.segment[moves], chain.local[moves])
    visible: BoolArray = np.asarray(np.isfinite(observed).all(axis=-1))

    # settings and noise of the filter; the encoder is compared with `rts`
    given = settings.model_dump(include={field.name for field in fields(FilterSettings)})
    if settings.method == "encoder":
        given["method"] = "rts"
    # If all markers of a segment are at one position, a dropout changes the angle of the segment while they are
    # missing. This change is not process noise, so the process noise is limited.
    local = as_complex(moving.local)
    if any(count_positions(local[moving.segment == k]) < 2 for k in range(1, len(moving.centres) + 1)):
        given["sigma_v_ratio"] = _SNAP_RATIO
    noise = FilterSettings(**given)

    # filter and smoother; `observed` becomes NaN, in place, where a marker is not used: a copy would double the memory
    worn = list_sensors(context.trial.imus)
    sensors, between = Findings(), None  # `between`: joints with a sensor on both their segments
    if worn:
        from mocap_id.estimation import inertial_tracking  # noqa: PLC0415
        from mocap_id.stages.ukf_smooth.inertial import check_method, describe_sensors, read_sensors  # noqa: PLC0415

        check_method(noise.method, noise.engine)
        signals = read_sensors(skeleton.segments, worn)
        states, results = inertial_tracking.smooth_with_sensors(
            observed, view.time, moving, sensors=signals, settings=noise
        )
        has_sensor = np.isin(
            np.arange(len(skeleton.segments)), [0, *(s for s, each in results.items() if each.used is not None)]
        )
        between = has_sensor[1:] & has_sensor[:-1]
        sensors = describe_sensors(skeleton.segments, worn, signals, results)
    else:
        states = smooth(observed, view.rate, moving, settings=noise, overwrite=True)
    observed[~states.used] = np.nan

    # skin motion, measured poses, and standard deviations that contain both
    camera = estimate_camera_sd(observed, states, settings.marker_sd_floor)
    skin = estimate_skin(states, observed, camera) if tree.facts.get("estimator") == "bundle" else None
    spectrum = compute_residual_spectrum(states, observed, view.rate)
    poses, shift, thigh = measure_poses(
        view, chain, skeleton, observed=observed, angles=states.mean[:, :, 0], camera=camera
    )
    bends = shift.across is not None and abs(shift.place) >= BENDS_M
    sd_holds = SKIN
    if settings.method in FRAMEWISE:  # the errors of these methods are unknown
        sd_holds = UNKNOWN
    elif spectrum.cut_off is not None and spectrum.cut_off < checks.UNKNOWN_SD_HZ:
        states, sd_holds = replace(states, sd=np.full_like(states.sd, np.nan)), UNKNOWN
    elif skin is None or settings.method == "two-filter":
        sd_holds = NOISE
    else:
        bend = stretch = None
        if thigh is not None and "hip" in skeleton.joints:
            stretch = (skeleton.joints.index("hip"), thigh)
        if bends and shift.across is not None:
            hip = skeleton.joints.index("hip")
            bend = (hip, shift.across / float(np.linalg.norm(chain.centres[hip])))
        lasting = estimate_lasting_errors(states, observed, skin, camera, spectrum, bend=bend, stretch=stretch)
        states = replace(states, sd=add_lasting_errors(states, spectrum.rate, camera, *lasting))
    if between is not None:
        states.sd[:, between, 2] *= _ACCELERATION_SHARE
    del observed
    labels = [skeleton.markers[k] for k in np.flatnonzero(moves)]
    if skin is None:
        skin = assume_skin(
            states.chain, states.mean[..., 0], tree.array("markers/residual")[moves], skeleton.covariance
        )
        basis = "the joint fit"
    else:
        labels, basis = [labels[k] for k in np.flatnonzero(np.any(states.used, axis=0))], "all frames"

    # artefacts
    rejected = find_rejected_segments(moving.segment - 1, len(moving.centres), visible, states.used)
    stretches = checks.list_rejected(rejected, view.time, skeleton.segments[1:])
    states = replace(states, observed=checks.bridge_repeated(states.observed & ~rejected, repeated, view.rate))
    encoder = read_encoder_states(context.trial.encoder, states, view.time, settings)
    if settings.method == "encoder":
        mean, sd = np.full(states.mean.shape, np.nan), np.full(states.sd.shape, np.nan)  # the jerk stays unknown
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            mean[:, 0, d], sd[:, 0, d] = encoder[name], encoder[f"sd_{name}"]
        states = replace(states, mean=mean, sd=sd, observed=np.isfinite(mean[..., 0]))
        sd_holds = _ENCODER_NOISE

    # the markers that the states predict (eq. 3.18), NaN where an angle is missing, with their distance to the measured
    # marker, NaN where the marker is not visible; only the residuals of the markers of moving segments count
    shape = (len(view.time), len(columns))
    x, y, residual, used = np.empty(shape), np.empty(shape), np.empty(shape), np.zeros(shape, dtype=np.bool_)
    used[:, moves] = states.used
    counted, seen, squares = 0, 0, 0.0
    for part in chunks(len(view.time)):
        predicted = marker_positions(states.mean[part, :, 0], chain.centres, chain.segment, chain.local)
        x[part], y[part] = predicted[..., 0], predicted[..., 1]
        residual[part] = np.abs(as_complex(view.read_positions(columns, part, "xy", keep_bursts=True) - predicted))
        residual[part][repeated[part]] = np.nan
        off = residual[part, moves]
        there = np.isfinite(off)
        own = off[states.used[part] & there]
        counted, seen = counted + own.size, seen + int(np.count_nonzero(there))
        squares += float(own @ own)
    out = Findings()
    out.fact(
        marker_sd_m=states.marker_sd,
        sigma_v=states.sigma_v.tolist(),
        reprojection_rms_m=math.sqrt(squares / counted) if counted else None,
        outlier_fraction=(seen - counted) / seen if seen else None,
        bridged_fraction=np.mean(~states.observed, axis=0).tolist(),
        method=settings.method,
        engine=settings.engine,
        sd_holds=sd_holds,
        cut_off_hz=spectrum.cut_off,
    )
    if sensors.facts:
        out.fact(imus=sensors.facts)
    if settings.method == "encoder":  # the markers do not enter the states
        stretches = []
    if stretches:
        out.fact(rejected=stretches)
    checks.report_gaps(
        out, np.isnan(states.mean[:, :, 0]), view.time, skeleton.joint_names, quantity="angle", settings=settings
    )
    if settings.method != "rts":
        no_sd = "; they have no standard deviations" if settings.method in FRAMEWISE else ""
        out.say(
            "states-method",
            f"the states are estimated by `{settings.method}`, which is only meant for comparison{no_sd}. Remove "
            "`ukf-smooth: {method: …}` to use the default, filter and smoother.",
        )
    checks.report_rejected(out, stretches, view.time)
    checks.report_repeated_frames(out, repeated)
    checks.report_residuals(out, spectrum, skeleton.segments, from_markers=settings.method != "encoder")
    if bends:
        out.say(
            "trunk-bends",
            f"the trunk bends: the markers of the pelvis move by {1e3 * shift.slide:.0f} mm along the trunk as the hip "
            f"turns, and the hip is {1e3 * abs(shift.place):.0f} mm beside the place that a rigid trunk gives. The "
            "intervals of angles and torques contain this error. The angle of the hip is that of the trunk, not of the "
            "pelvis. Put three or more markers on the pelvis and on the chest, at different places seen from the side, "
            "to make them two segments.",
            float(abs(shift.place)),
            BENDS_M,
        )
    out.reasons += sensors.reasons
    markers: dict[str, FloatArray | BoolArray] = {"x": x, "y": y, "residual": residual, "used": used}
    values = state_columns(view.time, states.mean, states.sd, states.observed)
    return (
        Table(STATES, values, out.facts, tuple(out.reasons)),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, markers),
        skin_motion.make_skin_tree(skin, labels, camera, f"residuals of {basis}"),
        encoder,
        poses,
        Table(ANGLES, {"time": view.time}),
    )


def state_columns(time: FloatArray, mean: FloatArray, sd: FloatArray, observed: BoolArray) -> dict[str, Any]:
    """Return the columns of states.parquet by name.

    They are the time (F,), the states (F, n, 4), the standard deviations (F, n, 3 or 4) without that of the jerk, and
    the flags (F, n).
    """
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for j in range(mean.shape[1]):
        for d, name in enumerate(("theta", "dtheta", "ddtheta", "dddtheta")):
            columns[f"{name}_{j + 1}"] = mean[:, j, d]
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            columns[f"sd_{name}_{j + 1}"] = sd[:, j, d]
        columns[f"observed_{j + 1}"] = observed[:, j]
    return columns


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
    angles = np.cumsum(interpolate_gaps(states.mean[..., 0]), axis=1)
    state = ChainState(as_complex(chain.centres), as_complex(chain.local[used]), angles)
    return fit_skin(points, chain.segment[used], state, np.flatnonzero(complete), camera)


def assume_skin(
    chain: MarkerChain, angles: FloatArray, residual: FloatArray, centre_covariance: FloatArray
) -> SkinModel:
    """Return a model of the skin in which all residuals of the markers in the fit of the joints are skin motion.

    ``angles`` (F, n) are those of the joints, rad, ``residual`` (M,) is the rms residual of each marker, m, and
    ``centre_covariance`` (n, 2, 2) the covariance of the joint centres, m^2.
    """
    summed = np.cumsum(interpolate_gaps(angles), axis=1)
    state = ChainState(as_complex(chain.centres), as_complex(chain.local), summed)
    return skin_from_residuals(state, chain.segment, residual, centre_covariance)


def estimate_lasting_errors(
    states: States,
    used_markers: FloatArray,
    skin: SkinModel,
    camera: float,
    spectrum: ResidualSpectrum,
    *,
    bend: tuple[int, FloatArray] | None = None,
    stretch: tuple[int, Stretch] | None = None,
) -> tuple[IntArray, FloatArray]:
    """Return some frames (T,), and in them the variances (T, n, 4) of errors of the states that average out slowly.

    ``used_markers`` and ``camera`` are as for :func:`estimate_skin`. ``bend`` is the hip, a joint from 0, and the turn
    (F,) of the thigh if it followed the hip of a trunk that bends, rad; None if the trunk is rigid. ``stretch`` is the
    hip and the stretch of the thigh; None if it is unknown.
    """
    angles, rate = interpolate_gaps(states.mean[..., 0]), spectrum.rate
    frames, variance = angle_errors(skin, angles, rate)
    variance *= compute_variance_growth(states, used_markers, angles, frames, rate=rate, camera=camera)[..., None]
    coloured = estimate_coloured_variance(states, used_markers, angles, frames, rate=rate, camera=camera)
    variance = np.maximum(variance, coloured) + spectrum.oscillating_variance(frames)
    moved = np.zeros_like(variance)
    if bend is not None:
        # the turn of the thigh has noise: a smooth function of the posture replaces it, which has derivatives
        hip, turn = bend
        posture = np.column_stack([angles[:, hip], angles.sum(axis=1)])
        posture -= posture.mean(axis=0)
        shapes = np.column_stack([np.ones(len(angles)), posture, posture**2, posture.prod(axis=1)])
        known = np.isfinite(turn)
        course = (shapes @ np.linalg.lstsq(shapes[known], turn[known])[0])[frames]
        course -= course.mean()
        segment = np.zeros(angles.shape[1] + 1)
        segment[hip - 1 : hip + 2] = _BENT
        joint = segment[:-1] ** 2 + segment[1:] ** 2
        for order in range(4):
            moved[:, :, order] = np.outer((course**2 + np.mean(course**2)) / 2, joint)
            course = np.gradient(course, (frames[1] - frames[0]) / rate) if len(course) > 1 else np.zeros_like(course)
    if stretch is not None and stretch[1].above_noise != 0.0:
        # The chain cannot follow a gap of the hip, so the angle of the thigh is wrong by about the gap divided by its
        # length: the angle in every posture, its derivatives while the gap changes. A trunk that bends also stretches
        # the thigh, so the larger of the two variances counts.
        hip, gap = stretch
        rms, centre = gap.above_noise, states.chain.centres[hip]
        square = np.nan_to_num(gap.acceleration**2 - gap.noise**2, nan=rms**2)
        wide = min(round(3 * _AROUND * rate), (len(square) - 1) // 2)
        window = np.exp(-((np.arange(-wide, wide + 1) / (_AROUND * rate)) ** 2) / 2)
        nearby = np.convolve(square, window, "same") / np.convolve(np.ones(len(square)), window, "same")
        nearby = np.maximum(nearby, 0.0)[frames]
        segment = np.zeros(angles.shape[1] + 1)
        segment[hip - 1 : hip + 2] = _LOOSE
        joint = (segment[:-1] ** 2 + segment[1:] ** 2) / float(centre @ centre)
        for order, (usual, hidden, visible) in enumerate(zip(_OF_STRETCH, _HIDDEN, gap.visible, strict=True)):
            factor = min(usual, float(np.hypot(hidden, visible)) / rms)
            own = factor**2 * np.outer(nearby if order else np.full(len(frames), rms**2), joint)
            moved[:, :, order] = np.maximum(moved[:, :, order], own)
    variance += moved
    return frames, variance


OTHERS = "others"  # name of the body with all markers that are on no segment, for example on arms and head
_BESIDE = 0.02  # m, largest distance in the plane between a left and a right marker at the same height
_ONE_BODY = ("pelvis", "trunk")  # each has few markers, so the pose of both as one body is an alternative


def measure_poses(
    view: Trajectories,
    chain: MarkerChain,
    skeleton: Skeleton,
    *,
    observed: FloatArray,
    angles: FloatArray,
    camera: float,
) -> tuple[Table, HipShift, Stretch | None]:
    """Return poses.parquet, the effect of a trunk that bends, and the stretch of the segment below the hip.

    The table contains the measured poses of all bodies of the dynamics. The stretch is None without the poses of the
    bodies around this segment.

    A body whose markers do not determine a pose has no columns. The facts list the bodies in the order of the columns.
    Pelvis and trunk are included separately and as one body, the torso. ``chain`` includes the markers of the base.
    ``observed`` (F, K, 2) are the markers of the moving segments, m; NaN where they are not used for the states. The
    mean of ``angles`` (F, n), rad, is the posture in which pelvis and trunk are one body. ``camera`` is the standard
    deviation of a coordinate due to camera noise, m.
    """
    of_chain = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    free = np.setdiff1d(np.arange(len(view.labels)), of_chain)
    moves = np.flatnonzero(chain.segment > 0)
    wanted = [(name, [k]) for k, name in enumerate(skeleton.segments)]
    if set(_ONE_BODY) <= set(skeleton.segments):
        wanted.append(("torso", [skeleton.segments.index(name) for name in _ONE_BODY]))
    found: list[tuple[str, list[int], list[str], ClusterPose]] = []
    single: dict[int, tuple[ClusterPose, ComplexArray]] = {}  # pose and markers (F, m), m, of the body of one segment
    feet_move = False
    for name, numbers in wanted:
        own = np.flatnonzero(np.isin(chain.segment, numbers))
        if numbers == [0]:
            base = view.read_positions(of_chain[own], axes="xy")
            on_feet = find_moving_markers(base, view.rate)
            feet_move = bool(on_feet.any())
            used = on_feet if feet_move else np.ones_like(on_feet)
            own, points = own[used], as_complex(base[:, used])
        else:
            points = as_complex(observed[:, np.searchsorted(moves, own)])
        # the markers in the frame of the body's first segment; the later ones have their mean angle
        local = as_complex(chain.local).copy()
        for segment in numbers[1:]:
            mean = np.nanmean(np.exp(1j * angles[:, segment - 1]))
            on = chain.segment == segment
            local[on] = complex(*chain.centres[segment - 1]) + mean / abs(mean) * local[on]
        pose = measure_cluster(points, local[own])
        if pose is not None:
            found.append((name, numbers, [skeleton.markers[k] for k in own[pose.markers]], pose))
            if len(numbers) == 1:
                single[numbers[0]] = (pose, points[:, pose.markers])
    others = measure_cluster(as_complex(view.read_positions(free, axes="xy"))) if len(free) > 1 else None
    if others is not None:
        found.append((OTHERS, [], [view.labels[k] for k in free[others.markers]], others))

    # displacement of the hip due to the bending of the trunk: zero if the poses are missing
    hip = skeleton.joints.index("hip") if "hip" in skeleton.joints else len(skeleton.segments)
    shift = HipShift()
    if hip in single and hip + 1 in single:
        trunk, points = single[hip + 1]
        far = np.abs(trunk.local)
        near = points[:, far <= far.min() + _BESIDE]  # left and right
        shift = estimate_hip_shift(_frame(single[hip][0]), _frame(trunk), near.mean(axis=1))
    ankle = None  # position of the first joint, between moving feet and the segment above
    if feet_move and {0, 1} <= single.keys():
        ankle = locate_ankle(_frame(single[0][0]), _frame(single[1][0]), complex(*chain.centres[0]))

    columns: dict[str, FloatArray | IntArray] = {"time": view.time}
    bodies: list[dict[str, Any]] = []
    for k, (name, numbers, labels, pose) in enumerate(found, start=1):
        columns |= {
            f"x_{k}": pose.position.real.copy(),
            f"y_{k}": pose.position.imag.copy(),
            f"angle_{k}": pose.angle,
            f"markers_{k}": pose.count.astype(np.int64),
        }
        places = {label: [float(z.real), float(z.imag)] for label, z in zip(labels, pose.local, strict=True)}
        fact = {"name": name, "segments": numbers, "markers": places, "residual_m": pose.residual}
        if hip + 1 in numbers:
            fact["joint_shift_m"] = [shift.place.real, shift.place.imag]
        if ankle is not None and numbers == [1]:
            in_foot, in_shank, joint_sd = ankle
            fact["joint_m"] = [[place.real, place.imag] for place in (in_foot, in_shank)]
            fact["joint_sd_m"] = joint_sd
        bodies.append(fact)
    table = Table(POSES, columns, {"bodies": bodies})

    # stretch of the segment below the hip
    around = (hip - 1, hip, hip + 1)
    if hip < 1 or not set(around) <= single.keys():
        return table, shift, None
    three = [single[number][0] for number in around]
    spread = [float(np.sum(np.abs(pose.local - pose.local.mean()) ** 2)) for pose in three]
    three_poses = BodyPoses(
        time=view.time,
        position=np.stack([as_xy(pose.position) for pose in three], axis=1),
        angle=np.stack([pose.angle for pose in three], axis=1),
        centroid=np.array([as_xy(pose.local).mean(axis=0) for pose in three]),
        information=np.ones((3, 2)),
        body=np.arange(3),
        centres=chain.centres[[hip - 1, hip]],
        camera=camera**2 * np.array([[1 / len(each.local), 1 / s] for each, s in zip(three, spread, strict=True)]),
    )
    return table, shift, measure_stretch(fill_gaps(three_poses)[0], 1)


def _frame(pose: ClusterPose) -> tuple[ComplexArray, FloatArray]:
    """Return the origin (F,), m, and the angle (F,), rad, of a body's frame."""
    return pose.position - np.exp(1j * pose.angle) * pose.local.mean(), pose.angle


_NAMES = ("theta", "dtheta", "ddtheta")
_LEAST_R2 = 0.999  # of the angle; two records of the same joint differ only by noise
_LARGEST_OFFSET_SD = 1e-3  # s; the torque of a robot changes by some per cent in this time
_LEAST_RATIO = 2.0  # of the residuals with the opposite direction of rotation to those with the chosen one
_IN_DEGREES = 0.1  # relative tolerance of the factor between degrees and radians


def read_encoder_states(file: Path | None, states: States, time: FloatArray, settings: UkfSmoothSettings) -> Table:
    """Return encoder.parquet: the encoder's states at the cameras' times (F,), s, with the sign and zero of the plane.

    The table has no rows if ``file`` is None, if the chain has several joints, or if the cameras give no angle.

    RecordingError is raised if the file is invalid, is in degrees, or covers less than half of the recording,
    ConfigError if `method: encoder` is set but the table has no rows.
    """

    def skip(why: str) -> Table:
        if settings.method == "encoder":
            raise ConfigError(
                f"ukf-smooth: `method: encoder` cannot be used: {why}; give a suitable `encoder:`, or another `method:`"
            )
        return empty_encoder_table(why)

    if file is None:
        return skip("the configuration names no encoder")
    if states.mean.shape[1] != 1:
        return skip(f"an encoder measures one joint, but the chain has {states.mean.shape[1]}")
    angle, limit = states.mean[:, 0, 0], settings.encoder_offset_limit_s
    log = recording.read_encoder(file)
    noise = estimate_encoder_noise(
        log.time,
        log.position,
        log.velocity,
        position_sd=settings.encoder_position_sd,
        velocity_sd=settings.encoder_velocity_sd,
    )
    if not np.isfinite(angle).any():
        return skip("the cameras give no angle of the joint")
    match = match_encoder(time, angle, smooth_encoder(log.time, log.position, log.velocity, noise), limit)
    if match is None:
        raise RecordingError(
            f"{file}: the file, from {log.time[0]:.6g} to {log.time[-1]:.6g} s, covers less than half of the "
            f"recording, from {time[0]:.6g} to {time[-1]:.6g} s, with every clock offset up to {limit:g} s: it is from "
            "another trial, or its clock differs by more than `ukf-smooth: {encoder_offset_limit_s: …}`"
        )
    if abs(match.gain * DEGREES - 1.0) < _IN_DEGREES:
        raise RecordingError(
            f"{file}: the angles are {1 / match.gain:.1f} times the cameras' angles, as if they were in degrees; "
            "convert position and velocity to radians, as the names of the columns require"
        )
    # the encoder's states at the cameras' times, NaN outside the encoder's record
    stamps = time - match.offset
    inside = (stamps >= log.time[0]) & (stamps <= log.time[-1])
    smoothed = smooth_encoder(log.time, log.position, log.velocity, noise, at=stamps[inside])
    mean, sd = (np.full((len(time), len(_NAMES)), np.nan) for _ in range(2))
    mean[inside], sd[inside] = match.express_in_plane(smoothed.mean), smoothed.sd
    columns = {"time": time, **dict(zip(_NAMES, mean.T, strict=True))}
    columns |= {f"sd_{name}": sd[:, d] for d, name in enumerate(_NAMES)}
    # the cameras' states relative to the encoder's; None with less than two common frames, or an encoder at rest
    camera: dict[str, dict[str, float | None]] = {}
    for d, name in enumerate(_NAMES):
        both = np.isfinite(states.mean[:, 0, d]) & np.isfinite(mean[:, d])
        off = (states.mean[:, 0, d] - mean[:, d])[both]
        spread = float(np.var(mean[both, d])) if both.any() else 0.0
        camera[name] = {"bias": None, "sd": None, "r2": None}
        if len(off) >= 2 and spread > 0.0:
            r2 = 1.0 - float(np.mean(off**2)) / spread
            camera[name] = {"bias": float(np.mean(off)), "sd": float(np.std(off)), "r2": r2}
    facts = {
        "why": None,
        "sign": match.sign,
        "zero_rad": match.zero,
        "zero_sd_rad": match.zero_sd,
        "clock_offset_s": match.offset,
        "clock_offset_sd_s": match.offset_sd,
        "gain": match.gain,
        "rate_hz": log.rate,
        "noise": asdict(noise),
        "torque": log.torque is not None,
        "camera": camera,
    }
    out = Findings(describe_held(log.held))
    if not match.r2 >= _LEAST_R2:
        out.say(
            "encoder-disagrees",
            f"{file.name} and the cameras measured different movements: r² of the angle is {match.r2:.4f}, the "
            f"difference is {np.degrees(match.rms):.2f}° rms, and the encoder's angle times {match.gain:.3f} would fit "
            "best. The file is from another joint or trial, the drive between encoder and link is elastic, or the "
            "chain estimated from the cameras is wrong.",
            match.r2,
            _LEAST_R2,
        )
    elif match.at_edge:
        out.say(
            "encoder-weak",
            f"the clocks of encoder and cameras differ by {limit:g} s, the largest offset that is tried, or by more: "
            "raise `ukf-smooth: {encoder_offset_limit_s: …}`",
            abs(match.offset),
            limit,
        )
    elif match.opposite_rms < _LEAST_RATIO * match.rms:
        out.say(
            "encoder-weak",
            "the movement does not determine the encoder's direction of rotation: the opposite direction with another "
            f"clock offset fits nearly as well ({np.degrees(match.opposite_rms):.2f}° rms; the chosen direction: "
            f"{np.degrees(match.rms):.2f}°). Let the joint rest before and after it moves.",
            match.opposite_rms / max(match.rms, 1e-12),
            _LEAST_RATIO,
        )
    elif match.offset_sd > _LARGEST_OFFSET_SD:
        out.say(
            "encoder-weak",
            f"the clock offset of the encoder has a standard deviation of {1e3 * match.offset_sd:.1f} ms: the movement "
            "is too small or too slow for the difference between encoder and cameras.",
            match.offset_sd,
            _LARGEST_OFFSET_SD,
        )
    return Table(ENCODER, columns, facts, tuple(out.reasons))


def empty_encoder_table(why: str) -> Table:
    """Return encoder.parquet without rows; ``why`` is the reason, which becomes a fact of the table."""
    return Table(ENCODER, {column.name: np.empty(0) for column in ENCODER.columns}, {"why": why})
