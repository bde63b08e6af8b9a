"""``summary.json``: verdict and numbers of a trial for other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.geometry.spatial_chain import SpatialJoint
from mocap_id.protocols.five_times import LOAD_PHASES, Attempt, FiveTimes, LoadShare, Spread
from mocap_id.reporting.numbers import NOT_FINITE, scale, to_number, to_numbers
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import (
    AngleEntry,
    BaseEntry,
    ChannelEntry,
    CompensationEntry,
    CurlsEntry,
    DynamicsEntry,
    EncoderEntry,
    GapEntry,
    HeldOutEntry,
    HypothesisEntry,
    ImuEntry,
    JointEntry,
    LandmarkEntry,
    LengthEntry,
    MarkersEntry,
    MotionEntry,
    NoiseEntry,
    PinsEntry,
    PlaneEntry,
    PredictedEntry,
    ReasonEntry,
    RepetitionEntry,
    RivalEntry,
    SegmentsEntry,
    Summary,
    TorqueEntry,
    TrendEntry,
    VerdictEntry,
    WorkspaceEntry,
)
from mocap_id.results import join_sentences, why_unknown
from mocap_id.store import Facts, Table
from mocap_id.store.views import MEANINGLESS_AT_POLE, IdentifiedDynamics, Skeleton, SpatialAngles

_NO_PLANE = "yaw_deg, origin_m: a trial in space has no plane of motion"
_NO_STATE_SD = "zero_sd_deg: the joint states have no standard deviations"
_NO_MOVEMENT_HELPS = "none of those tried"
_WIDE = 2.0  # times the median standard deviation; above it, a torque is not reported as the largest


def summarise(data: ReportData) -> Summary:
    """Return the summary of a trial; values of artefacts that are missing are null, with a ``why``."""
    joints = summarise_spatial_joints(data) if data.in_space else _summarise_joints(data)
    lengths = summarise_spatial_lengths(data) if data.in_space else _summarise_lengths(data)
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
        angles=summarise_angles(data),
        landmarks=summarise_landmarks(data),
        markers=_summarise_markers(data),
        noise=_summarise_noise(data),
        dynamics=_summarise_dynamics(data),
        repetitions=rises,
        five_times=summarise_five_times(data),
        attempts=failed,
        load_share=summarise_load_share(data),
        encoder=summarise_encoder(data),
        imus=summarise_imus(data),
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


_PINNED = "the dynamics use the pinned chain"


def summarise_motion(data: ReportData) -> MotionEntry | None:
    """Return the entry on the motion of the masses; None if nothing was identified."""
    found = data.facts("dynamics.h5").get("motion")
    if found is None:
        return None
    order = () if data.skeleton is None else data.skeleton.joints
    gaps = found.get("joints") or {}
    joints = {name: _summarise_gap(gaps[name]) for name in sorted(gaps, key=lambda name: (*order, name).index(name))}
    return MotionEntry(
        source=found["source"],
        why=str(found["why"]),
        bands_hz=data.bands,
        bands_why=found.get("bands_why"),
        bodies=found.get("bodies"),
        prior=found.get("prior"),
        bodies_condition_number=to_number(found.get("bodies_condition_number")),
        bodies_condition_number_scaled=to_number(found.get("bodies_condition_number_scaled")),
        joints=joints or None,
    )


def summarise_pins(data: ReportData) -> PinsEntry:
    """Return the errors of the pinned chain and the measured poses on the same left-out repetitions."""
    facts = data.facts("dynamics.h5")
    found, samples = facts.get("pins") or {}, to_number((facts.get("pins") or {}).get("samples"))
    unknown = _PINNED if facts.get("motion") else facts.get("why") or data.why_missing("dynamics.h5")
    return PinsEntry.explain(
        found.get("why") or unknown,
        samples=None if samples is None else int(samples),
        chain=_summarise_prediction(found.get("chain")),
        segments=_summarise_prediction(found.get("segments")),
        clock_offset_s=to_number(found.get("clock_offset_s")),
    )


def summarise_held_out(data: ReportData) -> HeldOutEntry:
    """Return the prediction errors on left-out repetitions; null with a ``why`` if there are none."""
    facts = data.facts("dynamics.h5")
    found = facts.get("held_out") or {}
    counts = {key: to_number(found.get(key)) for key in ("repetitions", "folds", "samples")}
    model, within, reference = (
        summarise_channels(found.get(key)) or None for key in ("model", "in_sample", "reference")
    )
    unfiltered = model if data.low_pass is None else summarise_channels(found.get("unfiltered")) or None
    inside = {
        str(name): share for name, held in (found.get("inside") or {}).items() if (share := to_number(held)) is not None
    }
    offsets = to_numbers(found.get("clock_offset_s"))
    unknown = found.get("why") or facts.get("why") or data.why_missing("dynamics.h5")
    no_share = f"inside: {_PINNED}" if data.low_pass is None else "inside: at least two repetitions are needed"
    why = (
        why_unknown(unknown, *counts.values(), model, unfiltered, within, offsets),
        why_unknown("reference: there is no reference body", reference) if model is not None else None,
        why_unknown(no_share, inside or None) if model is not None else None,
    )
    return HeldOutEntry(
        **{key: None if count is None else int(count) for key, count in counts.items()},
        model=model,
        unfiltered=unfiltered,
        in_sample=within,
        reference=reference,
        clock_offset_s=offsets,
        inside=inside or None,
        why=join_sentences(why),
    )


def _summarise_gap(found: Mapping[str, Any]) -> GapEntry:
    return GapEntry.explain(
        "no interval without gaps is long enough",
        gap_m=to_number(found["gap_m"]),
        acceleration_m_s2=to_number(found["acceleration_m_s2"]),
        pinned=bool(found["pinned"]),
    )


def _summarise_prediction(found: Mapping[str, Any] | None) -> PredictedEntry | None:
    if found is None:
        return None
    why = "no sample has a centre of pressure"
    return PredictedEntry.explain(
        why, wrench=summarise_channels(found["wrench"]), cop_rms_m=to_number(found["cop_rms_m"])
    )


_FILE = "events.parquet"


def summarise_repetitions(data: ReportData) -> list[RepetitionEntry] | None:
    """Return one entry for each repetition; None if repetitions were not searched for."""
    if data.table(_FILE) is None:
        return None
    entries = []
    for row in data.rows(_FILE):
        named = (name for name in RepetitionEntry.model_fields if name not in ("remark", "why"))
        found = RepetitionEntry.of(
            {name: row.get(name.removesuffix("_s")) for name in named} | {"remark": row["why"] or ""}
        )
        if None in [value for name, value in found if name != "why"]:
            why = found.remark or "the protocol has no such event, or it was not found"
            found = found.model_copy(update={"why": why})
        entries.append(found)
    return entries


def summarise_five_times(data: ReportData) -> FiveTimes:
    """Return the times of the five-times test; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("five_times")
    if facts is None:
        return FiveTimes(why=_explain_missing(data))
    found = FiveTimes.of(facts)
    stops = ("to_fifth_stand", "to_fifth_seat_contact", "to_fifth_seated")
    times = {stop: (getattr(found, f"{stop}_s"), getattr(found, f"{stop}_sd_s")) for stop in stops}
    spread = [stop for stop, (time, sd) in times.items() if time is not None and sd is None]
    why = found.why
    if why is None and spread:
        why = f"the standard deviation is unknown: {', '.join(spread)}; the rule for the contact gives none"
    elif why is None and None in (found.mean_cycle_s, found.cycle_sd_s, *(time for time, _ in times.values())):
        why = "fewer than three rises reach standing"
    return found.model_copy(update={"why": why})


