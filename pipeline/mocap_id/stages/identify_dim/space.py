"""Function of the stage identify-dim in space: its inputs, the identification, and its artefacts."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.dynamics.cautions import WEAK, Excitation, find_cautions_in_space
from mocap_id.dynamics.fit import LEAST_SECONDS, describe_clock, determines_parameters, select_samples
from mocap_id.dynamics.prediction import agreement, centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.preparation import FitSettings
from mocap_id.dynamics.space.identification import (
    SpatialIdentification,
    SpatialPrediction,
    identify_parameters_in_space,
    measure_excitation_in_space,
    predict_in_space,
)
from mocap_id.dynamics.space.instrument_errors import SpatialCalibration
from mocap_id.dynamics.space.preparation import (
    COMPONENTS,
    SpatialRecord,
    SpatialTrial,
    name_parameters_in_space,
    prepare_in_space,
)
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.dynamics_artefacts import describe_solver, make_empty_facts
from mocap_id.stages.identify_dim.events import make_events
from mocap_id.stages.identify_dim.trial_data import NotIdentifiable, read_common_time, read_cop_threshold, read_wrench
from mocap_id.store import Table, Tree
from mocap_id.store.schemas import DYNAMICS_TABLE, DYNAMICS_TREE, PHASES
from mocap_id.store.views import SpatialSkeleton
from mocap_id.verdict import Reason

_EXPLAINED = 0.5  # smallest share of the variance of the horizontal force that the model explains
_ADVICE = "Larger angles and higher speeds of all joints, one after the other and together, determine them better."


def identify_in_space(context: Context) -> Outputs:
    """Return events.parquet, dynamics.parquet, dynamics.h5 and phases.parquet of a trial in space."""
    inputs = read_spatial_inputs(context)
    events, torques = _make_events(context)
    if inputs.trial is None or inputs.obstacle is not None:
        table, tree = _explain_obstacle(context, inputs)
    else:
        table, tree = _identify(context, inputs, inputs.trial)
    return events, replace(table, columns={**table.columns, **torques}), tree, make_no_averages()


def _make_events(context: Context) -> tuple[Table, dict[str, FloatArray]]:
    """Return events.parquet and additional columns of dynamics.parquet, as the protocol requires."""
    if context.trial.protocol == "curl":
        from mocap_id.stages.identify_dim.curls import find_curl_events  # noqa: PLC0415  only for curls

        return find_curl_events(context)
    if context.trial.protocol == "reach":
        from mocap_id.stages.identify_dim.reaches import find_reach_events  # noqa: PLC0415  only for reaches

        return find_reach_events(context), {}
    return make_events(()), {}


def _identify(context: Context, inputs: SpatialInputs, trial: SpatialTrial) -> tuple[Table, Tree]:
    settings = context.settings
    found = identify_parameters_in_space(trial, np.ones(len(inputs.time), dtype=np.bool_), read_calibration(settings))
    excited = measure_excitation_in_space(trial, found, settings.weak_share or WEAK)
    model = predict_in_space(trial, found)
    facts = make_facts(trial, found, model, read_cop_threshold(context))
    reasons = find_cautions_in_space(trial, found, excited, _ADVICE) + _check_explained_force(found)
    tree = Tree(DYNAMICS_TREE, make_data(trial, found, excited), facts, reasons)
    return Table(DYNAMICS_TABLE, _columns(context, inputs, model, found)), tree


def _columns(
    context: Context, inputs: SpatialInputs, model: SpatialPrediction, found: SpatialIdentification
) -> dict[str, Any]:
    return make_columns(
        inputs.time,
        measured=model.measured,
        model=model.wrench,
        model_sd=model.wrench_sd,
        torque=model.torque,
        torque_sd=model.torque_sd,
        in_fit=found.fit.in_fit,
        threshold=read_cop_threshold(context),
    )


def _explain_obstacle(context: Context, inputs: SpatialInputs) -> tuple[Table, Tree]:
    """Return dynamics.parquet and dynamics.h5 of a trial without an identification."""
    obstacle = inputs.obstacle
    assert obstacle is not None
    coordinates = sum(joint.dimension for joint in inputs.chain.joints)
    absent = np.full((len(inputs.time), len(COMPONENTS)), np.nan)
    torque = np.full((len(inputs.time), coordinates), np.nan)
    columns = make_columns(
        inputs.time,
        measured=inputs.wrench,
        model=absent,
        model_sd=absent,
        torque=torque,
        torque_sd=torque,
        in_fit=np.zeros(len(inputs.time), dtype=np.bool_),
        threshold=read_cop_threshold(context),
    )
    data = make_empty_data(len(inputs.segments), obstacle.mass)
    expected = context.trial.protocol in ("reach", "curl")  # usually recorded without plates
    reasons = (Reason(obstacle.code, obstacle.why, level="ok" if expected else "caution"),)
    return Table(DYNAMICS_TABLE, columns), Tree(
        DYNAMICS_TREE, data, make_empty_facts_in_space(inputs.chain, obstacle.why), reasons
    )


def _check_explained_force(found: SpatialIdentification) -> tuple[Reason, ...]:
    """Return a caution if the motion of the chain does not explain the low-passed horizontal force of the plate."""
    fit, base = found.fit, found.base
    target = fit.target[:, [0, 2]] - fit.target[:, [0, 2]].mean(axis=0)
    rest = (fit.target - fit.design[..., : len(base)] @ base)[:, [0, 2]]
    share = 1.0 - float(np.var(rest, axis=0).sum() / max(float(np.sum(target**2) / len(target)), 1e-300))
    if share >= _EXPLAINED:
        return ()
    return (
        Reason(
            "wrench-unexplained",
            f"the motion of the chain explains {100 * max(share, 0.0):.0f} % of the variance of the horizontal force "
            f"on the plate, expected at least {100 * _EXPLAINED:.0f} %: the plate does not carry this base, or another "
            "object on the plate moves; do not use the parameters",
            value=share,
            limit=_EXPLAINED,
        ),
    )


_AT_REST = 5e-3, np.radians(1.0)  # m and rad: a base at rest moves less than this in 95 % of the frames
_PLATE_WIDTH = 0.5  # m: an error of a corner's position rotates the plate by twice this error divided by its width
_POSITION_SD = 0.005  # m: default standard deviation of the plate's position
_PERSON, _OF_PERSONS = "thorax", ("reach", "curl")


@dataclass(frozen=True)
class SpatialInputs:
    """Inputs of the identification of a trial in space."""

    time: FloatArray  # (T,) sample times, s
    chain: SpatialChain  # chain of the trial
    segments: tuple[str, ...]  # names of the segments, base first
    # (T, 6) measured wrench of the ground about the origin of the trial's axes, N and N·m; NaN where unknown
    wrench: FloatArray
    trial: SpatialTrial | None = None  # prepared trial; None if it could not be prepared
    obstacle: NotIdentifiable | None = None  # reason why nothing can be identified; None if there is none


def read_spatial_inputs(context: Context) -> SpatialInputs:
    """Return a trial in space, prepared if possible; StoreError if poses and wrench have different times."""
    settings: IdentifyDimSettings = context.settings
    poses = context.table("poses.parquet")
    wrench, clock = read_wrench(context)
    time = read_common_time(context, "poses.parquet")
    skeleton = SpatialSkeleton.from_tree(context.tree("chain.h5"))
    inputs = SpatialInputs(time, skeleton.chain, skeleton.segments, _read_wrench(wrench))
    obstacle = _check_wrench(context, inputs) or _check_base(context, inputs)
    if obstacle is not None:
        return replace(inputs, obstacle=obstacle)
    base = _find_base_at_rest(poses, inputs)
    if isinstance(base, NotIdentifiable):
        return replace(inputs, obstacle=base)
    centre = wrench.facts.get("centre_m")
    plate = None if centre is None else np.array(centre)
    record = replace(_make_record(poses, inputs, base), plate=plate, clock=clock)
    width = recording.compute_averaging_width(wrench.facts["analog_rate_hz"], record.rate)
    trial = prepare_in_space(replace(record, averaged=width), _make_fit_settings(settings, clock.search))
    return replace(inputs, trial=trial, obstacle=_check_excitation(settings, trial))


def read_calibration(settings: IdentifyDimSettings) -> SpatialCalibration:
    """Return the standard deviations of the errors of scale of plate and cameras, from the settings."""
    position = _POSITION_SD if settings.plate_position_sd_m is None else settings.plate_position_sd_m
    return SpatialCalibration(
        gain=settings.plate_gain_sd,
        moments=settings.plate_moments_sd,
        force=settings.plate_zero_sd_n,
        moment=settings.plate_zero_sd_nm,
        position=position,
        yaw=2 * position / _PLATE_WIDTH,
        lengths=settings.camera_scale_sd,
        tilt=float(np.radians(settings.camera_tilt_sd_deg)),
    )


def _make_fit_settings(settings: IdentifyDimSettings, search: float) -> FitSettings:
    return FitSettings(
        components=tuple(range(len(COMPONENTS))),
        cutoff=settings.cutoff_hz,
        offset_limit=search,
        apply_offset=settings.apply_clock_offset,
        plate_bias=settings.plate_bias,
        block=settings.block_s,
        gravity=settings.gravity,
    )


def _read_wrench(table: Table) -> FloatArray:
    """Return the wrench of the ground (T, 6), N and N·m; NaN where it is not valid or has fewer components."""
    if not set(COMPONENTS) <= set(table.names):
        return np.full((table.length, len(COMPONENTS)), np.nan)
    return np.where(table["plate_ok"][:, None], table.stack(COMPONENTS), np.nan)


def _check_wrench(context: Context, inputs: SpatialInputs) -> NotIdentifiable | None:
    if find_complete_rows(inputs.wrench).any():
        return None
    facts = context.table("wrench.parquet").facts
    why = facts.get("unusable") or facts.get("why") or "the recording has no usable force plate"
    return NotIdentifiable("no-wrench", f"the inertial parameters need the ground's wrench: {why}")


def _check_base(context: Context, inputs: SpatialInputs) -> NotIdentifiable | None:
    """Return the reason why the plates also measure bodies that are not in the chain; None if they do not."""
    person = context.trial.protocol in _OF_PERSONS or inputs.segments[0] == _PERSON
    if not person and all(joint.known and not joint.glide.any() for joint in inputs.chain.joints):
        return None
    base = "a person's thorax" if person else "connected to the chain by joints whose centres are unknown or move"
    return NotIdentifiable(
        "base-not-carried",
        f"the base is {base}, so the plates also measure segments without markers; the parameters are identified only "
        "if a plate carries the base, as under a robot",
    )


def _find_base_at_rest(poses: Table, inputs: SpatialInputs) -> FloatArray | NotIdentifiable:
    """Return the pose (4, 4) of the base, or the reason why it is unknown or not at rest."""
    rotation, origin, observed = _read_segment_poses(poses, inputs.segments, 0)
    observed = observed & np.isfinite(origin).all(axis=1) & np.isfinite(rotation).all(axis=(1, 2))
    if not observed.any():
        return NotIdentifiable("base-unseen", "the pose of the base is never known: put three markers on it")
    rotation, origin = rotation[observed], origin[observed]
    first = rotation[len(rotation) // 2]
    mean = first @ so3.exp(np.median(so3.log(first.T @ rotation), axis=0))
    position = np.median(origin, axis=0)
    distance = float(np.quantile(np.linalg.norm(origin - position, axis=1), 0.95))
    angle = float(np.quantile(np.linalg.norm(so3.log(mean.T @ rotation), axis=1), 0.95))
    if distance <= _AT_REST[0] and angle <= _AT_REST[1]:
        return se3.pose(mean, position)
    return NotIdentifiable(
        "base-moves",
        f"the base moves by {1e3 * distance:.0f} mm and {np.degrees(angle):.1f}°, expected a base at rest on the plate "
        f"(up to {1e3 * _AT_REST[0]:g} mm and {np.degrees(_AT_REST[1]):g}°). Fix the base; if it is fixed, the plates "
        "also carry other segments",
    )


def _make_record(poses: Table, inputs: SpatialInputs, base: FloatArray) -> SpatialRecord:
    moving = range(1, len(inputs.segments))
    each = [_read_segment_poses(poses, inputs.segments, k) for k in moving]
    names = [_find_column_prefix(poses, inputs.segments, k) for k in moving]
    omega, alpha = (
        np.stack([poses.stack([f"{name}_{rate}_{axis}" for axis in "xyz"]) for name in names], axis=1)
        for rate in ("omega", "alpha")
    )
    return SpatialRecord(
        time=inputs.time,
        chain=inputs.chain,
        base=base,
        rotation=np.stack([rotation for rotation, _, _ in each], axis=1),
        omega=omega,
        alpha=alpha,
        alpha_sd=poses.stack([f"sd_{name}_alpha" for name in names]),
        observed=np.logical_and.reduce([seen for _, _, seen in each]),
        wrench=inputs.wrench,
    )


def _find_column_prefix(poses: Table, segments: tuple[str, ...], k: int) -> str:
    """Return the prefix of a segment's columns in poses.parquet: its name, or ``segment_k``."""
    return segments[k] if f"{segments[k]}_qw" in poses.names else f"segment_{k}"


