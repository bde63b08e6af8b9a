"""Tables of the report of a trial, by the sections that show them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from mocap_id.protocols.five_times import Attempt, FiveTimes
from mocap_id.reporting import style
from mocap_id.reporting.grids import (
    UNKNOWN,
    Grid,
    GridColumn,
    columns_of,
    get_element,
    millimetres,
    numbers,
    percent,
    scale,
    show,
    show_beside,
    show_ends,
    show_fixed,
    show_interval,
    show_millimetres,
    show_percent,
    show_with_sd,
    texts,
    to_grid,
    with_sd,
)
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import (
    AngleEntry,
    BaseEntry,
    ChannelEntry,
    ImuEntry,
    JointEntry,
    RangeEntry,
    RepetitionEntry,
    Summary,
    TargetEntry,
)
from mocap_id.results import list_quantities

_EVENTS = "events.parquet"
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N·m", "tauy": "N·m", "tauz": "N·m"}
_IN_PLANE = ("Fx", "Fy", "tauz")
_AXES = "xyz"
_ERRORS = (numbers("bias", "bias"), numbers("standard deviation", "sd"))  # of a channel


def describe_band(data: ReportData) -> str:
    """Return in words the frequency band in which model and measurement are compared."""
    return "unfiltered" if data.low_pass is None else f"below {data.low_pass:g} Hz"


def to_words(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries with underscores in their keys replaced by blanks."""
    return {name.replace("_", " "): entry for name, entry in entries.items()}


def list_chain(summary: Summary) -> tuple[Grid, ...]:
    """Return the tables of joints and lengths; in space, also of glides, axes and kinds of the joints."""
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
    of_joints = to_grid(
        "Joint centres in the frame of the previous segment, ± one standard deviation" + notes,
        joints,
        (
            texts("joint", "name"),
            *([texts("kind", "kind")] if in_space else []),
            texts("fixed to", lambda joint: names[joint.parent] if 0 <= joint.parent < len(names) else joint.parent),
            texts("moves", lambda joint: moved.get(joint.name)),
            *(GridColumn(f"{_AXES[k]} (m)", partial(centre, k=k)) for k in range(3 if in_space else 2)),
            numbers("arc (deg)", "arc_deg", 1),
            *(() if in_space else zeros),
        ),
    )
    of_lengths = to_grid(
        "Segment lengths, joint to joint, ± one standard deviation",
        summary.lengths_m or {},
        [with_sd("length (m)", "value", "sd")],
        "segment",
    )
    if not in_space:
        return of_joints, of_lengths
    glides = to_grid(
        "Glide: shift of the joint centre at an elevation of 180°, in the frame of the previous segment",
        [joint for joint in joints if joint.glide_m],
        (
            texts("joint", "name"),
            *(
                with_sd(f"{axis} (mm)", get_element("glide_m", k), get_element("glide_sd_m", k), 1e3)
                for k, axis in enumerate(_AXES)
            ),
        ),
    )
    rows = []
    for joint in joints:
        listed = joint.axis if joint.axis and isinstance(joint.axis[0], list) else [joint.axis] if joint.axis else []
        sds = [*joint.axis_sd_deg, None, None]
        rows += [(joint.name, k, axis, sds[k]) for k, axis in enumerate(listed)]
    axes = to_grid(
        "Axes of hinges and two-axis joints",
        rows,
        (
            texts("joint", lambda row: row[0]),
            GridColumn("axis", lambda row: str(row[1] + 1)),
            texts("in the frame of the", lambda row: "own segment" if row[1] else "previous segment"),
            *(numbers(axis, get_element(lambda row: row[2], d), 3) for d, axis in enumerate(_AXES)),
            numbers("sd (deg)", lambda row: row[3], 1),
        ),
    )
    kinds = to_grid(
        "Kinds of the joints: rotation that each kind leaves unexplained, as a multiple of the noise of the markers. "
        "The simplest kind with a small multiple is chosen; a ball joint explains every rotation",
        [joint for joint in joints if joint.evidence],
        (
            texts("joint", "name"),
            texts("kind", "kind"),
            *(numbers(kind, get_element("evidence", kind), 2) for kind in ("ball", "two-axis", "hinge")),
        ),
    )
    return of_joints, glides, axes, kinds, of_lengths