def summarise_attempts(data: ReportData) -> list[Attempt] | None:
    """Return the failed attempts to rise; None for other protocols."""
    found = data.facts(_FILE).get("attempts")
    return None if found is None else [Attempt.of(one) for one in found]


def summarise_load_share(data: ReportData) -> LoadShare:
    """Return the fraction of the load on the left foot by phase; null with a ``why`` if unknown."""
    facts = data.facts(_FILE).get("load_share")
    if facts is None:
        return LoadShare(why=_explain_missing(data))
    found = LoadShare.of(facts)
    ordered = {phase: found.left.get(phase, Spread()) for phase in LOAD_PHASES}  # a file has its keys in another order
    found = found.model_copy(update={"left": ordered})
    if found.why is None and any(None in (one.mean, one.sd) for one in found.left.values()):
        return found.model_copy(update={"why": "a phase occurs in fewer than two repetitions"})
    return found


def _explain_missing(data: ReportData) -> str:
    return "the protocol is not sit-to-stand" if _FILE in data.artefacts else data.why_missing(_FILE)


_NUMBERS = ("zero_rad", "zero_sd_rad", "clock_offset_s", "clock_offset_sd_s")


def summarise_base_length(data: ReportData, skeleton: Skeleton) -> dict[str, LengthEntry]:
    """Return the distance of a robot joint from the plane origin (thesis table 5.1); empty for other protocols."""
    if data.settings.get("protocol") != "robot-joint" or not len(skeleton.centres):
        return {}
    value = float(np.hypot(*skeleton.centres[0]))
    along = skeleton.centres[0] / value if value > 0 else np.zeros(2)
    sd = float(np.sqrt(along @ skeleton.covariance[0] @ along))
    return {"base": LengthEntry.explain(NOT_FINITE, value=to_number(value), sd=to_number(sd))}


