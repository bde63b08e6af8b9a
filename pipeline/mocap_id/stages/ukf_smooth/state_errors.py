"""What the states' standard deviations stand for: the filter's own, or what is known of camera noise and skin."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray
from mocap_id.estimation import States
from mocap_id.estimation.absent import growth
from mocap_id.estimation.skin import LastingErrors
from mocap_id.kinematics import SkinModel, State, angle_errors, skin_model, skin_without_fit

_LEAST = 50  # frames that show every joint, below which nothing is told of the skin

UNKNOWN = "not known"
NOISE = "noise taken for white"
SKIN = "camera noise and skin"


def known_skin(states: States, rested: FloatArray, camera: float) -> SkinModel | None:
    """Slides of the markers on a chain that was fitted as a whole; None where too little is seen to tell.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        Markers that the states rest on, plane frame, m; NaN elsewhere.
    camera : float
        Camera noise of a coordinate, m.
    """
    chain = states.chain
    counts: BoolArray = np.any(states.used, axis=0)
    shown: BoolArray = np.all(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    if np.count_nonzero(shown) < _LEAST or set(chain.segment[counts]) < set(range(1, len(chain.centres) + 1)):
        return None
    points = _complex(rested)
    return skin_model(
        points if counts.all() else points[:, counts],
        chain.segment[counts],
        _state(states, counts),
        np.flatnonzero(shown),
        camera,
    )


def supposed_skin(states: States, residual: FloatArray, centre_covariance: FloatArray) -> SkinModel:
    """The same where it is not known: all that the joint fit left is skin.

    Parameters
    ----------
    states : States
    residual : (M,) array
        rms re-projection error of each marker in the joint fit, m.
    centre_covariance : (n, 2, 2) array
        Of the joint centres, m^2.
    """
    every = np.ones(len(states.chain.segment), dtype=np.bool_)
    return skin_without_fit(_state(states, every), states.chain.segment, residual, centre_covariance)


def lasting_errors(states: States, rested: FloatArray, skin: SkinModel, camera: float, rate: float) -> LastingErrors:
    """Errors of states that average out slowly or not at all.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        As for :func:`known_skin`.
    skin : SkinModel
    camera : float
        m.
    rate : float
        Frames per second.
    """
    angles = _filled(states.mean[..., 0])
    frames, variance = angle_errors(skin, angles, rate)
    variance *= growth(states, rested, angles, frames, rate=rate, camera=camera)[..., None]
    return LastingErrors(camera, frames, variance)


def _state(states: States, markers: BoolArray) -> State:
    """The chain with some of its markers, at every frame."""
    chain = states.chain
    angles = np.cumsum(_filled(states.mean[..., 0]), axis=1)
    return State(_complex(chain.centres), _complex(chain.local[markers]), angles)


def _complex(points: FloatArray) -> ComplexArray:
    """x + i y in the place of (..., 2) coordinates that lie side by side."""
    return np.ascontiguousarray(points).view(np.complex128)[..., 0]


def _filled(angles: FloatArray) -> FloatArray:
    """(F, n) angles with straight lines where they are not given; zero where they never are."""
    every, filled = np.arange(len(angles)), np.zeros(angles.shape)
    for joint, angle in enumerate(angles.T):
        known = np.isfinite(angle)
        if known.any():
            filled[:, joint] = np.interp(every, every[known], angle[known])
    return filled
