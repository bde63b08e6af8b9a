"""Tables of the report in the plane and in space: joints, wrench, parameters and markers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.dynamics_schema import ChannelEntry
from mocap_id.reporting.grids import Grid, GridColumn, millimetres, number, percent, text, to_grid, with_sd
from mocap_id.reporting.numbers import (
    UNKNOWN,
    scale,
    show,
    show_beside,
    show_fixed,
    show_interval,
    show_percent,
    show_with_sd,
)
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import JointEntry, Summary

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