def list_encoder_errors(summary: Summary) -> Grid:
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
    return to_grid(caption, known_errors, (*_ERRORS, numbers("r²", "r2", 5)), "quantity")


def list_imus(summary: Summary) -> Grid:
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


def list_repetitions(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return the tables of repetitions, rises, failed attempts, test times, load shares and agreement of angles."""
    entries = summary.repetitions or []
    events = to_grid(
        "Events of each repetition, on the clock of the recording",
        entries,
        (
            *columns_of(RepetitionEntry, "start_s seat_off_s stand_s seat_on_s end_s"),
            texts("complete", lambda entry: "yes" if entry.complete else "no"),
            texts("remark", lambda entry: entry.remark or ("" if entry.complete else entry.why)),
        ),
        "repetition",
    )

    def delay(entry: RepetitionEntry, name: str) -> str:
        """Format the time from seat-off to the seat-off by a different rule, in the attribute ``name``."""
        other = getattr(entry, name)
        return UNKNOWN if other is None or entry.seat_off_s is None else show_fixed(other - entry.seat_off_s, 3)

    rises = to_grid(
        "Each rise: seat-off (zero chair force), time from it to seat-off by the two rules of the thesis, greatest hip "
        "height as a share of the rise, time in pauses, failed attempts before it, and unexplained vertical force",
        entries if any(entry.reached is not None for entry in entries) else (),
        (
            numbers("seat-off (s)", "seat_off_s", 3),
            GridColumn("model agreement (s)", partial(delay, name="seat_off_model_s")),
            GridColumn("72 % of weight (s)", partial(delay, name="seat_off_72_s")),
            *columns_of(RepetitionEntry, "reached held_s attempts support"),
        ),
        "repetition",
    )
    found = summary.load_share
    shares = to_grid(
        f"Load shares of the feet; left foot on plate {found.left_plate}, right foot on plate {found.right_plate}",
        {phase: spread for phase, spread in found.left.items() if spread.mean is not None},
        (
            percent("left (%)", "mean"),
            percent("standard deviation (%)", "sd"),
            percent("right (%)", lambda spread: 1.0 - spread.mean),
        ),
        "phase",
    )
    agreement = to_grid(
        "Agreement of theta (zero on the segment lines) with the angles of another system. A negative r means the "
        "opposite sense; a minus sign before the column name in `compare:` corrects it",
        data.facts("phases.parquet").get("compared") or (),
        (
            texts("joint", "joint"),
            texts("column", "column"),
            numbers("r", "r", 4),
            numbers("mean difference (deg)", "offset_rad", 2, 180 / np.pi),
            numbers("rms without it (deg)", "rmse_rad", 2, 180 / np.pi),
            GridColumn("samples", lambda one: str(one.get("samples", ""))),
            texts("remark", "why"),
        ),
    )
    attempts = to_grid("Failed attempts to rise", summary.attempts or (), columns_of(Attempt))
    return events, rises, attempts, *_list_test_times(summary), shares, agreement


def _list_test_times(summary: Summary) -> tuple[Grid, Grid]:
    """Return tables of the times of the five-times test and of published times; empty for other protocols."""
    found = summary.five_times
    if found.repetitions is None:
        return Grid(), Grid()
    rows = {}
    for name, quantity in sorted(list_quantities(FiveTimes), key=lambda named: not named[1].unit):  # times, then counts
        value = getattr(found, name)
        if quantity.unit:
            sd = getattr(found, quantity.sd) if quantity.sd else None
            decimals = 2 if value is None or sd is None or sd >= 0.02 else 3
            spread = "" if value is None or sd is None else f" ± {show_fixed(sd, decimals)}"
            rows[f"{quantity.label} ({quantity.unit})"] = show_fixed(value, decimals) + spread
        elif name == "repetitions" or value:
            rows[quantity.label] = str(value)
    rows["why unknown"] = found.why or ""
    times = to_grid(
        "Five-times sit-to-stand test by both stop rules, from the start of the first rise, ± one standard deviation "
        "of the measurement (of the cycle: over the cycles). A stopwatch, which starts at the command, shows longer "
        "times",
        {name: value for name, value in rows.items() if value},
        [texts("value", str)],
        "quantity",
    )
    published = to_grid(
        "Published times, for context and not for diagnosis. The sources differ in chair, instruction and stop rule, "
        "and a motion-capture trial is not a clinical test",
        found.published if found.to_fifth_stand_s is not None else (),
        (
            GridColumn("longer than (s)", lambda one: f"{one.limit_s:g}"),
            texts("group", "people"),
            texts("meaning", "meaning"),
            texts("stop rule", "stop"),
            texts("source", "source"),
        ),
    )
    return times, published


def list_wrench_errors(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return tables of the errors of the modelled wrench: over the fit, on left-out repetitions, of other bodies."""
    dynamics, band = summary.dynamics, describe_band(data)
    channels = dynamics.wrench or {}
    named = {f"{name} ({_UNITS[name]})" if name in _UNITS else name: channel for name, channel in channels.items()}
    caption = f"Error of the model over the samples of the fit, {band}"
    of_model = to_grid(caption, named, (*_ERRORS, numbers("r²", "r2", 4)), "component")

    def error(channels: Mapping[str, Any], part: str, factor: float = 1.0) -> str:
        """Format bias ± sd of a component, times ``factor``; a number is a fraction of samples, in per cent."""
        found = channels.get(part)
        if not isinstance(found, ChannelEntry):
            return show_percent(found)
        if found.bias is None or found.sd is None:
            return UNKNOWN
        return f"{show(factor * found.bias)} ± {show(factor * found.sd)}"

    components = [GridColumn(f"{part} ({_UNITS[part]})", partial(error, part=part)) for part in _IN_PLANE]
    found = dynamics.held_out
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
    return of_model, held_out, references


def list_plates(data: ReportData) -> Grid:
    """Return a table of the detected use of each force plate."""
    columns = (
        texts("plate", lambda plate: str(plate.get("index", ""))),
        texts("type", "kind"),
        texts("use", "use"),
        numbers("mean vertical force (N)", "mean_vertical_N", 1),
        texts("reason", "why"),
    )
    plates = data.facts("wrench.parquet").get("plates") or ()
    return to_grid("Force plates and their detected use", plates, columns)


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
        texts("joint", lambda row: row[0]),
        texts("torque towards", lambda row: row[2]),
        GridColumn(
            "largest (N·m)", lambda row: show_with_sd(scale(row[3], -1 if row[3] and row[3] < 0 else 1), row[4])
        ),
        GridColumn("N·m/kg", lambda row: show_fixed(None if row[5] is None else abs(row[5]), 2)),
        numbers("at (s)", lambda row: row[6], 2),
        texts("remark", lambda row: row[1]),
    )
    legs = "both legs together, " if dynamics.legs == "both" else ""
    caption = (
        f"Largest torque of each joint in each direction ({legs}± one standard deviation), while only measured forces "
        "carry the body"
    )
    return to_grid(caption, rows, columns)


