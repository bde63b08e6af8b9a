"""``summary.json``: verdict and numbers of a trial for other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.reporting.dynamics_schema import BaseEntry, DynamicsEntry, RivalEntry, TorqueEntry
from mocap_id.reporting.numbers import NOT_FINITE, scale, to_number, to_numbers
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.robot_joint_summary import summarise_base_length, summarise_channels, summarise_encoder
from mocap_id.reporting.space import summary as spatial
from mocap_id.reporting.space.curls import summarise_curls
from mocap_id.reporting.space.reaches import summarise_workspace
from mocap_id.reporting.summary_motion import summarise_held_out, summarise_motion, summarise_pins
from mocap_id.reporting.summary_repetitions import (
    summarise_attempts,
    summarise_five_times,
    summarise_load_share,
    summarise_repetitions,
)
from mocap_id.reporting.summary_schema import (
    HypothesisEntry,
    JointEntry,
    LengthEntry,
    MarkersEntry,
    NoiseEntry,
    PlaneEntry,
    ReasonEntry,
    SegmentsEntry,
    Summary,
    VerdictEntry,
)
from mocap_id.results import join_sentences, why_unknown
from mocap_id.store import Facts, Table
from mocap_id.store.views import IdentifiedDynamics

_NO_PLANE = "yaw_deg, origin_m: a trial in space has no plane of motion"
_NO_STATE_SD = "zero_sd_deg: the joint states have no standard deviations"
_NO_MOVEMENT_HELPS = "none of those tried"
_WIDE = 2.0  # times the median standard deviation; above it, a torque is not reported as the largest


def summarise(data: ReportData) -> Summary:
    """Return the summary of a trial; values of artefacts that are missing are null, with a ``why``."""
    joints = spatial.summarise_joints(data) if data.in_space else _summarise_joints(data)
    lengths = spatial.summarise_lengths(data) if data.in_space else _summarise_lengths(data)
    rises, failed = summarise_repetitions(data), summarise_attempts(data)
    seconds = _summarise_run_times(data)
    why = (
        why_unknown(f"joints and lengths_m: {data.why_missing('chain.h5')}", joints, lengths),
        why_unknown(f"repetitions: {data.why_missing('events.parquet')}", rises),
        why_unknown("attempts: only a sit-to-stand has them", failed) if data.in_space else None,
        why_unknown("time_s: the run times of the stages were not recorded", seconds),
    )
    return Summary(
        trial=data.trial,
        product=data.product,
        space="3d" if data.in_space else "plane",
        mirrored=data.facts("planar.parquet").get("side") == "left",
        verdict=_summarise_verdict(data),
        plane=_summarise_plane(data),
        segments=_summarise_segments(data),
        joints=joints,
        lengths_m=lengths,
        angles=spatial.summarise_angles(data),
        landmarks=spatial.summarise_landmarks(data),
        markers=_summarise_markers(data),
        noise=_summarise_noise(data),
        dynamics=_summarise_dynamics(data),
        repetitions=rises,
        five_times=summarise_five_times(data),
        attempts=failed,
        load_share=summarise_load_share(data),
        encoder=summarise_encoder(data),
        imus=spatial.summarise_imus(data),
        workspace=summarise_workspace(data),
        curls=summarise_curls(data),
        time_s=seconds,
        why=join_sentences(why),
    )


def to_json(summary: Summary) -> bytes:
    """Return the content of ``summary.json``: strict JSON without NaN, in ASCII, with a final newline."""
    text = json.dumps(summary.model_dump(mode="json", by_alias=True), allow_nan=False, indent=1)
    return (text + "\n").encode("ascii")


def _summarise_verdict(data: ReportData) -> VerdictEntry:
    entries = [
        ReasonEntry(
            code=reason.code,
            message=reason.message,
            value=to_number(reason.value),
            limit=to_number(reason.limit),
            level=reason.level,
        )
        for reason in data.reasons
    ]
    reasons = [entry for entry in entries if entry.level != "ok"]
    return VerdictEntry(level=data.level, reasons=reasons, notes=[entry for entry in entries if entry.level == "ok"])


def _summarise_plane(data: ReportData) -> PlaneEntry:
    plane = data.facts("planar.parquet").get("plane") or {}
    if data.in_space:
        plane = {"planarity": data.facts("planar.parquet").get("planarity"), "why": _NO_PLANE, **plane}
    yaw, planarity = to_number(plane.get("yaw_deg")), to_number(plane.get("planarity"))
    origin = to_numbers(plane.get("origin_m"))
    share = to_number(data.facts("segments.parquet").get("planarity"))
    why = (
        why_unknown(plane.get("why") or data.why_missing("planar.parquet"), yaw, planarity, origin),
        why_unknown(f"out_of_plane_share: {data.why_missing('segments.parquet')}", share),
    )
    return PlaneEntry(
        yaw_deg=yaw, planarity=planarity, out_of_plane_share=share, origin_m=origin, why=join_sentences(why)
    )


def _summarise_segments(data: ReportData) -> SegmentsEntry:
    facts = data.facts("segments.parquet")
    count, names, against = to_number(facts.get("count")), facts.get("names"), facts.get("against")
    assignment = {row["marker"]: row["segment"] for row in data.rows("segments.parquet") if row["segment"] >= 0}
    return SegmentsEntry.explain(
        facts.get("why") or data.why_missing("segments.parquet"),
        count=None if count is None else int(count),
        names=None if names is None else [str(name) for name in names],
        assignment=None if data.table("segments.parquet") is None else assignment,
        confidence=to_number(facts.get("confidence")),
        against=None if against is None else {str(evidence): float(off) for evidence, off in against.items()},
        hypotheses=_summarise_hypotheses(facts),
    )


def _summarise_hypotheses(facts: Facts) -> list[HypothesisEntry] | None:
    """Return the segmentations that were considered, the chosen one first; None if they are unknown."""
    if facts.get("hypotheses") is None:
        return None
    return [
        HypothesisEntry(
            segments=int(entry["segments"]),
            cost=float(entry["cost"]),
            why=str(entry["why"]),
            chosen=k == 0,
            left_out=sum(len(body) for body in entry["left_out"]),
            joint_residual_m=[float(residual) for residual in entry["joint_residual_m"]],
            arc_deg=[float(arc) for arc in entry["arc_deg"]],
        )
        for k, entry in enumerate(facts["hypotheses"])
    ]


def _summarise_joints(data: ReportData) -> list[JointEntry] | None:
    skeleton = data.skeleton
    if skeleton is None:
        return None
    return [
        JointEntry.explain(
            NOT_FINITE if data.zeros[j].sd is not None else _NO_STATE_SD,
            name=name,
            parent=int(skeleton.parents[j]),
            centre_m=to_numbers(skeleton.centres[j]),
            sd_m=to_numbers(skeleton.centre_sd[j]),
            arc_deg=to_number(np.degrees(skeleton.arc[j])),
            zero=data.zeros[j].source,
            zero_deg=float(np.degrees(data.zeros[j].value)),
            zero_sd_deg=scale(data.zeros[j].sd, 180 / np.pi),
        )
        for j, name in enumerate(skeleton.joints)
    ]


def _summarise_lengths(data: ReportData) -> dict[str, LengthEntry] | None:
    """Return the lengths of the segments between two joints, for a robot also of its base; None without a chain."""
    skeleton = data.skeleton
    if skeleton is None:
        return None
    lengths = zip(skeleton.segments[1:-1], skeleton.lengths, skeleton.lengths_sd, strict=True)
    entries = {name: LengthEntry.explain(NOT_FINITE, value=to_number(m), sd=to_number(sd)) for name, m, sd in lengths}
    return summarise_base_length(data, skeleton) | entries


def _summarise_markers(data: ReportData) -> MarkersEntry:
    rms = to_number(data.facts("states.parquet").get("reprojection_rms_m"))
    missing = to_number(data.facts("planar.parquet").get("missing_fraction"))
    why = (
        why_unknown(data.why_missing("states.parquet"), rms),
        why_unknown(data.why_missing("planar.parquet"), missing),
    )
    return MarkersEntry(reprojection_rms_mm=scale(rms, 1e3), missing_fraction=missing, why=join_sentences(why))


def _summarise_noise(data: ReportData) -> NoiseEntry:
    facts = data.facts("states.parquet")
    sigma_v = facts.get("sigma_v")
    each = to_numbers(sigma_v if isinstance(sigma_v, (list, tuple)) else [sigma_v])
    return NoiseEntry.explain(
        facts.get("why") or data.why_missing("states.parquet"),
        marker_sd_m=to_number(facts.get("marker_sd_m")),
        sigma_v=None if each is None else float(np.sqrt(np.mean(np.square(each)))),
        sigma_v_per_joint=each,
    )


def _summarise_dynamics(data: ReportData) -> DynamicsEntry:
    facts = data.facts("dynamics.h5")
    identified = {
        key: to_number(facts.get(key))
        for key in ("condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m")
    }
    samples = to_number(facts.get("samples"))
    base, wrench = _summarise_parameters(data), summarise_channels(facts.get("wrench")) or None
    consistency, moved = facts.get("consistency"), summarise_motion(data)
    mass, cop = to_number(data.facts("wrench.parquet").get("mass_kg")), compute_mean_cop(data.table("wrench.parquet"))
    why = [
        why_unknown(
            facts.get("why") or data.why_missing("dynamics.h5"),
            *(*identified.values(), samples, base, wrench, consistency, moved),
        ),
        why_unknown(data.facts("wrench.parquet").get("why") or data.why_missing("wrench.parquet"), mass, cop),
    ]
    return DynamicsEntry(
        base=base,
        wrench=wrench,
        samples=None if samples is None else int(samples),
        mass_kg=mass,
        cop_mean_m=cop,
        consistency=consistency,
        rivals={str(name): _summarise_reference_body(body) for name, body in (facts.get("rivals") or {}).items()},
        held_out=summarise_held_out(data),
        motion=moved,
        pins=summarise_pins(data),
        legs=data.facts("dynamics.parquet").get("legs", "none"),
        torques=_summarise_torques(data, base, mass),
        why=join_sentences(why),
        **identified,
    )


def _summarise_torques(data: ReportData, base: list[BaseEntry] | None, mass: float | None) -> dict[str, TorqueEntry]:
    """Return the largest known torques of each joint in the plane; empty without an identification."""
    table, skeleton = data.table("dynamics.parquet"), data.skeleton
    if table is None or skeleton is None or base is None:
        return {}
    if mass is None:
        mass = next((each.value for each in base if each.unit == "kg" and each.verdict == "known"), None)
    words, entries = data.facts("dynamics.parquet").get("positive") or {}, {}
    for j, name in enumerate(skeleton.joints, start=1):
        torque, sd = table[f"tau_{j}"], table[f"sd_tau_{j}"]
        known = np.isfinite(torque) & np.isfinite(sd)
        free = known & ~data.contact
        used = np.flatnonzero(free & (sd <= _WIDE * np.median(sd[free]))) if free.any() else np.zeros(0, dtype=int)
        found: dict[str, float | None] = {}
        for end, pick in (("highest", np.argmax), ("lowest", np.argmin)):
            k = None if not len(used) else int(used[pick(torque[used])])
            found |= {
                f"{end}_nm": None if k is None else float(torque[k]),
                f"{end}_sd_nm": None if k is None else float(sd[k]),
                f"{end}_nm_per_kg": None if k is None or mass is None else float(torque[k]) / mass,
                f"{end}_time_s": None if k is None else float(table["time"][k]),
            }
        why = (
            why_unknown("the mass of the person is unknown", mass),
            None if len(used) else _explain_no_torque(data, j, known=bool(known.any())),
        )
        positive, negative = words.get(name, ("positive", "negative"))
        entries[name] = TorqueEntry(
            positive=positive,
            negative=negative,
            mass_kg=mass,
            known=float(known.mean()) if len(known) else 0.0,
            why=join_sentences(why),
            **found,
        )
    return entries


def _explain_no_torque(data: ReportData, joint: int, *, known: bool) -> str:
    if f"tau_{joint}" in (data.facts("dynamics.h5").get("untold") or ()):
        return "the fit does not determine this torque: both sides of the joint may be one body"
    support = "a chair or support that no plate measures carries, or may carry, the body"
    return f"{support} whenever the torque is known" if known else f"{support} in every sample"


def compute_mean_cop(wrench: Table | None) -> float | None:
    """Return the mean centre of pressure along the motion, m, over samples with valid load; None without any."""
    if wrench is None:
        return None
    cop = wrench["cop_x"][wrench["plate_ok"]]
    cop = cop[np.isfinite(cop)]
    return float(cop.mean()) if len(cop) else None


def _summarise_parameters(data: ReportData) -> list[BaseEntry] | None:
    """Return the base parameters; None if none was identified."""
    dynamics, facts = data.dynamics, data.facts("dynamics.h5")
    if dynamics is None or not dynamics.names:
        return None
    why = str(facts.get("why") or "the identification gave no finite value")
    advice = facts.get("advice") or []
    entries = [
        _summarise_parameter(dynamics, i, why, advice[i] if i < len(advice) else {}) for i in range(len(dynamics.names))
    ]
    return None if all(entry.value is None for entry in entries) else entries


def _summarise_parameter(dynamics: IdentifiedDynamics, i: int, why: str, advice: Mapping[str, Any]) -> BaseEntry:
    """Return the i-th base parameter, with ``why`` if its value or standard deviation is unknown."""
    value, sd = to_number(dynamics.value[i]), to_number(dynamics.sd[i])
    verdict: Any = dynamics.verdicts[i] if i < len(dynamics.verdicts) else None
    return BaseEntry(
        name=dynamics.names[i],
        value=value,
        sd=sd,
        unit=dynamics.units[i],
        verdict=verdict,
        relative_sd=_get(dynamics.relative_sd, i),
        excitation=_get(dynamics.excitation, i),
        own_share=_get(dynamics.own_share, i),
        helps=(advice["text"] or _NO_MOVEMENT_HELPS) if advice else None,
        prior_share=_get(dynamics.prior_share, i),
        sd_ratio=(1.0 if advice["sd_ratio"] is None else to_number(advice["sd_ratio"])) if advice else None,
        why=why_unknown(why, value, sd),
    )


def _get(values: FloatArray, i: int) -> float | None:
    return to_number(values[i]) if i < len(values) else None


def _summarise_reference_body(facts: Mapping[str, Any]) -> RivalEntry:
    return RivalEntry.explain(
        "no samples off the seat are available",
        height_m=to_number(facts.get("height_m")),
        mass_kg=to_number(facts.get("mass_kg")),
        assumed=[str(assumption) for assumption in facts.get("assumed") or ()],
        wrench=summarise_channels(facts.get("wrench")),
        cop_rms_m=to_number(facts.get("cop_rms_m")),
    )


def _summarise_run_times(data: ReportData) -> dict[str, float] | None:
    if data.seconds is None:
        return None
    times = {stage: to_number(seconds) for stage, seconds in data.seconds.items()}
    return {stage: seconds for stage, seconds in times.items() if seconds is not None}
