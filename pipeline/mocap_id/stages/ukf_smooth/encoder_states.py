"""Joint states from a robot's encoder, expressed in the plane and compared with the states from the cameras."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.estimation import States
from mocap_id.estimation.encoder_clock import match_encoder
from mocap_id.estimation.encoder_smoothing import estimate_encoder_noise, smooth_encoder
from mocap_id.recording.held_samples import describe_held
from mocap_id.recording.sensor_logs import DEGREES
from mocap_id.stages.base import Findings
from mocap_id.store import Table
from mocap_id.store.schemas import ENCODER

if TYPE_CHECKING:
    from mocap_id.stages.ukf_smooth import UkfSmoothSettings

_NAMES = ("theta", "dtheta", "ddtheta")
_LEAST_R2 = 0.999  # of the angle; two records of the same joint differ only by noise
_LARGEST_OFFSET_SD = 1e-3  # s; the torque of a robot changes by some per cent in this time
_LEAST_RATIO = 2.0  # of the residuals with the opposite direction of rotation to those with the chosen one
_IN_DEGREES = 0.1  # relative tolerance of the factor between degrees and radians


def read_encoder_states(file: Path | None, states: States, time: FloatArray, settings: UkfSmoothSettings) -> Table:
    """Return encoder.parquet: the encoder's states at the cameras' times (F,), s, with the sign and zero of the plane.

    The table has no rows if ``file`` is None, if the chain has several joints, or if the cameras give no angle.

    RecordingError is raised if the file is invalid, is in degrees, or covers less than half of the recording,
    ConfigError if `method: encoder` is set but the table has no rows.
    """

    def skip(why: str) -> Table:
        if settings.method == "encoder":
            raise ConfigError(
                f"ukf-smooth: `method: encoder` cannot be used: {why}; give a suitable `encoder:`, or another `method:`"
            )
        return empty_encoder_table(why)

    if file is None:
        return skip("the configuration names no encoder")
    if states.mean.shape[1] != 1:
        return skip(f"an encoder measures one joint, but the chain has {states.mean.shape[1]}")
    angle, limit = states.mean[:, 0, 0], settings.encoder_offset_limit_s
    log = recording.read_encoder(file)
    noise = estimate_encoder_noise(
        log.time,
        log.position,
        log.velocity,
        position_sd=settings.encoder_position_sd,
        velocity_sd=settings.encoder_velocity_sd,
    )
    if not np.isfinite(angle).any():
        return skip("the cameras give no angle of the joint")
    match = match_encoder(time, angle, smooth_encoder(log.time, log.position, log.velocity, noise), limit)
    if match is None:
        raise RecordingError(
            f"{file}: the file, from {log.time[0]:.6g} to {log.time[-1]:.6g} s, covers less than half of the "
            f"recording, from {time[0]:.6g} to {time[-1]:.6g} s, with every clock offset up to {limit:g} s: it is from "
            "another trial, or its clock differs by more than `ukf-smooth: {encoder_offset_limit_s: …}`"
        )
    if abs(match.gain * DEGREES - 1.0) < _IN_DEGREES:
        raise RecordingError(
            f"{file}: the angles are {1 / match.gain:.1f} times the cameras' angles, as if they were in degrees; "
            "convert position and velocity to radians, as the names of the columns require"
        )
    # the encoder's states at the cameras' times, NaN outside the encoder's record
    stamps = time - match.offset
    inside = (stamps >= log.time[0]) & (stamps <= log.time[-1])
    smoothed = smooth_encoder(log.time, log.position, log.velocity, noise, at=stamps[inside])
    mean, sd = (np.full((len(time), len(_NAMES)), np.nan) for _ in range(2))
    mean[inside], sd[inside] = match.express_in_plane(smoothed.mean), smoothed.sd
    columns = {"time": time, **dict(zip(_NAMES, mean.T, strict=True))}
    columns |= {f"sd_{name}": sd[:, d] for d, name in enumerate(_NAMES)}
    # the cameras' states relative to the encoder's; None with less than two common frames, or an encoder at rest
    camera: dict[str, dict[str, float | None]] = {}
    for d, name in enumerate(_NAMES):
        both = np.isfinite(states.mean[:, 0, d]) & np.isfinite(mean[:, d])
        off = (states.mean[:, 0, d] - mean[:, d])[both]
        spread = float(np.var(mean[both, d])) if both.any() else 0.0
        camera[name] = {"bias": None, "sd": None, "r2": None}
        if len(off) >= 2 and spread > 0.0:
            r2 = 1.0 - float(np.mean(off**2)) / spread
            camera[name] = {"bias": float(np.mean(off)), "sd": float(np.std(off)), "r2": r2}
    facts = {
        "why": None,
        "sign": match.sign,
        "zero_rad": match.zero,
        "zero_sd_rad": match.zero_sd,
        "clock_offset_s": match.offset,
        "clock_offset_sd_s": match.offset_sd,
        "gain": match.gain,
        "rate_hz": log.rate,
        "noise": asdict(noise),
        "torque": log.torque is not None,
        "camera": camera,
    }
    out = Findings(describe_held(log.held))
    if not match.r2 >= _LEAST_R2:
        out.say(
            "encoder-disagrees",
            f"{file.name} and the cameras measured different movements: r² of the angle is {match.r2:.4f}, the "
            f"difference is {np.degrees(match.rms):.2f}° rms, and the encoder's angle times {match.gain:.3f} would fit "
            "best. The file is from another joint or trial, the drive between encoder and link is elastic, or the "
            "chain estimated from the cameras is wrong.",
            match.r2,
            _LEAST_R2,
        )
    elif match.at_edge:
        out.say(
            "encoder-weak",
            f"the clocks of encoder and cameras differ by {limit:g} s, the largest offset that is tried, or by more: "
            "raise `ukf-smooth: {encoder_offset_limit_s: …}`",
            abs(match.offset),
            limit,
        )
    elif match.opposite_rms < _LEAST_RATIO * match.rms:
        out.say(
            "encoder-weak",
            "the movement does not determine the encoder's direction of rotation: the opposite direction with another "
            f"clock offset fits nearly as well ({np.degrees(match.opposite_rms):.2f}° rms; the chosen direction: "
            f"{np.degrees(match.rms):.2f}°). Let the joint rest before and after it moves.",
            match.opposite_rms / max(match.rms, 1e-12),
            _LEAST_RATIO,
        )
    elif match.offset_sd > _LARGEST_OFFSET_SD:
        out.say(
            "encoder-weak",
            f"the clock offset of the encoder has a standard deviation of {1e3 * match.offset_sd:.1f} ms: the movement "
            "is too small or too slow for the difference between encoder and cameras.",
            match.offset_sd,
            _LARGEST_OFFSET_SD,
        )
    return Table(ENCODER, columns, facts, tuple(out.reasons))


def empty_encoder_table(why: str) -> Table:
    """Return encoder.parquet without rows; ``why`` is the reason, which becomes a fact of the table."""
    return Table(ENCODER, {column.name: np.empty(0) for column in ENCODER.columns}, {"why": why})
