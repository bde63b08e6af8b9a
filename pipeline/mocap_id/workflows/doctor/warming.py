"""The compiled code of a run, made before the first run needs it."""

from __future__ import annotations

import time

import numpy as np

from mocap_id.estimation import smooth
from mocap_id.estimation.encoder import estimate_noise, fuse
from mocap_id.geometry.planar import marker_positions
from mocap_id.workflows.doctor.check import Check
from mocap_id.workflows.doctor.machine import compiled_code

_RATE = 100.0


def warm() -> Check:
    """Filter a swinging arm and its encoder, for which everything is compiled that a run would compile.

    Compiled code belongs to the user and to the processor: whoever runs trials has to warm it, on the same machine.
    """
    start = time.perf_counter()
    moment = np.arange(200) / _RATE
    angles = np.stack([np.sin(3.0 * moment), np.cos(2.0 * moment)], axis=1)
    centres, segment = np.array([[0.0, 0.0], [0.4, 0.0]]), np.array([1, 1, 2, 2])
    local = np.array([[0.1, 0.05], [0.3, -0.05], [0.1, 0.05], [0.3, -0.05]])
    smooth(marker_positions(angles, centres, segment, local), _RATE, centres, segment, local)
    encoder = (moment, angles[:, 0], 3.0 * np.cos(3.0 * moment))
    fuse(*encoder, estimate_noise(*encoder))
    kept = compiled_code()
    if kept.level != "ok":
        return kept
    return Check(kept.name, "ok", f"ready after {time.perf_counter() - start:.1f} s, {kept.found}")
