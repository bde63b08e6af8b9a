"""Pressures with which a device is nearest to a prescribed spring."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.config.device import DeviceConfig
from mocap_id.errors import ConfigError
from mocap_id.pneumatics.nearest_spring import NearestSpring, nearest_setting
from mocap_id.reporting.results.columns import finite

_GRID = 361


def spring_pressures(
    config: DeviceConfig, stiffness: float, rest: float, span: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Return the pressures nearest to a spring, and the spring that they give.

    Parameters
    ----------
    config : DeviceConfig
    stiffness, rest : float
        N·m/rad, rad.
    span : (low, high), optional
        Range over which the torques should agree, rad; by default the spring should agree at its rest angle.

    Raises
    ------
    ConfigError
        The stiffness is not above zero, or the range is empty or beyond the stroke.
    """
    if not 0 < stiffness < np.inf or not np.isfinite(rest):
        raise ConfigError(
            f"a spring of {stiffness:g} N·m/rad at {rest:g} rad: expected a stiffness above zero, in N·m/rad"
        )
    if span is not None and not span[0] < span[1]:
        raise ConfigError(
            f"the range {span[0]:g} to {span[1]:g} rad is empty: the first angle must be below the second"
        )
    angles = None if span is None else np.linspace(*span, _GRID)
    keys = config.keys
    try:
        found = nearest_setting(keys.cylinder(), stiffness, rest, keys.limits(), angles)
    except ValueError as error:
        raise ConfigError(f"{keys.device}: {error}") from error
    return {"device": keys.device, **nearest_spring(found)}


def nearest_spring(found: NearestSpring) -> dict[str, Any]:
    """Return a nearest spring as JSON."""
    return {
        "flexion_Pa": found.setting.flexion,
        "extension_Pa": found.setting.extension,
        "achieved": {
            "stiffness_Nm_rad": finite(found.stiffness),
            "rest_angle_rad": finite(found.rest),
            "range_rad": list(found.range),
            "largest_torque_error_Nm": found.largest_error,
            "rms_torque_error_Nm": found.rms_error,
        },
        "why": found.why,
    }
