"""Sections of the page in reading order, and its key numbers."""

from __future__ import annotations

from dataclasses import dataclass

from mocap_id.reporting import motion_section, repetition_tables, segment_tables, tables
from mocap_id.reporting.dynamics_schema import BaseEntry
from mocap_id.reporting.numbers import UNKNOWN, show, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.robot_joint_summary import encoder_table
from mocap_id.reporting.space.tables import imus
from mocap_id.reporting.summary_schema import Summary
from mocap_id.store import Facts

_SHOWN = {
    "wrench", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m", "rivals", "held_out", "advice", "torque", "motion",
    "pins", "torques",
}  # fmt: skip
"""Facts of ``dynamics.h5`` that have their own tables, or are for programs alone."""


@dataclass(frozen=True)
class Section:
    """A section of the page: paragraphs, then figures, then tables.

    ``needs`` is the artefact without which the section is empty.
    """

    anchor: str
    title: str
    needs: str
    figures: tuple[str, ...] = ()
    grids: tuple[tables.Grid, ...] = ()
    text: tuple[str, ...] = ()


@dataclass(frozen=True)
class KeyNumber:
    """A key number at the top of the page, with a remark."""

    name: str
    value: str
    remark: str


def sections(data: ReportData, summary: Summary) -> list[Section]:
    """Return the sections of the page; a refused trial has fewer, up to the stage that refused."""
    skeleton = "Markers as recorded" if data.skeleton is None else "Skeleton"
    figures = ("skeleton",) if data.skeleton is None else ("skeleton", "recovery")
    parts = [
        Section("skeleton", skeleton, "planar.parquet", figures, (tables.joints(summary), tables.lengths(summary))),
        Section("states", "Joint states", "states.parquet", ("states",), _states(data, summary)),
        *sensors(summary),
        Section(
            "repetitions",
            "Repetitions",
            "events.parquet",
            ("repetitions", "phases") if "phases.parquet" in data.artefacts else ("repetitions",),
            (
                repetition_tables.repetitions(summary),
                repetition_tables.seat_off(summary),
                repetition_tables.attempts(summary),
                repetition_tables.five_times(summary),
                repetition_tables.published(summary),
                repetition_tables.load_share(summary),
                repetition_tables.compared(data),
            ),
        ),
        Section(
            "wrench",
            "Ground reaction forces",
            "wrench.parquet",
            ("wrench",),
            (
                tables.agreement(data, summary),
                tables.held_out(data, summary),
                tables.rivals(data, summary),
                clock(summary),
                tables.plates(data),
            ),
        ),
        *_motion(data, summary),
        Section(
            "parameters",
            "Inertial parameters",
            "dynamics.h5",
            ("parameters", "point_masses"),
            (tables.base_parameters(data, summary), tables.excitation(summary), identification(data)),
        ),
        Section(
            "markers",
            "Markers and segments",
            "segments.parquet",
            ("residuals",) if "markers.parquet" in data.artefacts else (),
            (
                tables.markers(data),
                segment_tables.against(data),
                segment_tables.joints(data),
                segment_tables.hypotheses(data),
                segmentation(data),
            ),
        ),
        Section("origin", "Provenance", "", (), origin(data, summary)),
    ]
    return [part for part in parts if not part.needs or part.needs in data.artefacts or data.level != "refused"]


def sensors(summary: Summary) -> tuple[Section, ...]:
    """Return the section on inertial sensors; nothing without any."""
    if not summary.imus:
        return ()
    return (Section("imus", "Inertial sensors", "states.parquet", (), (imus(summary),)),)


def _motion(data: ReportData, summary: Summary) -> list[Section]:
    """Return the section on the motion of the masses; empty if nothing was identified."""
    if summary.dynamics.motion is None:
        return []
    grids = (motion_section.cost(data, summary), motion_section.joints(data, summary), motion_section.poses(summary))
    return [Section("motion", "Motion of the masses", "dynamics.h5", (), grids, motion_section.text(data, summary))]


def key_numbers(data: ReportData, summary: Summary) -> list[KeyNumber]:
    """Return the key numbers that are known."""
    dynamics, segments = summary.dynamics, summary.segments
    mass = next((entry for entry in dynamics.base or () if entry.unit == "kg"), None)
    vertical = (dynamics.wrench or {}).get("Fy")
    band = "" if data.low_pass is None else f", {tables.in_band(data)}"
    found = (
        KeyNumber("segments", _count(segments.count), f"confidence {show_fixed(segments.confidence, 2)}"),
        KeyNumber("reprojection error", show(summary.markers.reprojection_rms_mm, 3, "mm"), "rms over all markers"),
        KeyNumber("missing samples", _scaled(summary.markers.missing_fraction, 100, 1, "%"), "of all marker samples"),
        _repetitions(summary),
        KeyNumber("five-times test", show_fixed(summary.five_times.to_fifth_stand_s, 2, "s"), "to the fifth stand"),
        KeyNumber("mass, measured", show(dynamics.mass_kg, 3, "kg"), "by the plates at rest"),
        KeyNumber("mass, identified", show(mass.value if mass else None, 3, "kg"), _mass_remark(mass)),
        KeyNumber("mean CoP", _scaled(dynamics.cop_mean_m, 1e3, 1, "mm"), "along the motion, measured"),
        KeyNumber(
            "vertical force fit",
            show_fixed(vertical.r2 if vertical else None, 4),
            f"r² of the model{band}",
        ),
        KeyNumber("CoP error", _scaled(dynamics.cop_rms_m, 1e3, 1, "mm"), f"rms of the model{band}"),
        KeyNumber("condition number", show(dynamics.condition_number), _condition_remark(summary)),
        KeyNumber("clock offset", _scaled(dynamics.clock_offset_s, 1e3, 2, "ms"), "plates after cameras"),
    )
    return [number for number in found if number.value != UNKNOWN]


