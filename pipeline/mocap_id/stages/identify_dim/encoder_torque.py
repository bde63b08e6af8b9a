"""Comparison of the model's joint torque with the torque in a robot's encoder file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.clock_offset import SampledWrench
from mocap_id.stages.base import Context


def torque_facts(context: Context, dynamics: Mapping[str, FloatArray]) -> dict[str, Any] | None:
    """Return the difference between model and encoder at the encoder's times; None if either is missing.

    The model's torque is interpolated, because it is smooth; the clock offset is that of ukf-smooth.

    Parameters
    ----------
    context : Context
    dynamics : mapping
        Columns of dynamics.parquet.

    Returns
    -------
    dict or None
        ``bias`` and ``sd``, N·m, ``r2`` about the encoder's torque, and the number of ``samples``.
    """
    file = context.trial.encoder
    if file is None or "tau_1" not in dynamics:
        return None
    matched, log = context.table("encoder.parquet").facts, recording.read_encoder(file)
    if matched.get("why") is not None or log.torque is None:
        return None
    measured = matched["sign"] * log.torque
    model = SampledWrench.of(dynamics["time"], dynamics["tau_1"][:, None])
    off = model(log.time + matched["clock_offset_s"])[:, 0] - measured
    both = np.isfinite(off)
    if np.count_nonzero(both) < 2 or not np.ptp(measured[both]) > 0.0:
        return None
    return {
        "bias": float(np.mean(off[both])),
        "sd": float(np.std(off[both])),
        "r2": 1.0 - float(np.mean(off[both] ** 2)) / float(np.var(measured[both])),
        "samples": int(np.count_nonzero(both)),
    }