def summarise_channels(found: Mapping[str, Mapping[str, object] | None] | None) -> dict[str, ChannelEntry]:
    """Return the error of a model or measurement in each component, by its name; empty for None."""
    return {str(name): _summarise_channel(channel) for name, channel in (found or {}).items()}


def _summarise_channel(channel: Mapping[str, object] | None) -> ChannelEntry:
    numbers = {key: to_number((channel or {}).get(key)) for key in ("bias", "sd", "r2")}
    return ChannelEntry.explain("it could not be computed from the samples of the fit", **numbers)


def summarise_encoder(data: ReportData) -> EncoderEntry:
    """Return clock and zero of the encoder, and the errors of cameras and model against the encoder."""
    facts: Mapping[str, Any] = data.facts("encoder.parquet")
    torque = data.facts("dynamics.h5").get("torque")
    sign, why = to_number(facts.get("sign")), facts.get("why")
    if sign is None and why is None:
        why = data.why_missing("encoder.parquet")
    if why is None and torque is None:
        why = "torque: " + ("no torque was identified" if facts.get("torque") else "the encoder record has none")
    return EncoderEntry(
        sign=None if sign is None else int(sign),
        **{name: to_number(facts.get(name)) for name in _NUMBERS},
        camera=summarise_channels(facts.get("camera")) or None,
        torque=None if torque is None else _summarise_channel(torque),
        why=why,
    )


AXES = {"ball": 0, "hinge": 1, "two-axis": 2}
"""Number of axes of each kind of joint."""

_HIDDEN = "the motion does not determine the centre of this joint: use `calibration:`, or record a larger motion"


