"""Stage identify-dim in space: its inputs, the identification, and its artefacts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray, find_complete_rows
from mocap_id.dynamics.cautions import WEAK, find_cautions_in_space
from mocap_id.dynamics.fit import LEAST_SECONDS, determines_parameters, select_samples
from mocap_id.dynamics.prediction import centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.preparation import CoarseClock
from mocap_id.dynamics.space.identification import (
    SpatialCalibration,
    identify_parameters_in_space,
    measure_excitation_in_space,
    predict_in_space,
)
from mocap_id.dynamics.space.preparation import (
    COMPONENTS,
    SpatialRecord,
    SpatialTrial,
    name_parameters_in_space,
    prepare_in_space,
)
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.base import Context, Findings, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.dynamics_artefacts import (
    NO_FACTS,
    describe_fit,
    make_datasets,
    make_dynamics_columns,
)
from mocap_id.stages.identify_dim.events import find_curl_events, find_reach_events, make_events
from mocap_id.stages.identify_dim.trial_data import (
    NotIdentifiable,
    describe_errors,
    make_fit_settings,
    read_common_time,
    read_cop_threshold,
    read_plate_position_sd,
    read_wrench,
)
from mocap_id.store import Table, Tree
from mocap_id.store.artefacts import SpatialSkeleton
from mocap_id.store.provenance import DYNAMICS_TABLE, DYNAMICS_TREE, PHASES
from mocap_id.verdict import Reason

_EXPLAINED = 0.5  # smallest share of the variance of the horizontal force that the model explains
_PLANAR = [COMPONENTS.index(name) for name in ("Fx", "Fy", "tauz")]
_ADVICE = "Larger angles and higher speeds of all joints, one after the other and together, determine them better."


def identify_in_space(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in space."""
    table, clock = read_wrench(context)
    time = read_common_time(context, "poses.parquet")
    skeleton = SpatialSkeleton(context.tree("chain.h5"))
    wrench = np.full((table.length, len(COMPONENTS)), np.nan)  # of the ground about the origin of the trial's axes
    if set(COMPONENTS) <= set(table.names):  # a plate may measure fewer components
        wrench = np.where(table["plate_ok"][:, None], table.stack(COMPONENTS), np.nan)
    trial = _prepare(context, skeleton, time, wrench, clock)
    events = make_events(())
    torques: dict[str, FloatArray] = {}
    if context.trial.protocol == "curl":
        events, torques = find_curl_events(context)
    elif context.trial.protocol == "reach":
        events = find_reach_events(context)
    if isinstance(trial, NotIdentifiable):
        dynamics, tree = _describe_unidentified(context, skeleton, time, wrench, trial)
    else:
        dynamics, tree = _describe_identified(context, skeleton.chain, trial)
    names, empty = np.zeros(0, dtype=object), np.zeros(0)
    averages = {"span": names, "percent": empty, "quantity": names, "unit": names, "mean": empty, "sd": empty}
    why = "the repetitions of a trial in space are not averaged"
    phases = Table(PHASES, averages | {"count": empty}, {"repetitions": {}, "compared": [], "why": why})
    return events, dynamics.with_columns(**torques), tree, phases


def _describe_identified(context: Context, chain: SpatialChain, trial: SpatialTrial) -> tuple[Table, Tree]:
    """Identify the parameters; return dynamics.parquet and dynamics.h5."""
    settings: IdentifyDimSettings = context.settings
    threshold, structure, time = read_cop_threshold(context), trial.structure, trial.recorded.time
    position = read_plate_position_sd(context)
    calibration = SpatialCalibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        force=settings.plate_zero_sd_n,
        moment=settings.plate_zero_sd_nm,
        position=position,
        yaw=2 * position / _PLATE_WIDTH,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
    )
    found = identify_parameters_in_space(trial, np.ones(len(time), dtype=np.bool_), calibration)
    excited = measure_excitation_in_space(trial, found, settings.weak_share or WEAK)
    model, fit = predict_in_space(trial, found), found.fit

    # dynamics.parquet
    units = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    change = centre_of_pressure_rows(units, model.wrench[:, _PLANAR], threshold)
    cop_sd = np.sqrt(np.sum((change * model.wrench_sd[:, _PLANAR]) ** 2, axis=1))
    series = {
        "{}": (model.measured, centre_of_pressure(model.measured[:, _PLANAR], threshold)),
        "{}_model": (model.wrench, centre_of_pressure(model.wrench[:, _PLANAR], threshold)),
        "sd_{}_model": (model.wrench_sd, cop_sd),
    }
    columns = make_dynamics_columns(
        time, COMPONENTS, series, torque=model.torque, torque_sd=model.torque_sd, in_fit=fit.in_fit
    )

    # dynamics.h5
    data = make_datasets(
        structure.names,
        found.base,
        name_parameters_in_space(len(found.full) // 10),
        units=structure.units,
        regrouping=structure.mapping,
        sd=found.base_sd,
        covariance=found.covariance,
        full=found.full,
        excitation=excited,
        prior_share=np.zeros(len(found.base)),
    )
    facts = _make_common_facts(chain, None) | {
        "condition_number": fit.condition,
        "condition_number_scaled": fit.condition_scaled,
        **describe_fit(trial, found, "cone"),
        **describe_errors(model.wrench, model.measured, fit.in_fit, threshold, COMPONENTS),
        "consistency": "cone",
        "reference_pulls": False,
        "plate_bias": {COMPONENTS[k]: float(value) for k, value in zip(trial.constants, found.plate_bias, strict=True)},
        "residual_covariance": found.residual_covariance.tolist(),
        "unit_covariance": found.unit_covariance.tolist(),
        "error_modes": [[name, change[: len(found.base)].tolist()] for name, change, _, _ in found.modes],
        "frames": structure.frames[:, :3, :3].tolist(),
        "moments_about_m": trial.recorded.base[:3, 3].tolist(),
    }

    # cautions, also about a motion of the chain that does not explain the low-passed horizontal force of the plate
    out = Findings(find_cautions_in_space(trial, found, excited, _ADVICE))
    target = fit.target[:, [0, 2]] - fit.target[:, [0, 2]].mean(axis=0)
    rest = (fit.target - fit.design[..., : len(found.base)] @ found.base)[:, [0, 2]]
    share = 1.0 - float(np.var(rest, axis=0).sum() / max(float(np.sum(target**2) / len(target)), 1e-300))
    if not share >= _EXPLAINED:
        out.say(
            "wrench-unexplained",
            f"the motion of the chain explains {100 * max(share, 0.0):.0f} % of the variance of the horizontal force "
            f"on the plate, expected at least {100 * _EXPLAINED:.0f} %: the plate does not carry this base, or another "
            "object on the plate moves; do not use the parameters",
            share,
            _EXPLAINED,
        )
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, tuple(out.reasons))


