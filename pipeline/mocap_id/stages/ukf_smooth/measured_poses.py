"""poses.parquet: the measured pose of every body, each by its own markers and with no joint between them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.estimation.inverse import Chain
from mocap_id.kinematics.cluster_poses import ClusterPose, measure_cluster
from mocap_id.stages.trajectories import PlanarView
from mocap_id.store import Table
from mocap_id.store.schemas import POSES

OTHERS = "others"
"""Name of the body of all markers that are on no segment: arms, head."""
_ONE_BODY = ("pelvis", "trunk")  # each alone has few markers, so their common pose is an alternative


def measured_poses(
    view: PlanarView, chain: Chain, *, labels: list[str], segments: list[str], observed: FloatArray, angles: FloatArray
) -> Table:
    """Measure the pose of every body of the dynamics.

    Parameters
    ----------
    view : PlanarView
    chain : Chain
        With the base's markers.
    labels, segments : lists of str
        Of the chain's markers and segments.
    observed : (F, K, 2) array
        Markers of the moving segments as the states use them, m; NaN elsewhere.
    angles : (F, n) array
        Joint angles, rad; they place the trunk's markers on the pelvis.

    Returns
    -------
    Table
        No columns for a body whose markers show no pose; the facts list the bodies in the columns' order. Pelvis and
        trunk are there each by itself and as one body, the torso.
    """
    columns = {label: column for column, label in enumerate(view.labels)}
    of_chain = np.array([columns[label] for label in labels], dtype=np.int64)
    free = np.setdiff1d(np.arange(len(view.labels)), of_chain)
    moves = np.flatnonzero(chain.segment > 0)
    local = _complex(chain.local)
    found: list[tuple[str, list[int], list[str], ClusterPose]] = []
    for name, numbers in _bodies(segments):
        own = np.flatnonzero(np.isin(chain.segment, numbers))
        points = (
            _complex(view.without_bursts(of_chain[own]))
            if numbers == [0]
            else _complex(observed[:, np.searchsorted(moves, own)])
        )
        pose = measure_cluster(points, _in_body_frame(chain, local, numbers, angles)[own])
        if pose is not None:
            found.append((name, numbers, [labels[k] for k in own[pose.markers]], pose))
    others = measure_cluster(_complex(view.without_bursts(free))) if len(free) > 1 else None
    if others is not None:
        found.append((OTHERS, [], [view.labels[k] for k in free[others.markers]], others))
    return Table(POSES, _columns(view, [pose for *_, pose in found]), {"bodies": [_fact(*each) for each in found]})


def _bodies(segments: list[str]) -> list[tuple[str, list[int]]]:
    """Name and segments of each body: each segment, then pelvis and trunk as one."""
    apart = [(name, [k]) for k, name in enumerate(segments)]
    if not set(_ONE_BODY) <= set(segments):
        return apart
    return [*apart, ("torso", [segments.index(name) for name in _ONE_BODY])]


def _in_body_frame(chain: Chain, local: ComplexArray, numbers: list[int], angles: FloatArray) -> ComplexArray:
    """Markers (M,) in the frame of a body's first segment, m; those of its next segment at their mean place."""
    found = local.copy()
    for segment in numbers[1:]:
        mean = np.nanmean(np.exp(1j * angles[:, segment - 1]))
        on = chain.segment == segment
        found[on] = complex(*chain.centres[segment - 1]) + mean / abs(mean) * local[on]
    return found


def _complex(points: FloatArray) -> ComplexArray:
    return np.ascontiguousarray(points).view(np.complex128)[..., 0]


def _columns(view: PlanarView, poses: list[ClusterPose]) -> dict[str, FloatArray | IntArray]:
    columns: dict[str, FloatArray | IntArray] = {"time": view.time}
    for k, pose in enumerate(poses, start=1):
        columns |= {
            f"x_{k}": pose.position.real.copy(),
            f"y_{k}": pose.position.imag.copy(),
            f"angle_{k}": pose.angle,
            f"markers_{k}": pose.count.astype(np.int64),
        }
    return columns


def _fact(name: str, numbers: list[int], labels: list[str], pose: ClusterPose) -> dict[str, Any]:
    local = {label: [float(z.real), float(z.imag)] for label, z in zip(labels, pose.local, strict=True)}
    return {"name": name, "segments": numbers, "markers": local, "residual_m": pose.residual}
