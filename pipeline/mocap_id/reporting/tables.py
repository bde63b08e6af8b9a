"""Tables of the report of a trial, in the order of its sections."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from mocap_id.protocols.five_times import FiveTimes
from mocap_id.reporting import style
from mocap_id.reporting.grids import (
    Grid,
    GridColumn,
    get_element,
    millimetres,
    number,
    percent,
    show_ends,
    text,
    to_grid,
    with_sd,
)
from mocap_id.reporting.numbers import (
    UNKNOWN,
    scale,
    show,
    show_beside,
    show_fixed,
    show_interval,
    show_millimetres,
    show_percent,
    show_with_sd,
)
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary import summarise_curls
from mocap_id.reporting.summary_schema import (
    ChannelEntry,
    CompensationEntry,
    ImuEntry,
    JointEntry,
    RangeEntry,
    RepetitionEntry,
    Summary,
    TrendEntry,
    WorkspaceEntry,
)
from mocap_id.results import list_quantities

_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N·m", "tauy": "N·m", "tauz": "N·m"}
_IN_PLANE = ("Fx", "Fy", "tauz")


def list_joints(summary: Summary) -> Grid:
    """Return a table of the centres and arcs of the joints; in space, also of their kinds."""
    names, in_space = summary.segments.names or [], summary.space == "3d"
    moved = dict(zip([joint.name for joint in summary.joints or ()], names[1:], strict=False))
    columns = (
        text("joint", "name"),
        *([text("kind", "kind")] if in_space else []),
        text("fixed to", lambda joint: names[joint.parent] if 0 <= joint.parent < len(names) else joint.parent),
        text("moves", lambda joint: moved.get(joint.name)),
        *(_make_centre_column(k) for k in range(3 if in_space else 2)),
        number("arc (deg)", "arc_deg", 1),
        *(
            []
            if in_space
            else [text("angle is zero in", "zero"), with_sd("theta there (deg)", "zero_deg", "zero_sd_deg")]
        ),
    )
    caption = "Joint centres in the frame of the previous segment, ± one standard deviation"
    hinges = (
        ". A hinge has a centre only across its axis"
        if in_space
        else ". Last columns: pose in which the angle is zero, and the value of theta (states.parquet) in it"
    )
    return to_grid(caption + hinges, summary.joints or (), columns)


def _make_centre_column(k: int) -> GridColumn:
    """Return the column of coordinate ``k`` (0 to 2 for x to z) of the joint centres."""

    def cell(joint: JointEntry) -> str:
        if not joint.known:
            return "not determined by the motion"
        centre, sd = (None if values is None else values[k] for values in (joint.centre_m, joint.sd_m))
        return show_with_sd(centre, sd)

    return GridColumn(f"{'xyz'[k]} (m)", cell)


def list_lengths(summary: Summary) -> Grid:
    """Return a table of the segment lengths."""
    caption = "Segment lengths, joint to joint, ± one standard deviation"
    return to_grid(caption, summary.lengths_m or {}, [with_sd("length (m)", "value", "sd")], "segment")


def describe_band(data: ReportData) -> str:
    """Return in words the frequency band in which model and measurement are compared."""
    return "unfiltered" if data.low_pass is None else f"below {data.low_pass:g} Hz"


def list_model_errors(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the errors of the modelled wrench."""
    channels = summary.dynamics.wrench or {}
    named = {f"{name} ({_UNITS[name]})" if name in _UNITS else name: channel for name, channel in channels.items()}
    caption = f"Error of the model over the samples of the fit, {describe_band(data)}"
    return to_grid(caption, named, make_error_columns(4), "component")


def list_torques(summary: Summary) -> Grid:
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
        text("joint", lambda row: row[0]),
        text("torque towards", lambda row: row[2]),
        GridColumn(
            "largest (N·m)", lambda row: show_with_sd(scale(row[3], -1 if row[3] and row[3] < 0 else 1), row[4])
        ),
        GridColumn("N·m/kg", lambda row: show_fixed(None if row[5] is None else abs(row[5]), 2)),
        number("at (s)", lambda row: row[6], 2),
        text("remark", lambda row: row[1]),
    )
    legs = "both legs together, " if dynamics.legs == "both" else ""
    caption = (
        f"Largest torque of each joint in each direction ({legs}± one standard deviation), while only measured forces "
        "carry the body"
    )
    return to_grid(caption, rows, columns)