def summarise_spatial_joints(data: ReportData) -> list[JointEntry] | None:
    """Return the joints; None if no chain was found."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return None
    weighed = data.facts("chain.h5").get("evidence") or {}
    named = zip(skeleton.joints, skeleton.chain.joints, skeleton.arc, strict=True)
    return [_summarise_joint(name, joint, float(arc), weighed.get(name) or {}) for name, joint, arc in named]


def _summarise_joint(name: str, joint: SpatialJoint, arc: float, weighed: Mapping[str, Any]) -> JointEntry:
    centre, sd = (to_numbers(each) if joint.known else None for each in (joint.centre, _compute_sd(joint.covariance)))
    axes = [to_numbers(axis) for axis in (joint.first_axis, joint.second_axis)[: AXES[joint.kind]]]
    arc_deg = to_number(np.degrees(arc))
    axis = axes[0] if len(axes) == 1 else axes
    why = (
        why_unknown(NOT_FINITE if joint.known else _HIDDEN, centre, sd),
        why_unknown("axis: a ball has no axis" if not axes else "axis: " + NOT_FINITE, *(axes or [None])),
        why_unknown(f"arc_deg: {NOT_FINITE}", arc_deg),
    )
    return JointEntry(
        name=name,
        parent=joint.parent,
        kind=joint.kind,
        centre_m=centre,
        sd_m=sd,
        axis=None if not axes or None in axes else axis,  # type: ignore[arg-type]
        axis_sd_deg=[
            spread for each in joint.axes_covariance[: len(axes)] if (spread := compute_axis_sd(each)) is not None
        ],
        glide_m=_read_glide(joint.glide, joint.glide),
        glide_sd_m=_read_glide(joint.glide, _compute_sd(joint.glide_covariance)),
        arc_deg=arc_deg,
        known=joint.known,
        evidence={str(kind): cost for kind, value in weighed.items() if (cost := to_number(value)) is not None},
        why=join_sentences(why),
    )


def _read_glide(glide: FloatArray, values: FloatArray) -> list[float]:
    """Return ``values`` as a list; empty if ``glide`` is zero, because the joint then has no glide."""
    return (to_numbers(values) or []) if np.any(glide) else []


def _compute_sd(covariance: FloatArray) -> FloatArray:
    variance = np.diagonal(covariance)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def compute_axis_sd(covariance: FloatArray) -> float | None:
    """Return the standard deviation of an axis's direction, degrees, from its covariance (3, 3); None if unknown."""
    return to_number(np.degrees(np.sqrt(np.trace(covariance) / 2)))


def summarise_spatial_lengths(data: ReportData) -> dict[str, LengthEntry] | None:
    """Return the lengths of the segments; None if no chain was found."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return None
    why = "the motion does not determine both ends of the segment"
    lengths = skeleton.lengths.items()
    return {name: LengthEntry.explain(why, value=to_number(length), sd=to_number(sd)) for name, (length, sd) in lengths}


def summarise_angles(data: ReportData) -> dict[str, AngleEntry]:
    """Return the statistics of every angle; empty without ``angles.parquet``."""
    found = data.angles
    return {} if found is None else {name: _summarise_angle(found, k) for k, name in enumerate(found.names)}


def _summarise_angle(found: SpatialAngles, k: int) -> AngleEntry:
    """Return the statistics of one angle.

    A constant error of a segment's frame changes an angle by different amounts in different poses. The errors at both
    ends of a range have a correlation of about 0.5, so the range has about the same standard deviation as each end.
    """
    name = found.names[k]
    usable = found.find_usable(name)
    share = float(usable.mean()) if len(usable) else 0.0
    if not usable.any():
        why = "the angle is unknown in every sample"
        if name in MEANINGLESS_AT_POLE and np.isfinite(found.mean[:, k, 0]).any():
            why = "the elevation is within 15° of 0 or 180° in every sample, where this angle has no meaning"
        nothing = dict.fromkeys(("low_deg", "high_deg", "range_deg", "interval_deg", "sd_deg", "constant_sd_deg"))
        return AngleEntry(**nothing, used_share=share, why=why)
    turned = found.mean[usable, k, 0]
    values = np.degrees(shift_to_shortest_arc(turned) if name in MEANINGLESS_AT_POLE else turned)
    sd = np.degrees(found.sd[usable, k, 0])
    ends = [int(values.argmin()), int(values.argmax())]
    low, high = (float(values[end]) for end in ends)
    constant = to_number(np.degrees(np.sqrt(np.mean(np.square(found.constant_sd[usable, k])))))
    spread = None if constant is None else to_number(np.linalg.norm([*sd[ends], constant]))
    interval = None if spread is None else [max(high - low - NORMAL_95 * spread, 0.0), high - low + NORMAL_95 * spread]
    typical = to_number(np.sqrt(np.mean(np.square(sd))))
    return AngleEntry(
        low_deg=low,
        high_deg=high,
        range_deg=high - low,
        interval_deg=interval,
        sd_deg=typical,
        constant_sd_deg=constant,
        used_share=share,
        why=why_unknown("the standard deviation is unknown", interval, typical, constant),
    )


def summarise_landmarks(data: ReportData) -> dict[str, LandmarkEntry]:
    """Return the anatomical landmarks by name; empty if there are none."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return {}
    rows = zip(
        skeleton.landmarks, skeleton.landmark_segment, skeleton.landmark_local, skeleton.landmark_sd, strict=True
    )
    return {
        name: LandmarkEntry.explain(
            "the landmark is not visible in a still pose or a pointer trial",
            segment=skeleton.segments[int(segment)],
            local_m=to_numbers(local),
            sd_m=to_number(sd),
        )
        for name, segment, local, sd in rows
    }


