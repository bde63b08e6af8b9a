"""Sections of the report of a trial in reading order, and its key numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Set

from mocap_id.reporting import tables
from mocap_id.reporting.grids import Grid, list_facts, millimetres, number, text, to_grid
from mocap_id.reporting.numbers import UNKNOWN, scale, show, show_fixed, show_millimetres
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import BaseEntry, ChannelEntry, GapEntry, MotionEntry, PredictedEntry, Summary
from mocap_id.reporting.tables import describe_band, list_encoder_errors, list_imus
from mocap_id.store import Facts

_SHOWN = {
    "wrench", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m", "rivals", "held_out", "advice", "torque", "motion",
    "pins", "torques",
}  # fmt: skip
"""Facts of ``dynamics.h5`` that the table of facts omits: they are in other tables or only for programs."""


def make_sections(data: ReportData, summary: Summary) -> list[Section]:
    """Return the sections of the report; a refused trial only has the sections of the stages before the refusal."""
    make_results = make_spatial_sections if data.in_space else _make_planar_sections
    filtering = _list_noise(data, summary)
    residuals = ("residuals",) if "markers.parquet" in data.artefacts else ()
    parts = [
        *make_results(data, summary, filtering, _make_sensor_section(summary)),
        Section(
            "wrench",
            "Ground reaction wrench" if data.in_space else "Ground reaction forces",
            (
                tables.list_model_errors(data, summary),
                tables.list_held_out_errors(data, summary),
                tables.list_reference_errors(data, summary),
                _list_clock(summary),
                tables.list_plates(data),
            ),
            ("wrench",),
            needs="wrench.parquet",
        ),
        *_make_torque_section(summary),
        *make_motion_section(data, summary),
        Section(
            "parameters",
            "Inertial parameters",
            (
                tables.list_base_parameters(data, summary),
                tables.list_excitation(summary),
                list_facts("Identification", _remove(data.facts("dynamics.h5"), _SHOWN)),
            ),
            ("parameters",) if data.in_space else ("parameters", "point_masses"),
            needs="dynamics.h5",
        ),
        Section(
            "markers",
            "Markers and segments",
            (
                tables.list_markers(data),
                tables.list_evidence(data),
                tables.list_joint_confidences(data),
                tables.list_hypotheses(data),
                list_facts("Segmentation", _remove(data.facts("segments.parquet"), tables.SHOWN)),
            ),
            residuals,
            needs="segments.parquet",
        ),
        Section("origin", "Provenance", _list_provenance(data, summary)),
    ]
    complete = data.level != "refused" and not data.in_space
    return [part for part in parts if not part.needs or part.needs in data.artefacts or complete]


def _make_planar_sections(data: ReportData, summary: Summary, filtering: Grid, sensors: list[Section]) -> list[Section]:
    """Return the sections on skeleton, states and repetitions of a trial in the plane."""
    recovered = data.skeleton is not None
    return [
        Section(
            "skeleton",
            "Skeleton" if recovered else "Markers as recorded",
            (tables.list_joints(summary), tables.list_lengths(summary)),
            ("skeleton", "recovery") if recovered else ("skeleton",),
            needs="planar.parquet",
        ),
        Section(
            "states", "Joint states", (filtering, list_encoder_errors(summary)), ("states",), needs="states.parquet"
        ),
        *sensors,
        Section(
            "repetitions",
            "Repetitions",
            (
                tables.list_repetitions(summary),
                tables.list_seat_off_times(summary),
                tables.list_attempts(summary),
                tables.list_test_times(summary),
                tables.list_published_times(summary),
                tables.list_load_shares(summary),
                tables.list_agreement(data),
            ),
            ("repetitions", "phases") if "phases.parquet" in data.artefacts else ("repetitions",),
            needs="events.parquet",
        ),
    ]


def _make_torque_section(summary: Summary) -> list[Section]:
    """Return the section on the joint torques in the plane; empty without an identification."""
    if not summary.dynamics.torques:
        return []
    grid = tables.list_torques(summary)
    return [Section("torques", "Joint torques", (grid,), ("torques",), needs="dynamics.parquet")]


def _make_sensor_section(summary: Summary) -> list[Section]:
    """Return the section on inertial sensors; empty if the trial has none."""
    grids = (list_imus(summary),)
    return [Section("imus", "Inertial sensors", grids, needs="states.parquet")] if summary.imus else []


def make_key_numbers(data: ReportData, summary: Summary) -> list[KeyNumber]:
    """Return the known key numbers for the top of the page."""
    dynamics, segments = summary.dynamics, summary.segments
    mass = next((entry for entry in dynamics.base or () if entry.unit == "kg"), None)
    vertical = (dynamics.wrench or {}).get("Fy")
    band = "" if data.low_pass is None else f", {tables.describe_band(data)}"
    missing = scale(summary.markers.missing_fraction, 100)
    numbers = (
        KeyNumber("segments", show_fixed(segments.count, 0), f"confidence {show_fixed(segments.confidence, 2)}"),
        KeyNumber("reprojection error", show(summary.markers.reprojection_rms_mm, 3, "mm"), "rms over all markers"),
        KeyNumber("missing samples", show_fixed(missing, 1, "%"), "of all marker samples"),
        _count_repetitions(summary),
        KeyNumber(
            "five-times test", show_fixed(summary.five_times.to_fifth_stand_s, 2, "s"), _describe_five_times(summary)
        ),
        KeyNumber("mass, measured", show(dynamics.mass_kg, 3, "kg"), "by the plates at rest"),
        KeyNumber("mass, identified", show(mass.value if mass else None, 3, "kg"), _describe_mass(mass)),
        KeyNumber("mean CoP", show_fixed(scale(dynamics.cop_mean_m, 1e3), 1, "mm"), "along the motion, measured"),
        KeyNumber("vertical force fit", show_fixed(vertical.r2 if vertical else None, 4), f"r² of the model{band}"),
        KeyNumber("CoP error", show_fixed(scale(dynamics.cop_rms_m, 1e3), 1, "mm"), f"rms of the model{band}"),
        KeyNumber("condition number", show(dynamics.condition_number), _describe_condition(summary)),
        KeyNumber("clock offset", show_fixed(scale(dynamics.clock_offset_s, 1e3), 2, "ms"), "plates after cameras"),
    )
    return [number for number in numbers if number.value != UNKNOWN]


def _count_repetitions(summary: Summary) -> KeyNumber:
    """Return the number of repetitions or of curls as a key number."""
    curls = summary.curls
    if curls.count is None:
        return KeyNumber("repetitions", show_fixed(len(summary.repetitions or ()) or None, 0), "found")
    remark = "to the end of the recording"
    if curls.end_rule != "recording":
        remark = f"to the end of the trial at {show_fixed(curls.end_s, 1, 's')} ({curls.end_rule})"
    return KeyNumber("curls", str(curls.count), f"{remark}; {curls.partial} failed")


def _describe_five_times(summary: Summary) -> str:
    sd = summary.five_times.to_fifth_stand_sd_s
    return "to the fifth stand" if sd is None else f"± {show_fixed(sd, 3)} s, to the fifth stand"


def _describe_mass(mass: BaseEntry | None) -> str:
    sd = None if mass is None else mass.sd
    return "from the motion" if sd is None else f"± {show(sd, 2)} kg, from the motion"


def _describe_condition(summary: Summary) -> str:
    scaled = summary.dynamics.condition_number_scaled
    return "of the chain's regressor" if scaled is None else f"of the chain; {show(scaled)} with unit-norm columns"


def _list_noise(data: ReportData, summary: Summary) -> Grid:
    """Return a table of the noise that the filter assumes, and of its residuals."""
    facts = data.facts("states.parquet")
    values = {
        "marker noise per coordinate (mm)": show_fixed(scale(summary.noise.marker_sd_m, 1e3), 2),
        "process noise σ_v of each joint (rad/s⁴)": facts.get("sigma_v"),
        "reprojection error, rms (mm)": show(summary.markers.reprojection_rms_mm),
        **_remove(facts, {"marker_sd_m", "sigma_v", "reprojection_rms_m"}),
    }
    return list_facts("Filter: noise and residuals", values)


def _list_clock(summary: Summary) -> Grid:
    """Return a table of the clock offset of the plates, and of mass and centre of pressure measured by them."""
    dynamics = summary.dynamics
    not_predicted = dynamics.wrench is not None and dynamics.held_out.model is None
    offsets = (show_fixed(1e3 * offset, 2) for offset in dynamics.held_out.clock_offset_s or ())
    values = {
        "clock offset, plates after cameras (ms)": show_fixed(scale(dynamics.clock_offset_s, 1e3), 2),
        "standard deviation of the clock offset (ms)": show_fixed(scale(dynamics.clock_offset_sd_s, 1e3), 2),
        "clock offsets with one repetition left out (ms)": ", ".join(offsets),
        "rms error of the centre of pressure (mm)": show_millimetres(dynamics.cop_rms_m),
        "samples in the fit": dynamics.samples,
        "mass measured by the plates (kg)": show(dynamics.mass_kg, 4),
        "mean centre of pressure (mm)": show_millimetres(dynamics.cop_mean_m),
        "why unknown": dynamics.why,
        "why no left-out repetition was predicted": dynamics.held_out.why if not_predicted else None,
    }
    return list_facts("Plates and clock", values)


def _remove(facts: Facts, keys: Set[str]) -> Facts:
    """Return the facts without the given keys."""
    return {key: value for key, value in facts.items() if key not in keys}


def _list_provenance(data: ReportData, summary: Summary) -> tuple[Grid, ...]:
    """Return the tables about recording, plane, joint fit, settings, run times and version."""
    planar = data.facts("planar.parquet")
    return (
        list_facts("Recording", _remove(planar, {"plane", "bursts"})),  # the verdict gives the number of bursts
        list_facts("Plane of motion", planar.get("plane") or {}),
        list_facts("Joint fit", _remove(data.facts("chain.h5"), {"static"})),
        list_facts("Settings of the trial", data.settings),
        list_facts("Run time of each stage (s)", summary.time_s or {}),
        list_facts("Software version", {"mocap-id": data.product}),
    )


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


def make_spatial_sections(data: ReportData, summary: Summary, filtering: Grid, sensors: list[Section]) -> list[Section]:
    """Return the sections on chain, angles, sensors, protocol and landmarks.

    Parameters
    ----------
    data : ReportData
    summary : Summary
    filtering : Grid
        Table of the filter's noise.
    sensors : list of Section
        Section on inertial sensors; empty if the trial has none.
    """
    joints = (
        tables.list_joints(summary),
        tables.list_glides(summary),
        tables.list_axes(summary),
        tables.list_kinds(summary),
    )
    missing = tuple(f"{joint.name}: {joint.why}." for joint in summary.joints or () if not joint.known)
    return [
        Section(
            "skeleton",
            "Markers as recorded" if data.spatial_skeleton is None else "Skeleton",
            (*joints, tables.list_lengths(summary)),
            ("skeleton",),
            text=missing,
            needs="planar.parquet",
        ),
        Section(
            "angles", "Angles", (tables.list_angles(summary), filtering), ("angles", "rates"), needs="angles.parquet"
        ),
        *sensors,
        *_make_protocol_section(data, summary),
        Section(
            "landmarks",
            "Landmarks",
            (tables.list_landmarks(data, summary),),
            text=(_describe_frames(data, summary),),
            needs="chain.h5",
        ),
    ]


def _make_protocol_section(data: ReportData, summary: Summary) -> list[Section]:
    """Return the section on the reachable volume or on curls; empty for other protocols."""
    facts, needs = data.facts("events.parquet"), "events.parquet"
    grids: tuple[Grid, ...]
    if "reach" in facts:
        found = summary.workspace
        grids = (
            tables.list_volumes(found),
            tables.list_ranges(found),
            tables.list_areas(found),
            tables.list_heights(found),
            tables.list_targets(found),
            tables.list_reaches(data),
        )
        return [Section("reach", "Reach", grids, ("reach",), text=tables.describe_volume(found), needs=needs)]
    if "curl" in facts:
        grids = (tables.list_curls(data), tables.list_compensation(data))
        return [Section("curls", "Curls", grids, ("phase_portraits",), needs=needs)]
    return []


def _describe_frames(data: ReportData, summary: Summary) -> str:
    """Return sentences on the coordinate frames of the segments."""
    if data.facts("chain.h5").get("frames") == "isb":
        return "The frames of the segments are the ISB frames (Wu et al. 2005), computed from these landmarks."
    missing = "no landmarks were found" if not summary.landmarks else "the landmarks do not suffice for them"
    return (
        f"The frames of the segments are the program's own, because {missing}. The angles are the joints' own "
        "coordinates and have no anatomical meaning."
    )
