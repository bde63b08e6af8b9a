"""Force-plate types 1-4: channels → force and moment about the centre of the working surface, in the plate's frame.

The plate's frame is right-handed with z down. Whether the channels hold the load on the plate or the reaction on the
body is not decided here: force and moment carry the channels' own sense.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Channels by type."""


class UnusablePlateError(Exception):
    """A plate cannot be decoded; the message says why. It is left out, and the recording goes on without it."""


@dataclass(frozen=True)
class PlateSignals:
    """One plate's channels with what is needed to read them, SI.

    Parameters
    ----------
    kind : int
        FORCE_PLATFORM:TYPE, 1 to 4.
    channels : (K, C) array
        Type 1: Fx Fy Fz (N), CoPx CoPy (m), Tz (N·m). Types 2 and 4: Fx Fy Fz (N), Mx My Mz (N·m), a calibration
        matrix already applied. Type 3: Fx12 Fx34 Fy14 Fy23 Fz1 Fz2 Fz3 Fz4 (N).
    origin : (3,) array
        m, plate frame. Types 2 and 4: from the transducer to the centre of the working surface (z negative). Type 3:
        half the sensor distances along x and y, and the same z.
    corners : (4, 3) array
        (+x+y, -x+y, -x-y, +x-y) in the lab, m.
    rate : float
        Samples per second.
    """

    kind: int
    channels: FloatArray
    origin: FloatArray
    corners: FloatArray
    rate: float


def surface_wrench(plate: PlateSignals) -> tuple[FloatArray, FloatArray]:
    """Force (K, 3) N and moment (K, 3) N·m about the centre of the working surface, plate frame."""
    if plate.kind == 1:
        return _from_centre_of_pressure(plate.channels)
    if plate.kind == 3:
        force, moment = _from_four_sensors(plate.channels, plate.origin)
        arm = np.array([0.0, 0.0, plate.origin[2]])
    else:
        force, moment, arm = plate.channels[:, :3], plate.channels[:, 3:6], plate.origin
    return force, moment - np.cross(arm, force)


def _from_centre_of_pressure(channels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Type 1: force, point of application and free moment."""
    force = channels[:, :3]
    point = np.column_stack([channels[:, 3:5], np.zeros(len(channels))])
    moment = np.cross(point, force)
    moment[:, 2] += channels[:, 5]
    return force, moment


def _from_four_sensors(channels: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Type 3: piezoelectric plate with a three-component sensor near each corner, in the quadrants 1 to 4.

    Sensors 1 (+x+y), 2 (-x+y), 3 (-x-y), 4 (+x-y), at ±a along x and ±b along y.
    """
    x12, x34, y14, y23, z1, z2, z3, z4 = channels.T
    a, b = origin[0], origin[1]
    force = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
    moment = np.column_stack(
        [
            b * (z1 + z2 - z3 - z4),
            a * (-z1 + z2 + z3 - z4),
            b * (-x12 + x34) + a * (y14 - y23),
        ]
    )
    return force, moment


def plate_axes(corners: FloatArray) -> FloatArray:
    """The plate's axes in the lab as columns, (3, 3); NaN where the corners span no rectangle.

    x runs from corners 2 and 3 to 1 and 4, y from 3 and 4 to 1 and 2, z = x × y.
    """
    x = corners[0] - corners[1] + corners[3] - corners[2]
    y = corners[0] - corners[3] + corners[1] - corners[2]
    z = np.cross(x, y)
    lengths = np.array([np.linalg.norm(v) for v in (x, y, z)])
    if not np.all(lengths > 1e-6) or abs(x @ y) > 0.2 * lengths[0] * lengths[1]:
        return np.full((3, 3), np.nan)
    ex, ez = x / lengths[0], z / lengths[2]
    return np.column_stack([ex, np.cross(ez, ex), ez])
