"""Typed views of the artefacts of a trial in space: chain, poses of the segments, angles.

Positions are in the frame of the trial (y up) or, where a docstring says so, in the frame of a segment; m, rad, s.
``schemas.toml`` describes every quantity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id.store.artefacts import Facts, Table, Tree
from mocap_id.store.views import Rejected, find_measured

NEAR_GIMBAL = float(1 / np.sin(np.radians(15)))
"""Largest ``isb_condition`` with which plane of elevation and axial rotation of the shoulder have a meaning.
``isb_condition`` is larger if the elevation is within 15° of a pole (0° or 180°)."""

MEANINGLESS_AT_POLE = ("shoulder_plane", "shoulder_axial")
"""Angles that have no meaning near a pole."""

_VECTORS = ("centre", "glide", "rest", "long_axis")
_MATRICES = ("covariance", "offset", "glide_covariance", "untwisted")
_JOINT_ARRAYS: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(_VECTORS, (-1, 3)),
    **dict.fromkeys(_MATRICES, (-1, 3, 3)),
    "axes_covariance": (-1, 2, 3, 3),
}
"""Shapes of arrays in chain.h5 that are also fields of a joint, by name."""


def is_in_space(facts: Facts) -> bool:
    """Return whether the facts of ``planar.parquet`` describe a trial in space."""
    return facts.get("space") == "3d"


def is_skeleton(facts: Facts) -> bool:
    """Return whether the facts of ``planar.parquet`` describe a skeleton in place of markers."""
    return "skeleton" in facts


@dataclass(frozen=True)
class SpatialSkeleton:
    """The chain in ``chain.h5`` of a trial in space: n joints, M markers, L landmarks."""

    joints: tuple[str, ...]
    segments: tuple[str, ...]  # n + 1, base first
    arc: FloatArray  # (n,) rad
    lengths: dict[str, tuple[float, float]]  # length and standard deviation by segment, m
    chain: SpatialChain
    markers: tuple[str, ...]
    landmarks: tuple[str, ...]
    landmark_segment: IntArray  # (L,)
    landmark_local: FloatArray  # (L, 3)
    landmark_sd: FloatArray  # (L,)

    @classmethod
    def from_tree(cls, tree: Tree) -> SpatialSkeleton:
        """Return the chain of a trial in space."""
        segments, names = tree.texts("segments/name"), tree.texts("joints/name")
        chain = SpatialChain(
            _read_joints(tree),
            tree.integers("markers/segment"),
            tree.numbers("markers/local", (-1, 3)),
            tree.integers("markers/on_glide").astype(np.bool_),
            tree.numbers("markers/skin"),
            tree.numbers("markers/skin_sd"),
        )
        return cls(
            joints=names or tuple(f"joint {k}" for k in range(1, len(chain.joints) + 1)),
            segments=segments,
            arc=tree.numbers("joints/arc"),
            lengths=_read_lengths(tree, segments),
            chain=chain,
            markers=tree.texts("markers/name"),
            landmarks=tree.texts("landmarks/name"),
            landmark_segment=tree.integers("landmarks/segment"),
            landmark_local=tree.numbers("landmarks/local", (-1, 3)),
            landmark_sd=tree.numbers("landmarks/sd"),
        )

    @property
    def marker_segment(self) -> IntArray:
        """(M,) segment of each marker."""
        return self.chain.segment

    def locate_tip(self, segment: int) -> FloatArray:
        """Return the tip (3,) of a segment without a child, in its own frame, m: the centroid of its markers, or 0."""
        own = self.chain.local[self.chain.segment == segment]
        return np.asarray(own.mean(axis=0)) if len(own) else np.zeros(3)


def _read_joints(tree: Tree) -> tuple[SpatialJoint, ...]:
    kinds, parents, known = tree.texts("joints/kind"), tree.integers("joints/parent"), tree.integers("joints/known")
    axes, slide_sd = tree.numbers("joints/axes", (-1, 2, 3)), tree.numbers("joints/slide_sd")
    arrays = {name: tree.numbers(f"joints/{name}", shape) for name, shape in _JOINT_ARRAYS.items()}
    return tuple(
        SpatialJoint(
            kind=next(kind for kind in get_args(JointKind) if kind == text),
            parent=int(parents[k]),
            first_axis=axes[k, 0],
            second_axis=axes[k, 1],
            slide_sd=float(slide_sd[k]),
            known=bool(known[k]),
            **{name: values[k] for name, values in arrays.items()},
        )
        for k, text in enumerate(kinds)
    )


def _read_lengths(tree: Tree, segments: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return length and standard deviation, m, by segment; without anatomy, only of segments between two joints."""
    length, sd = tree.numbers("segments/length"), tree.numbers("segments/length_sd")
    named = segments if len(length) == len(segments) else segments[1 : 1 + len(length)]
    return {name: (float(a), float(b)) for name, a, b in zip(named, length, sd, strict=True)}


