"""Standard deviations of the joint states from camera noise and skin motion."""

from __future__ import annotations

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex
from mocap_id.estimation import States
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.coloured_errors import coloured_variance
from mocap_id.estimation.lasting_errors import LastingErrors
from mocap_id.estimation.missing_markers import variance_growth
from mocap_id.estimation.residual_spectrum import ResidualSpectrum
from mocap_id.kinematics import ChainState, SkinModel, angle_errors, fit_skin, skin_from_residuals

_LEAST = 50  # smallest number of frames showing every joint for an estimate of skin motion

UNKNOWN = "not known"
NOISE = "noise taken for white"
SKIN = "camera noise and skin"


def known_skin(states: States, rested: FloatArray, camera: float) -> SkinModel | None:
    """Return the motion of the markers on the skin, for a chain fitted as a whole; None with too few data.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        Markers used for the states, plane frame, m; else NaN.
    camera : float
        Standard deviation of a coordinate by camera noise, m.
    """
    chain = states.chain
    counts: BoolArray = np.any(states.used, axis=0)
    shown: BoolArray = np.all(states.observed & np.isfinite(states.mean[..., 0]), axis=1)
    if np.count_nonzero(shown) < _LEAST or set(chain.segment[counts]) < set(range(1, len(chain.centres) + 1)):
        return None
    points = as_complex(rested)
    return fit_skin(
        points if counts.all() else points[:, counts],
        chain.segment[counts],
        _state(states, counts),
        np.flatnonzero(shown),
        camera,
    )


def assumed_skin(states: States, residual: FloatArray, centre_covariance: FloatArray) -> SkinModel:
    """Return a skin model in which all residuals of the joint fit are skin motion.

    Parameters
    ----------
    states : States
    residual : (M,) array
        rms residual of each marker in the joint fit, m.
    centre_covariance : (n, 2, 2) array
        Covariance of the joint centres, m^2.
    """
    every = np.ones(len(states.chain.segment), dtype=np.bool_)
    return skin_from_residuals(_state(states, every), states.chain.segment, residual, centre_covariance)


def lasting_errors(
    states: States, rested: FloatArray, skin: SkinModel, camera: float, spectrum: ResidualSpectrum
) -> LastingErrors:
    """Return errors of the states that average out slowly or not at all.

    Parameters
    ----------
    states : States
    rested : (F, M, 2) array
        As for :func:`known_skin`.
    skin : SkinModel
    camera : float
        m.
    spectrum : ResidualSpectrum
    """
    angles, rate = _filled(states.mean[..., 0]), spectrum.rate
    frames, variance = angle_errors(skin, angles, rate)
    variance *= variance_growth(states, rested, angles, frames, rate=rate, camera=camera)[..., None]
    coloured = coloured_variance(ChainResiduals(states, rested, rate), angles, frames, camera)
    variance = np.maximum(variance, coloured) + spectrum.oscillating_variance(frames)
    return LastingErrors(camera, frames, variance)


def _state(states: States, markers: BoolArray) -> ChainState:
    """Return the chain at every frame, with some of its markers."""
    chain = states.chain
    angles = np.cumsum(_filled(states.mean[..., 0]), axis=1)
    return ChainState(as_complex(chain.centres), as_complex(chain.local[markers]), angles)


def _filled(angles: FloatArray) -> FloatArray:
    """Return angles (F, n) with gaps interpolated linearly; zero for an angle that is never given."""
    every, filled = np.arange(len(angles)), np.zeros(angles.shape)
    for joint, angle in enumerate(angles.T):
        known = np.isfinite(angle)
        if known.any():
            filled[:, joint] = np.interp(every, every[known], angle[known])
    return filled
