"""Sections of the report of a trial in reading order, and its key numbers."""

from __future__ import annotations

from collections.abc import Set

from mocap_id.reporting import repetition_tables, segment_tables, tables
from mocap_id.reporting.dynamics_schema import BaseEntry
from mocap_id.reporting.grids import Grid, list_facts
from mocap_id.reporting.motion_section import make_motion_section
from mocap_id.reporting.numbers import UNKNOWN, scale, show, show_fixed, show_millimetres
from mocap_id.reporting.page import KeyNumber, Section
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.robot_joint_summary import list_encoder_errors
from mocap_id.reporting.space.sections import make_spatial_sections
from mocap_id.reporting.space.tables import list_imus
from mocap_id.reporting.summary_schema import Summary
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
                segment_tables.list_evidence(data),
                segment_tables.list_joint_confidences(data),
                segment_tables.list_hypotheses(data),
                list_facts("Segmentation", _remove(data.facts("segments.parquet"), segment_tables.SHOWN)),
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
                repetition_tables.list_repetitions(summary),
                repetition_tables.list_seat_off_times(summary),
                repetition_tables.list_attempts(summary),
                repetition_tables.list_test_times(summary),
                repetition_tables.list_published_times(summary),
                repetition_tables.list_load_shares(summary),
                repetition_tables.list_agreement(data),
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
