"""Columns of wrench.parquet for the ground's wrench, in the plane and in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.geometry.plane_frame import PlaneFrame
from mocap_id.plates import PlateChoice
from mocap_id.recording import Plate, PlateSamples
from mocap_id.stages.planarise.external_wrenches import COMPONENTS, add_wrenches


def compute_ground_wrench(
    time: FloatArray, samples: Sequence[PlateSamples], choice: PlateChoice, frame: PlaneFrame, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of the feet's plates in the plane: their sum, and if there are several, each plate alone.

    Parameters
    ----------
    time : (F,) array
        Marker times, s.
    samples : sequence of PlateSamples
        Each plate's wrench at these times.
    choice : PlateChoice
    frame : PlaneFrame
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    """
    feet, count = choice.indices("feet"), len(time)
    total, ok = add_wrenches(samples, feet, frame) if feet else (np.empty((count, 3)), np.zeros(count, np.bool_))
    columns = _build_columns(time, COMPONENTS, total, ok, threshold)
    if len(samples) > 1:
        for number, plate in enumerate(samples, start=1):
            alone = frame.wrench_to_plane(plate.force, plate.moment).T.copy()
            columns |= {f"{name}_p{number}": each for name, each in zip(COMPONENTS, alone, strict=True)}
    return columns


_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])  # of a wrench, for z → -z: moments are axial vectors


def compute_ground_wrench_in_space(
    time: FloatArray,
    samples: Sequence[PlateSamples],
    choice: PlateChoice,
    frame: PlaneFrame,
    threshold: float,
    *,
    mirrored: bool = False,
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of the sum of the feet's plates in space: six components at marker times.

    Parameters as in :func:`compute_ground_wrench`. ``frame`` is the frame of the trial (y up), about whose origin the
    moments are. ``mirrored`` says whether the trial is mirrored, z → -z.
    """
    feet, count = choice.indices("feet"), len(time)
    ok = np.logical_and.reduce([samples[index].ok for index in feet]) if feet else np.zeros(count, np.bool_)
    force = sum((samples[index].force for index in feet), np.zeros((count, 3)))
    moment = sum((samples[index].moment for index in feet), np.zeros((count, 3))) - np.cross(frame.origin, force)
    total = np.concatenate([force @ frame.axes.T, moment @ frame.axes.T], axis=1)
    if mirrored:
        total *= _MIRROR
    return _build_columns(time, _IN_SPACE, total, ok, threshold)


def _build_columns(
    time: FloatArray, names: Sequence[str], total: FloatArray, ok: BoolArray, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of a wrench (F, len(names)) whose second component is Fy and whose last is tauz."""
    total[~ok] = np.nan
    with np.errstate(invalid="ignore"):
        vertical = np.where(total[:, 1] > threshold, total[:, 1], np.nan)
    components = dict(zip(names, total.T.copy(), strict=True))
    return {"time": time, **components, "cop_x": total[:, -1] / vertical, "plate_ok": ok}


def find_plates_centre(
    plates: Sequence[Plate], choice: PlateChoice, frame: PlaneFrame, *, mirrored: bool
) -> list[float] | None:
    """Return the centre (3,) of the feet's plates in the frame of a trial in space, m; None if it is not known."""
    centres = [plates[index].centre for index in choice.indices("feet")]
    known = [each for each in centres if each is not None]
    if not known or len(known) < len(centres):
        return None
    centre = frame.to_plane(np.mean(known, axis=0))
    return [float(x) for x in (centre * [1.0, 1.0, -1.0] if mirrored else centre)]


def measure_lateral_cop(samples: Sequence[PlateSamples], frame: PlaneFrame, threshold: float) -> list[float | None]:
    """Return the median centre of pressure of each plate along z, m; None for a plate that is hardly loaded."""
    medians: list[float | None] = []
    for plate in samples:
        force = plate.force @ frame.axes.T
        moment = (plate.moment - np.cross(frame.origin, plate.force)) @ frame.axes.T
        loaded = plate.ok & (np.nan_to_num(force[:, 1]) > threshold)
        medians.append(float(np.median(-moment[loaded, 0] / force[loaded, 1])) if loaded.any() else None)
    return medians
