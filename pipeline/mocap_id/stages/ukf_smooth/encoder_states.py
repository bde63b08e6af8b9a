"""A robot's encoder beside the cameras: its file, its fused states in the plane, and where the two disagree."""

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
from mocap_id.estimation.encoder import EncoderNoise, Fused, estimate_noise, fuse
from mocap_id.estimation.encoder_clock import Match, match
from mocap_id.recording.encoder_log import DEGREES, EncoderLog
from mocap_id.store import Table
from mocap_id.store.schemas import ENCODER
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.stages.ukf_smooth import UkfSmoothSettings

ENCODER_NOISE = "encoder noise"
_NAMES = ("theta", "dtheta", "ddtheta")
_DISAGREES = 0.999  # r² of the angle: two records of one joint share all but noise
_WEAK_OFFSET = 1e-3  # s, standard deviation; a robot's torque changes by per cents in so long
_SENSE = 2.0  # the other sense must leave so many times as much
_IN_DEGREES = 0.1  # share by which a factor may differ from that of degrees


def beside_cameras(file: Path | None, states: States, time: FloatArray, settings: UkfSmoothSettings) -> Table:
    """encoder.parquet: the encoder's states at the cameras' times, in the plane; no rows where there is no encoder.

    Parameters
    ----------
    file : Path or None
        The encoder's CSV.
    states : States
        By the cameras, F frames.
    time : (F,) array
        s.
    settings : UkfSmoothSettings

    Raises
    ------
    RecordingError
        The file is wrong, in degrees, or of another time than the recording.
    ConfigError
        The states are to come from an encoder that there is not.
    """
    if file is None:
        return _nothing("the configuration names no encoder", settings)
    if states.mean.shape[1] != 1:
        return _nothing(f"an encoder measures one joint, the chain has {states.mean.shape[1]}", settings)
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
        return _nothing("the cameras never tell the joint's angle", settings)
    own = fuse(log.time, log.position, log.velocity, noise)
    found = match(time, angle, own, settings.encoder_offset_limit_s)
    if found is None:
        raise RecordingError(_apart(file, log, time, settings.encoder_offset_limit_s))
    _check_unit(file, found)
    columns = _at_frames(log, noise, found, time)
    facts = _facts(log, own, found) | {"camera": _against(states.mean[:, 0], columns)}
    return Table(ENCODER, columns, facts, _doubts(file, found, settings.encoder_offset_limit_s))


def by_encoder(states: States, encoder: Table) -> States:
    """The states that the encoder gives in the place of the cameras' (F, 1, 4): without a jerk."""
    mean, sd = np.full(states.mean.shape, np.nan), np.full(states.sd.shape, np.nan)
    for d, name in enumerate(_NAMES):
        mean[:, 0, d] = encoder[name]
        sd[:, 0, d] = encoder[f"sd_{name}"]
    return replace(states, mean=mean, sd=sd, observed=np.isfinite(mean[..., 0]))


def _nothing(why: str, settings: UkfSmoothSettings) -> Table:
    if settings.method == "encoder":
        raise ConfigError(f"ukf-smooth: `method: encoder` needs an encoder's record: {why}; name one with `encoder:`")
    return Table(ENCODER, {column.name: np.empty(0) for column in ENCODER.columns}, {"why": why})


def _at_frames(log: EncoderLog, noise: EncoderNoise, found: Match, time: FloatArray) -> dict[str, FloatArray]:
    """The encoder's states at the cameras' times (F,); NaN where its record does not reach."""
    wanted = time - found.offset
    inside = (wanted >= log.time[0]) & (wanted <= log.time[-1])
    fused = fuse(log.time, log.position, log.velocity, noise, at=wanted[inside])
    mean, sd = (np.full((len(time), len(_NAMES)), np.nan) for _ in range(2))
    mean[inside], sd[inside] = found.into_plane(fused.mean), fused.sd
    columns = {name: mean[:, d] for d, name in enumerate(_NAMES)}
    return {"time": time, **columns, **{f"sd_{name}": sd[:, d] for d, name in enumerate(_NAMES)}}


def _facts(log: EncoderLog, own: Fused, found: Match) -> dict[str, Any]:
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
    """The cameras' states (F, 4) less the encoder's: bias, standard deviation, and r² about the encoder's."""
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
        f"recording, {time[0]:.6g} to {time[-1]:.6g} s, at any clock offset up to {limit:g} s: it is of another trial, "
        "or its clock has to be set to the recording's to within `ukf-smooth: {encoder_offset_limit_s: …}`"
    )


def _check_unit(file: Path, found: Match) -> None:
    if abs(found.gain * DEGREES - 1.0) < _IN_DEGREES:
        raise RecordingError(
            f"{file}: the angles are {1 / found.gain:.1f} times those of the cameras, as if they were in degrees; "
            "convert position and velocity to radians, as the columns' names say"
        )


def _doubts(file: Path, found: Match, limit: float) -> tuple[Reason, ...]:
    """What to know before the encoder is believed, or the cameras against it."""
    if not found.r2 >= _DISAGREES:
        message = (
            f"{file.name} and the cameras do not tell the same movement: r² of the angle is {found.r2:.4f}, the "
            f"difference {np.degrees(found.rms):.2f}° rms, and a factor of {found.gain:.3f} on the encoder would fit "
            "best. It is another joint or another trial, something between encoder and link gives, or the cameras' "
            "chain is wrong."
        )
        return (Reason("encoder-disagrees", message, found.r2, _DISAGREES),)
    if found.at_edge:
        message = (
            f"the encoder's clock is {limit:g} s or more off the cameras', which is as far as was sought: raise "
            "`ukf-smooth: {encoder_offset_limit_s: …}`"
        )
        return (Reason("encoder-weak", message, abs(found.offset), limit),)
    if found.other_sense < _SENSE * found.rms:
        message = (
            "the movement does not tell which way round the encoder counts: the other sense at another clock offset "
            f"fits nearly as well ({np.degrees(found.other_sense):.2f}° rms against {np.degrees(found.rms):.2f}°). Let "
            "the joint rest before and after it moves."
        )
        return (Reason("encoder-weak", message, found.other_sense / max(found.rms, 1e-12), _SENSE),)
    if found.offset_sd > _WEAK_OFFSET:
        message = (
            f"the movement tells the offset of the encoder's clock to {1e3 * found.offset_sd:.1f} ms only: it is too "
            "small or too slow for what encoder and cameras differ by."
        )
        return (Reason("encoder-weak", message, found.offset_sd, _WEAK_OFFSET),)
    return ()
