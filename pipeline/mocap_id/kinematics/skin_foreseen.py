"""How skin would slip over a chain, and what a joint fit would make of it, in another movement of the same body.

A marker slides in proportion to the angles of the joints next to it (:mod:`mocap_id.kinematics.skin_slides`): by how
much for a radian is the marker's own, so that in larger arcs it slides further, and the joint fit, which sees other
postures, answers otherwise. Small arcs leave the centres to the skin; large ones do not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.kinematics.centre_covariance import responses
from mocap_id.kinematics.chain_equations import Problem, State, reduce
from mocap_id.kinematics.skin_slides import EXACT, FRAMES, SkinModel, shapes_of, spread_of


def skin_in(skin: SkinModel, angles: FloatArray, camera_sd: float, seen: int, frames: int = FRAMES) -> SkinModel:
    """The same skin in another movement, from which the chain would be found anew.

    Parameters
    ----------
    skin : SkinModel
        As it was found.
    angles : (F, n) array
        Joint angles of the other movement, rad, finite; its postures count as often as they stand here.
    camera_sd : float
        Camera noise of a coordinate, m.
    seen : int
        Frames that the sizes of the skin's slides were found from: what camera noise makes of those by chance does not
        grow with the movement.
    frames : int
        Postures to look at.

    Returns
    -------
    SkinModel
        With the same chain.
    """
    mean = angles.mean(axis=0)
    relative = angles - mean
    spread = spread_of(relative)[skin.segment - 1]
    chance = camera_sd**2 * np.sqrt(2.0 / np.maximum(seen * skin.weight, 1.0))  # two standard deviations of none
    sliding = np.maximum(skin.size - skin.rest - chance, 0.0)
    size = skin.size + sliding * ((spread / skin.spread) ** 2 - 1.0)
    chosen = slice(None, None, max(1, len(angles) // frames))
    traced = State(skin.centres, skin.local, np.cumsum(angles[chosen], axis=1))
    weight = 1.0 / np.maximum(camera_sd**2 + size, EXACT**2)
    weights = np.broadcast_to(skin.weight * weight / weight.mean(), (len(traced.angles), len(weight)))
    nothing = np.zeros(weights.shape, dtype=np.complex128)
    fitted = Problem(nothing, weights, skin.segment, np.zeros(len(weight), dtype=np.bool_), len(skin.centres))
    reduced = reduce(fitted, traced)
    moved = responses(fitted, traced, reduced, shapes_of(relative[chosen], spread, skin.segment), reduced.inverse)
    values, vectors = np.linalg.eigh(reduced.inverse)
    fewer = np.sqrt(len(weights) / FRAMES)  # camera noise averages over the frames of a fit, which are not these
    noise = vectors * (camera_sd * fewer * np.sqrt(np.maximum(values, 0.0)))
    return replace(skin, size=size, mean=mean, spread=spread, moved=moved, noise=noise)
