"""Function of the stage planarise for a trial in space: expresses the recording in the lab's axes with y up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.landmarks import Side, find_landmarks, find_roles
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import ConfigError, RecordingError, Refused
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics.plane import fit_plane
from mocap_id.plates.choice import PlateChoice
from mocap_id.plates.placement import find_standing_feet
from mocap_id.recording import Recording, ThinnedFrames
from mocap_id.recording.imu_log import read_imu
from mocap_id.recording.markers import rotate_z_up
from mocap_id.recording.model import nearest_axis
from mocap_id.recording.sample_checks import find_upright, shows_standing
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.calibration_trial import FORMAT, get_calibration, read_chain
from mocap_id.stages.planarise import PlanariseSettings, wrenches
from mocap_id.stages.planarise.plane import (
    UsedPart,
    choose_on_one_clock,
    express_trajectories,
    list_bursts,
    read_recording,
    select_part,
)
from mocap_id.stages.trial_keys import TrialKeys, get_landmark_labels, get_recording, list_sensors
from mocap_id.store import LongTable, Table
from mocap_id.store.provenance import PLANAR, WRENCH
from mocap_id.verdict import Reason

_PLANAR = 0.01  # fraction of the motion out of the best vertical plane up to which a trial in the plane is sufficient


def planarise_in_space(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet of a trial in space.

    The trial's frame has the lab's axes with y up: x is the file's first horizontal axis, z = x × y. A left arm is
    mirrored (z → -z).
    """
    settings: PlanariseSettings = context.settings
    files, free = get_recording(context.trial), context.trial.protocol == "free"
    side, inferred = context.trial.side, None
    notes: tuple[Reason, ...] = ()
    if files.skeleton is None:
        source = read_recording(files, settings)
    else:
        source, side, inferred, notes = read_upright(context.trial, settings)
    part = select_part(source, context.trial.window or (float(source.time[0]), float(source.time[-1])), settings.ignore)
    named = None if context.trial.side else find_landmarks(part.labels, get_landmark_labels(context.trial)).side
    left = (side or named) == "left"
    frame = PlaneFrame(0.0)
    points = express_trajectories(part, frame)
    if left:
        points["z"] = -points["z"]
    visible = np.isfinite(points["x"])
    source, thinned, choice, clock = choose_on_one_clock(source, part, feet=context.trial.plates.feet)
    feet = [source.plates[index] for index in choice.indices("feet")]
    planarity = fit_plane(thinned.positions).planarity
    out = Findings(part.list_oddities(feet))
    out.fact(
        space="3d",
        side="left" if left else "right",
        bursts=list_bursts(part, points),
        plane={"yaw_deg": 0.0, "planarity": planarity, "lean_deg": 0.0, "origin_m": [0.0, 0.0, 0.0], "facing": None},
        **part.facts,
        missing_fraction=float(1.0 - visible.mean()),
    )
    if free and planarity <= _PLANAR:
        out.say(
            "planar-motion",
            f"all markers move in one vertical plane ({100 * (1 - planarity):.1f} % of the motion): a trial with "
            "`space: plane` is sufficient, and also gives the dynamics of a person.",
            planarity,
            _PLANAR,
            "ok",
        )
    if inferred is not None:  # first and last time of the intervals with inferred positions, by joint
        stretches = {}
        for number, label in enumerate(source.labels):
            runs = find_runs(inferred[part.first : part.stop, number])
            if label in part.labels and runs:
                stretches[label] = [part.time[[run.start, run.stop - 1]].tolist() for run in runs]
        out.fact(skeleton={"inferred": stretches})
    out.reasons += notes
    values = {**points, "visible": visible}
    planar = LongTable(PLANAR, part.frames, part.time, part.labels, values, out.facts, tuple(out.reasons))

    # wrench of the ground; no result of a reach or curl needs the plates
    samples = [recording.decimate(each, part.time, source.rate) for each in source.plates]
    ground, threshold = Findings(), settings.cop_threshold_N
    wrenches.describe_plates(ground, source, thinned, choice, wrenches.ExternalWrenches(), threshold=threshold)
    columns = wrenches.compute_ground_wrench_in_space(part.time, samples, choice, frame, threshold, mirrored=left)
    upright = find_upright(thinned.positions)[0]
    person = (
        shows_standing(thinned.positions, upright) and len(find_standing_feet(thinned.positions, upright, None, 2)) == 2
    )
    check, unusable, _ = wrenches.check_registration(
        feet,
        [thinned.samples[index] for index in choice.indices("feet")],
        thinned.positions,
        thinned.rate,
        person=person,
        yaw=None,
        labels=part.labels,
        others=choice.list_unused(source.plates),
    )
    ground.fact(
        clock=clock.facts(),
        centre_m=wrenches.find_plates_centre(source.plates, choice, frame, mirrored=left),
        registration=check.facts,
        unusable=unusable,
    )
    if unusable is not None:
        columns["plate_ok"] = np.zeros(len(part.time), np.bool_)
    wrenches.describe_losses(ground, feet, part.time, np.zeros(len(part.time), np.bool_), clock.offset_s)
    ground.reasons += check.reasons
    if not free:  # but an assumed unit stays a caution
        ground.reasons = [
            each if each.code == "plate-unit-assumed" else replace(each, level="ok") for each in ground.reasons
        ]
        if feet and not person:
            ground.say(
                "plate-unchecked",
                "the plates were not compared with the markers, because nobody stands on two feet with markers. Joint "
                "angles do not need the plates; the mass and the forces in the exports are as in the file",
                level="ok",
            )
    return planar, Table(WRENCH, columns, ground.facts, tuple(ground.reasons))


