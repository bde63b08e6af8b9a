"""The report of a trial: its sections and key numbers, its files, and what a notebook shows of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from functools import partial
from html import escape
from typing import Any

from mocap_id.reporting import PAGE_FILE, SUMMARY_FILE, PdfFonts, style, tables
from mocap_id.reporting.explanations import LEVELS
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.figures import draw_figures
from mocap_id.reporting.grids import (
    UNKNOWN,
    Grid,
    GridColumn,
    list_facts,
    millimetres,
    numbers,
    scale,
    show,
    show_ends,
    show_fixed,
    show_interval,
    show_millimetres,
    texts,
    to_grid,
    with_sd,
)
from mocap_id.reporting.page import KeyNumber, Page, Section, embed, explain_reason, make_environment, read_figures
from mocap_id.reporting.player import Player, make_player
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.reporting.summary_schema import ChannelEntry, GapEntry, MotionEntry, PredictedEntry, Summary
from mocap_id.reporting.tables import describe_band, list_angles
from mocap_id.store import Document, Facts

_SHOWN = {
    "wrench", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m", "rivals", "held_out", "advice", "torque", "motion",
    "pins", "torques",
}  # fmt: skip
"""Facts of ``dynamics.h5`` that the table of facts omits: they are in other tables or only for programs."""


def make_sections(data: ReportData, summary: Summary) -> list[Section]:
    """Return the sections of the report; a refused trial only has the sections of the stages before the refusal."""
    facts, planar, states = (data.facts(file) for file in ("dynamics.h5", "planar.parquet", "states.parquet"))
    filtering = list_facts(
        "Filter: noise and residuals",
        {
            "marker noise per coordinate (mm)": show_fixed(scale(summary.noise.marker_sd_m, 1e3), 2),
            "process noise σ_v of each joint (rad/s⁴)": states.get("sigma_v"),
            "reprojection error, rms (mm)": show(summary.markers.reprojection_rms_mm),
            **_remove(states, {"marker_sd_m", "sigma_v", "reprojection_rms_m"}),
        },
    )
    parts = [*(_make_spatial_sections if data.in_space else _make_planar_sections)(data, summary, filtering)]
    of_model, held_out, references = tables.list_wrench_errors(data, summary)
    parts.append(
        Section(
            "wrench",
            "Ground reaction wrench" if data.in_space else "Ground reaction forces",
            (of_model, held_out, references, _list_clock(summary), tables.list_plates(data)),
            ("wrench",),
            needs="wrench.parquet",
        )
    )
    if summary.dynamics.torques:
        torques = (tables.list_torques(summary),)
        parts.append(Section("torques", "Joint torques", torques, ("torques",), needs="dynamics.parquet"))
    if summary.dynamics.motion is not None and not data.in_space:
        parts.append(_make_motion_section(data, summary, summary.dynamics.motion))
    parts += [
        Section(
            "parameters",
            "Inertial parameters",
            (*tables.list_parameters(data, summary), list_facts("Identification", _remove(facts, _SHOWN))),
            ("parameters",) if data.in_space else ("parameters", "point_masses"),
            needs="dynamics.h5",
        ),
        Section(
            "markers",
            "Markers and segments",
            (
                *tables.list_markers(data),
                list_facts("Segmentation", _remove(data.facts("segments.parquet"), tables.SHOWN)),
            ),
            ("residuals",) if "markers.parquet" in data.artefacts else (),
            needs="segments.parquet",
        ),
        Section(
            "origin",
            "Provenance",
            (
                list_facts("Recording", _remove(planar, {"plane", "bursts"})),  # the verdict gives the number of bursts
                list_facts("Plane of motion", planar.get("plane") or {}),
                list_facts("Joint fit", _remove(data.facts("chain.h5"), {"static"})),
                list_facts("Settings of the trial", data.settings),
                list_facts("Run time of each stage (s)", summary.time_s or {}),
                list_facts("Software version", {"mocap-id": data.product}),
            ),
        ),
    ]
    complete = data.level != "refused" and not data.in_space
    return [part for part in parts if not part.needs or part.needs in data.artefacts or complete]


def _remove(facts: Facts, keys: Set[str]) -> Facts:
    """Return the facts without the given keys."""
    return {key: value for key, value in facts.items() if key not in keys}


def _list_sensors(summary: Summary) -> list[Section]:
    """Return the section on inertial sensors; empty if the trial has none."""
    grids = (tables.list_imus(summary),)
    return [Section("imus", "Inertial sensors", grids, needs="states.parquet")] if summary.imus else []


def _make_planar_sections(data: ReportData, summary: Summary, filtering: Grid) -> list[Section]:
    """Return the sections on skeleton, states and repetitions of a trial in the plane."""
    recovered, encoder = data.skeleton is not None, tables.list_encoder_errors(summary)
    return [
        Section(
            "skeleton",
            "Skeleton" if recovered else "Markers as recorded",
            tables.list_chain(summary),
            ("skeleton", "recovery") if recovered else ("skeleton",),
            needs="planar.parquet",
        ),
        Section("states", "Joint states", (filtering, encoder), ("states",), needs="states.parquet"),
        *_list_sensors(summary),
        Section(
            "repetitions",
            "Repetitions",
            tables.list_repetitions(data, summary),
            ("repetitions", "phases") if "phases.parquet" in data.artefacts else ("repetitions",),
            needs="events.parquet",
        ),
    ]


def _make_spatial_sections(data: ReportData, summary: Summary, filtering: Grid) -> list[Section]:
    """Return the sections on chain, angles, sensors, protocol and landmarks of a trial in space."""
    facts, needs = data.facts("events.parquet"), "events.parquet"
    protocol = []
    if "reach" in facts:
        found = summary.workspace
        meaning = () if found.visited is None else (found.visited.meaning,)
        if found.volume_m3 is None:
            meaning = (f"The reachable volume is unknown: {found.why}.",)
        grids = tables.list_reach(data, summary)
        protocol = [Section("reach", "Reach", grids, ("reach",), text=meaning, needs=needs)]
    elif "curl" in facts:
        protocol = [Section("curls", "Curls", tables.list_curls(data, summary), ("phase_portraits",), needs=needs)]
    frames = "The frames of the segments are the ISB frames (Wu et al. 2005), computed from these landmarks."
    if data.facts("chain.h5").get("frames") != "isb":
        missing = "no landmarks were found" if not summary.landmarks else "the landmarks do not suffice for them"
        frames = (
            f"The frames of the segments are the program's own, because {missing}. The angles are the joints' own "
            "coordinates and have no anatomical meaning."
        )
    angles = (tables.list_angles(summary), filtering)
    landmarks = (tables.list_landmarks(data, summary),)
    return [
        Section(
            "skeleton",
            "Markers as recorded" if data.spatial_skeleton is None else "Skeleton",
            tables.list_chain(summary),
            ("skeleton",),
            text=tuple(f"{joint.name}: {joint.why}." for joint in summary.joints or () if not joint.known),
            needs="planar.parquet",
        ),
        Section("angles", "Angles", angles, ("angles", "rates"), needs="angles.parquet"),
        *_list_sensors(summary),
        *protocol,
        Section("landmarks", "Landmarks", landmarks, text=(frames,), needs="chain.h5"),
    ]


def make_key_numbers(data: ReportData, summary: Summary) -> list[KeyNumber]:
    """Return the known key numbers for the top of the page."""
    dynamics, segments, five_times, curls = summary.dynamics, summary.segments, summary.five_times, summary.curls
    mass = next((entry for entry in dynamics.base or () if entry.unit == "kg"), None)
    mass_sd = None if mass is None else mass.sd
    vertical = (dynamics.wrench or {}).get("Fy")
    band = "" if data.low_pass is None else f", {describe_band(data)}"
    sd, scaled = five_times.to_fifth_stand_sd_s, dynamics.condition_number_scaled
    counted = KeyNumber("repetitions", show_fixed(len(summary.repetitions or ()) or None, 0), "found")
    if curls.count is not None:
        remark = "to the end of the recording"
        if curls.end_rule != "recording":
            remark = f"to the end of the trial at {show_fixed(curls.end_s, 1, 's')} ({curls.end_rule})"
        counted = KeyNumber("curls", str(curls.count), f"{remark}; {curls.partial} failed")
    found = (
        KeyNumber("segments", show_fixed(segments.count, 0), f"confidence {show_fixed(segments.confidence, 2)}"),
        KeyNumber("reprojection error", show(summary.markers.reprojection_rms_mm, 3, "mm"), "rms over all markers"),
        KeyNumber(
            "missing samples",
            show_fixed(scale(summary.markers.missing_fraction, 100), 1, "%"),
            "of all marker samples",
        ),
        counted,
        KeyNumber(
            "five-times test",
            show_fixed(five_times.to_fifth_stand_s, 2, "s"),
            "to the fifth stand" if sd is None else f"± {show_fixed(sd, 3)} s, to the fifth stand",
        ),
        KeyNumber("mass, measured", show(dynamics.mass_kg, 3, "kg"), "by the plates at rest"),
        KeyNumber(
            "mass, identified",
            show(mass.value if mass else None, 3, "kg"),
            "from the motion" if mass_sd is None else f"± {show(mass_sd, 2)} kg, from the motion",
        ),
        KeyNumber("mean CoP", show_fixed(scale(dynamics.cop_mean_m, 1e3), 1, "mm"), "along the motion, measured"),
        KeyNumber("vertical force fit", show_fixed(vertical.r2 if vertical else None, 4), f"r² of the model{band}"),
        KeyNumber("CoP error", show_fixed(scale(dynamics.cop_rms_m, 1e3), 1, "mm"), f"rms of the model{band}"),
        KeyNumber(
            "condition number",
            show(dynamics.condition_number),
            "of the chain's regressor" if scaled is None else f"of the chain; {show(scaled)} with unit-norm columns",
        ),
        KeyNumber("clock offset", show_fixed(scale(dynamics.clock_offset_s, 1e3), 2, "ms"), "plates after cameras"),
    )
    return [one for one in found if one.value != UNKNOWN]


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


_COMPONENTS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}


def _make_motion_section(data: ReportData, summary: Summary, motion: MotionEntry) -> Section:
    """Return the section on the motion of the masses: pinned chain or measured poses, and the errors of both."""
    pins = summary.dynamics.pins
    motions = {
        "pinned chain": (pins.chain, pins.clock_offset_s),
        "measured poses": (pins.segments, summary.dynamics.clock_offset_s),
    }
    errors = to_grid(
        f"Pinned chain and measured poses: rms error on left-out repetitions, {describe_band(data)}",
        {name: row for name, row in motions.items() if row[0] is not None},
        (
            *(numbers(f"{part} ({unit})", partial(_get_rms, part=part)) for part, unit in _COMPONENTS.items()),
            millimetres("centre of pressure (mm)", lambda row: row[0].cop_rms_m),
            numbers("clock offset (ms)", lambda row: row[1], 2, 1e3),
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
        return Section("motion", "Motion of the masses", (errors,), text=(chosen,), needs="dynamics.h5")
    # joints whose two segments belong to one body of the dynamics
    bodies, inside = data.facts("poses.parquet").get("bodies") or (), {}
    used = (data.facts("dynamics.h5").get("motion") or {}).get("used") or ()
    for j, name in enumerate(data.skeleton.joints if data.skeleton is not None else ()):
        for body in (bodies[k] for k in used if k < len(bodies)):
            if {j, j + 1} <= set(body["segments"]):
                inside[name] = f"inside one body ({body['name']})"

    def describe_treatment(row: tuple[str, GapEntry]) -> str:
        return inside.get(row[0], "pinned" if row[1].pinned else "free")

    joints = to_grid(
        "Gap between the two sides of each joint (rms). A joint whose gap is within the noise of the cameras is pinned",
        list((motion.joints or {}).items()),
        (
            texts("joint", lambda row: row[0]),
            millimetres("gap (mm)", lambda row: row[1].gap_m),
            numbers("acceleration below 3 Hz (m/s²)", lambda row: row[1].acceleration_m_s2),
            texts("in the dynamics", describe_treatment),
        ),
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
    return Section(
        "motion",
        "Motion of the masses",
        (errors, joints, poses),
        text=(choice, _compare_errors(data, summary, motion)),
        needs="dynamics.h5",
    )


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


def _compute_rms(channel: ChannelEntry | None) -> float | None:
    if channel is None or channel.bias is None or channel.sd is None:
        return None
    return math.hypot(channel.bias, channel.sd)


def _get_rms(row: tuple[PredictedEntry, float | None], part: str) -> float | None:
    return _compute_rms(row[0].wrench.get(part))


def make_documents(data: ReportData, *, figures: bool = False, pdf_fonts: PdfFonts = "type-3") -> tuple[Document, ...]:
    """Return the files of :data:`mocap_id.reporting.FILES`, followed by the paper figures if requested."""
    summary = summarise(data)
    verdict = summary.verdict
    headline, lead = LEVELS[verdict.level]
    along = "the first horizontal axis of the recording" if data.in_space else "the motion"
    page = Page(
        name=data.trial,
        headline=headline,
        lead=lead,
        command="report",
        sections=tuple(make_sections(data, summary)),
        figures=draw_figures(data),
        footer=f"SI units; x along {along}, y up. Angles are in degrees here and in radians in the data files.",
        level=verdict.level,
        reasons=tuple(map(explain_reason, verdict.reasons)),
        key_numbers=tuple(make_key_numbers(data, summary)),
        player=make_player(data),
        notes=tuple(map(explain_reason, verdict.notes)),
    )
    contents = {SUMMARY_FILE: encode_summary(summary), PAGE_FILE: page.render()}
    if figures:
        from mocap_id.reporting import paper_figures  # noqa: PLC0415  loads matplotlib

        contents |= paper_figures.make_figure_files(
            read_figures(contents[PAGE_FILE].decode("utf-8")), pdf_fonts
        )  # as `mocap-id figures` does
    return tuple(Document(file, content) for file, content in contents.items())


_PER_INCH = 104  # pixels of the page for an inch on paper, as in chart.js
_TITLE = 0.35  # inches, for the title of a panel and the space below it
_PLAYER_HEIGHT = 860  # pixels, in a notebook 60rem wide


def render_notebook_view(document: Mapping[str, Any], player: Player | None = None) -> str:
    """Return the verdict, the main numbers with 95 % intervals, and the player as an HTML fragment.

    ``document`` is the content of ``summary.json``. Without a ``player``, the HTML fragment has no script.
    """
    summary = Summary.model_validate(document)
    headline, lead = LEVELS[summary.verdict.level]
    lengths = to_grid(
        "Segment lengths",
        summary.lengths_m or {},
        (
            with_sd("length ± sd (m)", "value", "sd"),
            GridColumn("95 % interval", lambda entry: show_interval(entry.value, entry.sd)),
        ),
        "segment",
    )
    volume = to_grid(
        "Reachable volume",
        {} if summary.workspace.volume_m3 is None else {"wrist": summary.workspace},
        (
            numbers("volume (m³)", "volume_m3", 3),
            GridColumn("95 % interval", lambda entry: show_ends(entry.interval_m3, 3)),
        ),
        "point",
    )
    vertical = (summary.dynamics.wrench or {}).get("Fy")
    parameters = to_grid(
        f"Base parameters; vertical force: r² {show_fixed(vertical.r2 if vertical else None, 4)}",
        summary.dynamics.base or (),
        (
            texts("parameter", "name"),
            with_sd("value ± sd", "value", "sd"),
            GridColumn("95 % interval", lambda entry: show_interval(entry.value, entry.sd)),
            texts("unit", lambda entry: style.format_unit(entry.unit)),
            texts("verdict", "verdict", UNKNOWN),
        ),
    )
    template = make_environment().get_template("notebook.html.j2")
    view = template.render(
        trial=style.clean(summary.trial),
        headline=headline,
        lead=lead,
        reasons=[explain_reason(reason) for reason in summary.verdict.reasons],
        grids=[lengths, list_angles(summary), volume, parameters],
    )
    return view if player is None else view + _make_frame(_render_page(summary.trial, player=player), _PLAYER_HEIGHT)


def render_figure_page(of: str, drawing: Drawing) -> str:
    """Return an HTML page, including its scripts, for one figure of the trial or study named ``of``."""
    return _render_page(of, drawing)


def render_figure_frame(of: str, drawing: Drawing) -> str:
    """Return an HTML frame that contains the page of one figure of the trial or study named ``of``."""
    panels = (
        0.0
        if isinstance(drawing.figure, str)
        else sum(max(panel.height for panel in line) + _TITLE for line in drawing.figure.lines)
    )
    return _make_frame(_render_page(of, drawing), round(_PER_INCH * panels) + 180)


def _render_page(of: str, *drawings: Drawing, player: Player | None = None) -> str:
    template = make_environment().get_template("notebook_frame.html.j2")
    embedded = embed(Drawings(of, drawings), player)
    return template.render(title=style.clean(of), drawings=drawings, player=player, embedded=embedded)


def _make_frame(page: str, height: int) -> str:
    """Return an HTML frame with a page whose scripts can access neither the notebook nor the network.

    ``height`` is in pixels.
    """
    look = f"width: 100%; height: {height}px; border: 0; resize: vertical; overflow: auto"
    return f'<iframe sandbox="allow-scripts allow-downloads" style="{look}" srcdoc="{escape(page)}"></iframe>'
