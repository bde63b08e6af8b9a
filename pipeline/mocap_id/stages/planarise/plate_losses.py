"""What the feet's plates did not measure: samples at the end of their range, beyond their file, or without a signal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.recording import Plate
from mocap_id.verdict import Reason

_FEW = 0.05
"""Of the samples: fewer that lie beyond the plates' file are a note."""


def losses(plates: Sequence[Plate], time: FloatArray, dropout: BoolArray) -> tuple[Reason, ...]:
    """Reasons for samples that no identification can use.

    Parameters
    ----------
    plates : sequence of Plate
        Those under the feet.
    time : (F,) array
        Marker times, s.
    dropout : (F,) bool array
        As :func:`mocap_id.plates.dropout.dropped_out` found them.
    """
    found = [reason for plate in plates for reason in (_saturated(plate, time), _short(plate, time))]
    return tuple(reason for reason in (*found, _dropout(time, dropout)) if reason is not None)


def _saturated(plate: Plate, time: FloatArray) -> Reason | None:
    if plate.saturated is None:
        return None
    stamped = plate.start + np.arange(len(plate.ok)) / plate.rate
    share = float(plate.saturated[(stamped >= time[0]) & (stamped <= time[-1])].mean())
    if share == 0.0:
        return None
    return Reason(
        "plate-saturated",
        f"plate {plate.index} is at the end of its range in {100 * share:.1f} % of its samples, expected none: they "
        "are left out, and what is largest in the movement with them. Choose a larger range of its amplifier",
        value=share,
        limit=0.0,
    )


def _short(plate: Plate, time: FloatArray) -> Reason | None:
    """Frames before the plate's first sample or after its last one, by more than one interval of either clock."""
    slack = 1.0 / plate.rate + float(np.median(np.diff(time)))
    end = plate.start + (len(plate.ok) - 1) / plate.rate
    share = float(np.mean((time < plate.start - slack) | (time > end + slack)))
    if share == 0.0:
        return None
    return Reason(
        "plate-short",
        f"the forces of plate {plate.index} run from {plate.start:.2f} to {end:.2f} s and the markers from "
        f"{time[0]:.2f} to {time[-1]:.2f} s: {100 * share:.0f} % of the frames have no force and are not identified "
        "on. If both were recorded together, export the whole of them; check that they belong to one trial",
        value=share,
        limit=_FEW,
        level="caution" if share > _FEW else "ok",
    )


def _dropout(time: FloatArray, dropout: BoolArray) -> Reason | None:
    if not dropout.any():
        return None
    first = time[np.argmax(dropout)]
    return Reason(
        "plate-dropout",
        f"the plates carry nothing in {100 * dropout.mean():.0f} % of the frames, from {first:.2f} s on, while the "
        "person stands on them: a cable, an amplifier's reset, or a step beside them. These frames are left out; "
        "look at the plates' signal there, or give the `window:` without them",
        value=float(dropout.mean()),
        limit=0.0,
    )