def _describe_unidentified(
    context: Context, skeleton: SpatialSkeleton, time: FloatArray, wrench: FloatArray, obstacle: NotIdentifiable
) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial without an identification."""
    chain, segments = skeleton.chain, len(skeleton.segments)
    absent = np.full((len(time), len(COMPONENTS)), np.nan)
    torque = np.full((len(time), sum(joint.dimension for joint in chain.joints)), np.nan)
    series = {
        "{}": (wrench, centre_of_pressure(wrench[:, _PLANAR], read_cop_threshold(context))),
        "{}_model": (absent, absent[:, 0]),
        "sd_{}_model": (absent, absent[:, 0]),
    }
    nowhere = np.zeros(len(time), dtype=np.bool_)
    columns = make_dynamics_columns(time, COMPONENTS, series, torque=torque, torque_sd=torque, in_fit=nowhere)
    # the only base parameter is the mass
    names, regrouping = name_parameters_in_space(segments), np.zeros((1, 10 * segments))
    regrouping[0, ::10] = 1.0
    mass = np.array([np.nan if obstacle.mass is None else obstacle.mass])
    data = make_datasets(["+".join(names[::10])], mass, names, units=["kg"], regrouping=regrouping)
    expected = context.trial.protocol in ("reach", "curl")  # usually recorded without plates
    reasons = (Reason(obstacle.code, obstacle.why, level="ok" if expected else "caution"),)
    facts = _make_common_facts(chain, obstacle.why)
    return Table(DYNAMICS_TABLE, columns), Tree(DYNAMICS_TREE, data, facts, reasons)


def _make_common_facts(chain: SpatialChain, why: str | None) -> dict[str, Any]:
    """Return the facts of dynamics.h5 that do not depend on a fit; ``why`` says why there is none.

    The fact ``torques`` contains the joint, from 1, and the direction of the torque in each column ``tau_k``.
    """
    words = {
        "hinge": ("axis",),
        "two-axis": ("first axis", "second axis"),
        "ball": ("x of the parent", "y of the parent", "z of the parent"),
    }
    every = [(k, word) for k, joint in enumerate(chain.joints, start=1) for word in words[joint.kind]]
    torques = [{"column": f"tau_{k}", "joint": joint, "about": word} for k, (joint, word) in enumerate(every, 1)]
    motion = {"source": "chain", "why": "the joints of a chain in space are pinned"}
    return {**NO_FACTS, "why": why, "motion": motion, "rivals": {}, "torques": torques}


_AT_REST = 5e-3, np.radians(1.0)  # m and rad: a base at rest moves less than this in 95 % of the frames
_PLATE_WIDTH = 0.5  # m: an error of a corner's position rotates the plate by twice this error divided by its width
_PERSON, _OF_PERSONS = "thorax", ("reach", "curl")


def _prepare(
    context: Context, skeleton: SpatialSkeleton, time: FloatArray, wrench: FloatArray, clock: CoarseClock
) -> SpatialTrial | NotIdentifiable:
    """Return the prepared trial, or the reason why nothing can be identified.

    ``wrench`` (T, 6) is that of the ground about the origin of the trial's axes, N and N·m; NaN where unknown.
    """
    settings: IdentifyDimSettings = context.settings
    poses, facts = context.table("poses.parquet"), context.table("wrench.parquet").facts
    chain, segments = skeleton.chain, skeleton.segments
    if not find_complete_rows(wrench).any():
        why = facts.get("unusable") or facts.get("why") or "the recording has no usable force plate"
        return NotIdentifiable("no-wrench", f"the inertial parameters need the ground's wrench: {why}")

    # the plates must measure only bodies of the chain
    person = context.trial.protocol in _OF_PERSONS or segments[0] == _PERSON
    if person or not all(joint.known and not joint.glide.any() for joint in chain.joints):
        carrier = (
            "a person's thorax" if person else "connected to the chain by joints whose centres are unknown or move"
        )
        return NotIdentifiable(
            "base-not-carried",
            f"the base is {carrier}, so the plates also measure segments without markers; the parameters are "
            "identified only if a plate carries the base, as under a robot",
        )
    # prefix of each segment's columns in poses.parquet
    prefixes = [name if f"{name}_qw" in poses.names else f"segment_{k}" for k, name in enumerate(segments)]
    rotations, origins, seen = [], [], []
    for name in prefixes:
        cross = so3.hat(poses.stack([f"{name}_q{axis}" for axis in "xyz"]))
        rotations.append(np.eye(3) + 2 * poses[f"{name}_qw"][:, None, None] * cross + 2 * cross @ cross)
        origins.append(poses.stack([f"{name}_{axis}" for axis in "xyz"]))
        seen.append(poses[f"{name}_observed"].astype(np.bool_))

    # pose of the base, which must be at rest
    known = seen[0] & np.isfinite(origins[0]).all(axis=1) & np.isfinite(rotations[0]).all(axis=(1, 2))
    if not known.any():
        return NotIdentifiable("base-unseen", "the pose of the base is never known: put three markers on it")
    rotation, origin = rotations[0][known], origins[0][known]
    first = rotation[len(rotation) // 2]
    mean = first @ so3.exp(np.median(so3.log(first.T @ rotation), axis=0))
    position = np.median(origin, axis=0)
    distance = float(np.quantile(np.linalg.norm(origin - position, axis=1), 0.95))
    angle = float(np.quantile(np.linalg.norm(so3.log(mean.T @ rotation), axis=1), 0.95))
    if not (distance <= _AT_REST[0] and angle <= _AT_REST[1]):
        return NotIdentifiable(
            "base-moves",
            f"the base moves by {1e3 * distance:.0f} mm and {np.degrees(angle):.1f}°, expected a base at rest on the "
            f"plate (up to {1e3 * _AT_REST[0]:g} mm and {np.degrees(_AT_REST[1]):g}°). Fix the base; if it is fixed, "
            "the plates also carry other segments",
        )

    # motion of the other segments
    names = prefixes[1:]
    omega, alpha = (
        np.stack([poses.stack([f"{name}_{rate}_{axis}" for axis in "xyz"]) for name in names], axis=1)
        for rate in ("omega", "alpha")
    )
    record = SpatialRecord(
        time=time,
        chain=chain,
        base=se3.pose(mean, position),
        rotation=np.stack(rotations[1:], axis=1),
        omega=omega,
        alpha=alpha,
        alpha_sd=poses.stack([f"sd_{name}_alpha" for name in names]),
        observed=np.logical_and.reduce(seen[1:]),
        wrench=wrench,
        plate=None if facts.get("centre_m") is None else np.array(facts["centre_m"]),
        clock=clock,
    )
    record = replace(record, averaged=recording.compute_averaging_width(facts["analog_rate_hz"], record.rate))
    trial = prepare_in_space(record, make_fit_settings(settings, range(len(COMPONENTS)), clock.search))

    # whether the usable samples determine the parameters
    everywhere = np.ones(len(trial.usable), dtype=np.bool_)
    chosen = select_samples(trial, everywhere)
    if chosen.sum() < LEAST_SECONDS * record.rate:
        return NotIdentifiable(
            "too-few-samples",
            f"{chosen.sum() / record.rate:.2f} s are usable, expected at least {LEAST_SECONDS:g} s: in usable "
            "samples, all segments and the wrench of the plate are known, and gaps are at least "
            f"{trial.lowpass.reach:.2f} s away, because the low-pass spreads gaps. Record longer or with fewer gaps",
        )
    mass = float(np.nanmedian(record.wrench[chosen, 1])) / settings.gravity
    # range of rotation of each moving segment, from the 2.5 to the 97.5 % quantile
    rotation = record.rotation[chosen]
    turned = so3.log(np.swapaxes(rotation[:1], -1, -2) @ rotation)
    low, high = np.quantile(turned, [0.025, 0.975], axis=0)
    arc = float(np.degrees(np.linalg.norm(high - low, axis=-1).max()))
    if arc < settings.still_arc_deg:
        return NotIdentifiable(
            "standing-still",
            f"no segment rotates more than {arc:.1f}°, expected at least {settings.still_arc_deg:g}°: only the mass is "
            "known; record a movement",
            mass,
        )
    if not determines_parameters(trial, everywhere):
        return NotIdentifiable(
            "not-excited",
            "a joint does not move, so the parameters of its two segments cannot be separated; record a movement of "
            "every joint",
            mass,
        )
    return trial