def summarise_imus(data: ReportData) -> dict[str, ImuEntry]:
    """Return the inertial sensors by segment; empty if there are none."""
    return {name: ImuEntry(**entry) for name, entry in data.facts("states.parquet").get("imus", {}).items()}


def summarise_curls(data: ReportData) -> CurlsEntry:
    """Return counts, end of the trial, compensation, torque and fatigue; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("curl")
    if facts is None:
        return CurlsEntry(why="only `protocol: curl` counts curls")
    torque = [one for one in facts.get("torque") or () if one is not None]
    peak = max(torque, key=lambda one: one["peak_Nm"], default=None)
    return CurlsEntry(
        count=facts.get("count"),
        partial=facts.get("partial"),
        after_end=facts.get("after_end"),
        condition=facts.get("condition"),
        end_s=to_number((facts.get("end") or {}).get("time_s")),
        end_rule=(facts.get("end") or {}).get("rule"),
        compensation={
            name: _summarise_compensation(found, (facts.get("in_step") or {}).get(name))
            for name, found in (facts.get("compensation") or {}).items()
        },
        largest_torque_nm=None if peak is None else peak["peak_Nm"],
        largest_torque_sd_nm=None if peak is None else peak["sd_Nm"],
        fatigue={
            name: _summarise_trend(found) for name, found in (facts.get("fatigue") or {}).items() if found is not None
        },
        why=facts.get("why") or facts.get("torque_why") or None,
    )


def _summarise_compensation(found: list[dict[str, Any] | None], in_step: Mapping[str, Any] | None) -> CompensationEntry:
    """Return the compensation of one angle, degrees.

    ``found`` has an entry for each curl, None for a failed attempt; ``in_step`` is the part of the angle that depends
    on the flexion alone, None if it is not separated.
    """

    def degrees(value: float) -> float:
        return float(np.degrees(value))

    there = [one or {} for one in found]
    return CompensationEntry(
        range_deg=[degrees(one["range_rad"]) if one else None for one in there],
        interval_deg=[[degrees(end) for end in one["interval_rad"]] if one else None for one in there],
        floor_deg=[degrees(one["floor_rad"]) if one else None for one in there],
        offset_deg=[degrees(one["offset_rad"]) if one else None for one in there],
        sustained_s=[one["sustained_s"] if one else None for one in there],
        in_step_deg=None if in_step is None else degrees(in_step["range_rad"]),
        in_step_interval_deg=None if in_step is None else [degrees(end) for end in in_step["interval_rad"]],
    )


def _summarise_trend(found: Mapping[str, Any]) -> TrendEntry:
    return TrendEntry(slope=found["slope"], interval=found["interval"], curls=found["count"])


_VIEW_ONLY = {"mesh", "view", "why"}


def summarise_workspace(data: ReportData) -> WorkspaceEntry:
    """Return the reachable volume and the quantities about it; null with a ``why`` for other protocols."""
    facts = data.facts(_FILE).get("reach")
    if facts is None:
        where = "only `protocol: reach` has a reachable volume"
        return WorkspaceEntry(why=where if data.in_space else f"{where}, which needs `space: 3d`")
    return WorkspaceEntry(**{k: v for k, v in facts.items() if k not in _VIEW_ONLY}, why=facts.get("why") or None)
