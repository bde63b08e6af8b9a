"""Sections of the report of a trial in reading order, with their tables except those of protocols."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Set
from functools import partial
from typing import Any

import numpy as np

from mocap_id.reporting import style
from mocap_id.reporting.grids import (
    UNKNOWN,
    Grid,
    GridColumn,
    columns_of,
    get_element,
    list_facts,
    list_values,
    millimetres,
    numbers,
    percent,
    scale,
    show,
    show_beside,
    show_fixed,
    show_interval,
    show_millimetres,
    show_with_sd,
    texts,
    to_grid,
    to_words,
    with_sd,
)
from mocap_id.reporting.page import Section
from mocap_id.reporting.protocol_tables import list_curls, list_reach, list_repetitions
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import (
    AngleEntry,
    BaseEntry,
    ChannelEntry,
    GapEntry,
    ImuEntry,
    JointEntry,
    MotionEntry,
    Summary,
)
from mocap_id.store import Facts

_AXES = "xyz"
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N·m", "tauy": "N·m", "tauz": "N·m"}
_IN_PLANE = ("Fx", "Fy", "tauz")
_SHOWN_OF_DYNAMICS = {
    "wrench", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m", "rivals", "held_out", "advice", "torque", "motion",
    "pins", "torques",
}  # fmt: skip
"""Facts of ``dynamics.h5`` that the table of facts omits: they are in other tables or only for programs."""
_SHOWN_OF_SEGMENTS = {
    "names", "confidence", "against", "joint_names", "joint_confidences", "joint_ratios", "hypotheses", "divisions",
    "bad_stretches",
}  # fmt: skip
"""Facts of ``segments.parquet`` that the table of facts omits: they are in other tables, in reasons or for programs."""


def make_sections(data: ReportData, summary: Summary) -> list[Section]:
    """Return the sections of the report; a refused trial only has the sections of the stages before the refusal."""
    planar, states, events = (data.facts(f"{name}.parquet") for name in ("planar", "states", "events"))
    parts = [_make_skeleton_section(data, summary)]
    filtering = list_facts(
        "Filter: noise and residuals",
        {
            "marker noise per coordinate (mm)": show_fixed(scale(summary.noise.marker_sd_m, 1e3), 2),
            "process noise σ_v of each joint (rad/s⁴)": states.get("sigma_v"),
            "reprojection error, rms (mm)": show(summary.markers.reprojection_rms_mm),
            **_remove(states, {"marker_sd_m", "sigma_v", "reprojection_rms_m"}),
        },
    )
    if data.in_space:
        angles = (list_angles(summary), filtering)
        parts.append(Section("angles", "Angles", angles, ("angles", "rates"), needs="angles.parquet"))
    else:
        grids = (filtering, _list_encoder_errors(summary))
        parts.append(Section("states", "Joint states", grids, ("states",), needs="states.parquet"))
    if summary.imus:
        parts.append(Section("imus", "Inertial sensors", (_list_imus(summary),), needs="states.parquet"))
    if not data.in_space:
        figures = ("repetitions", "phases") if "phases.parquet" in data.artefacts else ("repetitions",)
        repetitions = list_repetitions(data, summary)
        parts.append(Section("repetitions", "Repetitions", repetitions, figures, needs="events.parquet"))
    elif "reach" in events:
        found = summary.workspace
        meaning = () if found.visited is None else (found.visited.meaning,)
        if found.volume_m3 is None:
            meaning = (f"The reachable volume is unknown: {found.why}.",)
        reach = list_reach(data, summary)
        parts.append(Section("reach", "Reach", reach, ("reach",), text=meaning, needs="events.parquet"))
    elif "curl" in events:
        curls = list_curls(data, summary)
        parts.append(Section("curls", "Curls", curls, ("phase_portraits",), needs="events.parquet"))
    if data.in_space:
        parts.append(_make_landmark_section(data, summary))
    parts.append(_make_wrench_section(data, summary))
    if summary.dynamics.torques:
        torques = (_list_torques(summary),)
        parts.append(Section("torques", "Joint torques", torques, ("torques",), needs="dynamics.parquet"))
    if summary.dynamics.motion is not None and not data.in_space:
        parts.append(_make_motion_section(data, summary, summary.dynamics.motion))
    origin = (
        list_facts("Recording", _remove(planar, {"plane", "bursts"})),  # the verdict gives the number of bursts
        list_facts("Plane of motion", planar.get("plane") or {}),
        list_facts("Joint fit", _remove(data.facts("chain.h5"), {"static"})),
        list_facts("Settings of the trial", data.settings),
        list_facts("Run time of each stage (s)", summary.time_s or {}),
        list_facts("Software version", {"mocap-id": data.product}),
    )
    parts += [
        _make_parameter_section(data, summary),
        _make_marker_section(data),
        Section("origin", "Provenance", origin),
    ]
    complete = data.level != "refused" and not data.in_space
    return [part for part in parts if not part.needs or part.needs in data.artefacts or complete]


def _remove(facts: Facts, keys: Set[str]) -> Facts:
    return {key: value for key, value in facts.items() if key not in keys}


def describe_band(data: ReportData) -> str:
    """Return in words the frequency band in which model and measurement are compared."""
    return "unfiltered" if data.low_pass is None else f"below {data.low_pass:g} Hz"


def _make_skeleton_section(data: ReportData, summary: Summary) -> Section:
    """Return the section on joints and lengths; in space, also on glides, axes and kinds of the joints."""
    joints, names, in_space = summary.joints or (), summary.segments.names or [], summary.space == "3d"
    moved = dict(zip([joint.name for joint in joints], names[1:], strict=False))

    def centre(joint: JointEntry, k: int) -> str:
        if not joint.known:
            return "not determined by the motion"
        middle, sd = (None if values is None else values[k] for values in (joint.centre_m, joint.sd_m))
        return show_with_sd(middle, sd)

    zeros = (texts("angle is zero in", "zero"), with_sd("theta there (deg)", "zero_deg", "zero_sd_deg"))
    notes = (
        ". A hinge has a centre only across its axis"
        if in_space
        else ". Last columns: pose in which the angle is zero, and the value of theta (states.parquet) in it"
    )
    grids = [
        to_grid(
            "Joint centres in the frame of the previous segment, ± one standard deviation" + notes,
            joints,
            (
                texts("joint", "name"),
                *([texts("kind", "kind")] if in_space else []),
                texts(
                    "fixed to", lambda joint: names[joint.parent] if 0 <= joint.parent < len(names) else joint.parent
                ),
                texts("moves", lambda joint: moved.get(joint.name)),
                *(GridColumn(f"{_AXES[k]} (m)", partial(centre, k=k)) for k in range(3 if in_space else 2)),
                numbers("arc (deg)", "arc_deg", 1),
                *(() if in_space else zeros),
            ),
        )
    ]
    if in_space:
        glides = [
            with_sd(f"{axis} (mm)", get_element("glide_m", k), get_element("glide_sd_m", k), 1e3)
            for k, axis in enumerate(_AXES)
        ]
        axes = []
        for joint in joints:
            listed = (
                joint.axis if joint.axis and isinstance(joint.axis[0], list) else [joint.axis] if joint.axis else []
            )
            sds = [*joint.axis_sd_deg, None, None]
            axes += [(joint.name, k, axis, sds[k]) for k, axis in enumerate(listed)]
        grids += [
            to_grid(
                "Glide: shift of the joint centre at an elevation of 180°, in the frame of the previous segment",
                [joint for joint in joints if joint.glide_m],
                (texts("joint", "name"), *glides),
            ),
            to_grid(
                "Axes of hinges and two-axis joints",
                axes,
                (
                    texts("joint", 0),
                    GridColumn("axis", lambda row: str(row[1] + 1)),
                    texts("in the frame of the", lambda row: "own segment" if row[1] else "previous segment"),
                    *(numbers(axis, get_element(2, d), 3) for d, axis in enumerate(_AXES)),
                    numbers("sd (deg)", 3, 1),
                ),
            ),
            to_grid(
                "Kinds of the joints: rotation that each kind leaves unexplained, as a multiple of the noise of the "
                "markers. The simplest kind with a small multiple is chosen; a ball joint explains every rotation",
                [joint for joint in joints if joint.evidence],
                (
                    texts("joint", "name"),
                    texts("kind", "kind"),
                    *(numbers(kind, get_element("evidence", kind), 2) for kind in ("ball", "two-axis", "hinge")),
                ),
            ),
        ]
    caption, lengths = "Segment lengths, joint to joint, ± one standard deviation", summary.lengths_m or {}
    grids.append(to_grid(caption, lengths, [with_sd("length (m)", "value", "sd")], "segment"))
    recovered = data.skeleton is not None or data.spatial_skeleton is not None
    return Section(
        "skeleton",
        "Skeleton" if recovered else "Markers as recorded",
        tuple(grids),
        ("skeleton", "recovery") if recovered and not in_space else ("skeleton",),
        text=tuple(f"{joint.name}: {joint.why}." for joint in joints if not joint.known),
        needs="planar.parquet",
    )


def _list_encoder_errors(summary: Summary) -> Grid:
    """Return a table of the errors of cameras and model against the encoder; empty without an encoder."""
    found = summary.encoder
    if found.clock_offset_s is None or found.clock_offset_sd_s is None:
        return Grid()
    camera = found.camera or {}
    errors = {
        "angle, cameras (rad)": camera.get("theta"),
        "velocity, cameras (rad/s)": camera.get("dtheta"),
        "acceleration, cameras (rad/s²)": camera.get("ddtheta"),
        "torque, identified model (N·m)": found.torque,
    }
    clock = f"{1e3 * found.clock_offset_s:.2f} ± {1e3 * found.clock_offset_sd_s:.2f} ms"
    sense = "the same" if found.sign == 1 else "the opposite"
    caption = f"Error against the encoder ({sense} sense as the plane; clock {clock} after the cameras')"
    known_errors = {name: error for name, error in errors.items() if error is not None}
    return to_grid(caption, known_errors, (*columns_of(ChannelEntry), numbers("r²", "r2", 5)), "quantity")


def _list_imus(summary: Summary) -> Grid:
    """Return a table of clock, bias, position and residuals of each inertial sensor."""

    def bias(entry: ImuEntry) -> float | None:
        return None if entry.gyro_bias_rad_s is None else math.degrees(math.hypot(*entry.gyro_bias_rad_s))

    columns = (
        texts("used", lambda entry: "yes" if entry.used else f"no: {entry.why}"),
        *columns_of(ImuEntry, "clock_offset_s"),
        texts("determined by the motion", lambda entry: "yes" if entry.observable else "no"),
        *columns_of(ImuEntry, "ppm"),
        numbers("gyroscope bias (deg/s)", bias, 2),
        GridColumn("position (mm)", lambda entry: ", ".join(map(show_millimetres, entry.position_m or [None] * 3))),
        *columns_of(ImuEntry, "mounting_sd_deg skin_share gyro_residual_rad_s acc_residual_m_s2"),
    )
    caption = "Inertial sensors: clock relative to the cameras, and other quantities estimated from the motion"
    return to_grid(caption, to_words(summary.imus), columns, "segment")


def list_angles(summary: Summary) -> Grid:
    """Return a table of each angle: range, interval, standard deviations, and percentage of usable samples."""
    caption = (
        "Angles. Plane and axial rotation of the shoulder are evaluated only where the elevation is more than 15° from "
        "0 and 180°. The interval of the range contains both standard deviations"
    )
    return to_grid(caption, to_words(summary.angles), columns_of(AngleEntry), "angle")


def _make_landmark_section(data: ReportData, summary: Summary) -> Section:
    frames = "The frames of the segments are the ISB frames (Wu et al. 2005), computed from these landmarks."
    if data.facts("chain.h5").get("frames") != "isb":
        missing = "no landmarks were found" if not summary.landmarks else "the landmarks do not suffice for them"
        frames = (
            f"The frames of the segments are the program's own, because {missing}. The angles are the joints' own "
            "coordinates and have no anatomical meaning."
        )
    labels = dict(part.split(" ", 1) for part in data.settings.get("landmarks", "").split(", ") if " " in part)
    residuals = {name: data.residuals.get(labels.get(name, name)) for name in summary.landmarks}
    columns = (
        texts("landmark", 0),
        texts("segment", lambda row: row[1].segment),
        *(millimetres(f"{axis} (mm)", get_element(lambda row: row[1].local_m, d)) for d, axis in enumerate(_AXES)),
        millimetres("sd (mm)", lambda row: row[1].sd_m),
        millimetres("residual of its marker, rms (mm)", lambda row: (residuals[row[0]] or {}).get("rms")),
    )
    caption = "Anatomical landmarks in the frames of their segments. The residual is the rms distance from the chain"
    grid = to_grid(caption, list(summary.landmarks.items()), columns)
    return Section("landmarks", "Landmarks", (grid,), text=(frames,), needs="chain.h5")


def _make_wrench_section(data: ReportData, summary: Summary) -> Section:
    """Return the section on plates and modelled wrench: errors of the fit, on left-out repetitions, of other bodies."""
    dynamics, found, band = summary.dynamics, summary.dynamics.held_out, describe_band(data)
    of_model = to_grid(
        f"Error of the model over the samples of the fit, {band}",
        {f"{name} ({_UNITS[name]})" if name in _UNITS else name: one for name, one in (dynamics.wrench or {}).items()},
        (*columns_of(ChannelEntry), numbers("r²", "r2", 4)),
        "component",
    )

    def error(channels: Mapping[str, Any], part: str, factor: float = 1.0) -> str:
        """Format bias ± sd of a component, times ``factor``; a number is a fraction of samples, in per cent."""
        channel = channels.get(part)
        if not isinstance(channel, ChannelEntry):
            return show_fixed(scale(channel, 100), 1)
        if channel.bias is None or channel.sd is None:
            return UNKNOWN
        return f"{show(factor * channel.bias)} ± {show(factor * channel.sd)}"

    components = [GridColumn(f"{part} ({_UNITS[part]})", partial(error, part=part)) for part in _IN_PLANE]
    errors: dict[str, Mapping[str, Any] | None] = {
        "models fitted without the repetition": found.model,
        "the same, unfiltered": None if data.low_pass is None else found.unfiltered,
        "model of the whole trial": found.in_sample,
        "allometric body": found.reference,
        "samples within the 95 % interval (%)": found.inside,
    }
    held_out = to_grid(
        f"Prediction errors on left-out repetitions, {band}: bias ± standard deviation over "
        f"{found.samples} samples, {found.folds} fits for {found.repetitions} repetitions",
        {name: channels for name, channels in errors.items() if channels},
        (*components, GridColumn("centre of pressure (mm)", partial(error, part="cop_x", factor=1e3))),
        "predicted by",
    )
    bodies: dict[str, Any] = {"identified model": dynamics, **dynamics.rivals} if dynamics.rivals else {}
    references = to_grid(
        f"Errors of the model and of allometric bodies, {band}: bias ± standard deviation",
        {name: {**(body.wrench or {}), "cop_rms_m": body.cop_rms_m} for name, body in bodies.items()},
        (*components, millimetres("centre of pressure, rms (mm)", "cop_rms_m")),
        "body",
    )
    offsets = (show_fixed(1e3 * offset, 2) for offset in found.clock_offset_s or ())
    clock = list_facts(
        "Plates and clock",
        {
            **list_values(dynamics, "clock_offset_s clock_offset_sd_s"),
            "clock offsets with one repetition left out (ms)": ", ".join(offsets),
            **list_values(dynamics),
            "why unknown": dynamics.why,
            "why no left-out repetition was predicted": found.why if dynamics.wrench and found.model is None else None,
        },
    )
    plates = to_grid(
        "Force plates and their detected use",
        data.facts("wrench.parquet").get("plates") or (),
        (
            texts("plate", lambda plate: str(plate.get("index", ""))),
            texts("type", "kind"),
            texts("use", "use"),
            numbers("mean vertical force (N)", "mean_vertical_N", 1),
            texts("reason", "why"),
        ),
    )
    title, grids = (
        "Ground reaction wrench" if data.in_space else "Ground reaction forces",
        (of_model, held_out, references),
    )
    return Section("wrench", title, (*grids, clock, plates), ("wrench",), needs="wrench.parquet")


def _list_torques(summary: Summary) -> Grid:
    """Return a table of the largest torque of each joint in each direction, in words."""
    dynamics = summary.dynamics
    rows = [
        (name, one.why, direction, *values)
        for name, one in dynamics.torques.items()
        for direction, sign, values in (
            (one.positive, 1, (one.highest_nm, one.highest_sd_nm, one.highest_nm_per_kg, one.highest_time_s)),
            (one.negative, -1, (one.lowest_nm, one.lowest_sd_nm, one.lowest_nm_per_kg, one.lowest_time_s)),
        )
        if values[0] is None or sign * values[0] > 0
    ]
    columns = (
        texts("joint", 0),
        texts("torque towards", 2),
        GridColumn(
            "largest (N·m)", lambda row: show_with_sd(scale(row[3], -1 if row[3] and row[3] < 0 else 1), row[4])
        ),
        GridColumn("N·m/kg", lambda row: show_fixed(None if row[5] is None else abs(row[5]), 2)),
        numbers("at (s)", 6, 2),
        texts("remark", 1),
    )
    legs = "both legs together, " if dynamics.legs == "both" else ""
    caption = (
        f"Largest torque of each joint in each direction ({legs}± one standard deviation), while only measured forces "
        "carry the body"
    )
    return to_grid(caption, rows, columns)


def _make_motion_section(data: ReportData, summary: Summary, motion: MotionEntry) -> Section:
    """Return the section on the motion of the masses: pinned chain or measured poses, and the errors of both."""
    dynamics, pins = summary.dynamics, summary.dynamics.pins
    errors: dict[str, dict[str, float | None]] = {}
    for name, own, offset in (
        ("pinned chain", pins.chain, pins.clock_offset_s),
        ("measured poses", pins.segments, dynamics.clock_offset_s),
    ):
        if own is not None:
            errors[name] = {"the centre of pressure": own.cop_rms_m, "clock": offset}
            for part in _IN_PLANE:
                one = own.wrench.get(part)
                known = one is not None and one.bias is not None and one.sd is not None
                errors[name][part] = math.hypot(one.bias, one.sd) if known else None  # type: ignore[union-attr,arg-type]
    compared = to_grid(
        f"Pinned chain and measured poses: rms error on left-out repetitions, {describe_band(data)}",
        errors,
        (
            *(numbers(f"{part} ({_UNITS[part]})", part) for part in _IN_PLANE),
            millimetres("centre of pressure (mm)", "the centre of pressure"),
            numbers("clock offset (ms)", "clock", 2, 1e3),
        ),
        "motion",
    )
    if motion.source == "chain":
        why = "it is configured" if motion.why == "asked for" else motion.why
        gaps = ", ".join(
            f"{name} {show_millimetres(gap.gap_m)} mm and {show(gap.acceleration_m_s2, 2)} m/s²"
            for name, gap in (motion.joints or {}).items()
        )
        chosen = f"The masses move with the pinned chain, because {why}" + (f" (rms gaps: {gaps})." if gaps else ".")
        return Section("motion", "Motion of the masses", (compared,), text=(chosen,), needs="dynamics.h5")
    # joints whose two segments belong to one body of the dynamics
    bodies, inside = data.facts("poses.parquet").get("bodies") or (), {}
    used = (data.facts("dynamics.h5").get("motion") or {}).get("used") or ()
    for j, name in enumerate(data.joint_names):
        for body in (bodies[k] for k in used if k < len(bodies)):
            if {j, j + 1} <= set(body["segments"]):
                inside[name] = f"inside one body ({body['name']})"
    joints = to_grid(
        "Gap between the two sides of each joint (rms). A joint whose gap is within the noise of the cameras is pinned",
        {
            name: {**dict(gap), "treatment": inside.get(name, "pinned" if gap.pinned else "free")}
            for name, gap in (motion.joints or {}).items()
        },
        (*columns_of(GapEntry), texts("in the dynamics", "treatment")),
        "joint",
    )
    poses = list_facts(
        "Measured poses",
        {
            "bodies": motion.bodies,
            **{f"cut-off frequency for {axis} (Hz)": f"{hz:g}" for axis, hz in (motion.bands_hz or {}).items()},
            "reason for these cut-off frequencies": motion.bands_why,
            "source of the loose prior of the body parameters": motion.prior,
            "condition number of the regressor of all bodies, without the prior": motion.bodies_condition_number,
            "the same with unit-norm columns": motion.bodies_condition_number_scaled,
        },
    )
    choice = (
        f"In the dynamics, every body moves as its own markers were measured, because {motion.why}. Pinned joints "
        "would hide this movement. Skeleton, lengths and angles still belong to the pinned chain."
    )
    if len(errors) < 2:
        effect = f"The effect of pinned joints is unknown: {pins.why}."
    else:
        pinned, free = errors["pinned chain"], errors["measured poses"]
        pairs = ((part, pinned[part], free[part]) for part in (*_IN_PLANE, "the centre of pressure"))
        ratios = ", ".join(f"{show_fixed(a / b, 1)} times as large for {part}" for part, a, b in pairs if a and b)
        offsets, clocks = (pinned["clock"], free["clock"]), ""
        if offsets[0] is not None and offsets[1] is not None:
            clocks = f" The two clock offsets differ by {show_fixed(1e3 * abs(offsets[0] - offsets[1]), 1)} ms."
        others = ", and no body for the other markers (arms, head)" if "others" in (motion.bodies or ()) else ""
        effect = (
            f"Both motions were used to predict left-out repetitions, on the same {pins.samples} samples, "
            f"{describe_band(data)}. With the pinned chain the error is {ratios}. Not all of this is due to the pins, "
            f"because the chain has its own smoothing and fit{others}.{clocks}"
        )
    grids = (compared, joints, poses)
    return Section("motion", "Motion of the masses", grids, text=(choice, effect), needs="dynamics.h5")


def _make_parameter_section(data: ReportData, summary: Summary) -> Section:
    """Return the section on the parameters, with intervals, references, and how well each of them is excited."""
    base, dynamics = summary.dynamics.base or (), data.dynamics
    columns = [
        texts("parameter", lambda row: row[0].name),
        GridColumn("value ± sd", lambda row: show_with_sd(row[0].value, row[0].sd)),
        GridColumn("95 % interval", lambda row: show_interval(row[0].value, row[0].sd)),
        GridColumn("reference", lambda row: show_beside(row[1], row[0].sd)),
        texts("unit", lambda row: style.format_unit(row[0].unit)),
        texts("verdict", lambda row: row[0].verdict, UNKNOWN),
    ]
    caption = "Base parameters"
    if data.measured_poses:
        columns.append(percent("share of prior (%)", lambda row: row[0].prior_share))
        caption += "; the last column is the share of the loose prior in the precision"
    rows = zip(base, () if dynamics is None else dynamics.base_reference, strict=False)
    excitation = to_grid(
        "Excitation of each base parameter: standard deviation relative to its size; norm of the part of its regressor "
        "column that is independent of the others, in residual standard deviations per SI unit; own share of that part",
        [entry for entry in base if entry.excitation is not None],
        (
            texts("parameter", "name"),
            texts("verdict", "verdict", UNKNOWN),
            *columns_of(BaseEntry),
            texts("movement that would help", "helps", UNKNOWN),
            GridColumn(
                "factor on the sd", lambda entry: UNKNOWN if entry.sd_ratio is None else f"× {show(entry.sd_ratio, 2)}"
            ),
        ),
    )
    facts = list_facts("Identification", _remove(data.facts("dynamics.h5"), _SHOWN_OF_DYNAMICS))
    figures = ("parameters",) if data.in_space else ("parameters", "point_masses")
    grids = (to_grid(caption, rows, columns), excitation, facts)
    return Section("parameters", "Inertial parameters", grids, figures, needs="dynamics.h5")


AGAINST: Mapping[str, str] = {
    "skipped": "the segment beyond the joint with the lowest confidence could be omitted at little cost",
    "left-out": "some moving markers belong neither to a segment nor to another limb",
    "axis": "a still marker near the first joint may belong to the moving segment beyond this joint",
    "first-joint": "the first joint is not a fixed point of base and first segment to within 8 mm",
    "base": "the still markers move almost as much as the moving markers",
    "runner-up": "another number of segments fits the markers almost as well",
    "links": "a segment has a single marker, and no marker is at either of its joints",
    "ankle": "joint 1 rotates little, and no marker is at this joint",
}
"""Text for each piece of evidence in :class:`mocap_id.kinematics.segmentation.Confidence`."""

_NEGLIGIBLE = 5e-4  # would be shown as 0.000


def _make_marker_section(data: ReportData) -> Section:
    """Return the section on markers, evidence against the segments, confidence in the joints, and segmentations.

    The evidence is empty without a search for segments, as for the segments of a calibration.
    """
    facts, names = data.facts("segments.parquet"), dict(enumerate(data.segment_names))

    def residual(name: str) -> Callable[[Mapping[str, Any]], float | None]:
        return lambda row: data.residuals.get(row["marker"], {}).get(name)

    markers = to_grid(
        "Markers: rms distance from the rigid segment; rms and 95 % quantile of the distance from the chain",
        data.rows("segments.parquet"),
        (
            texts("marker", "marker"),
            texts("segment", lambda row: "none" if row["segment"] < 0 else names.get(row["segment"], row["segment"])),
            millimetres("rigid (mm)", "residual"),
            millimetres("chain (mm)", residual("rms")),
            millimetres("95 % (mm)", residual("q95")),
            percent("visible (%)", residual("seen")),
            texts("reason", "reason"),
        ),
    )
    evidence = Grid()
    if facts.get("against") is not None:
        reductions = ((off, name) for name, off in facts["against"].items() if off >= _NEGLIGIBLE)
        rows = {AGAINST.get(name, name): off for off, name in sorted(reductions, reverse=True)}  # strongest first
        evidence = to_grid(
            f"Probability that the segments are right: {show_fixed(facts.get('confidence'), 2)}",
            rows or {"none": 0.0},
            (
                GridColumn("reduction of the log odds", lambda off: show_fixed(off, 3) if off else "0"),
                GridColumn("factor on the odds", lambda off: show_fixed(np.exp(off), 2) if off else "1"),
            ),
            "evidence against the segments",
        )
    keys = ("joint_names", "joint_confidences", "joint_ratios")
    confidences = to_grid(
        "Confidence in each joint. It is 0.5 if the residual is 3.5 times as large without the segment beyond it "
        "(1.5 times for the last joint)",
        zip(*(facts.get(key) or () for key in keys), strict=True) if facts.get("joint_confidences") else (),
        (texts("joint", 0), numbers("confidence", 1, 2), numbers("residual without the segment, factor", 2)),
    )

    def join(values: Iterable[Any] | None, show: Callable[[Any], str] = str) -> str:
        return ", ".join(map(show, values or ()))

    hypotheses = to_grid(
        "Segmentations considered, lowest cost first: the best chain at each level of detail for each number of "
        "segments, including the base. A missing number has no chain with valid joints, or was not searched for",
        facts.get("hypotheses") or (),
        (
            GridColumn("segments", lambda entry: str(entry.get("segments", ""))),
            numbers("cost", "cost", 1),
            texts("result", "why"),
            texts("joint residuals (mm)", lambda entry: join(entry.get("joint_residual_m"), show_millimetres)),
            texts("arcs (deg)", lambda entry: join(entry.get("arc_deg"), lambda arc: show_fixed(arc, 1))),
            texts("markers by segment", lambda entry: " | ".join(map(join, entry.get("markers") or ()))),
            texts("left out", lambda entry: join(itertools.chain.from_iterable(entry.get("left_out") or ()))),
        ),
    )
    grids = (markers, evidence, confidences, hypotheses, list_facts("Segmentation", _remove(facts, _SHOWN_OF_SEGMENTS)))
    figures = ("residuals",) if "markers.parquet" in data.artefacts else ()
    return Section("markers", "Markers and segments", grids, figures, needs="segments.parquet")
