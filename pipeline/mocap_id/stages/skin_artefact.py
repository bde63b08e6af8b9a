"""How skin slips over a recovered chain, as ``skin.h5`` keeps it between ukf-smooth and identify-dim."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics import SkinModel
from mocap_id.store import Tree
from mocap_id.store.schemas import SKIN


def as_tree(skin: SkinModel, labels: Sequence[str], camera_sd: float, basis: str) -> Tree:
    """Write a skin model down.

    Parameters
    ----------
    skin : SkinModel
    labels : (K,) sequence of str
        Of its markers.
    camera_sd : float
        Camera noise of a coordinate, m.
    basis : str
        What the sizes rest on.
    """
    data = {
        "joints": {"centre": _xy(skin.centres), "mean_angle": skin.mean},
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": skin.segment,
            "local": _xy(skin.local),
            "seen": skin.weight,
            "variance": skin.size,
            "unshaped_variance": skin.rest,
            "spread": skin.spread,
        },
        "response": {"slides": skin.moved, "noise": skin.noise},
    }
    return Tree(SKIN, data, {"camera_sd_m": camera_sd, "basis": basis})


def from_tree(tree: Tree) -> SkinModel:
    """Read it back."""
    joints, markers, response = (tree.data[name] for name in ("joints", "markers", "response"))
    assert isinstance(joints, dict) and isinstance(markers, dict) and isinstance(response, dict)
    return SkinModel(
        centres=_complex(joints["centre"]),
        local=_complex(markers["local"]),
        segment=np.asarray(markers["segment"], dtype=np.int64),
        weight=np.asarray(markers["seen"], dtype=np.float64),
        size=np.asarray(markers["variance"], dtype=np.float64),
        rest=np.asarray(markers["unshaped_variance"], dtype=np.float64),
        mean=np.asarray(joints["mean_angle"], dtype=np.float64),
        spread=np.asarray(markers["spread"], dtype=np.float64),
        moved=np.asarray(response["slides"], dtype=np.float64),
        noise=np.asarray(response["noise"], dtype=np.float64),
    )


def _xy(points: ComplexArray) -> FloatArray:
    return np.stack([points.real, points.imag], axis=-1)


def _complex(points: FloatArray) -> ComplexArray:
    return np.asarray(np.asarray(points, dtype=np.float64) @ np.array([1.0, 1.0j]), dtype=np.complex128)