_BEHIND = 0.05  # m; if hands or feet are farther behind the trunk than this, the file is a mirror image


def read_upright(
    trial: TrialKeys, settings: PlanariseSettings
) -> tuple[Recording, Side, BoolArray, tuple[Reason, ...]]:
    """Read the skeleton of a trial, and determine the axis that points up and the arm that moves.

    Return the skeleton with an upright trunk in lab axes with Z up, the side of the arm, whether the sensor inferred
    each joint position (F, M), and reasons. Raises Refused if it has no arm with shoulder, elbow and wrist.
    """
    file = get_recording(trial).skeleton
    assert file is not None
    read = read_skeleton(file, units=settings.units, vertical=settings.vertical)
    source, out = read.recording, Findings(read.reasons)
    moved: dict[Side, float] = {"right": 0.0, "left": 0.0}  # by the wrist relative to its shoulder
    for each in moved:
        roles = find_roles(source.labels, each)
        if {"near_shoulder", "wrist"} <= roles.keys():
            arm = source.positions[:, roles["wrist"]] - source.positions[:, roles["near_shoulder"]]
            moved[each] = 1e-6 + float(np.nansum(np.nanvar(arm, axis=0))) if np.isfinite(arm).any() else 0.0
    side: Side = trial.side or ("left" if moved["left"] > moved["right"] else "right")
    roles = find_roles(source.labels, side)
    missing = [name for name in ("near_shoulder", "elbow", "wrist") if name not in roles]
    if missing:
        raise Refused(
            "skeleton-incomplete",
            f"the skeleton does not contain the {' and '.join(missing).replace('near_', '')} of the {side} arm; its "
            f"joints are {', '.join(source.labels)[:200]}.",
        )
    if trial.side is None:
        text = f"the {side} arm moves more than the other and is used (if it is the wrong one, set `side:`)."
        out.say("recording-oddity", text, level="ok")
    if settings.vertical is None:  # the axis nearest to the trunk points up
        up = np.nanmedian(_find_trunk(source, roles)[0], axis=0) if len(source.time) else np.zeros(3)
        axis = nearest_axis(up, 0.75)
        if axis not in (None, "Z"):
            positions = source.positions.copy()
            rotate_z_up(positions, str(axis))
            text = "the upward axis was determined from the trunk (if it is another, set `vertical:`)."
            source = replace(source, positions=positions, vertical=f"{source.vertical} ({axis})")
        else:
            known = np.isfinite(up).all()
            tilt = float(np.degrees(np.arctan2(np.linalg.norm(up[:2]), up[2]))) if known else float("nan")
            text = (
                f"{source.vertical} of the file is taken as up; the trunk leans {tilt:.0f}° from it, with an unknown "
                "tilt of the camera. Angles of the arm relative to the thorax do not depend on it."
            )
        out.say("recording-oddity", text, level="ok")

    # hands or feet behind the trunk: the file is a mirror image
    up, across = _find_trunk(source, roles)
    forward = np.cross(up, across if side == "right" else -across)
    with np.errstate(invalid="ignore"):
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    ahead = []
    for start, end in (("near_ankle", "near_foot"), ("far_ankle", "far_foot")):
        if start in roles and end in roles:
            ahead.append(source.positions[:, roles[end]] - source.positions[:, roles[start]])
    if not ahead:
        ahead.append(source.positions[:, roles["wrist"]] - source.positions[:, roles["near_shoulder"]])
    along = float(np.nanmedian(np.einsum("fi,fi->f", np.mean(ahead, axis=0), forward)))
    if along < -_BEHIND:
        source = replace(source, positions=source.positions * [1.0, -1.0, 1.0])
        out.say(
            "skeleton-mirrored",
            f"hands or feet are {-100 * along:.0f} cm behind the trunk, so the file is a mirror image or exchanges "
            "left and right. It was mirrored back; check that `side:` names the arm that moved.",
            -along,
            _BEHIND,
        )
    return source, side, read.inferred, tuple(out.reasons)