def list_parameters(data: ReportData, summary: Summary) -> tuple[Grid, Grid]:
    """Return tables of the parameters with intervals and references, and of how well each of them is excited."""
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
    return to_grid(caption, rows, columns), excitation


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


def list_markers(data: ReportData) -> tuple[Grid, ...]:
    """Return the tables of markers, evidence against the segments, confidence in the joints, and segmentations.

    The evidence is empty without a search for segments, as for the segments of a calibration.
    """
    facts, names = data.facts("segments.parquet"), dict(enumerate(data.segment_names))

    def residual(name: str) -> Callable[[Mapping[str, Any]], float | None]:
        return lambda row: getattr(data.residuals.get(row["marker"]), name, None)

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
        (
            texts("joint", lambda row: row[0]),
            numbers("confidence", lambda row: row[1], 2),
            numbers("residual without the segment, factor", lambda row: row[2]),
        ),
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
    return markers, evidence, confidences, hypotheses


def list_angles(summary: Summary) -> Grid:
    """Return a table of each angle: range, interval, standard deviations, and percentage of usable samples."""
    caption = (
        "Angles. Plane and axial rotation of the shoulder are evaluated only where the elevation is more than 15° from "
        "0 and 180°. The interval of the range contains both standard deviations"
    )
    return to_grid(caption, to_words(summary.angles), columns_of(AngleEntry), "angle")


