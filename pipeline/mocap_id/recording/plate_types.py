"""Force and moment of plates of types 1 to 4, in the plate frame about the centre of the working surface.

The plate frame is right-handed with z down. The sign convention is that of the channels;
:mod:`mocap_id.recording.lab_plates` decides whether they measure the force on the plate or on the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Number of channels of each type."""


class UnusablePlateError(Exception):
    """Error for a plate that cannot be decoded; the recording is read without it, and the message says why."""


@dataclass(frozen=True)
class PlateSignals:
    """Channels of one plate and its geometry, SI units.

    Parameters
    ----------
    kind : int
        FORCE_PLATFORM:TYPE, 1 to 4.
    channels : (K, C) array
        Type 1: Fx Fy Fz (N), CoPx CoPy (m), Tz (N·m). Types 2 and 4: Fx Fy Fz (N), Mx My Mz (N·m), after
        calibration. Type 3: Fx12 Fx34 Fy14 Fy23 Fz1 Fz2 Fz3 Fz4 (N).
    origin : (3,) array
        Vector in the plate frame, m. Types 2 and 4: from the transducer to the centre of the working surface (z
        negative). Type 3: half the distances between sensors along x and y, and z as for type 2. Type 1: zero.
    corners : (4, 3) array
        Corners in the lab, in the order +x+y, -x+y, -x-y, +x-y, m.
    rate : float
        Samples per second.
    """

    kind: int
    channels: FloatArray
    origin: FloatArray
    corners: FloatArray
    rate: float


def compute_surface_wrench(plate: PlateSignals) -> tuple[FloatArray, FloatArray]:
    """Return force (K, 3), N, and moment (K, 3) about the centre of the working surface, N·m, in the plate frame."""
    if plate.kind == 1:
        force = plate.channels[:, :3]
        point = np.column_stack([plate.channels[:, 3:5], np.zeros(len(force))])
        moment = np.cross(point, force)
        moment[:, 2] += plate.channels[:, 5]
        return force, moment
    if plate.kind == 3:
        force, moment = _add_four_sensors(plate.channels, plate.origin)
        arm = np.array([0.0, 0.0, plate.origin[2]])
    else:
        force, moment, arm = plate.channels[:, :3], plate.channels[:, 3:6], plate.origin
    return force, moment - np.cross(arm, force)


def _add_four_sensors(channels: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return force and moment, both (K, 3), of a type 3 plate, which has a three-component sensor near each corner.

    The moment is about the point between the sensors, in their plane. The sensors 1 (+x+y), 2 (-x+y), 3 (-x-y) and 4
    (+x-y) are at ±a along x and ±b along y.
    """
    x12, x34, y14, y23, z1, z2, z3, z4 = channels.T
    a, b = origin[0], origin[1]
    force = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
    mx, my, mz = b * (z1 + z2 - z3 - z4), a * (-z1 + z2 + z3 - z4), b * (-x12 + x34) + a * (y14 - y23)
    return force, np.column_stack([mx, my, mz])


def compute_plate_axes(corners: FloatArray) -> FloatArray:
    """Return the plate's axes in the lab as columns, (3, 3); NaN if the corners do not form a rectangle.

    x points from corners 2 and 3 to corners 1 and 4, y from corners 3 and 4 to corners 1 and 2, and z = x × y.
    """
    x = corners[0] - corners[1] + corners[3] - corners[2]
    y = corners[0] - corners[3] + corners[1] - corners[2]
    z = np.cross(x, y)
    lengths = np.array([np.linalg.norm(v) for v in (x, y, z)])
    if not np.all(lengths > 1e-6) or abs(x @ y) > 0.2 * lengths[0] * lengths[1]:
        return np.full((3, 3), np.nan)
    ex, ez = x / lengths[0], z / lengths[2]
    return np.column_stack([ex, np.cross(ez, ex), ez])
