"""Base parameters of a chain in space: the combinations of ten parameters per segment that a wrench determines.

They are determined as in the plane (:mod:`mocap_id.dynamics.base_parameters`), but in the simple frames, in which the
combinations are short. The simple frame of the base has the axes of the trial's frame. That of a segment beyond a hinge
has z along the axis of the hinge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import BaseSet, regroup_columns
from mocap_id.dynamics.regressor import LINK_PARAMETERS
from mocap_id.dynamics.space.motion import move_joints, rotate_z_to, segment_regressor
from mocap_id.dynamics.space.pseudo_inertia import change_of_frame
from mocap_id.geometry import se3
from mocap_id.geometry.spatial_chain import SpatialChain

_UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
_STATES = 60  # number of random states from which the base parameters are determined
_WRITTEN = 3  # largest number of regrouped parameters that a name lists


@dataclass(frozen=True)
class SpatialBase:
    """Base parameters of a chain in space."""

    base: BaseSet  # base parameters in the simple frames
    frames: FloatArray  # (K, 4, 4) pose of each simple frame in the frame of its segment

    @property
    def mapping(self) -> FloatArray:
        """Matrix (b, 10K) from the full parameters in the segments' frames to the base parameters."""
        return np.asarray(self.base.regrouping @ block_diag(*change_of_frame(se3.inverse(self.frames))))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters as symbols; "…" replaces regrouped parameters if there are more than three."""
        symbols = name_parameters(len(self.frames))
        return tuple(
            _format_name(row, int(column), self.base, symbols)
            for row, column in zip(self.base.regrouping, self.base.kept, strict=True)
        )

    @property
    def units(self) -> tuple[str, ...]:
        """SI unit of each base parameter."""
        return tuple(_UNITS[column % 10] for column in self.base.kept)


def name_parameters(segments: int) -> tuple[str, ...]:
    """Return the names of the full parameters, numbered from 1 for the base: m1, mx1, my1, mz1, Ixx1 … Iyz1, m2 …"""
    return tuple(f"{symbol}{k}" for k in range(1, segments + 1) for symbol in LINK_PARAMETERS)


def structural_base(chain: SpatialChain, base: FloatArray) -> SpatialBase:
    """Return the base parameters of a chain in which every joint moves; no trial can determine more parameters.

    ``base`` (4, 4) is the pose of the base, which is at rest, in the trial's frame, m.
    """
    size = sum(joint.dimension for joint in chain.joints)
    states = np.random.default_rng(0).normal(size=(3, _STATES, size))
    frames = build_simple_frames(chain, base)
    motion = move_joints(chain, base, *states).in_frames(frames)
    rows = segment_regressor(motion)
    columns = np.abs(rows).max(axis=(0, 1))
    rows = np.where(columns > 1e-9 * columns.max(), rows, 0.0)  # rounding errors of the rotated axes
    return SpatialBase(regroup_columns(rows.reshape(-1, rows.shape[-1])), frames)


def build_simple_frames(chain: SpatialChain, base: FloatArray) -> FloatArray:
    """Return the simple frames of the segments, as poses (K, 4, 4) in the segments' own frames."""
    frames = [se3.pose(base[:3, :3].T, np.zeros(3))]
    for joint in chain.joints:
        axis = {
            "ball": np.array([0.0, 0.0, 1.0]),
            "two-axis": joint.second_axis,
            "hinge": joint.offset.T @ joint.first_axis,
        }[joint.kind]
        frames.append(se3.pose(rotate_z_to(axis), np.zeros(3)))
    return np.stack(frames)


def _format_name(row: FloatArray, column: int, base: BaseSet, symbols: tuple[str, ...]) -> str:
    """Return the name of one base parameter from its row of the regrouping and its kept column."""
    others = [int(k) for k in np.setdiff1d(np.flatnonzero(row), base.kept)]
    if len(others) > _WRITTEN and not np.allclose(row[others], 1.0):
        return f"{symbols[column]}+…"
    return symbols[column] + "".join(_format_term(row[k], symbols[k]) for k in others)


def _format_term(value: float, symbol: str) -> str:
    """Return one regrouped parameter with its coefficient."""
    sign, size = ("-" if value < 0 else "+"), abs(value)
    return f"{sign}{symbol}" if np.isclose(size, 1.0) else f"{sign}{size:.4g}*{symbol}"
