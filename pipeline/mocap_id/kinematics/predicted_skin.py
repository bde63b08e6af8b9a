"""Prediction of skin slides, and of their effect on a joint fit, for another movement of the same body.

The slide of a marker per radian of its joints belongs to the marker. It slides farther in larger arcs, and the joint
fit responds differently because it sees other postures (docs/concepts/sliding-skin.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.chain_equations import ChainProblem, ChainState
from mocap_id.kinematics.skin_slides import EXACT, FRAMES, SkinModel, fit_response, scale_angles, slide_scales


def predict_skin(skin: SkinModel, angles: FloatArray, camera_sd: float, seen: int, frames: int = FRAMES) -> SkinModel:
    """Predict the skin model of another movement from which the chain would be fitted anew.

    Parameters
    ----------
    skin : SkinModel
        Model of the recorded movement.
    angles : (F, n) array
        Joint angles of the other movement, rad, finite; each posture counts as often as it occurs.
    camera_sd : float
        Camera noise of a coordinate, m.
    seen : int
        Number of frames behind the sizes in ``skin``. Their share from camera noise does not grow with the movement.
    frames : int
        Number of postures used.

    Returns
    -------
    SkinModel
        Model with the same chain.
    """
    mean = angles.mean(axis=0)
    relative = angles - mean
    spread = slide_scales(relative)[skin.segment - 1]
    chance = camera_sd**2 * np.sqrt(2.0 / np.maximum(seen * skin.weight, 1.0))  # two standard deviations without skin
    sliding = np.maximum(skin.size - skin.rest - chance, 0.0)
    size = skin.size + sliding * ((spread / skin.spread) ** 2 - 1.0)
    chosen = slice(None, None, max(1, len(angles) // frames))
    traced = ChainState(skin.centres, skin.local, np.cumsum(angles[chosen], axis=1))
    weight = 1.0 / np.maximum(camera_sd**2 + size, EXACT**2)
    weights = np.broadcast_to(skin.weight * weight / weight.mean(), (len(traced.angles), len(weight)))
    fitted = ChainProblem.without_points(weights, skin.segment, len(skin.centres))
    averaging = np.sqrt(len(weights) / FRAMES)  # camera noise averages over FRAMES frames in a fit
    shape = scale_angles(relative[chosen], spread, skin.segment)
    moved, noise = fit_response(fitted, traced, shape, camera_sd * averaging)
    return replace(skin, size=size, mean=mean, spread=spread, moved=moved, noise=noise)