@dataclass(frozen=True)
class SegmentPoses:
    """The poses of S segments in ``poses.parquet`` of a trial in space, T samples, in the frame of the trial."""

    time: FloatArray  # (T,)
    segments: tuple[str, ...]
    origin: FloatArray  # (T, S, 3)
    quaternion: FloatArray  # (T, S, 4) w, x, y, z
    observed: BoolArray  # (T, S)
    rejected: Rejected = ()

    @classmethod
    def from_table(cls, table: Table) -> SegmentPoses:
        """Return the poses of ``poses.parquet``."""
        ending = "_qw"
        names = tuple(name.removesuffix(ending) for name in table.names if name.endswith(ending))

        def stacked(axes: tuple[str, ...]) -> FloatArray:
            columns = [table.stack([f"{name}_{axis}" for axis in axes]) for name in names]
            return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0, len(axes)))

        origin, quaternion = stacked(("x", "y", "z")), stacked(("qw", "qx", "qy", "qz"))
        seen = [f"{name}_observed" for name in names]
        observed = table.stack(seen).astype(np.bool_) if names else np.zeros((table.length, 0), dtype=np.bool_)
        return cls(table["time"], names, origin, quaternion, observed, table.facts.get("rejected", ()))

    def find_measured(self, *segments: str) -> BoolArray:
        """Return True (T,) except where markers of ``segments`` are rejected; see :func:`~.views.find_measured`."""
        return find_measured(self.time, self.rejected, segments)

    @cached_property
    def rotation(self) -> FloatArray:
        """(T, S, 3, 3) rotation from the segment's frame to the frame of the trial; NaN if not known."""
        w, x, y, z = np.moveaxis(self.quaternion, -1, 0)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))

    def locate_points(self, segment: int, local: FloatArray) -> FloatArray:
        """Return the positions (T, K, 3) in the frame of the trial, m, of points (K, 3) that are fixed in a segment."""
        rotated = np.einsum("tij,kj->tki", self.rotation[:, segment], local)
        return np.asarray(self.origin[:, segment, None] + rotated)

    def compute_rotation(self, parent: int, child: int) -> FloatArray:
        """Return the rotation (T, 3, 3) of a joint, from the child's frame to the parent's."""
        return np.asarray(np.swapaxes(self.rotation[:, parent], -1, -2) @ self.rotation[:, child])


@dataclass(frozen=True)
class SpatialAngles:
    """The angles of ``angles.parquet``: T samples, A angles, rad and s."""

    time: FloatArray  # (T,)
    names: tuple[str, ...]
    mean: FloatArray  # (T, A, 3) angle, velocity, acceleration
    sd: FloatArray  # (T, A, 3) standard deviation of the errors that vary within a trial, due to camera and skin
    constant_sd: FloatArray  # (T, A) standard deviation of the error that is constant in a trial, due to the landmarks
    condition: FloatArray  # (T,) 1 / sin(elevation); NaN without landmarks

    @classmethod
    def from_table(cls, table: Table) -> SpatialAngles:
        """Return the angles of ``angles.parquet``."""
        names = tuple(name.removeprefix("sd_dd") for name in table.names if name.startswith("sd_dd"))

        def stacked(prefix: str) -> FloatArray:
            columns = [table.stack([f"{prefix}{order}{name}" for order in ("", "d", "dd")]) for name in names]
            return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0, 3))

        unknown = np.full(table.length, np.nan)
        condition = table["isb_condition"] if "isb_condition" in table.names else unknown
        constant = [table[f"constant_sd_{name}"] for name in names]
        return cls(
            table["time"],
            names,
            stacked(""),
            stacked("sd_"),
            np.stack(constant, axis=1) if names else np.zeros((table.length, 0)),
            np.asarray(condition, np.float64),
        )

    @property
    def near_gimbal(self) -> BoolArray:
        """(T,) whether plane of elevation and axial rotation of the shoulder have no meaning in a sample."""
        return np.asarray(self.condition > NEAR_GIMBAL)

    def find_usable(self, name: str) -> BoolArray:
        """Return for every sample (T,) whether the angle ``name`` is finite and has a meaning."""
        known: BoolArray = np.isfinite(self.mean[:, self.names.index(name), 0])
        return known & ~self.near_gimbal if name in MEANINGLESS_AT_POLE else known