def _find_trunk(source: Recording, roles: dict[str, int]) -> tuple[FloatArray, FloatArray]:
    """Return the vectors (F, 3) up along the trunk (NaN if unknown) and from the far to the near shoulder, m."""
    near, far = (source.positions[:, roles.get(f"{part}_shoulder", roles["near_shoulder"])] for part in ("near", "far"))
    low = [source.positions[:, roles[name]] for name in ("pelvis", "near_hip", "far_hip", "spine") if name in roles]
    if not low:
        return np.full(near.shape, np.nan), near - far
    return (near + far) / 2 - np.mean(low[: 1 if "pelvis" in roles else 2], axis=0), near - far


_RATES = (50.0, 250.0)  # Hz, of the frames
_LEAST_S = 5.0


def planarise_sensors(context: Context) -> Outputs:
    """Return planar.parquet and wrench.parquet without any measured marker, at the times of the first sensor.

    The trajectories are those of the calibration's markers, all missing; there is no plate.

    Raises ConfigError if the window is outside the recording. Raises RecordingError if a log cannot be read, or the
    sensors have too little time in common. Raises Refused if a moving segment has no sensor, in this trial or in the
    calibration.
    """
    calibration, trial = get_calibration(context.trial), context.trial
    tree = read_chain(calibration)
    segments = tree.texts("segments/name")
    for name in trial.imus:
        if name not in segments:
            raise ConfigError(f"imus: there is no segment {name!r}; the segments are {', '.join(segments)}")
    without = [name for name in segments[1:] if name not in trial.imus or name not in calibration.imus]
    if without:
        raise Refused(
            "imus-alone-incomplete",
            f"without markers, every moving segment ({', '.join(segments[1:])}) needs an inertial sensor in this trial "
            f"and in {calibration.trial.name}; one of the two trials has none on the {' and '.join(without)}.",
        )

    # times with a constant step that all sensors cover, on the assumption that their clocks agree
    sensors = list_sensors(trial.imus)
    logs = {segment: read_imu(sensor.file, sensor.rate_hz) for segment, sensor in sensors.items()}
    first, last = max(log.time[0] for log in logs.values()), min(log.time[-1] for log in logs.values())
    steps = [float(np.median(np.diff(log.time))) for log in logs.values()]
    rate = float(np.clip(round(1.0 / max(steps)), *_RATES))
    if last - first < _LEAST_S:
        files = ", ".join(sensor.file.name for sensor in sensors.values())
        raise RecordingError(
            f"{files}: the sensors have {max(last - first, 0):.1f} s in common, expected at least {_LEAST_S:g} s; use "
            "logs of one recording"
        )
    start, stop = first, last
    if trial.window is not None:
        start, stop = max(first, trial.window[0]), min(last, trial.window[1])
    if stop - start < _LEAST_S:
        raise ConfigError(
            f"`window:` contains less than {_LEAST_S:g} s of the sensor logs, which run from {first:g} to {last:g} s"
        )
    time = np.asarray(np.arange(np.ceil(start * rate), np.floor(stop * rate) + 1) / rate)

    labels = tree.texts("markers/name")
    rate = 1.0 / float(time[1] - time[0])
    missing = np.full((len(time), len(labels)), np.nan)
    source = Recording(
        files=tuple(sensor.file for sensor in sensors.values()),
        format=FORMAT,
        labels=tuple(labels),
        positions=np.repeat(missing[..., None], 3, axis=2),
        frames=np.arange(1, len(time) + 1),
        time=time,
        rate=rate,
        units="m",
        vertical="by gravity",
        analog_rate=None,
        plates=(),
        oddities=(),
    )
    planar_facts = {
        **UsedPart(source, 0, len(time), source.labels, source.positions, proposed=False).facts,
        "swaps": [],
        "bursts": {},
        "plane": {"yaw_deg": None, "planarity": None, "lean_deg": None, "origin_m": None, "facing": None},
        "missing_fraction": 1.0,
    }
    values = {"x": missing, "y": missing, "z": missing, "visible": np.isfinite(missing)}
    planar = LongTable(PLANAR, source.frames, time, source.labels, values, planar_facts, ())
    choice, threshold = PlateChoice((), (), ()), context.settings.cop_threshold_N
    ground = Findings()
    thinned = ThinnedFrames.of(source.positions, time, rate, ())
    wrenches.describe_plates(ground, source, thinned, choice, wrenches.ExternalWrenches(), threshold=threshold)
    ground.fact(registration={})
    reasons = tuple(replace(each, level="ok") for each in ground.reasons)  # nobody expects a plate here
    columns = wrenches.compute_ground_wrench(time, (), choice, PlaneFrame(0.0), threshold)
    return planar, Table(WRENCH, columns, ground.facts, reasons)
