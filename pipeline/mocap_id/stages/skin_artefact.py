"""Conversion between a model of skin motion and ``skin.h5``, which ukf-smooth writes and identify-dim reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import as_complex, as_xy
from mocap_id.kinematics import SkinModel
from mocap_id.store import Tree
from mocap_id.store.schemas import SKIN


def make_skin_tree(skin: SkinModel, labels: Sequence[str], camera_sd: float | None, basis: str) -> Tree:
    """Return the content of skin.h5 for a model of skin motion.

    Parameters
    ----------
    labels : sequence of str
        Labels of the markers.
    camera_sd : float or None
        Standard deviation of the camera noise of a coordinate, m; None without cameras.
    basis : str
        Name of the data from which the variances were estimated.
    """
    data = {
        "joints": {"centre": as_xy(skin.centres), "mean_angle": skin.mean},
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": skin.segment,
            "local": as_xy(skin.local),
            "seen": skin.weight,
            "variance": skin.size,
            "unshaped_variance": skin.rest,
            "spread": skin.spread,
        },
        "response": {"slides": skin.moved, "noise": skin.noise},
    }
    return Tree(SKIN, data, {"camera_sd_m": camera_sd, "basis": basis})


def read_skin_tree(tree: Tree) -> SkinModel:
    """Return the model of skin motion that skin.h5 contains."""
    return SkinModel(
        centres=as_complex(tree.array("joints/centre")),
        local=as_complex(tree.array("markers/local")),
        segment=tree.array("markers/segment"),
        weight=tree.array("markers/seen"),
        size=tree.array("markers/variance"),
        rest=tree.array("markers/unshaped_variance"),
        mean=tree.array("joints/mean_angle"),
        spread=tree.array("markers/spread"),
        moved=tree.array("response/slides"),
        noise=tree.array("response/noise"),
    )