def make_error_columns(decimals: int) -> tuple[GridColumn, ...]:
    """Return the columns bias, standard deviation and r² of a channel; r² has the given number of decimals."""
    return number("bias", "bias"), number("standard deviation", "sd"), number("r²", "r2", decimals)


def list_reference_errors(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the errors of the identified model and the allometric bodies; empty without such a body."""
    dynamics = summary.dynamics
    bodies = {"identified model": dynamics, **dynamics.rivals} if dynamics.rivals else {}
    columns = (
        *_make_wrench_columns(lambda body: body.wrench or {}),
        millimetres("centre of pressure, rms (mm)", "cop_rms_m"),
    )
    caption = f"Errors of the model and of allometric bodies, {describe_band(data)}: bias ± standard deviation"
    return to_grid(caption, bodies, columns, "body")


def list_held_out_errors(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the prediction errors of the models and the reference body on left-out repetitions."""
    found = summary.dynamics.held_out
    errors: dict[str, Mapping[str, Any] | None] = {
        "models fitted without the repetition": found.model,
        "the same, unfiltered": None if data.low_pass is None else found.unfiltered,
        "model of the whole trial": found.in_sample,
        "allometric body": found.reference,
        "samples within the 95 % interval (%)": found.inside,
    }
    columns = (
        *_make_wrench_columns(lambda channels: channels),
        GridColumn("centre of pressure (mm)", lambda channels: _show_bias_and_sd(channels.get("cop_x"), 1e3)),
    )
    caption = (
        f"Prediction errors on left-out repetitions, {describe_band(data)}: bias ± standard deviation over "
        f"{found.samples} samples, {found.folds} fits for {found.repetitions} repetitions"
    )
    return to_grid(caption, {name: channels for name, channels in errors.items() if channels}, columns, "predicted by")


def _make_wrench_columns(channels: Callable[[Any], Mapping[str, Any]]) -> list[GridColumn]:
    """Return a column of errors for each component of the wrench in the plane.

    ``channels`` is a function that returns the errors of a row by component.
    """
    return [_make_error_column(part, channels) for part in _IN_PLANE]


def _make_error_column(part: str, channels: Callable[[Any], Mapping[str, Any]]) -> GridColumn:
    return GridColumn(f"{part} ({_UNITS[part]})", lambda row: _show_bias_and_sd(channels(row).get(part)))


def _show_bias_and_sd(error: ChannelEntry | float | None, factor: float = 1.0) -> str:
    """Format bias ± sd of a channel, times ``factor``; a number is formatted as a fraction of samples in per cent."""
    if not isinstance(error, ChannelEntry):
        return show_percent(error)
    if error.bias is None or error.sd is None:
        return UNKNOWN
    return f"{show(factor * error.bias)} ± {show(factor * error.sd)}"


def list_base_parameters(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the identified parameters with intervals and reference values."""
    dynamics = data.dynamics
    references = () if dynamics is None else dynamics.base_reference
    rows = zip(summary.dynamics.base or (), references, strict=False)
    columns = [
        text("parameter", lambda row: row[0].name),
        GridColumn("value ± sd", lambda row: show_with_sd(row[0].value, row[0].sd)),
        GridColumn("95 % interval", lambda row: show_interval(row[0].value, row[0].sd)),
        GridColumn("reference", lambda row: show_beside(row[1], row[0].sd)),
        text("unit", lambda row: style.format_unit(row[0].unit)),
        text("verdict", lambda row: row[0].verdict, UNKNOWN),
    ]
    if not data.measured_poses:
        return to_grid("Base parameters", rows, columns)
    columns.append(percent("share of prior (%)", lambda row: row[0].prior_share))
    return to_grid("Base parameters; the last column is the share of the loose prior in the precision", rows, columns)


def list_excitation(summary: Summary) -> Grid:
    """Return a table of how well each base parameter is excited, and of the movement that would improve this."""
    columns = (
        text("parameter", "name"),
        text("verdict", "verdict", UNKNOWN),
        percent("sd (%)", "relative_sd"),
        number("excitation", "excitation"),
        percent("own share (%)", "own_share"),
        text("movement that would help", "helps", UNKNOWN),
        GridColumn(
            "factor on the sd", lambda entry: UNKNOWN if entry.sd_ratio is None else f"× {show(entry.sd_ratio, 2)}"
        ),
    )
    caption = (
        "Excitation of each base parameter: standard deviation relative to its size; norm of the part of its regressor "
        "column that is independent of the others, in residual standard deviations per SI unit; own share of that part"
    )
    return to_grid(caption, [entry for entry in summary.dynamics.base or () if entry.excitation is not None], columns)


def list_plates(data: ReportData) -> Grid:
    """Return a table of the detected use of each force plate."""
    columns = (
        text("plate", lambda plate: str(plate.get("index", ""))),
        text("type", "kind"),
        text("use", "use"),
        number("mean vertical force (N)", "mean_vertical_N", 1),
        text("reason", "why"),
    )
    plates = data.facts("wrench.parquet").get("plates") or ()
    return to_grid("Force plates and their detected use", plates, columns)


def list_markers(data: ReportData) -> Grid:
    """Return a table of each marker: its segment, the reason for the assignment, and its prediction errors."""
    names = dict(enumerate(data.segment_names))

    def residual(name: str) -> Callable[[Mapping[str, Any]], float | None]:
        return lambda row: getattr(data.residuals.get(row["marker"]), name, None)

    columns = (
        text("marker", "marker"),
        text("segment", lambda row: "none" if row["segment"] < 0 else names.get(row["segment"], row["segment"])),
        millimetres("rigid (mm)", "residual"),
        millimetres("chain (mm)", residual("rms")),
        millimetres("95 % (mm)", residual("q95")),
        percent("visible (%)", residual("seen")),
        text("reason", "reason"),
    )
    caption = "Markers: rms distance from the rigid segment; rms and 95 % quantile of the distance from the chain"
    return to_grid(caption, data.rows("segments.parquet"), columns)


SHOWN = frozenset(
    {
        *("names", "confidence", "against", "joint_names", "joint_confidences", "joint_ratios", "hypotheses"),
        *("divisions", "bad_stretches"),
    }
)
"""Facts of ``segments.parquet`` that the table of facts omits: they are in other tables, in reasons or for programs."""

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


def list_evidence(data: ReportData) -> Grid:
    """Return a table of the evidence against the segments, strongest first; empty without a search for segments."""
    facts = data.facts("segments.parquet")
    if facts.get("against") is None:
        return Grid()
    reductions = ((off, name) for name, off in facts["against"].items() if off >= _NEGLIGIBLE)
    rows = {AGAINST.get(name, name): off for off, name in sorted(reductions, reverse=True)}
    caption = f"Probability that the segments are right: {show_fixed(facts.get('confidence'), 2)}"
    columns = (
        GridColumn("reduction of the log odds", lambda off: show_fixed(off, 3) if off else "0"),
        GridColumn("factor on the odds", lambda off: show_fixed(np.exp(off), 2) if off else "1"),
    )
    return to_grid(caption, rows or {"none": 0.0}, columns, "evidence against the segments")


def list_joint_confidences(data: ReportData) -> Grid:
    """Return a table of the confidence in each joint, and how much worse the fit is without the segment beyond it."""
    facts = data.facts("segments.parquet")
    if not facts.get("joint_confidences"):  # segments of a calibration are not searched for
        return Grid()
    keys = ("joint_names", "joint_confidences", "joint_ratios")
    columns = (
        text("joint", lambda row: row[0]),
        number("confidence", lambda row: row[1], 2),
        number("residual without the segment, factor", lambda row: row[2]),
    )
    caption = (
        "Confidence in each joint. It is 0.5 if the residual is 3.5 times as large without the segment beyond it "
        "(1.5 times for the last joint)"
    )
    return to_grid(caption, zip(*(facts.get(key) or () for key in keys), strict=True), columns)


def list_hypotheses(data: ReportData) -> Grid:
    """Return a table of the segmentations that were considered, and why they were rejected."""
    columns = (
        GridColumn("segments", lambda entry: str(entry.get("segments", ""))),
        number("cost", "cost", 1),
        text("result", "why"),
        text("joint residuals (mm)", lambda entry: _join(entry.get("joint_residual_m"), show_millimetres)),
        text("arcs (deg)", lambda entry: _join(entry.get("arc_deg"), lambda arc: show_fixed(arc, 1))),
        text("markers by segment", lambda entry: " | ".join(map(_join, entry.get("markers") or ()))),
        text("left out", lambda entry: _join(itertools.chain.from_iterable(entry.get("left_out") or ()))),
    )
    caption = (
        "Segmentations considered, lowest cost first: the best chain at each level of detail for each number of "
        "segments, including the base. A missing number has no chain with valid joints, or was not searched for"
    )
    return to_grid(caption, data.facts("segments.parquet").get("hypotheses") or (), columns)


def _join(values: Iterable[Any] | None, show: Callable[[Any], str] = str) -> str:
    return ", ".join(map(show, values or ()))


def list_repetitions(summary: Summary) -> Grid:
    """Return a table of the events of each repetition."""
    columns = (
        number("start (s)", "start_s", 2),
        number("seat-off (s)", "seat_off_s", 2),
        number("standing (s)", "stand_s", 2),
        number("seat-on (s)", "seat_on_s", 2),
        number("end (s)", "end_s", 2),
        text("complete", lambda entry: "yes" if entry.complete else "no"),
        text("remark", lambda entry: entry.remark or ("" if entry.complete else entry.why)),
    )
    caption = "Events of each repetition, on the clock of the recording"
    return to_grid(caption, summary.repetitions or (), columns, "repetition")


def list_seat_off_times(summary: Summary) -> Grid:
    """Return a table of the rises: seat-off by each rule, height, pauses, failed attempts and unexplained force.

    The table is empty if no rise has a known height.
    """
    columns = (
        number("seat-off (s)", "seat_off_s", 3),
        _make_delay_column("model agreement (s)", "seat_off_model_s"),
        _make_delay_column("72 % of weight (s)", "seat_off_72_s"),
        percent("height (%)", "reached"),
        number("paused (s)", "held_s", 1),
        number("failed attempts", "attempts", 0),
        percent("unexplained force (% of weight)", "support"),
    )
    caption = (
        "Each rise: seat-off (zero chair force), time from it to seat-off by the two rules of the thesis, greatest hip "
        "height as a share of the rise, time in pauses, failed attempts before it, and unexplained vertical force"
    )
    entries = summary.repetitions or []
    has_rises = any(entry.reached is not None for entry in entries)
    return to_grid(caption, entries if has_rises else (), columns, "repetition")


def _make_delay_column(head: str, name: str) -> GridColumn:
    """Return the column of the time from seat-off to the seat-off by a different rule, in the attribute ``name``."""

    def cell(entry: RepetitionEntry) -> str:
        other = getattr(entry, name)
        return UNKNOWN if other is None or entry.seat_off_s is None else show_fixed(other - entry.seat_off_s, 3)

    return GridColumn(head, cell)


def list_attempts(summary: Summary) -> Grid:
    """Return a table of the failed attempts to rise."""
    columns = (
        number("time (s)", "time_s", 2),
        percent("hip height (% of the rise)", "height"),
        percent("unloading of the chair (% of its load)", "unloaded"),
    )
    return to_grid("Failed attempts to rise", summary.attempts or (), columns)


def list_test_times(summary: Summary) -> Grid:
    """Return a table of the times of the five-times sit-to-stand test; empty for other protocols."""
    found = summary.five_times
    if found.repetitions is None:
        return Grid()
    rows = {}
    for name, quantity in sorted(list_quantities(FiveTimes), key=lambda named: not named[1].unit):  # times, then counts
        value = getattr(found, name)
        if quantity.unit:
            sd = getattr(found, quantity.sd) if quantity.sd else None
            rows[f"{quantity.label} ({quantity.unit})"] = _show_time(value, sd)
        elif name == "repetitions" or value:
            rows[quantity.label] = str(value)
    rows["why unknown"] = found.why or ""
    caption = (
        "Five-times sit-to-stand test by both stop rules, from the start of the first rise, ± one standard deviation "
        "of the measurement (of the cycle: over the cycles). A stopwatch, which starts at the command, shows longer "
        "times"
    )
    return to_grid(caption, {name: value for name, value in rows.items() if value}, [text("value", str)], "quantity")


def _show_time(seconds: float | None, sd: float | None) -> str:
    """Format a time in s with its standard deviation; the latter is omitted if it is unknown."""
    shown = show_fixed(seconds, 2)
    if seconds is None or sd is None:
        return shown
    return f"{shown} ± {show_fixed(sd, 2)}" if sd >= 0.02 else f"{show_fixed(seconds, 3)} ± {show_fixed(sd, 3)}"


def list_published_times(summary: Summary) -> Grid:
    """Return a table of published test times for comparison; empty if the trial has no time to the fifth stand."""
    columns = (
        GridColumn("longer than (s)", lambda one: f"{one.limit_s:g}"),
        text("group", "people"),
        text("meaning", "meaning"),
        text("stop rule", "stop"),
        text("source", "source"),
    )
    caption = (
        "Published times, for context and not for diagnosis. The sources differ in chair, instruction and stop rule, "
        "and a motion-capture trial is not a clinical test"
    )
    found = summary.five_times
    return to_grid(caption, found.published if found.to_fifth_stand_s is not None else (), columns)


def list_load_shares(summary: Summary) -> Grid:
    """Return a table of the fractions of the load on the left and the right foot, by phase; empty if unknown."""
    found = summary.load_share
    columns = (
        percent("left (%)", "mean"),
        percent("standard deviation (%)", "sd"),
        percent("right (%)", lambda spread: 1.0 - spread.mean),
    )
    caption = f"Load shares of the feet; left foot on plate {found.left_plate}, right foot on plate {found.right_plate}"
    known_phases = {phase: spread for phase, spread in found.left.items() if spread.mean is not None}
    return to_grid(caption, known_phases, columns, "phase")


def list_agreement(data: ReportData) -> Grid:
    """Return a table of the agreement with the angles of another system."""
    columns = (
        text("joint", "joint"),
        text("column", "column"),
        number("r", "r", 4),
        number("mean difference (deg)", "offset_rad", 2, 180 / np.pi),
        number("rms without it (deg)", "rmse_rad", 2, 180 / np.pi),
        GridColumn("samples", lambda one: str(one.get("samples", ""))),
        text("remark", "why"),
    )
    caption = (
        "Agreement of theta (zero on the segment lines) with the angles of another system. A negative r means the "
        "opposite sense; a minus sign before the column name in `compare:` corrects it"
    )
    return to_grid(caption, data.facts("phases.parquet").get("compared") or (), columns)


_KINDS = ("ball", "two-axis", "hinge")
_AXES = "xyz"


def to_words(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries with underscores in their keys replaced by blanks."""
    return {name.replace("_", " "): entry for name, entry in entries.items()}


def list_glides(summary: Summary) -> Grid:
    """Return a table of the shifts of joint centres that depend on the elevation; empty if no joint has one."""
    shifts = (
        with_sd(f"{axis} (mm)", get_element("glide_m", k), get_element("glide_sd_m", k), 1e3)
        for k, axis in enumerate(_AXES)
    )
    caption = "Glide: shift of the joint centre at an elevation of 180°, in the frame of the previous segment"
    rows = [joint for joint in summary.joints or () if joint.glide_m]
    return to_grid(caption, rows, (text("joint", "name"), *shifts))


def list_axes(summary: Summary) -> Grid:
    """Return a table of the axes of hinges and two-axis joints."""
    rows = []
    for joint in summary.joints or ():
        listed = joint.axis if joint.axis and isinstance(joint.axis[0], list) else [joint.axis] if joint.axis else []
        sds = [*joint.axis_sd_deg, None, None]
        rows += [(joint.name, k, axis, sds[k]) for k, axis in enumerate(listed)]
    columns = (
        text("joint", lambda row: row[0]),
        GridColumn("axis", lambda row: str(row[1] + 1)),
        text("in the frame of the", lambda row: "own segment" if row[1] else "previous segment"),
        *(number(axis, get_element(lambda row: row[2], d), 3) for d, axis in enumerate(_AXES)),
        number("sd (deg)", lambda row: row[3], 1),
    )
    return to_grid("Axes of hinges and two-axis joints", rows, columns)


def list_kinds(summary: Summary) -> Grid:
    """Return a table of the evidence for the kind (ball, two-axis, hinge) of each joint."""
    columns = (
        text("joint", "name"),
        text("kind", "kind"),
        *(number(kind, get_element("evidence", kind), 2) for kind in _KINDS),
    )
    caption = (
        "Kinds of the joints: rotation that each kind leaves unexplained, as a multiple of the noise of the markers. "
        "The simplest kind with a small multiple is chosen; a ball joint explains every rotation"
    )
    return to_grid(caption, [joint for joint in summary.joints or () if joint.evidence], columns)


def list_angles(summary: Summary) -> Grid:
    """Return a table of each angle: range, interval, standard deviations, and percentage of usable samples."""
    columns = (
        number("lowest (deg)", "low_deg", 1),
        number("highest (deg)", "high_deg", 1),
        number("range (deg)", "range_deg", 1),
        GridColumn("95 % interval of the range (deg)", lambda entry: show_ends(entry.interval_deg, 1)),
        number("sd of changes (deg)", "sd_deg", 2),
        number("sd of a constant error (deg)", "constant_sd_deg", 1),
        percent("samples used (%)", "used_share"),
    )
    caption = (
        "Angles. Plane and axial rotation of the shoulder are evaluated only where the elevation is more than 15° from "
        "0 and 180°. The interval of the range contains both standard deviations"
    )
    return to_grid(caption, to_words(summary.angles), columns, "angle")


def list_imus(summary: Summary) -> Grid:
    """Return a table of clock, bias, position and residuals of each inertial sensor."""

    def bias(entry: ImuEntry) -> float | None:
        return None if entry.gyro_bias_rad_s is None else math.degrees(math.hypot(*entry.gyro_bias_rad_s))

    columns = (
        text("used", lambda entry: "yes" if entry.used else f"no: {entry.why}"),
        with_sd("clock offset (ms)", "clock_offset_s", "sd_s", 1e3),
        text("determined by the motion", lambda entry: "yes" if entry.observable else "no"),
        number("clock drift (ppm)", "ppm", 0),
        number("gyroscope bias (deg/s)", bias, 2),
        GridColumn("position (mm)", lambda entry: ", ".join(map(show_millimetres, entry.position_m or [None] * 3))),
        number("sd of mounting (deg)", "mounting_sd_deg", 1),
        number("fraction of axial rotation that the skin does not follow", "skin_share", 2),
        number("gyroscope against markers (rad/s)", "gyro_residual_rad_s", 3),
        number("accelerometer against markers (m/s²)", "acc_residual_m_s2", 2),
    )
    caption = "Inertial sensors: clock relative to the cameras, and other quantities estimated from the motion"
    return to_grid(caption, to_words(summary.imus), columns, "segment")


def list_landmarks(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the landmarks with their standard deviations, and the residuals of their markers."""
    labels = dict(part.split(" ", 1) for part in data.settings.get("landmarks", "").split(", ") if " " in part)
    residuals = {name: data.residuals.get(labels.get(name, name)) for name in summary.landmarks}
    columns = (
        text("landmark", lambda row: row[0]),
        text("segment", lambda row: row[1].segment),
        *(millimetres(f"{axis} (mm)", get_element(lambda row: row[1].local_m, d)) for d, axis in enumerate(_AXES)),
        millimetres("sd (mm)", lambda row: row[1].sd_m),
        millimetres("residual of its marker, rms (mm)", lambda row: getattr(residuals[row[0]], "rms", None)),
    )
    caption = "Anatomical landmarks in the frames of their segments. The residual is the rms distance from the chain"
    return to_grid(caption, list(summary.landmarks.items()), columns)


_FILE = "events.parquet"


def list_curls(data: ReportData) -> Grid:
    """Return a table with a row for every curl and every failed attempt; empty for other protocols."""
    facts = data.facts(_FILE).get("curl") or {}
    rows = data.rows(_FILE) if facts else []
    columns = (
        number("start (s)", lambda row: row[0]["start"], 2),
        number("top (s)", lambda row: row[0]["top"], 2),
        number("end (s)", lambda row: row[0]["end"], 2),
        number("rise of the flexion (deg)", lambda row: row[0]["amplitude"], 0, 180 / np.pi),
        text("complete", lambda row: "yes" if row[0]["complete"] else f"no: {row[0]['why']}"),
        GridColumn("largest torque (N·m)", lambda row: _show_peak(row[1], "")),
        GridColumn("of the person (N·m)", lambda row: _show_peak(row[1], "person_")),
    )
    end = facts.get("end") or {}
    caption = "Curls, with the largest torque about the elbow's axis ± one standard deviation"
    if end.get("rule") not in {None, "recording"}:
        caption += f". The trial ends at {end['time_s']:.1f} s ({end['rule']}): {end['why']}"
    torques = facts.get("torque") or [None] * len(rows)
    return to_grid(caption, zip(rows, torques, strict=True), columns)


def _show_peak(torque: Mapping[str, Any] | None, who: str) -> str:
    if torque is None or torque.get(f"{who}peak_Nm") is None:
        return UNKNOWN
    return f"{torque[f'{who}peak_Nm']:.1f} ± {torque[f'{who}sd_Nm']:.1f}"


def list_compensation(data: ReportData) -> Grid:
    """Return a table of the ranges of every angle that should not change, and the range that errors alone can cause."""
    entry = summarise_curls(data)
    rows = {
        name: (found, entry.fatigue.get(f"{name}_range_rad"))
        for name, found in entry.compensation.items()
        if _remove_missing(found.range_deg)
    }
    columns = (
        number("mean range (deg)", lambda row: np.mean(_remove_missing(row[0].range_deg)), 1),
        number("largest range (deg)", lambda row: max(_remove_missing(row[0].range_deg)), 1),
        number("range by errors alone (deg)", lambda row: np.mean(_remove_missing(row[0].floor_deg)), 1),
        GridColumn("change per curl, 95 % interval (deg)", lambda row: _show_change(row[1])),
        GridColumn("curls with a sustained compensation", lambda row: str(sum(1 for one in row[0].sustained_s if one))),
        GridColumn("excluded part that follows the flexion, 95 % interval (deg)", lambda row: _show_in_step(row[0])),
    )
    caption = (
        "Compensation: range of each angle within a curl. If it is below the range by errors alone, the angle may not "
        "move at all. Axial rotation excludes the part that follows the flexion in the first curl, because an error of "
        "the elbow's axis has the same effect"
    )
    return to_grid(caption, to_words(rows), columns, "angle")


def _remove_missing(values: list[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _show_change(trend: TrendEntry | None) -> str:
    """Format the change per curl, degrees, with its interval; return a dash if it is unknown."""
    if trend is None:
        return UNKNOWN
    slope, low, high = np.degrees([trend.slope, *trend.interval])
    return f"{slope:+.2f} ({low:+.2f} … {high:+.2f})"


def _show_in_step(found: CompensationEntry) -> str:
    if found.in_step_deg is None or found.in_step_interval_deg is None:
        return UNKNOWN
    low, high = found.in_step_interval_deg
    return f"{found.in_step_deg:.1f} ({low:.1f} … {high:.1f})"


_SETS = {"box": "box of independent limits", "visited": "visited region"}


def describe_volume(found: WorkspaceEntry) -> tuple[str, ...]:
    """Return sentences on the meaning of the volumes, or on why the volume is unknown; may be empty."""
    if found.volume_m3 is None:
        return (f"The reachable volume is unknown: {found.why}.",)
    return () if found.visited is None else (found.visited.meaning,)


def list_volumes(found: WorkspaceEntry) -> Grid:
    """Return a table of the volume in both sets of angles: interval, fraction of a sphere, and convergence."""
    share = {"box": found.relative_volume}
    columns = (
        text("set", lambda row: _SETS[row[0]]),
        number("volume (m³)", lambda row: row[1].volume_m3, 4),
        GridColumn("95 % interval (m³)", lambda row: show_ends(row[1].interval_m3, 4)),
        number("fraction of a sphere with the arm's length as radius", lambda row: share.get(row[0]), 3),
        GridColumn(
            "volume on finer and finer grids (m³)",
            lambda row: ", ".join(show_fixed(volume, 4) for volume in row[1].convergence_m3 or ()),
        ),
    )
    sets = (("box", found), ("visited", found.visited))
    rows = [row for row in sets if row[1] is not None and row[1].volume_m3 is not None]
    return to_grid("Volume that the wrist can reach", rows, columns)


def list_ranges(found: WorkspaceEntry) -> Grid:
    """Return a table of the range of every angle, and of its contribution to the variance of the volume."""

    def share(row: tuple[str, RangeEntry]) -> float | None:
        parts = [share for key, share in (found.sources or {}).items() if key.startswith(row[0])]
        return sum(parts) if parts else None

    columns = (
        text("angle", lambda row: row[0].replace("_", " ")),
        number("lowest (deg)", lambda row: row[1].low_deg, 1),
        number("highest (deg)", lambda row: row[1].high_deg, 1),
        number("range (deg)", lambda row: row[1].range_deg, 1),
        GridColumn("95 % interval of the range (deg)", lambda row: show_ends(row[1].interval_deg, 1)),
        percent("samples used (%)", lambda row: row[1].used_share),
        percent("contribution to the variance of the volume (%)", share),
    )
    caption = "Ranges, robust against single samples: the angle is beyond each end for 0.05 s in total"
    return to_grid(caption, (found.ranges or {}).items(), columns)


def list_areas(found: WorkspaceEntry) -> Grid:
    """Return a table of the relative area of the surface of furthest reach, by quadrants."""
    names = ("total", "upper_medial", "upper_lateral", "lower_medial", "lower_lateral", "behind")
    caption = (
        "Relative area of the furthest reach about the shoulder. In front, 1 is half a sphere of the arm's length and "
        "0.25 a full quadrant; medial is towards the other arm"
    )
    rows = {_SETS.get(name, name): one for name, one in (found.surface or {}).items()}
    return to_grid(caption, rows, [number(name.replace("_", " "), name, 3) for name in names], "set")


def list_heights(found: WorkspaceEntry) -> Grid:
    """Return a table of the heights that wrist and hand reached; empty if they are unknown."""
    one = found.heights
    if one is None:
        return Grid()
    rows = {
        "wrist, highest": (show_millimetres(one.highest_m), show_fixed(one.highest_share, 2)),
        "wrist, lowest": (show_millimetres(one.lowest_m), show_fixed(one.lowest_share, 2)),
    }
    for name, reached in one.levels.items():
        level = "an overhead shelf" if name == "overhead" else f"the {name}"
        rows[f"hand at the height of {level}"] = (UNKNOWN if reached is None else "yes" if reached else "no", "")
    columns = (
        GridColumn("height (mm)", lambda row: row[0]),
        GridColumn("fraction of the arm's length", lambda row: row[1]),
    )
    return to_grid("Heights above the shoulder, along the thorax", rows, columns, "level")


def list_targets(found: WorkspaceEntry) -> Grid:
    """Return a table of the number of reaches to each part of the body, and the distances by which they missed it."""
    columns = (
        number("reaches", "count", 0),
        millimetres("smallest miss (mm)", "best_miss_m"),
        millimetres("median miss (mm)", "median_miss_m"),
    )
    caption = "Targets: part of the body nearest to the resting hand; positions from tables of proportions, ± 3 cm"
    return to_grid(caption, to_words(found.tasks or {}), columns, "target")


def list_reaches(data: ReportData) -> Grid:
    """Return a table with a row for every reach."""
    columns = (
        number("start (s)", "start", 2),
        number("held (s)", "top", 2),
        number("end (s)", "end", 2),
        text("target", lambda row: row["target"].replace("_", " ")),
        number("missed by (mm)", "miss_m", factor=1e3),
        text("complete", lambda row: "yes" if row["complete"] else f"no: {row['why']}"),
    )
    return to_grid("Reaches", [row for row in data.rows(_FILE) if "target" in row], columns)


_COMPARED = {
    "theta": "angle, cameras (rad)",
    "dtheta": "velocity, cameras (rad/s)",
    "ddtheta": "acceleration, cameras (rad/s²)",
}


def list_encoder_errors(summary: Summary) -> Grid:
    """Return a table of the errors of cameras and model against the encoder; empty without an encoder."""
    found = summary.encoder
    if found.clock_offset_s is None or found.clock_offset_sd_s is None:
        return Grid()
    errors = {name: (found.camera or {}).get(key) for key, name in _COMPARED.items()}
    errors["torque, identified model (N·m)"] = found.torque
    clock = f"{1e3 * found.clock_offset_s:.2f} ± {1e3 * found.clock_offset_sd_s:.2f} ms"
    sense = "the same" if found.sign == 1 else "the opposite"
    caption = f"Error against the encoder ({sense} sense as the plane; clock {clock} after the cameras')"
    known_errors = {name: error for name, error in errors.items() if error is not None}
    return to_grid(caption, known_errors, make_error_columns(5), "quantity")