def _repetitions(summary: Summary) -> KeyNumber:
    curls = summary.curls
    if curls.count is None:
        return KeyNumber("repetitions", _count(len(summary.repetitions or ()) or None), "found")
    remark = "to the end of the recording"
    if curls.end_rule != "recording":
        remark = f"to the end of the trial at {show_fixed(curls.end_s, 1, 's')} ({curls.end_rule})"
    return KeyNumber("curls", str(curls.count), f"{remark}; {curls.partial} failed")


def _count(value: int | None) -> str:
    return UNKNOWN if value is None else str(value)


def _scaled(value: float | None, factor: float, decimals: int, unit: str) -> str:
    return show_fixed(None if value is None else factor * value, decimals, unit)


def _mass_remark(mass: BaseEntry | None) -> str:
    sd = None if mass is None else mass.sd
    return "from the motion" if sd is None else f"± {show(sd, 2)} kg, from the motion"


def _condition_remark(summary: Summary) -> str:
    scaled = summary.dynamics.condition_number_scaled
    return "of the regressor" if scaled is None else f"{show(scaled)} with unit-norm columns"


def _states(data: ReportData, summary: Summary) -> tuple[tables.Grid, ...]:
    return noise(data, summary), encoder_table(summary)


def noise(data: ReportData, summary: Summary) -> tables.Grid:
    """Return the noise and the residuals of the filter."""
    facts = data.facts("states.parquet")
    values = {
        "marker noise per coordinate (mm)": _scaled(summary.noise.marker_sd_m, 1e3, 2, ""),
        "process noise σ_v of each joint (rad/s⁴)": facts.get("sigma_v"),
        "reprojection error, rms (mm)": show(summary.markers.reprojection_rms_mm),
        **_without(facts, {"marker_sd_m", "sigma_v", "reprojection_rms_m"}),
    }
    return tables.facts("Filter: noise and residuals", values)


def clock(summary: Summary) -> tables.Grid:
    """Return the clock offset of the plates, and what they measure."""
    dynamics = summary.dynamics
    not_predicted = dynamics.wrench is not None and dynamics.held_out.model is None
    values = {
        "clock offset, plates after cameras (ms)": _scaled(dynamics.clock_offset_s, 1e3, 2, ""),
        "standard deviation of the clock offset (ms)": _scaled(dynamics.clock_offset_sd_s, 1e3, 2, ""),
        "clock offsets with one repetition left out (ms)": ", ".join(
            _scaled(offset, 1e3, 2, "") for offset in dynamics.held_out.clock_offset_s or ()
        ),
        "rms error of the centre of pressure (mm)": _scaled(dynamics.cop_rms_m, 1e3, 1, ""),
        "samples in the fit": dynamics.samples,
        "mass measured by the plates (kg)": show(dynamics.mass_kg, 4),
        "mean centre of pressure (mm)": _scaled(dynamics.cop_mean_m, 1e3, 1, ""),
        "why unknown": dynamics.why,
        "why no left-out repetition was predicted": dynamics.held_out.why if not_predicted else None,
    }
    return tables.facts("Plates and clock", values)


def identification(data: ReportData) -> tables.Grid:
    """Return the facts of ``dynamics.h5`` about the identification that no other table shows."""
    return tables.facts("Identification", _without(data.facts("dynamics.h5"), _SHOWN))


def segmentation(data: ReportData) -> tables.Grid:
    """Return the facts of ``segments.parquet`` that no other table shows, without those for programs alone."""
    shown = {"names", "joint_names", "divisions", "bad_stretches", *segment_tables.SHOWN}  # reasons list the stretches
    return tables.facts("Segmentation", _without(data.facts("segments.parquet"), shown))


def _without(facts: Facts, shown: set[str]) -> Facts:
    """Return the facts whose keys are not in ``shown``."""
    return {key: value for key, value in facts.items() if key not in shown}


def origin(data: ReportData, summary: Summary) -> tuple[tables.Grid, ...]:
    """Return the tables about recording, plane, joint fit, settings, run times and version."""
    planar = dict(data.facts("planar.parquet"))
    planar.pop("bursts", None)  # one interval per jump; the verdict gives their number
    plane = planar.pop("plane", None) or {}
    chain = data.facts("chain.h5")
    return (
        tables.facts("Recording", planar),
        tables.facts("Plane of motion", plane),
        tables.facts("Joint fit", chain),
        tables.facts("Settings of the trial", data.settings),
        tables.facts("Run time of each stage (s)", summary.time_s or {}),
        tables.facts("Software version", {"mocap-id": data.product}),
    )
