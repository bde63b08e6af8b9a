"""``summary.json``: verdict and numbers of a trial for other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.protocols.five_times import LOAD_PHASES, Attempt, FiveTimes, LoadShare, Spread
from mocap_id.reporting import summary_schema as schema
from mocap_id.reporting.grids import scale, to_number, to_numbers
from mocap_id.reporting.report_data import ReportData
from mocap_id.results import join_sentences, why_unknown
from mocap_id.store.artefacts import MEANINGLESS_AT_POLE

_EVENTS = "events.parquet"
_NOT_FINITE = "the joint fit gave no finite value"
_NO_PLANE = "yaw_deg, origin_m: a trial in space has no plane of motion"
_NO_STATE_SD = "zero_sd_deg: the joint states have no standard deviations"
_NO_MOVEMENT_HELPS = "none of those tried"
_PINNED = "the dynamics use the pinned chain"
_HIDDEN = "the motion does not determine the centre of this joint: use `calibration:`, or record a larger motion"
_WIDE = 2.0  # times the median standard deviation; above it, a torque is not reported as the largest
_AXES = {"ball": 0, "hinge": 1, "two-axis": 2}  # number of axes of each kind of joint


def summarise(data: ReportData) -> schema.Summary:
    """Return the summary of a trial; values of artefacts that are missing are null, with a ``why``."""
    joints, lengths = _summarise_spatial_chain(data) if data.in_space else _summarise_chain(data)
    rises, failed = _summarise_repetitions(data), data.facts(_EVENTS).get("attempts")
    seconds = None if data.seconds is None else {k: s for k, s in data.seconds.items() if to_number(s) is not None}
    why = (
        why_unknown(f"joints and lengths_m: {data.why_missing('chain.h5')}", joints, lengths),
        why_unknown(f"repetitions: {data.why_missing(_EVENTS)}", rises),
        why_unknown("attempts: only a sit-to-stand has them", failed) if data.in_space else None,
        why_unknown("time_s: the run times of the stages were not recorded", seconds),
    )
    planar, states, segments = (data.facts(f"{name}.parquet") for name in ("planar", "states", "segments"))
    missing = {name: data.why_missing(f"{name}.parquet") for name in ("planar", "states", "segments", "encoder")}
    residual, gaps, share = states.get("reprojection_rms_m"), planar.get("missing_fraction"), segments.get("planarity")
    why_markers = (why_unknown(missing["states"], residual), why_unknown(missing["planar"], gaps))
    # plane of motion
    plane = planar.get("plane") or {}
    if data.in_space:
        plane = {"planarity": planar.get("planarity"), "why": _NO_PLANE, **plane}
    yaw, planarity, origin = plane.get("yaw_deg"), plane.get("planarity"), to_numbers(plane.get("origin_m"))
    why_plane = (
        why_unknown(plane.get("why") or missing["planar"], yaw, planarity, origin),
        why_unknown(f"out_of_plane_share: {missing['segments']}", share),
    )
    # markers by segment, and the segmentations that were considered, the chosen one first
    assignment = {row["marker"]: row["segment"] for row in data.rows("segments.parquet") if row["segment"] >= 0}
    hypotheses = segments.get("hypotheses")
    if hypotheses is not None:
        hypotheses = [
            schema.HypothesisEntry.of(
                {**entry, "chosen": k == 0, "left_out": sum(len(body) for body in entry["left_out"])}
            )
            for k, entry in enumerate(hypotheses)
        ]
    sigma_v = states.get("sigma_v")
    each = to_numbers(sigma_v if isinstance(sigma_v, (list, tuple)) else [sigma_v])
    # clock and zero of the encoder, and the errors of cameras and model against it
    encoder, torque = data.facts("encoder.parquet"), data.facts("dynamics.h5").get("torque")
    why_encoder = encoder.get("why")
    if encoder.get("sign") is None and why_encoder is None:
        why_encoder = missing["encoder"]
    if why_encoder is None and torque is None:
        why_encoder = "torque: " + (
            "no torque was identified" if encoder.get("torque") else "the encoder record has none"
        )
    reach = data.facts(_EVENTS).get("reach")
    if reach is None:
        where = "only `protocol: reach` has a reachable volume"
        reach = {"why": where if data.in_space else f"{where}, which needs `space: 3d`"}
    reasons = [schema.ReasonEntry(**reason.as_dict()) for reason in data.reasons]
    angles, skeleton, landmarks = data.angles, data.spatial_skeleton, {}
    if skeleton is not None:
        for k, name in enumerate(skeleton.landmarks):
            landmarks[name] = schema.LandmarkEntry.explain(
                "the landmark is not visible in a still pose or a pointer trial",
                segment=skeleton.segments[int(skeleton.landmark_segment[k])],
                local_m=to_numbers(skeleton.landmark_local[k]),
                sd_m=to_number(skeleton.landmark_sd[k]),
            )
    return schema.Summary(
        trial=data.trial,
        product=data.product,
        space="3d" if data.in_space else "plane",
        mirrored=planar.get("side") == "left",
        verdict=schema.VerdictEntry(
            level=data.level,
            reasons=[entry for entry in reasons if entry.level != "ok"],
            notes=[entry for entry in reasons if entry.level == "ok"],
        ),
        plane=schema.PlaneEntry(
            yaw_deg=yaw,
            planarity=planarity,
            out_of_plane_share=share,
            origin_m=origin,
            why=join_sentences(why_plane),
        ),
        segments=schema.SegmentsEntry.explain(
            data.explain("segments.parquet"),
            segments,
            assignment=None if data.table("segments.parquet") is None else assignment,
            hypotheses=hypotheses,
        ),
        joints=joints,
        lengths_m=lengths,
        angles={} if angles is None else {name: _summarise_angle(data, k) for k, name in enumerate(angles.names)},
        landmarks=landmarks,
        markers=schema.MarkersEntry(
            reprojection_rms_mm=scale(residual, 1e3), missing_fraction=gaps, why=join_sentences(why_markers)
        ),
        noise=schema.NoiseEntry.explain(
            data.explain("states.parquet"),
            states,
            sigma_v=None if each is None else float(np.sqrt(np.mean(np.square(each)))),
            sigma_v_per_joint=each,
        ),
        dynamics=_summarise_dynamics(data),
        repetitions=rises,
        five_times=_summarise_five_times(data),
        attempts=None if failed is None else [Attempt.of(one) for one in failed],
        load_share=_summarise_load_share(data),
        encoder=schema.EncoderEntry.explain(
            "",
            encoder,
            camera=_summarise_channels(encoder.get("camera")) or None,
            torque=None if torque is None else _summarise_channels({"torque": torque})["torque"],
        ).model_copy(update={"why": why_encoder}),
        imus={name: schema.ImuEntry(**entry) for name, entry in states.get("imus", {}).items()},
        workspace=schema.WorkspaceEntry.of({**reach, "why": reach.get("why") or None}),
        curls=_summarise_curls(data),
        time_s=seconds,
        why=join_sentences(why),
    )


def encode_summary(summary: schema.Summary) -> bytes:
    """Return the content of ``summary.json``: strict JSON without NaN, in ASCII, with a final newline."""
    text = json.dumps(summary.model_dump(mode="json", by_alias=True), allow_nan=False, indent=1)
    return (text + "\n").encode("ascii")


def _summarise_chain(data: ReportData) -> tuple[list[schema.JointEntry] | None, dict[str, schema.LengthEntry] | None]:
    """Return joints, and lengths of segments between two joints, of the chain in the plane; None without a chain.

    For a robot, the lengths contain the distance of the joint from the plane origin (thesis table 5.1), ``base``.
    """
    skeleton = data.skeleton
    if skeleton is None:
        return None, None
    joints = []
    for j, name in enumerate(skeleton.joints):
        source, value, sd = data.zeros[j]
        joints.append(
            schema.JointEntry.explain(
                _NOT_FINITE if sd is not None else _NO_STATE_SD,
                name=name,
                parent=int(skeleton.parents[j]),
                centre_m=to_numbers(skeleton.centres[j]),
                sd_m=to_numbers(skeleton.centre_sd[j]),
                arc_deg=to_number(np.degrees(skeleton.arc[j])),
                zero=source,
                zero_deg=float(np.degrees(value)),
                zero_sd_deg=scale(sd, 180 / np.pi),
            )
        )
    lengths = list(zip(skeleton.segments[1:-1], skeleton.lengths, skeleton.lengths_sd, strict=True))
    if data.settings.get("protocol") == "robot-joint" and len(skeleton.centres):
        value = float(np.hypot(*skeleton.centres[0]))
        along = skeleton.centres[0] / value if value > 0 else np.zeros(2)
        lengths.insert(0, ("base", value, np.sqrt(along @ skeleton.covariance[0] @ along)))
    return joints, {name: schema.LengthEntry.explain(_NOT_FINITE, value=m, sd=sd) for name, m, sd in lengths}


def _summarise_dynamics(data: ReportData) -> schema.DynamicsEntry:
    facts, measured = data.facts("dynamics.h5"), data.facts("wrench.parquet")
    # motion of the masses; the gaps in the order of the joints
    motion, found = None, facts.get("motion")
    if found is not None:
        gaps = found.get("joints") or {}
        order = {name: k for k, name in reversed([*enumerate(data.joint_names)])}
        joints = {
            name: schema.GapEntry.explain("no interval without gaps is long enough", gaps[name])
            for name in sorted(gaps, key=lambda name: order.get(name, len(order)))
        }
        missing = dict.fromkeys(schema.MotionEntry.model_fields)
        motion = schema.MotionEntry.of(missing | found | {"bands_hz": data.bands, "joints": joints or None})
    # errors of the pinned chain and of the measured poses on the same left-out repetitions
    pins, errors = facts.get("pins") or {}, {}
    for source in ("chain", "segments"):
        own = pins.get(source)
        errors[source] = own and schema.PredictedEntry.explain(
            "no sample has a centre of pressure", own, wrench=_summarise_channels(own["wrench"])
        )
    no_pins = pins.get("why") or (_PINNED if found else data.explain("dynamics.h5"))
    identified: dict[str, Any] = {
        "base": _summarise_parameters(data),
        "wrench": _summarise_channels(facts.get("wrench")) or None,
        "motion": motion,
        **{
            key: facts.get(key)
            for key in (
                *("condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "cop_rms_m"),
                *("samples", "consistency"),
            )
        },
    }
    mass, cop, wrench = measured.get("mass_kg"), None, data.table("wrench.parquet")
    if wrench is not None:  # mean over the samples with valid load
        valid = wrench["cop_x"][wrench["plate_ok"] & np.isfinite(wrench["cop_x"])]
        cop = float(valid.mean()) if len(valid) else None
    why = (
        why_unknown(data.explain("dynamics.h5"), *identified.values()),
        why_unknown(data.explain("wrench.parquet"), mass, cop),
    )
    return schema.DynamicsEntry(
        **identified,
        mass_kg=mass,
        cop_mean_m=cop,
        rivals={
            str(name): schema.RivalEntry.explain(
                "no samples off the seat are available",
                body,
                assumed=[str(assumption) for assumption in body.get("assumed") or ()],
                wrench=_summarise_channels(body.get("wrench")),
            )
            for name, body in (facts.get("rivals") or {}).items()
        },
        held_out=_summarise_held_out(data),
        pins=schema.PinsEntry.explain(no_pins, pins, **errors),
        legs=data.facts("dynamics.parquet").get("legs", "none"),
        torques=_summarise_torques(data, identified["base"], mass),
        why=join_sentences(why),
    )


def _summarise_torques(
    data: ReportData, base: list[schema.BaseEntry] | None, mass: float | None
) -> dict[str, schema.TorqueEntry]:
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
        support = "a chair or support that no plate measures carries, or may carry, the body"
        missing = f"{support} whenever the torque is known" if known.any() else f"{support} in every sample"
        if f"tau_{j}" in (data.facts("dynamics.h5").get("untold") or ()):
            missing = "the fit does not determine this torque: both sides of the joint may be one body"
        why = (why_unknown("the mass of the person is unknown", mass), None if len(used) else missing)
        positive, negative = words.get(name, ("positive", "negative"))
        entries[name] = schema.TorqueEntry(
            positive=positive,
            negative=negative,
            mass_kg=mass,
            known=float(known.mean()) if len(known) else 0.0,
            why=join_sentences(why),
            **found,
        )
    return entries


def _summarise_parameters(data: ReportData) -> list[schema.BaseEntry] | None:
    """Return the base parameters; None if none was identified."""
    dynamics, facts = data.dynamics, data.facts("dynamics.h5")
    if dynamics is None or not dynamics.names or not np.isfinite(dynamics.value).any():
        return None
    why = str(facts.get("why") or "the identification gave no finite value")
    advice, entries = facts.get("advice") or [], []
    for i, name in enumerate(dynamics.names):
        value, sd = to_number(dynamics.value[i]), to_number(dynamics.sd[i])
        verdict: Any = dynamics.verdicts[i] if i < len(dynamics.verdicts) else None
        other = {
            key: float(values[i]) if i < len(values) else None
            for key in ("relative_sd", "excitation", "own_share", "prior_share")
            for values in [getattr(dynamics, key)]
        }
        own = advice[i] if i < len(advice) else {}
        entries.append(
            schema.BaseEntry(
                name=name,
                value=value,
                sd=sd,
                unit=dynamics.units[i],
                verdict=verdict,
                helps=(own["text"] or _NO_MOVEMENT_HELPS) if own else None,
                sd_ratio=(1.0 if own["sd_ratio"] is None else own["sd_ratio"]) if own else None,
                why=why_unknown(why, value, sd),
                **other,
            )
        )
    return entries


def _summarise_held_out(data: ReportData) -> schema.HeldOutEntry:
    """Return the prediction errors on left-out repetitions; null with a ``why`` if there are none."""
    facts = data.facts("dynamics.h5")
    found = facts.get("held_out") or {}
    values: dict[str, Any] = {key: found.get(key) for key in ("repetitions", "folds", "samples")}
    values |= {key: _summarise_channels(found.get(key)) or None for key in ("model", "unfiltered", "in_sample")}
    values["clock_offset_s"], model = to_numbers(found.get("clock_offset_s")), values["model"]
    if data.low_pass is None:
        values["unfiltered"] = model
    reference = _summarise_channels(found.get("reference")) or None
    inside = {str(name): share for name, share in (found.get("inside") or {}).items() if share is not None} or None
    unknown = found.get("why") or data.explain("dynamics.h5")
    no_share = f"inside: {_PINNED}" if data.low_pass is None else "inside: at least two repetitions are needed"
    why = (
        why_unknown(unknown, *values.values()),
        why_unknown("reference: there is no reference body", reference) if model is not None else None,
        why_unknown(no_share, inside) if model is not None else None,
    )
    return schema.HeldOutEntry(**values, reference=reference, inside=inside, why=join_sentences(why))


def _summarise_channels(found: Mapping[str, Mapping[str, Any] | None] | None) -> dict[str, schema.ChannelEntry]:
    """Return the error of a model or measurement in each component, by its name; empty for None."""
    why = "it could not be computed from the samples of the fit"
    return {str(name): schema.ChannelEntry.explain(why, channel or {}) for name, channel in (found or {}).items()}


def _summarise_repetitions(data: ReportData) -> list[schema.RepetitionEntry] | None:
    """Return one entry for each repetition; None if repetitions were not searched for."""
    if data.table(_EVENTS) is None:
        return None
    entries = []
    for row in data.rows(_EVENTS):
        remark = row["why"] or ""
        why = remark or "the protocol has no such event, or it was not found"
        values = {
            name: row.get(name.removesuffix("_s")) for name in schema.RepetitionEntry.model_fields if name != "why"
        }
        entries.append(schema.RepetitionEntry.explain(why, values | {"remark": remark}))
    return entries


def _summarise_five_times(data: ReportData) -> FiveTimes:
    """Return the times of the five-times test; null with a ``why`` for other protocols."""
    facts = data.facts(_EVENTS).get("five_times")
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


def _summarise_load_share(data: ReportData) -> LoadShare:
    """Return the fraction of the load on the left foot by phase; null with a ``why`` if unknown."""
    facts = data.facts(_EVENTS).get("load_share")
    if facts is None:
        return LoadShare(why=_explain_missing(data))
    found = LoadShare.of(facts)
    ordered = {phase: found.left.get(phase, Spread()) for phase in LOAD_PHASES}  # a file has its keys in another order
    found = found.model_copy(update={"left": ordered})
    if found.why is None and any(None in (one.mean, one.sd) for one in found.left.values()):
        return found.model_copy(update={"why": "a phase occurs in fewer than two repetitions"})
    return found


def _explain_missing(data: ReportData) -> str:
    return "the protocol is not sit-to-stand" if _EVENTS in data.artefacts else data.why_missing(_EVENTS)


def _summarise_spatial_chain(
    data: ReportData,
) -> tuple[list[schema.JointEntry] | None, dict[str, schema.LengthEntry] | None]:
    """Return joints, and lengths of segments, of the chain in space; None if no chain was found."""
    skeleton = data.spatial_skeleton
    if skeleton is None:
        return None, None
    evidence, entries = data.facts("chain.h5").get("evidence") or {}, []
    for name, joint, arc in zip(skeleton.joints, skeleton.chain.joints, skeleton.arc, strict=True):
        centre = to_numbers(joint.centre) if joint.known else None
        sd = to_numbers(_compute_sd(joint.covariance)) if joint.known else None
        axes = [to_numbers(axis) for axis in (joint.first_axis, joint.second_axis)[: _AXES[joint.kind]]]
        arc_deg = to_number(np.degrees(arc))
        why = (
            why_unknown(_NOT_FINITE if joint.known else _HIDDEN, centre, sd),
            why_unknown("axis: a ball has no axis" if not axes else "axis: " + _NOT_FINITE, *(axes or [None])),
            why_unknown(f"arc_deg: {_NOT_FINITE}", arc_deg),
        )
        axis_sd = np.degrees([np.sqrt(np.trace(each) / 2) for each in joint.axes_covariance[: len(axes)]])
        glides = bool(np.any(joint.glide))
        entries.append(
            schema.JointEntry(
                name=name,
                parent=joint.parent,
                kind=joint.kind,
                centre_m=centre,
                sd_m=sd,
                axis=None if not axes or None in axes else axes[0] if len(axes) == 1 else axes,  # type: ignore[arg-type]
                axis_sd_deg=axis_sd[np.isfinite(axis_sd)].tolist(),
                glide_m=(to_numbers(joint.glide) or []) if glides else [],
                glide_sd_m=(to_numbers(_compute_sd(joint.glide_covariance)) or []) if glides else [],
                arc_deg=arc_deg,
                known=joint.known,
                evidence={kind: cost for kind, cost in (evidence.get(name) or {}).items() if cost is not None},
                why=join_sentences(why),
            )
        )
    unknown = "the motion does not determine both ends of the segment"
    lengths = skeleton.lengths.items()
    return entries, {name: schema.LengthEntry.explain(unknown, value=length, sd=sd) for name, (length, sd) in lengths}


def _compute_sd(covariance: FloatArray) -> FloatArray:
    variance = np.diagonal(covariance)
    return np.sqrt(np.where(variance >= 0, variance, np.nan))


def _summarise_angle(data: ReportData, k: int) -> schema.AngleEntry:
    """Return the statistics of one angle.

    A constant error of a segment's frame changes an angle by different amounts in different poses. The errors at both
    ends of a range have a correlation of about 0.5, so the range has about the same standard deviation as each end.
    """
    found = data.angles
    assert found is not None
    name = found.names[k]
    usable = found.find_usable(name)
    share = float(usable.mean()) if len(usable) else 0.0
    if not usable.any():
        why = "the angle is unknown in every sample"
        if name in MEANINGLESS_AT_POLE and np.isfinite(found.mean[:, k, 0]).any():
            why = "the elevation is within 15° of 0 or 180° in every sample, where this angle has no meaning"
        return schema.AngleEntry.explain(why, {}, used_share=share)
    turned = found.mean[usable, k, 0]
    values = np.degrees(shift_to_shortest_arc(turned) if name in MEANINGLESS_AT_POLE else turned)
    sd = np.degrees(found.sd[usable, k, 0])
    ends = [int(values.argmin()), int(values.argmax())]
    low, high = (float(values[end]) for end in ends)
    constant = to_number(np.degrees(np.sqrt(np.mean(np.square(found.constant_sd[usable, k])))))
    spread = None if constant is None else to_number(np.linalg.norm([*sd[ends], constant]))
    interval = None if spread is None else [max(high - low - NORMAL_95 * spread, 0.0), high - low + NORMAL_95 * spread]
    return schema.AngleEntry.explain(
        "the standard deviation is unknown",
        low_deg=low,
        high_deg=high,
        range_deg=high - low,
        interval_deg=interval,
        sd_deg=to_number(np.sqrt(np.mean(np.square(sd)))),
        constant_sd_deg=constant,
        used_share=share,
    )


def _summarise_curls(data: ReportData) -> schema.CurlsEntry:
    """Return counts, end of the trial, compensation, torque and fatigue; null with a ``why`` for other protocols."""
    facts = data.facts(_EVENTS).get("curl")
    if facts is None:
        return schema.CurlsEntry(why="only `protocol: curl` counts curls")
    torque = [one for one in facts.get("torque") or () if one is not None]
    peak: Mapping[str, Any] = max(torque, key=lambda one: one["peak_Nm"], default={})
    end, compensation = facts.get("end") or {}, {}

    def degrees(one: Mapping[str, Any] | None, name: str) -> Any:
        return np.degrees(one[name]).tolist() if one else None

    for name, found in (facts.get("compensation") or {}).items():
        # an entry for each curl, None for a failed attempt; and the part of the angle that depends on the flexion alone
        in_step = (facts.get("in_step") or {}).get(name)
        compensation[name] = schema.CompensationEntry(
            range_deg=[degrees(one, "range_rad") for one in found],
            interval_deg=[degrees(one, "interval_rad") for one in found],
            floor_deg=[degrees(one, "floor_rad") for one in found],
            offset_deg=[degrees(one, "offset_rad") for one in found],
            sustained_s=[one["sustained_s"] if one else None for one in found],
            in_step_deg=degrees(in_step, "range_rad"),
            in_step_interval_deg=degrees(in_step, "interval_rad"),
        )
    return schema.CurlsEntry.of(
        facts
        | {
            "end_s": end.get("time_s"),
            "end_rule": end.get("rule"),
            "compensation": compensation,
            "largest_torque_nm": peak.get("peak_Nm"),
            "largest_torque_sd_nm": peak.get("sd_Nm"),
            "fatigue": {
                name: schema.TrendEntry(slope=found["slope"], interval=found["interval"], curls=found["count"])
                for name, found in (facts.get("fatigue") or {}).items()
                if found is not None
            },
            "why": facts.get("why") or facts.get("torque_why") or None,
        }
    )
