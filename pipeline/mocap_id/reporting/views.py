"""The artefacts as arrays with the shapes that figures and tables want; nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.store import Table, Tree


def _node(tree: Tree, path: str) -> Any:
    """The node at ``group/name``, None where the tree does not hold it."""
    node: Any = tree.data
    for name in path.split("/"):
        if not isinstance(node, Mapping) or name not in node:
            return None
        node = node[name]
    return node


def _numbers(tree: Tree, path: str, shape: tuple[int, ...]) -> FloatArray:
    """A node as float64 of this shape; an absent one has zero rows."""
    node = _node(tree, path)
    return np.zeros((0, *shape[1:])) if node is None else np.asarray(node, dtype=np.float64).reshape(shape)


def _whole(tree: Tree, path: str) -> IntArray:
    node = _node(tree, path)
    return np.zeros(0, dtype=np.int64) if node is None else np.asarray(node, dtype=np.int64).reshape(-1)


def _names(tree: Tree, path: str) -> tuple[str, ...]:
    node = _node(tree, path)
    return () if node is None else tuple(str(name) for name in np.asarray(node).reshape(-1))


@dataclass(frozen=True)
class Skeleton:
    """The chain of ``chain.h5``; n joints, M assigned markers, lengths in m, angles in rad."""

    joints: tuple[str, ...]
    parents: IntArray  # (n,)
    centres: FloatArray  # (n, 2)
    covariance: FloatArray  # (n, 2, 2)
    arc: FloatArray  # (n,)
    segments: tuple[str, ...]  # n + 1, base first
    lengths: FloatArray  # (n - 1,) of segments 1 … n - 1
    lengths_sd: FloatArray  # (n - 1,)
    markers: tuple[str, ...]
    marker_segment: IntArray  # (M,)
    local: FloatArray  # (M, 2)

    @classmethod
    def from_tree(cls, tree: Tree) -> Skeleton:
        return cls(
            joints=_names(tree, "joints/name"),
            parents=_whole(tree, "joints/parent"),
            centres=_numbers(tree, "joints/centre", (-1, 2)),
            covariance=_numbers(tree, "joints/covariance", (-1, 2, 2)),
            arc=_numbers(tree, "joints/arc", (-1,)),
            segments=_names(tree, "segments/name"),
            lengths=_numbers(tree, "segments/length", (-1,)),
            lengths_sd=_numbers(tree, "segments/length_sd", (-1,)),
            markers=_names(tree, "markers/name"),
            marker_segment=_whole(tree, "markers/segment"),
            local=_numbers(tree, "markers/local", (-1, 2)),
        )

    @property
    def centre_sd(self) -> FloatArray:
        """Standard deviation of each centre's coordinates, (n, 2), m."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2)
        return np.sqrt(np.where(variance >= 0, variance, np.nan))

    @property
    def tip(self) -> FloatArray:
        """Where the stick of the last segment ends, (2,) in its own frame, m: the centroid of its markers."""
        own = self.local[self.marker_segment == len(self.joints)]
        return own.mean(axis=0) if len(own) else np.zeros(2)


@dataclass(frozen=True)
class Motion:
    """The joint states of ``states.parquet``: T samples, n joints, rad and s."""

    time: FloatArray  # (T,)
    mean: FloatArray  # (T, n, 3) angle, velocity, acceleration
    sd: FloatArray  # (T, n, 3)
    observed: BoolArray  # (T, n)

    @classmethod
    def from_table(cls, table: Table) -> Motion:
        joints = sum(name.startswith("theta_") for name in table.names)
        orders = ("theta", "dtheta", "ddtheta")

        def stack(prefix: str) -> FloatArray:
            names = [f"{prefix}{order}_{k}" for k in range(1, joints + 1) for order in orders]
            return table.stack(names).reshape(-1, joints, 3) if joints else np.zeros((table.length, 0, 3))

        seen = [table[f"observed_{k}"] for k in range(1, joints + 1)]
        observed = np.stack(seen, axis=1) if joints else np.zeros((table.length, 0), dtype=np.bool_)
        return cls(table["time"], stack(""), stack("sd_"), observed)

    @property
    def angles(self) -> FloatArray:
        """Joint angles, (T, n), rad."""
        return self.mean[..., 0]


@dataclass(frozen=True)
class Dynamics:
    """The parameters of ``dynamics.h5``: b base parameters, p point masses, SI."""

    names: tuple[str, ...]
    value: FloatArray  # (b,)
    sd: FloatArray  # (b,)
    units: tuple[str, ...]
    verdicts: tuple[str, ...]  # b, or none where they were not judged
    relative_sd: FloatArray  # (b,) or (0,)
    excitation: FloatArray  # (b,) or (0,)
    own_share: FloatArray  # (b,) or (0,)
    prior_share: FloatArray  # (b,) or (0,)
    regrouping: FloatArray  # (b, 4(n + 1)); (b, 0) where nothing was identified
    reference: FloatArray  # (4(n + 1),)
    grid_segment: IntArray  # (p,)
    grid_position: FloatArray  # (p, 2)
    grid_mass: FloatArray  # (p,)

    @classmethod
    def from_tree(cls, tree: Tree) -> Dynamics:
        names = _names(tree, "base/name")
        regrouping = _numbers(tree, "base/regrouping", (-1,))
        return cls(
            names=names,
            value=_numbers(tree, "base/value", (-1,)),
            sd=_numbers(tree, "base/sd", (-1,)),
            units=_names(tree, "base/unit"),
            verdicts=_names(tree, "base/verdict"),
            relative_sd=_numbers(tree, "base/relative_sd", (-1,)),
            excitation=_numbers(tree, "base/excitation", (-1,)),
            own_share=_numbers(tree, "base/own_share", (-1,)),
            prior_share=_numbers(tree, "base/prior_share", (-1,)),
            regrouping=regrouping.reshape(len(names), -1) if regrouping.size else np.zeros((len(names), 0)),
            reference=_numbers(tree, "full/reference", (-1,)),
            grid_segment=_whole(tree, "grid/segment"),
            grid_position=_numbers(tree, "grid/position", (-1, 2)),
            grid_mass=_numbers(tree, "grid/mass", (-1,)),
        )

    @property
    def base_reference(self) -> FloatArray:
        """The allometric base parameters, (b,), by eq. 4.24; NaN where a parameter that enters has no reference."""
        if not self.regrouping.size or self.regrouping.shape[1] != len(self.reference):
            return np.full(len(self.names), np.nan)
        known = np.isfinite(self.reference)
        value = self.regrouping[:, known] @ self.reference[known]
        return np.where(np.any(self.regrouping[:, ~known] != 0, axis=1), np.nan, value)
