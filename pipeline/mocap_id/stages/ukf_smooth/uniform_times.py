"""Check of the recording's time stamps: the process model has a fixed time step."""

from __future__ import annotations

import numpy as np

from mocap_id.errors import RecordingError
from mocap_id.store.views import Trajectories

_JITTER = 0.25  # of a frame; rounding to milliseconds causes this at 500 Hz


def check_uniform(view: Trajectories, trial: str) -> None:
    """Raise RecordingError for times that are not uniform, since the process model has a fixed time step."""
    time, period = view.time, 1.0 / view.rate
    off = np.abs(time - time[0] - period * np.arange(len(time))) / period
    if not np.all(off <= _JITTER):
        k = int(np.argmax(~(off <= _JITTER)))
        raise RecordingError(
            f"trial {trial}: ukf-smooth: time stamps are not uniform: frame {view.frames[k]} is at "
            f"{time[k]:.4f} s where {view.rate:g} frames per second put it at {time[0] + period * k:.4f} s; "
            "export the trial at a constant rate with a row for every frame, or use a `window:` without the break"
        )