def list_landmarks(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the landmarks with their standard deviations, and the residuals of their markers."""
    labels = dict(part.split(" ", 1) for part in data.settings.get("landmarks", "").split(", ") if " " in part)
    residuals = {name: data.residuals.get(labels.get(name, name)) for name in summary.landmarks}
    columns = (
        texts("landmark", lambda row: row[0]),
        texts("segment", lambda row: row[1].segment),
        *(millimetres(f"{axis} (mm)", get_element(lambda row: row[1].local_m, d)) for d, axis in enumerate(_AXES)),
        millimetres("sd (mm)", lambda row: row[1].sd_m),
        millimetres("residual of its marker, rms (mm)", lambda row: getattr(residuals[row[0]], "rms", None)),
    )
    caption = "Anatomical landmarks in the frames of their segments. The residual is the rms distance from the chain"
    return to_grid(caption, list(summary.landmarks.items()), columns)


def list_curls(data: ReportData, summary: Summary) -> tuple[Grid, Grid]:
    """Return tables of every curl and failed attempt, and of the angles that should not change in curls."""
    facts, rows = data.facts(_EVENTS)["curl"], data.rows(_EVENTS)

    def peak(row: tuple[Any, Mapping[str, Any] | None], who: str) -> str:
        torque = row[1]
        if torque is None or torque.get(f"{who}peak_Nm") is None:
            return UNKNOWN
        return f"{torque[f'{who}peak_Nm']:.1f} ± {torque[f'{who}sd_Nm']:.1f}"

    end = facts.get("end") or {}
    caption = "Curls, with the largest torque about the elbow's axis ± one standard deviation"
    if end.get("rule") not in {None, "recording"}:
        caption += f". The trial ends at {end['time_s']:.1f} s ({end['rule']}): {end['why']}"
    curls = to_grid(
        caption,
        zip(rows, facts.get("torque") or [None] * len(rows), strict=True),
        (
            numbers("start (s)", lambda row: row[0]["start"], 2),
            numbers("top (s)", lambda row: row[0]["top"], 2),
            numbers("end (s)", lambda row: row[0]["end"], 2),
            numbers("rise of the flexion (deg)", lambda row: row[0]["amplitude"], 0, 180 / np.pi),
            texts("complete", lambda row: "yes" if row[0]["complete"] else f"no: {row[0]['why']}"),
            GridColumn("largest torque (N·m)", partial(peak, who="")),
            GridColumn("of the person (N·m)", partial(peak, who="person_")),
        ),
    )
    compared = {}
    for name, found in summary.curls.compensation.items():
        ranges = [value for value in found.range_deg if value is not None]
        if not ranges:
            continue
        trend, change, in_step = summary.curls.fatigue.get(f"{name}_range_rad"), UNKNOWN, UNKNOWN
        if trend is not None:
            slope, low, high = np.degrees([trend.slope, *trend.interval])
            change = f"{slope:+.2f} ({low:+.2f} … {high:+.2f})"
        if found.in_step_deg is not None and found.in_step_interval_deg is not None:
            low, high = found.in_step_interval_deg
            in_step = f"{found.in_step_deg:.1f} ({low:.1f} … {high:.1f})"
        compared[name] = {
            "mean": np.mean(ranges),
            "largest": max(ranges),
            "errors": np.mean([value for value in found.floor_deg if value is not None]),
            "change": change,
            "sustained": str(sum(1 for one in found.sustained_s if one)),
            "in step": in_step,
        }
    compensation = to_grid(
        "Compensation: range of each angle within a curl. If it is below the range by errors alone, the angle may not "
        "move at all. Axial rotation excludes the part that follows the flexion in the first curl, because an error of "
        "the elbow's axis has the same effect",
        to_words(compared),
        (
            numbers("mean range (deg)", "mean", 1),
            numbers("largest range (deg)", "largest", 1),
            numbers("range by errors alone (deg)", "errors", 1),
            GridColumn("change per curl, 95 % interval (deg)", lambda row: row["change"]),
            GridColumn("curls with a sustained compensation", lambda row: row["sustained"]),
            GridColumn("excluded part that follows the flexion, 95 % interval (deg)", lambda row: row["in step"]),
        ),
        "angle",
    )
    return curls, compensation


def list_reach(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return the tables of volumes, ranges of the angles, areas, heights, targets and reaches."""
    found, kinds = summary.workspace, {"box": "box of independent limits", "visited": "visited region"}
    volumes = to_grid(
        "Volume that the wrist can reach",
        [
            (kinds[name], one, found.relative_volume if one is found else None)
            for name, one in (("box", found), ("visited", found.visited))
            if one is not None and one.volume_m3 is not None
        ],
        (
            texts("set", lambda row: row[0]),
            numbers("volume (m³)", lambda row: row[1].volume_m3, 4),
            GridColumn("95 % interval (m³)", lambda row: show_ends(row[1].interval_m3, 4)),
            numbers("fraction of a sphere with the arm's length as radius", lambda row: row[2], 3),
            GridColumn(
                "volume on finer and finer grids (m³)",
                lambda row: ", ".join(show_fixed(volume, 4) for volume in row[1].convergence_m3 or ()),
            ),
        ),
    )
    ranges = {}
    for name, one in (found.ranges or {}).items():
        parts = [share for key, share in (found.sources or {}).items() if key.startswith(name)]
        ranges[name] = {**dict(one), "contribution": sum(parts) if parts else None}
    of_angles = to_grid(
        "Ranges, robust against single samples: the angle is beyond each end for 0.05 s in total",
        to_words(ranges),
        (*columns_of(RangeEntry), percent("contribution to the variance of the volume (%)", "contribution")),
        "angle",
    )
    quadrants = ("total", "upper_medial", "upper_lateral", "lower_medial", "lower_lateral", "behind")
    areas = to_grid(
        "Relative area of the furthest reach about the shoulder. In front, 1 is half a sphere of the arm's length and "
        "0.25 a full quadrant; medial is towards the other arm",
        {kinds.get(name, name): one for name, one in (found.surface or {}).items()},
        [numbers(name.replace("_", " "), name, 3) for name in quadrants],
        "set",
    )
    levels: dict[str, tuple[str, str]] = {}
    if found.heights is not None:
        one_height = found.heights
        for end in ("highest", "lowest"):
            height, share = getattr(one_height, f"{end}_m"), getattr(one_height, f"{end}_share")
            levels[f"wrist, {end}"] = (show_millimetres(height), show_fixed(share, 2))
        for name, reached in one_height.levels.items():
            level = "an overhead shelf" if name == "overhead" else f"the {name}"
            levels[f"hand at the height of {level}"] = (UNKNOWN if reached is None else "yes" if reached else "no", "")
    heights = to_grid(
        "Heights above the shoulder, along the thorax",
        levels,
        (
            GridColumn("height (mm)", lambda row: row[0]),
            GridColumn("fraction of the arm's length", lambda row: row[1]),
        ),
        "level",
    )
    targets = to_grid(
        "Targets: part of the body nearest to the resting hand; positions from tables of proportions, ± 3 cm",
        to_words(found.tasks or {}),
        columns_of(TargetEntry),
        "target",
    )
    reaches = to_grid(
        "Reaches",
        [row for row in data.rows(_EVENTS) if "target" in row],
        (
            numbers("start (s)", "start", 2),
            numbers("held (s)", "top", 2),
            numbers("end (s)", "end", 2),
            texts("target", lambda row: row["target"].replace("_", " ")),
            numbers("missed by (mm)", "miss_m", factor=1e3),
            texts("complete", lambda row: "yes" if row["complete"] else f"no: {row['why']}"),
        ),
    )
    return volumes, of_angles, areas, heights, targets, reaches
