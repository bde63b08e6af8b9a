"""A robot's joint: its distance from the plane's origin, and its encoder beside the cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.dynamics_shape import ChannelEntry
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import known, show, show_fixed
from mocap_id.reporting.shape import EncoderEntry, LengthEntry, Summary
from mocap_id.reporting.tables import Grid, grid
from mocap_id.reporting.views import Skeleton

_COMPARED = {
    "theta": "angle, cameras (rad)",
    "dtheta": "velocity, cameras (rad/s)",
    "ddtheta": "acceleration, cameras (rad/s²)",
}
_NUMBERS = ("zero_rad", "zero_sd_rad", "clock_offset_s", "clock_offset_sd_s")


def base_length(material: Material, skeleton: Skeleton) -> dict[str, LengthEntry]:
    """Distance of a robot's joint from the plane's origin (thesis table 5.1); nothing for other protocols."""
    if material.settings.get("protocol") != "robot-joint" or not len(skeleton.centres):
        return {}
    value = float(np.hypot(*skeleton.centres[0]))
    along = skeleton.centres[0] / value if value > 0 else np.zeros(2)
    sd = float(np.sqrt(along @ skeleton.covariance[0] @ along))
    length, spread = known(value), known(sd)
    why = None if length is not None and spread is not None else "the joint fit gave no finite value"
    return {"base": LengthEntry(value=length, sd=spread, why=why)}


def channels(found: Mapping[str, Mapping[str, object] | None] | None) -> dict[str, ChannelEntry]:
    """How far a model, or a measurement, is off in each component."""
    return {str(name): _channel(channel) for name, channel in (found or {}).items()}


def _channel(channel: Mapping[str, object] | None) -> ChannelEntry:
    numbers = {key: known((channel or {}).get(key)) for key in ("bias", "sd", "r2")}
    complete = all(number is not None for number in numbers.values())
    why = None if complete else "it could not be computed over the samples of the fit"
    return ChannelEntry(**numbers, why=why)


def encoder(material: Material) -> EncoderEntry:
    """The encoder's clock and zero, and what cameras and model are off it."""
    facts: Mapping[str, Any] = material.facts("encoder.parquet")
    torque = material.facts("dynamics.h5").get("torque")
    sign, why = known(facts.get("sign")), facts.get("why")
    if sign is None and why is None:
        why = material.why_missing("encoder.parquet")
    if why is None and torque is None:
        why = "torque: " + ("no torque was identified" if facts.get("torque") else "the encoder's record has none")
    return EncoderEntry(
        sign=None if sign is None else int(sign),
        **{name: known(facts.get(name)) for name in _NUMBERS},
        camera=channels(facts.get("camera")) or None,
        torque=None if torque is None else _channel(torque),
        why=why,
    )


def encoder_table(summary: Summary) -> Grid:
    """What cameras and model are off the encoder; nothing where there is none."""
    found = summary.encoder
    if found.clock_offset_s is None or found.clock_offset_sd_s is None:
        return grid("Encoder", (), ())
    compared = {name: (found.camera or {}).get(key) for key, name in _COMPARED.items()}
    compared["torque, identified model (N·m)"] = found.torque
    rows = [
        (name, show(channel.bias), show(channel.sd), show_fixed(channel.r2, 5))
        for name, channel in compared.items()
        if channel is not None
    ]
    clock = f"{1e3 * found.clock_offset_s:.2f} ± {1e3 * found.clock_offset_sd_s:.2f} ms"
    caption = (
        f"Less the encoder's, which counts {'with' if found.sign == 1 else 'against'} the plane, its clock {clock}"
    )
    return grid(f"{caption} after the cameras'", ("", "bias", "standard deviation", "r²"), rows)
