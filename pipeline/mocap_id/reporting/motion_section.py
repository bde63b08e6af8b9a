"""Page section on the motion of the masses: pinned chain or measured poses, and the effect of pinned joints."""

from __future__ import annotations

import math
from collections.abc import Callable

from mocap_id.reporting.dynamics_schema import ChannelEntry, GapEntry, MotionEntry, PredictedEntry
from mocap_id.reporting.grids import Grid, list_facts, millimetres, number, text, to_grid
from mocap_id.reporting.numbers import show, show_fixed, show_millimetres
from mocap_id.reporting.page import Section
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import describe_band

_COMPONENTS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}


def make_motion_section(data: ReportData, summary: Summary) -> list[Section]:
    """Return the section on the motion of the masses; empty in space, or if nothing was identified."""
    motion = summary.dynamics.motion
    if motion is None or data.in_space:
        return []
    sentences: tuple[str, ...] = (_describe_chain(motion),)
    grids: tuple[Grid, ...] = (_list_errors(data, summary),)
    if motion.source != "chain":
        choice = (
            f"In the dynamics, every body moves as its own markers were measured, because {motion.why}. Pinned joints "
            "would hide this movement. Skeleton, lengths and angles still belong to the pinned chain."
        )
        sentences = (choice, _compare_errors(data, summary, motion))
        grids = (*grids, _list_joints(data, motion), _list_poses(motion))
    return [Section("motion", "Motion of the masses", grids, text=sentences, needs="dynamics.h5")]


def _describe_chain(motion: MotionEntry) -> str:
    """Return a sentence that says why the pinned chain was chosen, with the gaps of the joints if they are known."""
    why = "it is configured" if motion.why == "asked for" else motion.why
    gaps = ", ".join(
        f"{name} {show_millimetres(gap.gap_m)} mm and {show(gap.acceleration_m_s2, 2)} m/s²"
        for name, gap in (motion.joints or {}).items()
    )
    return f"The masses move with the pinned chain, because {why}" + (f" (rms gaps: {gaps})." if gaps else ".")


def _compare_errors(data: ReportData, summary: Summary, motion: MotionEntry) -> str:
    """Return sentences that compare the errors of the pinned chain and of the measured poses."""
    pins, offset = summary.dynamics.pins, summary.dynamics.clock_offset_s
    if pins.chain is None or pins.segments is None:
        return f"The effect of pinned joints is unknown: {pins.why}."
    errors = {
        part: (_compute_rms(pins.chain.wrench.get(part)), _compute_rms(pins.segments.wrench.get(part)))
        for part in _COMPONENTS
    }
    errors["the centre of pressure"] = (pins.chain.cop_rms_m, pins.segments.cop_rms_m)
    ratios = ", ".join(
        f"{show_fixed(pinned / free, 1)} times as large for {name}"
        for name, (pinned, free) in errors.items()
        if pinned and free
    )
    clocks = ""
    if pins.clock_offset_s is not None and offset is not None:
        clocks = f" The two clock offsets differ by {show_fixed(1e3 * abs(pins.clock_offset_s - offset), 1)} ms."
    others = ", and no body for the other markers (arms, head)" if "others" in (motion.bodies or ()) else ""
    return (
        f"Both motions were used to predict left-out repetitions, on the same {pins.samples} samples, "
        f"{describe_band(data)}. With the pinned chain the error is {ratios}. Not all of this is due to the pins, "
        f"because the chain has its own smoothing and fit{others}.{clocks}"
    )


def _list_errors(data: ReportData, summary: Summary) -> Grid:
    """Return a table of errors on left-out repetitions and clock offsets, of pinned chain and measured poses."""
    pins = summary.dynamics.pins
    motions = {
        "pinned chain": (pins.chain, pins.clock_offset_s),
        "measured poses": (pins.segments, summary.dynamics.clock_offset_s),
    }
    columns = (
        *(number(f"{part} ({unit})", _make_rms_source(part)) for part, unit in _COMPONENTS.items()),
        millimetres("centre of pressure (mm)", lambda row: row[0].cop_rms_m),
        number("clock offset (ms)", lambda row: row[1], 2, 1e3),
    )
    caption = f"Pinned chain and measured poses: rms error on left-out repetitions, {describe_band(data)}"
    return to_grid(caption, {name: row for name, row in motions.items() if row[0] is not None}, columns, "motion")


def _list_joints(data: ReportData, motion: MotionEntry) -> Grid:
    """Return a table of the gap of each joint and whether it is pinned in the dynamics."""
    inside = _find_joints_inside_bodies(data)

    def describe_treatment(row: tuple[str, GapEntry]) -> str:
        if row[0] in inside:
            return f"inside one body ({inside[row[0]]})"
        return "pinned" if row[1].pinned else "free"

    columns = (
        text("joint", lambda row: row[0]),
        millimetres("gap (mm)", lambda row: row[1].gap_m),
        number("acceleration below 3 Hz (m/s²)", lambda row: row[1].acceleration_m_s2),
        text("in the dynamics", describe_treatment),
    )
    caption = (
        "Gap between the two sides of each joint (rms). A joint whose gap is within the noise of the cameras is pinned"
    )
    return to_grid(caption, list((motion.joints or {}).items()), columns)


def _list_poses(motion: MotionEntry) -> Grid:
    """Return a table of the bodies, cut-off frequencies and prior of a fit to measured poses."""
    cutoffs = {f"cut-off frequency for {axis} (Hz)": f"{cutoff:g}" for axis, cutoff in (motion.bands_hz or {}).items()}
    values = {
        "bodies": motion.bodies,
        **cutoffs,
        "reason for these cut-off frequencies": motion.bands_why,
        "source of the loose prior of the body parameters": motion.prior,
        "condition number of the regressor of all bodies, without the prior": motion.bodies_condition_number,
        "the same with unit-norm columns": motion.bodies_condition_number_scaled,
    }
    return list_facts("Measured poses", values)


def _compute_rms(channel: ChannelEntry | None) -> float | None:
    if channel is None or channel.bias is None or channel.sd is None:
        return None
    return math.hypot(channel.bias, channel.sd)


def _make_rms_source(part: str) -> Callable[[tuple[PredictedEntry, float | None]], float | None]:
    return lambda row: _compute_rms(row[0].wrench.get(part))


def _find_joints_inside_bodies(data: ReportData) -> dict[str, str]:
    """Return the name of the body by joint, for joints whose two segments belong to one body of the dynamics."""
    bodies = data.facts("poses.parquet").get("bodies") or ()
    used = (data.facts("dynamics.h5").get("motion") or {}).get("used") or ()
    own = [bodies[k] for k in used if k < len(bodies)]
    names = data.skeleton.joints if data.skeleton is not None else ()
    return {
        name: str(body["name"]) for j, name in enumerate(names) for body in own if {j, j + 1} <= set(body["segments"])
    }
