"""Bodies of three joints with chosen amplitudes and speeds, and their identification."""

from __future__ import annotations

import numpy as np
from dynamics_cases import BODY, CENTRES, waves

from mocap_id.dynamics.cautions import Excitation, measure_excitation
from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import KinematicError
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare
from mocap_id.dynamics.regressor import planar_regressor

SEGMENT = np.repeat([0, 1, 2, 3], 3)
LOCAL = np.array([[-0.25, 0.02], [0.06, 0.1], [-0.1, 0.05], *3 * [[-0.1, 0.1], [0.1, 0.4], [0.02, 0.85]]])
EXACT = KinematicError.none(3)


def slides(q: np.ndarray) -> np.ndarray:
    """Errors (T, 3, 12) of every joint, rad, as four waves of its own angle."""
    waves_ = [0.002 * np.sin((1 + k / 2) * q[:, :, None] + k) * np.eye(3) for k in range(4)]
    return np.concatenate(waves_, axis=-1)


SLIDING = KinematicError(slides, np.zeros((3, 2, 12)))
NOISE = (1.0, 1.0, 0.3)


def recorded(
    size: np.ndarray, speed: np.ndarray | float = 1.0, seed: int = 0, noise: tuple[float, ...] = NOISE
) -> TrialData:
    """A recording of a body with amplitudes ``size`` (n,) and speeds ``speed`` (n,) of its joints."""
    time, speed = np.arange(0, 40, 0.01), np.broadcast_to(speed, 3)
    clock = np.multiply.outer(time, speed)
    sign, clock = np.where(clock < 40, 1.0, -1.0), np.where(clock < 40, clock, 80 - clock)  # to and fro
    each = [[part[:, j] for part in waves(clock[:, j], 3, seed)] for j in range(3)]
    q, dq, ddq = (np.stack(part, axis=1) for part in zip(*each, strict=True))
    q, dq, ddq = size * q, size * speed * sign * dq, size * speed**2 * ddq
    wrench = planar_regressor(CENTRES, q, dq, ddq) @ BODY.ravel()
    wrench = wrench + np.random.default_rng(seed + 1).normal(size=wrench.shape) * noise
    return TrialData(time, q, dq, ddq, np.zeros_like(q), np.ones(len(time), dtype=bool), wrench, CENTRES)


def identified(made: TrialData, error: KinematicError = EXACT) -> tuple[PreparedTrial, Identification, Excitation]:
    prepared = prepare(made, FitSettings(cutoff=8.0))
    grid = build_grid(CENTRES, SEGMENT, LOCAL, (5, 9))
    found = identify(prepared, np.ones(len(made.time), bool), grid, np.full(16, np.nan), error)
    return prepared, found, measure_excitation(prepared, found)
