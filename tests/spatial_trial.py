"""Synthetic trials in space: artefacts of an arm with landmarks, and of a plain chain without names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mocap_id.errors import Refused
from mocap_id.geometry import so3
from mocap_id.geometry.spatial_chain import SpatialChain, SpatialJoint
from mocap_id.stages.base import Context
from mocap_id.stages.report import ReportSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import Artefact, LongTable, Table, Tree
from mocap_id.store.provenance import (
    ANGLES,
    CHAIN,
    DYNAMICS_TABLE,
    DYNAMICS_TREE,
    EVENTS,
    MARKERS,
    PLANAR,
    POSES,
    SEGMENTS,
    STATES,
    WRENCH,
)

RATE = 100.0
ARM = ("thorax", "upper_arm", "forearm", "hand")
X, Y, Z = np.eye(3)
ANGLES_OF_ARM = (
    *("shoulder_plane", "shoulder_elevation", "shoulder_axial"),
    *("elbow_flexion", "elbow_carrying", "elbow_pronation"),
    *("wrist_flexion", "wrist_deviation"),
)


def about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations (F, 3, 3) about an axis by angles (F,)."""
    return so3.exp(np.asarray(angle)[:, None] * axis)


class SpatialTrial:
    """Artefacts of a trial in space; ``arm=False`` is a plain chain of a ball and a hinge on a base."""

    def __init__(self, frames: int = 900, *, arm: bool = True, known: bool = True, seed: int = 0) -> None:
        self.arm, self.frames, self.random = arm, frames, np.random.default_rng(seed)
        self.time = np.arange(frames) / RATE
        self.segments = ARM if arm else ("segment_0", "segment_1", "segment_2")
        self.joints = ("shoulder", "elbow", "wrist") if arm else ("joint_1", "joint_2")
        self.axes_of = {"shoulder": 0, "elbow": 2, "wrist": 2, "joint_1": 0, "joint_2": 1}
        self.angles = self._arm_angles() if arm else self._plain_angles()
        self.rotations = self._arm_rotations() if arm else self._plain_rotations()
        self.chain = self._chain(known)
        sway = 0.02 * np.sin(0.9 * self.time)
        base = about(Y, 0.1 * np.sin(0.7 * self.time))
        at = np.stack([sway, 1.2 + 0.5 * sway, -sway], axis=1)
        self.origin, self.rotation = self.chain.place(at, base, self.rotations)
        self.labels = tuple(f"{self.segments[k]}{i}" for i, k in enumerate(self.chain.segment))
        turned = np.einsum("fmij,mj->fmi", self.rotation[:, self.chain.segment], self.chain.local)
        self.predicted = self.origin[:, self.chain.segment] + turned
        first = self.chain.joints[0]
        shift = np.einsum("fij,fj->fi", base, first.origin(self.rotations[:, 0]) - first.centre)
        self.predicted[:, self.chain.on_glide] += shift[:, None]
        self.noise = 0.001 * self.random.standard_normal(self.predicted.shape)
        self.seen = self.random.random(self.predicted.shape[:2]) > 0.01

    def _arm_angles(self) -> np.ndarray:
        t = self.time
        columns = (
            0.6 + 0.5 * np.sin(0.8 * t), 0.75 - 0.7 * np.cos(0.7 * t), 0.3 * np.sin(0.9 * t),
            1.2 + 0.8 * np.sin(1.1 * t), np.full(len(t), -0.17), 1.4 + 0.3 * np.sin(1.3 * t),
            0.2 * np.sin(1.5 * t), 0.1 * np.cos(1.5 * t),
        )  # fmt: skip
        return np.stack(columns, axis=1)

    def _arm_rotations(self) -> np.ndarray:
        q = self.angles.T
        shoulder = about(Y, q[0]) @ about(X, -q[1]) @ about(Y, q[2])
        elbow = about(Z, q[3]) @ about(X, q[4]) @ about(Y, q[5])
        return np.stack([shoulder, elbow, about(Z, q[6]) @ about(X, q[7])], axis=1)

    def _plain_angles(self) -> np.ndarray:
        t = self.time
        ball = np.stack([0.5 * np.sin(t), 0.4 * np.cos(1.3 * t), 0.3 * np.sin(1.7 * t)], axis=1)
        return np.column_stack([ball, 0.6 * np.sin(1.1 * t)])

    def _plain_rotations(self) -> np.ndarray:
        self.hinge = np.array([0.6, 0.0, 0.8])
        return np.stack([so3.exp(self.angles[:, :3]), about(self.hinge, self.angles[:, 3])], axis=1)

    def _chain(self, known: bool) -> SpatialChain:
        sd = np.diag([1e-6, 4e-6, 9e-6])
        if self.arm:
            axes = np.tile(np.diag([1e-4, 1e-4, 0.0]), (2, 1, 1))
            carrying = so3.exp(-0.17 * X)
            made = (
                SpatialJoint(
                    "ball", 0, np.array([0.0, -0.02, 0.17]), sd, glide=np.array([0.0, 0.015, 0.0]),
                    glide_covariance=sd, rest=Y, long_axis=Y, known=known,
                ),
                SpatialJoint("two-axis", 1, np.array([0.0, -0.3, 0.0]), sd, Z, Y, axes, carrying),
                SpatialJoint("two-axis", 2, np.array([0.0, -0.25, 0.0]), sd, Z, X, axes),
            )  # fmt: skip
            places = [[[0.1, 0.0, 0.02], [0.08, -0.2, 0.0], [-0.09, 0.0, 0.0], [-0.1, -0.2, 0.03], [0.0, 0.05, 0.15]]]
            places += [[[0.04, -0.1, 0.02], [-0.04, -0.15, 0.03], [0.0, -0.25, 0.05], [0.03, -0.29, -0.03]]] * 2
            places += [[[0.02, -0.05, 0.03], [0.02, -0.06, -0.03], [0.0, -0.1, 0.0]]]
        else:
            axes = np.tile(np.diag([1e-4, 1e-4, 1e-5]), (2, 1, 1))
            made = (
                SpatialJoint("ball", 0, np.array([0.05, 0.1, 0.0]), sd),
                SpatialJoint("hinge", 1, np.array([0.0, 0.35, 0.02]), sd, self.hinge, Z, axes),
            )
            places = [[[0.1, 0.0, 0.02], [0.08, -0.2, 0.0], [-0.09, 0.0, 0.0], [-0.1, -0.2, 0.03]]] * 3
        segment = np.repeat(np.arange(len(places)), [len(own) for own in places])
        local = np.concatenate([np.array(own) for own in places])
        on_glide = np.array([self.arm and k == 4 for k in range(len(segment))])
        return SpatialChain(made, segment, local, on_glide)

    def planar(self) -> LongTable:
        measured = np.where(self.seen[..., None], self.predicted + self.noise, np.nan)
        facts = {
            "space": "3d", "planarity": 0.31, "rate_hz": RATE, "missing_fraction": float(1 - self.seen.mean()),
            "window_s": [0.0, self.frames / RATE],
        }  # fmt: skip
        values = dict(zip("xyz", np.moveaxis(measured, -1, 0), strict=True)) | {"visible": self.seen}
        return LongTable(PLANAR, np.arange(self.frames), self.time, self.labels, values, facts)

    def markers(self) -> LongTable:
        residual = np.where(self.seen, np.linalg.norm(self.noise, axis=-1), np.nan)
        values = dict(zip("xyz", np.moveaxis(self.predicted, -1, 0), strict=True))
        values |= {"residual": residual, "used": self.seen}
        return LongTable(MARKERS, np.arange(self.frames), self.time, self.labels, values)

    def table_of_segments(self) -> Table:
        columns = {
            "marker": np.array(self.labels, object), "segment": self.chain.segment.astype(np.int64),
            "residual": np.full(len(self.labels), 0.001), "reason": np.array(["rigid"] * len(self.labels), object),
        }  # fmt: skip
        facts = {
            "count": len(self.segments), "names": list(self.segments), "joint_names": list(self.joints),
            "parents": [joint.parent for joint in self.chain.joints], "confidence": 0.97,
            "against": {"skipped": 0.03}, "planarity": 0.2, "hypotheses": [],
        }  # fmt: skip
        return Table(SEGMENTS, columns, facts)

    def tree(self) -> Tree:
        made = self.chain.joints
        marks = {"IJ": (0, [0.0, 0.0, 0.0]), "EL": (1, [0.0, -0.3, 0.035]), "EM": (1, [0.0, -0.3, -0.035])}
        marks = marks if self.arm else {}
        data = {
            "joints": {
                "name": np.array(self.joints),
                "kind": np.array([joint.kind for joint in made]),
                "parent": np.array([joint.parent for joint in made]),
                "known": np.array([joint.known for joint in made]),
                "arc": np.full(len(made), 1.2),
                "axes": np.array([(joint.first_axis, joint.second_axis) for joint in made]),
            }
            | {
                name: np.array([getattr(joint, name) for joint in made])
                for name in (
                    *("centre", "covariance", "axes_covariance", "offset"),
                    *("glide", "glide_covariance", "rest", "long_axis", "untwisted", "slide_sd"),
                )
            },
            "segments": {
                "name": np.array(self.segments),
                "length": np.array([np.linalg.norm(joint.centre) for joint in made[1:]]),
                "length_sd": np.full(len(made) - 1, 0.002),
            },
            "markers": {
                "name": np.array(self.labels),
                "segment": self.chain.segment,
                "local": self.chain.local,
                "residual": np.full(len(self.labels), 0.001),
                "on_glide": self.chain.on_glide,
                "skin": np.zeros(len(self.chain.segment)),
                "skin_sd": np.zeros(len(self.chain.segment)),
            },
            "landmarks": {
                "name": np.array(list(marks), dtype="U4"),
                "segment": np.array([k for k, _ in marks.values()], dtype=np.int64),
                "local": np.array([local for _, local in marks.values()]).reshape(-1, 3),
                "sd": np.full(len(marks), 0.003),
            },
        }
        evidence = {name: {"ball": 0.0, "two-axis": 1.5 + k, "hinge": 9.0} for k, name in enumerate(self.joints)}
        facts = {"estimator": "bundle", "frames": "isb" if self.arm else "own", "evidence": evidence}
        return Tree(CHAIN, data, facts)

    def states(self) -> Table:
        facts = {"marker_sd_m": 0.001, "sigma_v": [300.0] * len(self.joints), "reprojection_rms_m": 0.0017}
        return Table(STATES, {"time": self.time}, facts)

    def poses(self) -> Table:
        columns = {"time": self.time}
        for k, name in enumerate(self.segments):
            vector = so3.log(self.rotation[:, k])
            angle = np.linalg.norm(vector, axis=1, keepdims=True)
            axis = np.divide(vector, angle, out=np.zeros_like(vector), where=angle > 0)
            quaternion = np.column_stack([np.cos(angle / 2), np.sin(angle / 2) * axis])
            columns |= {f"{name}_q{axis}": quaternion[:, i] for i, axis in enumerate("wxyz")}
            columns |= {f"{name}_{axis}": self.origin[:, k, i] for i, axis in enumerate("xyz")}
            columns |= {f"{name}_{kind}_{axis}": 0 * self.time for kind in ("omega", "alpha") for axis in "xyz"}
            columns |= {f"sd_{name}_omega": 0 * self.time + 0.02, f"sd_{name}_alpha": 0 * self.time + 0.3}
            columns[f"{name}_observed"] = ~((self.time > 3.0) & (self.time < 3.3) & (k == len(self.segments) - 1))
        return Table(POSES, columns)

    def angles_table(self) -> Table:
        names = ANGLES_OF_ARM if self.arm else ("joint_1_1", "joint_1_2", "joint_1_3", "joint_2_1")
        velocity = np.gradient(self.angles, 1 / RATE, axis=0)
        orders = (self.angles, velocity, np.gradient(velocity, 1 / RATE, axis=0))
        columns = {"time": self.time}
        for k, name in enumerate(names):
            for order, values, sd in zip(("", "d", "dd"), orders, (0.01, 0.05, 0.4), strict=True):
                columns |= {f"{order}{name}": values[:, k], f"sd_{order}{name}": np.full(self.frames, sd)}
            columns[f"constant_sd_{name}"] = np.full(self.frames, 0.03)
        if self.arm:
            columns["isb_condition"] = 1 / np.maximum(np.abs(np.sin(self.angles[:, 1])), 1e-9)
        return Table(ANGLES, columns)

    def wrench(self, *, plates: bool = True) -> Table:
        names = ("Fx", "Fy", "tauz", "cop_x", "Fz", "taux", "tauy")
        columns = {"time": self.time}
        for k, name in enumerate(names):
            columns[name] = (
                700.0 * (name == "Fy") + 10 * np.sin(k + self.time) if plates else np.full(self.frames, np.nan)
            )
        columns["plate_ok"] = np.full(self.frames, plates)
        return Table(WRENCH, columns, {"plates": [], "mass_kg": 71.4} if plates else {"why": "no force plate"})

    def artefacts(self, *, plates: bool = False) -> dict[str, Artefact]:
        """Artefacts of a complete run; the dynamics were not identified."""
        nothing = Tree(DYNAMICS_TREE, {}, {"why": "the base is not on a plate"})
        made: tuple[Artefact, ...] = (
            self.planar(), self.wrench(plates=plates), self.table_of_segments(), self.tree(), self.states(),
            self.markers(), self.poses(), self.angles_table(), nothing,
            Table(EVENTS, {name.name: np.zeros(0) for name in EVENTS.columns}),
            Table(DYNAMICS_TABLE, dict(self.wrench(plates=plates).columns)),
        )  # fmt: skip
        return {artefact.schema.file: artefact for artefact in made}


def context(artefacts: dict[str, Artefact], refused: Refused | None = None) -> Context:
    """The context that the runner passes to the report of a trial in space."""
    keys = TrialKeys(trial="s07-reach", space="3d", protocol="reach", recording=Files(markers=Path("away/reach.c3d")))
    return Context(keys, ReportSettings(), artefacts, refused, {"planarise": 0.1})
