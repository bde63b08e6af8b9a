"""Function of the stage fit-joints in the plane, which fits joint centres, marker positions and segment lengths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.anatomy.landmarks import find_still_pose
from mocap_id.arrays import IntArray, as_xy
from mocap_id.dynamics.priors import look_up_table
from mocap_id.errors import ConfigError, RecordingError, Refused
from mocap_id.kinematics.bundle import chain_angles, fit_chain, fit_links, frames_along_motion
from mocap_id.kinematics.chain_fit import ChainFit, ChainState, fit_static_pose, orient_frames
from mocap_id.kinematics.joint import count_positions
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.calibration_trial import get_calibration, has_no_markers, read_chain
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.trial_keys import StaticTrial, Subject
from mocap_id.store import Tree
from mocap_id.store.artefacts import Trajectories
from mocap_id.store.provenance import CHAIN

_MARKED_SD = 0.005  # m; limit for a joint with a marker at it, and for the first joint if its segment has few
_OTHER_PERSON = 0.03  # m; rms distance of the static pose's markers from the chain; the same person: below 0.015
_FEWEST_MARKERS = 4  # smallest number of markers of a static pose
_FEW_FRAMES = 10  # smallest number of frames of a static pose
_OFF = 0.25  # largest relative difference of a length from that of the person's height or of the other segment
_TRUNK, _TALLEST_M = 0.4, 2.1  # share of the height from hip to shoulder, with a margin of 40 %; height, m
_LEG = (0.2, 0.62)  # m; shank and thigh of a child of three years, and of the tallest people
_ANKLE, _ANKLE_M = 0.2, 0.2  # largest height of the ankle above the floor, as share of the body's height (a knee is at
# 0.28) and in m, for markers on the legs alone
_FEW_POSITIONS = 3  # smallest sufficient number of different marker positions on the first segment


def fit_joints(context: Context) -> Outputs:
    """Return chain.h5 of a trial in the plane."""
    trial = context.trial
    out = Findings()
    if has_no_markers(context.long("planar.parquet").facts):  # the chain is that of the calibration trial
        calibration = get_calibration(trial)
        tree, name = read_chain(calibration), calibration.trial.name
        out.say("calibrated", f"the joint centres and the segments' axes come from {name}.", level="ok")
        cautions = (reason for reason in tree.reasons if reason.level != "ok")
        return (Tree(CHAIN, tree.data, {**tree.facts, "calibration": name}, (*out.reasons, *cautions)),)
    settings: FitJointsSettings = context.settings
    segments = context.table("segments.parquet")
    view = Trajectories(context.long("planar.parquet"), segments.facts.get("bad_stretches", ()))
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    points, own = view.read_plane(), _columns(view, labels)
    heights = np.where(np.isfinite(points), points.imag, np.nan)
    top, floor = float(np.nanpercentile(heights, 99.5)), float(np.nanmean(heights[:, own[segment == 0]], axis=0).min())
    joint_names, names = segments.facts["joint_names"], segments.facts["names"]
    marked: Mapping[str, list[str]] = segments.facts["joint_markers"]
    tracks = {
        joint_names.index(name) + 1: points[:, _columns(view, about)].mean(axis=1) for name, about in marked.items()
    }

    # with single markers on segments, the fit starts from the chain of the stage segment
    links, start = segments.facts.get("links"), None
    if links is not None:
        centres = np.array([complex(x, y) for x, y in links["centres"]])
        local = np.array([complex(*links["local"][label]) for label in labels])
        start = ChainState(centres, local, chain_angles(points[:, own], segment, centres, local, tracks))
        usable = np.isfinite(start.angles).all(axis=1)
    else:
        visible = np.isfinite(points[:, own])
        usable = np.all([visible[:, segment == k].sum(axis=1) >= 2 for k in range(1, segment.max() + 1)], axis=0)
    if np.count_nonzero(usable) > settings.frames:
        frames = frames_along_motion(points, settings.frames, np.flatnonzero(usable))
        points = points[frames]
        start = None if start is None else replace(start, angles=start.angles[frames])
        tracks = {joint: track[frames] for joint, track in tracks.items()}
    if settings.estimator == "bundle":
        fit = fit_chain(points[:, own], segment, tracks, settings.lambda_a, start)
    elif start is not None:
        raise ConfigError(
            f"fit-joints: a segment has a single marker, and `estimator: {settings.estimator}` needs two markers on "
            "every segment; expected `estimator: bundle`"
        )
    elif tracks:
        raise ConfigError(f"segment: joint_markers: `fit-joints: {{estimator: {settings.estimator}}}` cannot use them")
    else:
        fit = fit_links(points[:, own], segment, "circle" if settings.estimator == "circle" else "rigid-body")
    fit = orient_frames(fit)
    sds = np.nan_to_num(fit.length_sd)
    check_sizes(dict(zip(names[1:-1], zip(fit.lengths, sds, strict=True), strict=True)), trial.subject)
    if trial.protocol == "sit-to-stand" and names[0] == "foot":
        # if the ankle is as high above the lowest still marker as a knee, the shank was taken for the foot
        height, stature = float(fit.centres[0].imag) - floor, trial.subject.height
        limit = max(_ANKLE * (top - floor if stature is None else stature), _ANKLE_M)
        if height > limit:
            raise Refused(
                "size-impossible",
                f"the joint called ankle is {height:.2f} m above the lowest marker that stands, expected at most "
                f"{limit:.2f} m: this is a higher joint, such as the knee, and what is still below it was taken for "
                "the foot. Record a movement in which the shank rotates, or name the segments: `segment: {count: …, "
                "names: […]}`, with `protocol: free`",
                height,
                limit,
            )
    out.fact(
        estimator=settings.estimator,
        iterations=fit.iterations,
        reprojection_rms_m=float(np.sqrt(np.mean(fit.residual[segment > 0] ** 2))),
        single_markers=links is not None,
    )
    if isinstance(trial.static, StaticTrial):
        _fit_static_trial(out, trial.static, view, labels, fit)
    report_estimator(out, settings)
    for name, about in marked.items():
        out.say(
            "joint-markers",
            f"the centre of the {name} is attracted to the mean of {', '.join(about)} (λ_A = {settings.lambda_a:g}); "
            "its standard deviation includes 10 mm for the distance between this mean and the joint.",
            settings.lambda_a,
            level="ok",
        )

    # An error of the joints of conventional marker sets, and of the first joint if its segment has few different
    # positions, is multiplied by the weight on them and gives an error of the torque: their limit is smaller.
    critical = set(() if links is None else marked)
    if count_positions(fit.local[fit.segment == 1]) < _FEW_POSITIONS:
        critical |= set(joint_names[:1])
    for name, arc, covariance in zip(joint_names, np.degrees(fit.arcs), fit.covariance, strict=True):
        sd = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else None
        if arc < settings.small_arc_deg:
            out.say(
                "small-arc",
                f"the {name} rotates by only {arc:.1f}°: skin motion of 2 mm then moves its centre by "
                f"{2 / np.radians(arc):.0f} mm unnoticed. Record a movement in which it rotates more.",
                float(arc),
                settings.small_arc_deg,
            )
        elif sd is not None and sd > (limit := min(settings.large_sd_m, _MARKED_SD if name in critical else np.inf)):
            report_uncertain_centre(out, name, sd, limit)
    data = {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.arange(len(fit.centres)),
            "centre": as_xy(fit.centres),
            "covariance": fit.covariance,
            "arc": fit.arcs,
        },
        "segments": {"name": np.array(names, dtype=object), "length": fit.lengths, "length_sd": fit.length_sd},
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": segment,
            "local": as_xy(fit.local),
            "residual": fit.residual,
        },
    }
    return (Tree(CHAIN, data, out.facts, tuple(out.reasons)),)


def _columns(view: Trajectories, labels: list[str]) -> IntArray:
    return np.array([view.labels.index(label) for label in labels], dtype=np.int64)


def _fit_static_trial(out: Findings, static: StaticTrial, view: Trajectories, labels: list[str], fit: ChainFit) -> None:
    """Add the fact ``static``, the joint angles of the chain in the static trial, and cautions."""
    file, source = static.recording, recording.read(static.recording, units=static.units, vertical=static.vertical)
    both = [k for k, label in enumerate(labels) if label in source.labels]
    points = source.positions[:, [source.labels.index(labels[k]) for k in both]]
    if static.window is not None:
        inside = (source.time >= static.window[0]) & (source.time <= static.window[1])
        points = points[inside]
        if np.count_nonzero(inside) < _FEW_FRAMES:
            raise RecordingError(
                f"{file}: the static trial has fewer than {_FEW_FRAMES} frames from {static.window[0]:g} to "
                f"{static.window[1]:g} s; it runs from {source.time[0]:g} to {source.time[-1]:g} s"
            )
    hidden = [label for label in labels if label not in source.labels]
    if len(both) < _FEWEST_MARKERS or not np.isfinite(points).any():
        raise RecordingError(
            f"{file}: the static trial shows {len(both)} of the {len(labels)} markers on the segments; missing: "
            f"{', '.join(hidden[:6])}. Give a static trial with the same markers and labels"
        )
    try:
        pose = find_still_pose(points, source.rate)
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from error
    still = points[pose.frames]
    seen = np.asarray(np.isfinite(still).all(axis=2))
    mean = np.where(seen[..., None], still, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
    known = np.asarray(seen.any(axis=0))
    used = np.array(both)[known]
    track = view.read_positions(_columns(view, [labels[k] for k in used]), axes="z")[..., 0]
    theta, sd_theta, residual = fit_static_pose(
        mean[known], np.nanmean(track, axis=0), fit.segment[used], as_xy(fit.local[used]), as_xy(fit.centres)
    )
    if residual > _OTHER_PERSON:
        raise RecordingError(
            f"{file}: in the static pose, the markers are {1e3 * residual:.0f} mm rms from the chain of this "
            f"trial, expected at most {1e3 * _OTHER_PERSON:.0f} mm; give a static trial of the same person with the "
            "same markers, unmoved, or leave out `static:`"
        )
    if pose.reasons:
        text = (
            f"the markers move at {1e3 * pose.speed:.0f} mm/s in the stillest part of {file.name}, so the zero of the "
            "joint angles is uncertain; record a person who stands still for two seconds."
        )
        out.say("static-moves", text, pose.speed, pose.reasons[0].limit)
    out.facts["static"] = {
        "trial": static.trial.name,
        "theta": [float(angle) if np.isfinite(angle) else None for angle in theta],
        "sd_theta": [float(sd) for sd in sd_theta],
        "residual_m": residual,
    }


def check_sizes(sizes: Mapping[str, tuple[float, float]], subject: Subject) -> None:
    """Raise Refused if a segment has a length that this person, or any person, cannot have.

    With a height, the length is compared with the tables' share of it; without, shank and thigh are compared with each
    other and with the smallest and tallest people. A segment above the hip is shorter than the trunk up to the
    shoulder. Two standard deviations of the length are allowed in addition. ``sizes`` are the length and its standard
    deviation, m, of each segment between two joints.
    """
    sex = subject.sex
    tables = [look_up_table("winter", None), *((look_up_table("de-leva", sex),) if sex is not None else ())]
    shares = {"shank": [table.shank.length for table in tables], "thigh": [table.thigh.length for table in tables]}
    legs = {name: sizes[name] for name in shares if name in sizes}
    wrong = []
    for name, (length, own_sd) in legs.items():
        sd = own_sd
        other = next((each for each in legs if each != name), None)
        if subject.height is not None:
            usual = [share * subject.height for share in shares[name]]
            against = f"for a height of {subject.height:g} m"
            hint = "the height, "
        elif not _LEG[0] - 2 * sd <= length <= _LEG[1] + 2 * sd:
            usual, against, hint = [_LEG[0] / (1 - _OFF), _LEG[1] / (1 + _OFF)], "in any person", ""
        elif other is not None:
            usual = [share / part * legs[other][0] for share, part in zip(shares[name], shares[other], strict=True)]
            sd = float(np.hypot(own_sd, legs[other][1]))
            against, hint = f"beside a {other} of {legs[other][0]:.2f} m", ""
        else:
            continue
        low, high = (1 - _OFF) * min(usual), (1 + _OFF) * max(usual)
        if not low - 2 * sd <= length <= high + 2 * sd:
            wrong.append(
                (
                    length,
                    low if length < low else high,
                    f"the {name} is {length:.2f} m long, expected {low:.2f} to {high:.2f} m {against}",
                    hint,
                )
            )
    trunk = _TRUNK * (_TALLEST_M if subject.height is None else subject.height)
    wrong += [
        (length, trunk, f"the {name} is {length:.2f} m long, expected at most {trunk:.2f} m above the hip", "")
        for name, (length, sd) in sizes.items()
        if legs and name not in legs and length > trunk + 2 * sd
    ]
    if wrong:
        length, limit, text, hint = max(wrong, key=lambda each: abs(np.log(each[0] / each[1])))
        raise Refused(
            "size-impossible",
            f"{text}. Check {hint}the unit of length (`planarise: {{units: …}}`) and the segments: give them with "
            "`segment: {count: …}`, `names`, `together` or `apart`",
            length,
            limit,
        )


def report_estimator(out: Findings, settings: FitJointsSettings) -> None:
    """Add a caution if the estimator is not the default; for trials in the plane and in space."""
    if settings.estimator != "bundle":
        without_sd = (
            "" if settings.estimator == "rigid-body" else "; its joints and lengths have no standard deviations"
        )
        out.say(
            "estimator",
            f"the joints are fitted by `{settings.estimator}`, which is only for comparison{without_sd}. Remove "
            "`fit-joints: {estimator: …}` to fit the whole chain.",
        )


def report_uncertain_centre(out: Findings, name: str, sd: float, limit: float) -> None:
    """Add a caution about a joint centre whose standard deviation ``sd``, m, is above the limit."""
    text = f"the centre of the {name} has a standard deviation of {1e3 * sd:.0f} mm."
    out.say("joint-uncertain", text, sd, limit)