def _read_segment_poses(poses: Table, segments: tuple[str, ...], k: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return rotations (T, 3, 3) and origins (T, 3), m, of a segment, and True (T,) where it is observed."""
    name = _find_column_prefix(poses, segments, k)
    scalar, vector = poses[f"{name}_qw"], poses.stack([f"{name}_q{axis}" for axis in "xyz"])
    cross = so3.hat(vector)
    rotation = np.eye(3) + 2 * scalar[:, None, None] * cross + 2 * cross @ cross
    return rotation, poses.stack([f"{name}_{axis}" for axis in "xyz"]), poses[f"{name}_observed"].astype(np.bool_)


def _check_excitation(settings: IdentifyDimSettings, trial: SpatialTrial) -> NotIdentifiable | None:
    """Return the reason why the usable samples do not determine the parameters; None if they do."""
    everywhere = np.ones(len(trial.usable), dtype=np.bool_)
    chosen = select_samples(trial, everywhere)
    recorded = trial.recorded
    if chosen.sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "too-few-samples",
            f"{chosen.sum() / recorded.rate:.2f} s are usable, expected at least {LEAST_SECONDS:g} s: in usable "
            "samples, all segments and the wrench of the plate are known, and gaps are at least "
            f"{trial.lowpass.reach:.2f} s away, because the low-pass spreads gaps. Record longer or with fewer gaps",
        )
    mass = float(np.nanmedian(recorded.wrench[chosen, 1])) / settings.gravity
    arc = float(np.degrees(_measure_rotations(recorded, chosen).max()))
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
    return None


def _measure_rotations(recorded: SpatialRecord, chosen: BoolArray) -> FloatArray:
    """Return the range of rotation (n,) of each moving segment, from the 2.5 to the 97.5 % quantile, rad."""
    rotation = recorded.rotation[chosen]
    turned = so3.log(np.swapaxes(rotation[:1], -1, -2) @ rotation)
    low, high = np.quantile(turned, [0.025, 0.975], axis=0)
    return np.asarray(np.linalg.norm(high - low, axis=-1))


_PLANAR = [COMPONENTS.index(name) for name in ("Fx", "Fy", "tauz")]


def make_columns(
    time: FloatArray,
    *,
    measured: FloatArray,
    model: FloatArray,
    model_sd: FloatArray,
    torque: FloatArray,
    torque_sd: FloatArray,
    in_fit: BoolArray,
    threshold: float,
) -> dict[str, Any]:
    """Return the columns of dynamics.parquet.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    measured, model, model_sd : (T, 6) arrays
        Wrench of the ground about the origin of the trial's axes, N and N·m.
    torque, torque_sd : (T, N) arrays
        Torque of each joint coordinate, N·m.
    in_fit : (T,) bool array
        Samples of the fit.
    threshold : float
        Largest vertical force without a centre of pressure, N.
    """
    absent = np.full(len(time), np.nan)
    found: dict[str, Any] = {"time": time}
    for prefix, suffix, wrench in (("", "", measured), ("", "_model", model), ("sd_", "_model", model_sd)):
        found |= {f"{prefix}{name}{suffix}": wrench[:, k] for k, name in enumerate(COMPONENTS)}
    found["cop_x"] = centre_of_pressure(measured[:, _PLANAR], threshold)
    found["cop_x_model"] = centre_of_pressure(model[:, _PLANAR], threshold)
    units = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    change = centre_of_pressure_rows(units, model[:, _PLANAR], threshold)
    found["sd_cop_x_model"] = np.sqrt(np.sum((change * model_sd[:, _PLANAR]) ** 2, axis=1))
    for suffix in ("_reference", "_held_out"):
        found |= {f"{name}{suffix}": absent for name in ("Fx", "Fy", "tauz", "cop_x")}
    for j in range(torque.shape[1]):
        found[f"tau_{j + 1}"], found[f"sd_tau_{j + 1}"] = torque[:, j], torque_sd[:, j]
    return found | {"in_fit": in_fit}


def make_data(trial: SpatialTrial, found: SpatialIdentification, excited: Excitation) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5."""
    structure = trial.structure
    return _make_groups(found.full, len(found.base)) | {
        "base": {
            "name": np.array(structure.names, dtype=object),
            "value": found.base,
            "sd": found.base_sd,
            "covariance": found.covariance,
            "unit": np.array(structure.units, dtype=object),
            "verdict": np.array(excited.verdict, dtype=object),
            "excitation": excited.own,
            "own_share": excited.share,
            "relative_sd": excited.relative_sd,
            "prior_share": np.zeros(len(found.base)),
            "regrouping": structure.mapping,
        }
    }


def make_empty_data(segments: int, mass: float | None) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5 of a trial without an identification; ``mass``, kg, is None if unknown."""
    value = np.array([np.nan if mass is None else mass])
    absent = np.full(1, np.nan)
    full = np.full(10 * segments, np.nan)
    regrouping = np.zeros((1, 10 * segments))
    regrouping[0, ::10] = 1.0
    return _make_groups(full, 1) | {
        "base": {
            "name": np.array(["+".join(name_parameters_in_space(segments)[::10])], dtype=object),
            "value": value,
            "sd": absent,
            "covariance": absent[:, None],
            "unit": np.array(["kg"], dtype=object),
            "verdict": np.array(["not identifiable" if mass is None else "known"], dtype=object),
            "excitation": absent,
            "own_share": absent,
            "relative_sd": absent,
            "prior_share": absent,
            "regrouping": regrouping,
        }
    }


def _make_groups(full: FloatArray, base: int) -> dict[str, dict[str, Any]]:
    """Return the groups of dynamics.h5 except ``base``, without a reference body and a grid."""
    absent = np.full(len(full), np.nan)
    return {
        "full": {
            "name": np.array(name_parameters_in_space(len(full) // 10), dtype=object),
            "value": full,
            "reference": absent,
        },
        "bodies": {"value": full, "reference": absent, "covariance": np.full((len(full), len(full)), np.nan)},
        "grid": {"segment": np.zeros(0, dtype=np.int64), "position": np.zeros((0, 2)), "mass": np.zeros(0)},
        "held_out": {"base": np.zeros((0, base)), "clock_offset": np.zeros(0)},
    }


def make_facts(
    trial: SpatialTrial, found: SpatialIdentification, model: SpatialPrediction, threshold: float
) -> dict[str, Any]:
    """Return the facts of dynamics.h5 about an identification."""
    fit = found.fit
    compared = {
        name: agreement(model.wrench[:, k], model.measured[:, k], fit.in_fit) for k, name in enumerate(COMPONENTS)
    }
    cop = agreement(
        centre_of_pressure(model.wrench[:, _PLANAR], threshold),
        centre_of_pressure(model.measured[:, _PLANAR], threshold),
        fit.in_fit,
    )
    bias = {COMPONENTS[k]: float(value) for k, value in zip(trial.constants, found.plate_bias, strict=True)}
    return make_empty_facts_in_space(trial.recorded.chain, None) | {
        "condition_number": fit.condition,
        "condition_number_scaled": fit.condition_scaled,
        "clock_offset_s": fit.total_offset if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "clock": describe_clock(trial, fit),
        "wrench": {name: None if one is None else asdict(one) for name, one in compared.items()},
        "cop_rms_m": None if cop is None else float(np.hypot(cop.bias, cop.sd)),
        "samples": int(fit.in_fit.sum()),
        "consistency": "cone",
        "solver": describe_solver(found.solution, "cone"),
        "reference_pulls": False,
        "cutoff_hz": trial.lowpass.cutoff,
        "plate_bias": bias,
        "residual_covariance": found.residual_covariance.tolist(),
        "unit_covariance": found.unit_covariance.tolist(),
        "error_modes": [[mode.name, mode.parameters[: len(found.base)].tolist()] for mode in found.modes],
        "frames": trial.structure.frames[:, :3, :3].tolist(),
        "moments_about_m": trial.recorded.base[:3, 3].tolist(),
    }


def make_empty_facts_in_space(chain: SpatialChain, why: str | None) -> dict[str, Any]:
    """Return the facts of dynamics.h5 without an identification; ``why`` says why there is none.

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
    return make_empty_facts(why) | {"motion": motion, "rivals": {}, "torques": torques}


def make_no_averages() -> Table:
    """Return phases.parquet without rows, because trials in space are not averaged."""
    empty = np.zeros(0)
    names = np.zeros(0, dtype=object)
    values = {"span": names, "percent": empty, "quantity": names, "unit": names, "mean": empty, "sd": empty}
    why = "the repetitions of a trial in space are not averaged"
    return Table(PHASES, values | {"count": empty}, {"repetitions": {}, "compared": [], "why": why})
