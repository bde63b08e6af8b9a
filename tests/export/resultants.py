"""Sums of the forces on free bodies, which give joint torques and the ground wrench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from mocap_id.recording.text_tables import MotionTable
from mocap_id.store import Folder

COMPONENTS = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class JointPlaces:
    """Joint centres of a run in the frames of the segments before and after them, and their shifts, (n, 2), m."""

    centre: np.ndarray
    beyond: np.ndarray
    shift: np.ndarray

    @staticmethod
    def of(run: Path) -> JointPlaces:
        with h5py.File(run / "chain.h5") as chain:
            centre = np.asarray(chain["joints/centre"])
        shift, beyond = np.zeros_like(centre), np.zeros_like(centre)
        for body in Folder(run).read("poses.parquet").facts["bodies"]:
            if "joint_shift_m" in body:
                shift[min(body["segments"]) - 1] = body["joint_shift_m"]
            if "joint_m" in body:
                joint = min(body["segments"]) - 1
                centre[joint], beyond[joint] = body["joint_m"]
        return JointPlaces(centre, beyond, shift)


@dataclass(frozen=True)
class Poses:
    """Exported poses of free bodies: origins (T, K, 2), m, and angles (T, K), rad, of their frames."""

    names: tuple[str, ...]
    origin: np.ndarray
    angle: np.ndarray

    @staticmethod
    def of(states: MotionTable, names: tuple[str, ...], time: np.ndarray) -> Poses:
        """Return the poses at the given times."""

        def column(name: str, coordinate: str) -> np.ndarray:
            return np.interp(time, states.time, states[f"/jointset/{name}_pose/{name}_{coordinate}/value"])

        place = [np.stack([column(name, "tx"), column(name, "ty")], axis=-1) for name in names]
        return Poses(names, np.stack(place, axis=1), np.stack([column(name, "rz") for name in names], axis=1))

    def joint(self, joint: int, places: JointPlaces) -> np.ndarray:
        """Return the centre (T, 2) of joint j (from 0): the shifted mean of its positions in both bodies."""
        near, far = self._turned(joint, places.centre[joint]), self._turned(joint + 1, places.beyond[joint])
        sides = self.origin[:, joint] + near + self.origin[:, joint + 1] + far
        return sides / 2 + self._turned(joint, places.shift[joint])

    def _turned(self, body: int, place: np.ndarray) -> np.ndarray:
        c, s = np.cos(self.angle[:, body]), np.sin(self.angle[:, body])
        return np.stack([c * place[0] - s * place[1], s * place[0] + c * place[1]], axis=-1)


@dataclass(frozen=True)
class Needs:
    """Required forces (T, K, 2) at the origins of the bodies' frames, N, and moments (T, K) about them, N·m."""

    poses: Poses
    force: np.ndarray
    moment: np.ndarray

    @staticmethod
    def of(poses: Poses, column: Callable[[str, str], np.ndarray]) -> Needs:
        """Return the forces, read by ``column(body, coordinate)``."""
        force = [np.stack([column(name, "tx"), column(name, "ty")], axis=-1) for name in poses.names]
        return Needs(
            poses, np.stack(force, axis=1), np.stack([np.asarray(column(name, "rz")) for name in poses.names], axis=1)
        )

    def about(self, point: np.ndarray, first: int = 0) -> np.ndarray:
        """Return the moment (T,) about points (T, 2) of the forces on the bodies from ``first`` on."""
        arm, force = (self.poses.origin - point[:, None])[:, first:], self.force[:, first:]
        turning = arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0]
        return np.asarray((self.moment[:, first:] + turning).sum(axis=1))

    def errors(self, time: np.ndarray, dynamics: pd.DataFrame, places: JointPlaces) -> dict[str, np.ndarray]:
        """Return torques and wrench minus those of a table with tau_1 … and *_model, by column.

        The last body may belong to no segment; it is beyond every joint. Unknown torques on a chair are left out.
        """
        ground = self.about(np.zeros((len(time), 2)))
        ours = dict(zip(COMPONENTS, (*self.force.sum(axis=1).T, ground), strict=True))
        found = {f"{name}_model": values for name, values in ours.items()}
        for joint in range(len(places.centre)):
            if dynamics[f"tau_{joint + 1}"].notna().any():
                found[f"tau_{joint + 1}"] = self.about(self.poses.joint(joint, places), joint + 1)
        off = {name: values - np.interp(time, dynamics["time"], dynamics[name]) for name, values in found.items()}
        return {name: error[np.isfinite(error)] if name.startswith("tau_") else error for name, error in off.items()}
