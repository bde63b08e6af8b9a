"""Joint states from a robot's encoder, expressed in the plane and compared with the cameras'."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.estimation import States
from mocap_id.estimation.encoder_clock import EncoderMatch, match_encoder
from mocap_id.estimation.encoder_smoothing import EncoderNoise, EncoderStates, estimate_noise, smooth_encoder
from mocap_id.recording.encoder_log import DEGREES, EncoderLog
from mocap_id.store import Table
from mocap_id.store.schemas import ENCODER
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.stages.ukf_smooth import UkfSmoothSettings

ENCODER_NOISE = "encoder noise"
_NAMES = ("theta", "dtheta", "ddtheta")
_DISAGREES = 0.999  # r² of the angle; two records of the same joint differ only by noise
_WEAK_OFFSET = 1e-3  # s, standard deviation; the torque of a robot changes by some per cent in this time
_SENSE = 2.0  # smallest ratio between the residuals of the opposite and of the chosen sense
_IN_DEGREES = 0.1  # relative tolerance of the factor between degrees and radians


def beside_cameras(file: Path | None, states: States, time: FloatArray, settings: UkfSmoothSettings) -> Table:
    """Return encoder.parquet: the encoder's states at the cameras' times, in the plane; no rows without an encoder.

    Parameters
    ----------
    file : Path or None
        CSV file of the encoder.
    states : States
        From the cameras, F frames.
    time : (F,) array
        s.
    settings : UkfSmoothSettings

    Raises
    ------
    RecordingError
        The file is invalid, in degrees, or does not overlap with the recording.
    ConfigError
        `method: encoder` is set without an encoder.
    """
    if file is None:
        return _nothing("the configuration names no encoder", settings)
    if states.mean.shape[1] != 1:
        return _nothing(f"an encoder measures one joint, but the chain has {states.mean.shape[1]}", settings)
    log = recording.read_encoder(file)
    noise = estimate_noise(
        log.time,
        log.position,
        log.velocity,
        position_sd=settings.encoder_position_sd,
        velocity_sd=settings.encoder_velocity_sd,
    )
    angle = states.mean[:, 0, 0]
    if not np.isfinite(angle).any():
        return _nothing("the cameras never show the joint's angle", settings)
    own = smooth_encoder(log.time, log.position, log.velocity, noise)
    found = match_encoder(time, angle, own, settings.encoder_offset_limit_s)
    if found is None:
        raise RecordingError(_apart(file, log, time, settings.encoder_offset_limit_s))
    _check_unit(file, found)
    columns = _at_frames(log, noise, found, time)
    facts = _facts(log, own, found) | {"camera": _against(states.mean[:, 0], columns)}
    return Table(ENCODER, columns, facts, _doubts(file, found, settings.encoder_offset_limit_s))


def by_encoder(states: States, encoder: Table) -> States:
    """Return the states (F, 1, 4) with the encoder's values; their jerk is NaN."""
    mean, sd = np.full(states.mean.shape, np.nan), np.full(states.sd.shape, np.nan)
    for d, name in enumerate(_NAMES):
        mean[:, 0, d] = encoder[name]
        sd[:, 0, d] = encoder[f"sd_{name}"]
    return replace(states, mean=mean, sd=sd, observed=np.isfinite(mean[..., 0]))


def _nothing(why: str, settings: UkfSmoothSettings) -> Table:
    if settings.method == "encoder":
        raise ConfigError(f"ukf-smooth: `method: encoder` needs an encoder: {why}; name its file under `encoder:`")
    return no_encoder(why)


def no_encoder(why: str) -> Table:
    """Return encoder.parquet without rows."""
    return Table(ENCODER, {column.name: np.empty(0) for column in ENCODER.columns}, {"why": why})


def _at_frames(log: EncoderLog, noise: EncoderNoise, found: EncoderMatch, time: FloatArray) -> dict[str, FloatArray]:
    """Return the encoder's states at the cameras' times (F,); NaN outside its record."""
    wanted = time - found.offset
    inside = (wanted >= log.time[0]) & (wanted <= log.time[-1])
    fused = smooth_encoder(log.time, log.position, log.velocity, noise, at=wanted[inside])
    mean, sd = (np.full((len(time), len(_NAMES)), np.nan) for _ in range(2))
    mean[inside], sd[inside] = found.into_plane(fused.mean), fused.sd
    columns = {name: mean[:, d] for d, name in enumerate(_NAMES)}
    return {"time": time, **columns, **{f"sd_{name}": sd[:, d] for d, name in enumerate(_NAMES)}}


