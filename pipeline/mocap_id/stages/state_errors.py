"""What the states' standard deviations stand for: the filter's own, or what is known of camera noise and skin."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray
from mocap_id.estimation import States
from mocap_id.estimation.absent import growth
from mocap_id.estimation.skin import LastingErrors, camera_sd
from mocap_id.kinematics import angle_errors

_LEAST = 50  # frames that show every joint, below which nothing is told of the skin

UNKNOWN = "not known"
NOISE = "noise taken for white"
SKIN = "camera noise and skin"


def lasting_errors(states: States, rested: FloatArray, rate: float, floor: float) -> LastingErrors | None:
    """Errors of states of a chain that was fitted as a whole; None where too little is seen to tell.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        Markers that the states rest on, plane frame, m; NaN elsewhere.
    rate : float
        Frames per second.
    floor : float
        Least camera noise, m.
    """
    chain, counts = states.chain, states.used.any(axis=0)
    shown: BoolArray = np.all(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    if np.count_nonzero(shown) < _LEAST or set(chain.segment[counts]) < set(range(1, len(chain.centres) + 1)):
        return None
    camera, angles = camera_sd(rested, states, floor), _filled(states.mean[..., 0])
    frames, variance = angle_errors(
        _complex(rested),
        chain.segment,
        _complex(chain.centres),
        _complex(chain.local),
        angles,
        observed=shown,
        camera_sd=camera,
        rate=rate,
    )
    variance *= growth(states, rested, angles, frames, rate=rate, camera=camera)[..., None]
    return LastingErrors(camera, frames, variance)


def _complex(points: FloatArray) -> ComplexArray:
    """x + i y in the place of (..., 2) coordinates that lie side by side."""
    return np.ascontiguousarray(points).view(np.complex128)[..., 0]


def _filled(angles: FloatArray) -> FloatArray:
    """(F, n) angles with straight lines where they are not given."""
    every = np.arange(len(angles))
    known = [np.isfinite(angle) for angle in angles.T]
    return np.column_stack([np.interp(every, every[k], angle[k]) for k, angle in zip(known, angles.T, strict=True)])
