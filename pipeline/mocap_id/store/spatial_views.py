"""Typed views of the artefacts of a trial in space: chain, poses of the segments, angles.

Positions are in the frame of the trial (y up) or, where said, in the frame of a segment; m, rad, s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.geometry.spatial_chain import JointKind, SpatialChain, SpatialJoint
from mocap_id.store.artefacts import Facts, Table, Tree

NEAR_GIMBAL = float(1 / np.sin(np.radians(15)))
"""``isb_condition`` from which plane and axial rotation of the shoulder have no meaning: within 15° of the pole."""

GATED = ("shoulder_plane", "shoulder_axial")
"""Angles without meaning near the pole."""


def in_space(facts: Facts) -> bool:
    """Return whether the facts of ``planar.parquet`` are those of a trial in space."""
    return facts.get("space") == "3d"


def is_skeleton(facts: Facts) -> bool:
    """Return whether the facts of ``planar.parquet`` are those of a skeleton in place of markers."""
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
        segments, names = tree.texts("segments/name"), tree.texts("joints/name")
        chain = SpatialChain(
            _joints(tree),
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
            lengths=_lengths(tree, segments),
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

    def tip(self, segment: int) -> FloatArray:
        """Return the end (3,) of a segment without a child in its own frame, m: the centroid of its markers."""
        own = self.chain.local[self.chain.segment == segment]
        return np.asarray(own.mean(axis=0)) if len(own) else np.zeros(3)


def _joints(tree: Tree) -> tuple[SpatialJoint, ...]:
    vector, matrix = (-1, 3), (-1, 3, 3)
    centres, covariance = tree.numbers("joints/centre", vector), tree.numbers("joints/covariance", matrix)
    axes, axes_covariance = (
        tree.numbers("joints/axes", (-1, 2, 3)),
        tree.numbers("joints/axes_covariance", (-1, 2, 3, 3)),
    )
    offset, parents = tree.numbers("joints/offset", matrix), tree.integers("joints/parent")
    glide, glide_covariance = tree.numbers("joints/glide", vector), tree.numbers("joints/glide_covariance", matrix)
    untwisted = tree.numbers("joints/untwisted", matrix)
    slide_sd = tree.numbers("joints/slide_sd")
    rest, long_axis = tree.numbers("joints/rest", vector), tree.numbers("joints/long_axis", vector)
    return tuple(
        SpatialJoint(
            kind=_kind(kind),
            parent=int(parents[k]),
            centre=centres[k],
            covariance=covariance[k],
            first_axis=axes[k, 0],
            second_axis=axes[k, 1],
            axes_covariance=axes_covariance[k],
            offset=offset[k],
            glide=glide[k],
            glide_covariance=glide_covariance[k],
            rest=rest[k],
            long_axis=long_axis[k],
            untwisted=untwisted[k],
            slide_sd=float(slide_sd[k]),
            known=bool(known),
        )
        for k, (kind, known) in enumerate(zip(tree.texts("joints/kind"), tree.integers("joints/known"), strict=True))
    )


def _kind(text: str) -> JointKind:
    found: JointKind = next(kind for kind in get_args(JointKind) if kind == text)
    return found


def _lengths(tree: Tree, segments: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return the lengths of all segments, or of those between two joints, by name."""
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

    @classmethod
    def from_table(cls, table: Table) -> SegmentPoses:
        ending = "_qw"
        names = tuple(name.removesuffix(ending) for name in table.names if name.endswith(ending))

        def stacked(axes: tuple[str, ...]) -> FloatArray:
            columns = [table.stack([f"{name}_{axis}" for axis in axes]) for name in names]
            return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0, len(axes)))

        origin, quaternion = stacked(("x", "y", "z")), stacked(("qw", "qx", "qy", "qz"))
        seen = [f"{name}_observed" for name in names]
        observed = table.stack(seen).astype(np.bool_) if names else np.zeros((table.length, 0), dtype=np.bool_)
        return cls(table["time"], names, origin, quaternion, observed)

    @cached_property
    def rotation(self) -> FloatArray:
        """(T, S, 3, 3) segment to trial; NaN where unknown."""
        w, x, y, z = np.moveaxis(self.quaternion, -1, 0)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))

    def place(self, segment: int, local: FloatArray) -> FloatArray:
        """Return fixed points (K, 3) of a segment in the frame of the trial, (T, K, 3), m."""
        turned = np.einsum("tij,kj->tki", self.rotation[:, segment], local)
        return np.asarray(self.origin[:, segment, None] + turned)

    def between(self, parent: int, child: int) -> FloatArray:
        """Return the rotation of a joint, child to parent, (T, 3, 3)."""
        return np.asarray(np.swapaxes(self.rotation[:, parent], -1, -2) @ self.rotation[:, child])


@dataclass(frozen=True)
class SpatialAngles:
    """The angles of ``angles.parquet``: T samples, A angles, rad and s."""

    time: FloatArray  # (T,)
    names: tuple[str, ...]
    mean: FloatArray  # (T, A, 3) angle, velocity, acceleration
    sd: FloatArray  # (T, A, 3) of changes, by camera and skin
    constant_sd: FloatArray  # (T, A) of a constant error, by the landmarks
    condition: FloatArray  # (T,) 1 / sin(elevation); NaN without landmarks

    @classmethod
    def from_table(cls, table: Table) -> SpatialAngles:
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
        """(T,) samples in which plane and axial rotation of the shoulder have no meaning."""
        return np.asarray(self.condition > NEAR_GIMBAL)

    def usable(self, name: str) -> BoolArray:
        """Return the samples (T,) in which an angle is known and has a meaning."""
        known: BoolArray = np.isfinite(self.mean[:, self.names.index(name), 0])
        return known & ~self.near_gimbal if name in GATED else known