def _facts(log: EncoderLog, own: EncoderStates, found: EncoderMatch) -> dict[str, Any]:
    return {
        "why": None,
        "sign": found.sign,
        "zero_rad": found.zero,
        "zero_sd_rad": found.zero_sd,
        "clock_offset_s": found.offset,
        "clock_offset_sd_s": found.offset_sd,
        "gain": found.gain,
        "rate_hz": log.rate,
        "noise": asdict(own.noise),
        "torque": log.torque is not None,
    }


def _against(states: FloatArray, encoder: Mapping[str, FloatArray]) -> dict[str, dict[str, float | None]]:
    """Return bias, standard deviation and r² of the cameras' states (F, 4) with respect to the encoder's."""
    found: dict[str, dict[str, float | None]] = {}
    for d, name in enumerate(_NAMES):
        reference = encoder[name]
        both = np.isfinite(states[:, d]) & np.isfinite(reference)
        off, spread = (states[:, d] - reference)[both], float(np.var(reference[both])) if both.any() else 0.0
        if len(off) < 2 or not spread > 0.0:
            found[name] = {"bias": None, "sd": None, "r2": None}
            continue
        r2 = 1.0 - float(np.mean(off**2)) / spread
        found[name] = {"bias": float(np.mean(off)), "sd": float(np.std(off)), "r2": r2}
    return found


def _apart(file: Path, log: EncoderLog, time: FloatArray, limit: float) -> str:
    return (
        f"{file}: the encoder's record from {log.time[0]:.6g} to {log.time[-1]:.6g} s covers less than half of the "
        f"recording, {time[0]:.6g} to {time[-1]:.6g} s, at any clock offset up to {limit:g} s: it is from another "
        "trial, or its clock differs by more than `ukf-smooth: {encoder_offset_limit_s: …}`"
    )


def _check_unit(file: Path, found: EncoderMatch) -> None:
    if abs(found.gain * DEGREES - 1.0) < _IN_DEGREES:
        raise RecordingError(
            f"{file}: the angles are {1 / found.gain:.1f} times those of the cameras, as if they were in degrees; "
            "convert position and velocity to radians, as the names of the columns require"
        )


def _doubts(file: Path, found: EncoderMatch, limit: float) -> tuple[Reason, ...]:
    """Return cautions about the match between encoder and cameras."""
    if not found.r2 >= _DISAGREES:
        message = (
            f"{file.name} and the cameras show different movements: r² of the angle is {found.r2:.4f}, the "
            f"difference {np.degrees(found.rms):.2f}° rms, and a factor of {found.gain:.3f} on the encoder would fit "
            "best. The file is from another joint or trial, the drive between encoder and link is elastic, or the "
            "chain found by the cameras is wrong."
        )
        return (Reason("encoder-disagrees", message, found.r2, _DISAGREES),)
    if found.at_edge:
        message = (
            f"the encoder's clock differs from the cameras' by {limit:g} s or more, the largest offset considered: "
            "raise `ukf-smooth: {encoder_offset_limit_s: …}`"
        )
        return (Reason("encoder-weak", message, abs(found.offset), limit),)
    if found.other_sense < _SENSE * found.rms:
        message = (
            "the movement does not show the sense of the encoder: the opposite sense with another clock offset "
            f"fits nearly as well ({np.degrees(found.other_sense):.2f}° rms against {np.degrees(found.rms):.2f}°). Let "
            "the joint rest before and after it moves."
        )
        return (Reason("encoder-weak", message, found.other_sense / max(found.rms, 1e-12), _SENSE),)
    if found.offset_sd > _WEAK_OFFSET:
        message = (
            f"the clock offset of the encoder has a standard deviation of {1e3 * found.offset_sd:.1f} ms: the movement "
            "is too small or too slow for the difference between encoder and cameras."
        )
        return (Reason("encoder-weak", message, found.offset_sd, _WEAK_OFFSET),)
    return ()
