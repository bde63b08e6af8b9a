"""Inputs of the identification in space: chain, motion of the segments, base at rest, and wrench (6 components)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, find_complete_rows
from mocap_id.dynamics.fit import determines_parameters
from mocap_id.dynamics.preparation import FitSettings
from mocap_id.dynamics.sample_choice import LEAST_SECONDS, select_samples
from mocap_id.dynamics.space.instrument_errors import SpatialCalibration
from mocap_id.dynamics.space.preparation import COMPONENTS, SpatialRecord, SpatialTrial, prepare
from mocap_id.geometry import se3, so3
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.identifiability import NotIdentifiable
from mocap_id.stages.identify_dim.trial_data import read_common_time, read_wrench
from mocap_id.store import Table
from mocap_id.store.spatial_views import SpatialSkeleton

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
    trial = prepare(replace(record, averaged=width), _make_fit_settings(settings, clock.search))
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
