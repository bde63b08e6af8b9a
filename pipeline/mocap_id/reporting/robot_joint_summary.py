"""Summary and table of a robot joint: distance from the plane origin, and errors against the encoder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id.reporting.dynamics_schema import ChannelEntry
from mocap_id.reporting.grids import Grid, to_grid
from mocap_id.reporting.numbers import NOT_FINITE, to_number
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import EncoderEntry, LengthEntry, Summary
from mocap_id.reporting.tables import make_error_columns
from mocap_id.store.views import Skeleton

_COMPARED = {
    "theta": "angle, cameras (rad)",
    "dtheta": "velocity, cameras (rad/s)",
    "ddtheta": "acceleration, cameras (rad/s²)",
}
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


def list_encoder_errors(summary: Summary) -> Grid:
    """Return a table of the errors of cameras and model against the encoder; empty without an encoder."""
    found = summary.encoder
    if found.clock_offset_s is None or found.clock_offset_sd_s is None:
        return Grid()
    errors = {name: (found.camera or {}).get(key) for key, name in _COMPARED.items()}
    errors["torque, identified model (N·m)"] = found.torque
    clock = f"{1e3 * found.clock_offset_s:.2f} ± {1e3 * found.clock_offset_sd_s:.2f} ms"
    sense = "the same" if found.sign == 1 else "the opposite"
    caption = f"Error against the encoder ({sense} sense as the plane; clock {clock} after the cameras')"
    known_errors = {name: error for name, error in errors.items() if error is not None}
    return to_grid(caption, known_errors, make_error_columns(5), "quantity")
