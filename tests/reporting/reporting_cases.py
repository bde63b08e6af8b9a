"""Synthetic trials for the report: artefacts of a chain that rises and sits down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from mocap_id.errors import Refused
from mocap_id.geometry.planar import marker_positions
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim.events import average_signals
from mocap_id.stages.report import STAGE, ReportSettings
from mocap_id.stages.trial_keys import Files, Subject, TrialKeys
from mocap_id.store import Artefact, Document, Facts, LongTable, Table, TableSchema, Tree
from mocap_id.store.provenance import (
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
from mocap_id.verdict import Reason

RATE = 100.0
CYCLE = 6.0  # s, one repetition
NAMES = ("foot", "shank", "thigh", "torso", "head")
JOINTS = ("ankle", "knee", "hip", "neck")
LOST = "costs 40.2 more: leaves out 4 markers of the chosen segments (+44.2); but has 1 segment fewer (−4.0)"
SEATED, STANDING = np.array([-0.25, 1.5, -1.7, 0.3]), np.array([0.02, 0.05, -0.1, 0.0])


NO_ADVICE = (None, None, None, None)
ADVICE = ("larger", "knee", 0.6, "the knee's movement 1.5 times larger")


class Trial:
    """Artefacts of a synthetic trial with ``joints`` joints and ``frames`` frames at 100 Hz."""

    def __init__(self, joints: int = 3, frames: int = 1800, per_segment: int = 4, seed: int = 0) -> None:
        self.n, self.frames = joints, frames
        self.random = np.random.default_rng(seed)
        self.time = np.arange(frames) / RATE
        self.centres = np.array([[-0.03, 0.08], [0.0, 0.43], [0.0, 0.42], [0.0, 0.5]])[:joints]
        self.names, self.joints = NAMES[: joints + 1], JOINTS[:joints]
        self.segment = np.repeat(np.arange(joints + 1), per_segment)
        self.labels = [f"{self.names[k]}{i}" for i, k in enumerate(self.segment)]
        self.local = self.random.uniform((-0.06, 0.02), (0.06, 0.38), (len(self.segment), 2))
        self.local[self.segment == 0] = self.random.uniform((-0.2, 0.0), (0.05, 0.08), (per_segment, 2))
        rise = 0.5 - 0.5 * np.cos(2 * np.pi * self.time / CYCLE)
        self.theta = SEATED[:joints] + rise[:, None] * (STANDING - SEATED)[:joints]
        self.predicted = marker_positions(self.theta, self.centres, self.segment, self.local)
        self.noise = 0.002 * self.random.standard_normal(self.predicted.shape)
        self.seen = self.random.random(self.predicted.shape[:2]) > 0.02

    def planar(self, reasons: tuple[Reason, ...] = ()) -> LongTable:
        measured = np.where(self.seen[..., None], self.predicted + self.noise, np.nan)
        values = {"x": measured[..., 0], "y": measured[..., 1], "z": np.where(self.seen, 0.1, np.nan)}
        facts = {
            "plane": {"yaw_deg": 12.5, "planarity": 0.004, "origin_m": [0.1, 0.2, 0.0]},
            "window_s": [0.0, self.frames / RATE],
            "window_proposed": True,
            "rate_hz": RATE,
            "missing_fraction": float(1 - self.seen.mean()),
            "vertical": "Z",
            "units": "mm",
            "files": ["trial.c3d"],
        }
        return self._long(PLANAR, values | {"visible": self.seen}, facts, reasons)

    def wrench(self, *, plates: bool = True) -> Table:
        force = 700 + 60 * np.sin(2 * np.pi * self.time / CYCLE)
        cop = 0.02 * np.cos(2 * np.pi * self.time / CYCLE)
        columns = {"Fx": 0.05 * force - 35, "Fy": force, "tauz": cop * force, "cop_x": cop}
        frame = pd.DataFrame({"time": self.time} | columns)
        frame["plate_ok"] = plates
        if not plates:
            frame[list(columns)] = np.nan
        found = [{"index": 1, "kind": "type 2", "use": "feet", "mean_vertical_N": 699.8}]
        facts = {
            "plates": found if plates else [],
            "mass_kg": 71.4 if plates else None,
            "why": None if plates else "the recording has no force plate",
        }
        return Table.from_frame(WRENCH, frame, facts)

    def segments(self, reasons: tuple[Reason, ...] = ()) -> Table:
        frame = pd.DataFrame(
            {
                "marker": pd.Categorical([*self.labels, "STRAY"]),
                "segment": pd.array([*self.segment.tolist(), None], dtype="Int64"),
                "residual": [*self.random.uniform(0.0005, 0.004, len(self.labels)), np.nan],
                "reason": [*["rigid with its neighbours"] * len(self.labels), "belongs to no rigid body"],
            }
        )
        facts = {
            "count": self.n + 1,
            "names": list(self.names),
            "joint_names": list(self.joints),
            "joint_markers": {},
            "confidence": 0.83,
            "against": {
                "skipped": 0.7,
                "left-out": 0.0,
                "axis": 1.5,
                "first-joint": 0.0,
                "base": 0.0,
                "runner-up": 0.0,
            },
            "joint_confidences": [0.9, 0.75, 0.7, 0.65][: self.n],
            "joint_ratios": [31.5, 10.5, 8.2, 6.5][: self.n],
            "planarity": 0.012,
            "noise_floor_m": 0.0004,
            "static_gap": 21.0,
            "hypotheses": [self._hypothesis(self.n, -120.5, "chosen"), self._hypothesis(self.n - 1, -80.25, LOST)],
        }
        return Table.from_frame(SEGMENTS, frame, facts, reasons)

    def _hypothesis(self, joints: int, cost: float, why: str) -> dict[str, object]:
        bodies = [
            [label for label, k in zip(self.labels, self.segment, strict=True) if k == j] for j in range(self.n + 1)
        ]
        return {
            "segments": joints + 1,
            "cost": cost,
            "why": why,
            "joint_residual_m": [0.0021] * joints,
            "arc_deg": [35.5] * joints,
            "markers": bodies[1 : joints + 1],
            "left_out": bodies[joints + 1 :],
        }

    def chain(self) -> Tree:
        markers = len(self.labels)
        data = {
            "joints": {
                "name": np.array(self.joints),
                "parent": np.arange(self.n),
                "centre": self.centres,
                "covariance": np.tile(np.diag([1e-6, 4e-6]), (self.n, 1, 1)),
                "arc": np.ptp(self.theta, axis=0),
            },
            "segments": {
                "name": np.array(self.names),
                "length": np.hypot(*self.centres[1:].T),
                "length_sd": np.full(self.n - 1, 0.002),
            },
            "markers": {
                "name": np.array(self.labels),
                "segment": self.segment,
                "local": self.local,
                "residual": np.full(markers, 0.002),
            },
        }
        return Tree(CHAIN, data, {"iterations": 5, "reprojection_rms_m": 0.0029})

    def states(self, *, bridged: slice = slice(400, 460)) -> Table:
        velocity = np.gradient(self.theta, 1 / RATE, axis=0)
        orders = [self.theta, velocity, np.gradient(velocity, 1 / RATE, axis=0)]
        frame = pd.DataFrame({"time": self.time})
        for k in range(self.n):
            gap = np.zeros(self.frames, dtype=bool)
            gap[bridged] = k == self.n - 1
            for name, values, sd in zip(("theta", "dtheta", "ddtheta"), orders, (0.002, 0.02, 0.2), strict=True):
                frame[f"{name}_{k + 1}"] = values[:, k]
                frame[f"sd_{name}_{k + 1}"] = np.where(gap, 20 * sd, sd)
            frame[f"dddtheta_{k + 1}"] = 0.0
            frame[f"observed_{k + 1}"] = ~gap
        facts = {
            "marker_sd_m": 0.0021,
            "sigma_v": 3200.0,
            "reprojection_rms_m": 0.0028,
            "method": "rts",
            "engine": "numba",
        }
        return Table.from_frame(STATES, frame, facts)

    def markers(self) -> LongTable:
        residual = np.where(self.seen, np.hypot(*np.moveaxis(self.noise, -1, 0)), np.nan)
        values = {"x": self.predicted[..., 0], "y": self.predicted[..., 1], "residual": residual}
        return self._long(MARKERS, values, {}, ())

    def events(self, repetitions: int = 3) -> Table:
        start = CYCLE * np.arange(repetitions, dtype=float)
        frame = pd.DataFrame(
            {
                "start": start,
                "seat_off": start + 1.2,
                "stand": start + 3.0,
                "seat_on": np.where(np.arange(repetitions) == repetitions - 1, np.nan, start + 4.8),
                "end": start + 5.9,
                "complete": np.arange(repetitions) < repetitions - 1,
                "why": ["" if k < repetitions - 1 else "no seat-on was found" for k in range(repetitions)],
            }
        )
        frame = frame.assign(
            seat_off_72=start + 0.95,
            seat_off_model=start + 1.15,
            reached=1.0,
            held=0.0,
            attempts=0,
            support=0.01,
            left_seated=0.52,
            left_rising=0.5,
            left_standing=0.48,
        )
        facts = {
            "five_times": {
                "asked": 5,
                "repetitions": repetitions,
                "to_fifth_stand_s": 27.0,
                "to_fifth_seat_contact_s": 28.8,
                "to_fifth_seated_s": 29.9,
                "to_fifth_stand_sd_s": 0.008,
                "to_fifth_seat_contact_sd_s": 0.02,
                "to_fifth_seated_sd_s": 0.009,
                "mean_cycle_s": CYCLE,
                "cycle_sd_s": 0.01,
                "failed_attempts": 0,
                "published": [
                    {"limit_s": 11.4, "people": "some", "meaning": "slow", "stop": "not said", "source": "a paper"}
                ],
                "why": None,
            },
            "attempts": [],
            "load_share": {
                "left_plate": 2,
                "right_plate": 1,
                "left": {phase: {"mean": 0.5, "sd": 0.01} for phase in ("seated", "rising", "standing")},
                "why": None,
            },
        }
        return Table.from_frame(EVENTS, frame.astype({"complete": bool, "why": object}), facts)

    def dynamics_table(self, *, plates: bool = True) -> Table:
        frame = self.wrench().frame.drop(columns="plate_ok")
        for name, spread in (("Fx", 4.0), ("Fy", 8.0), ("tauz", 3.0), ("cop_x", 0.004)):
            frame[f"{name}_model"] = frame[name] + spread * np.sin(3 * self.time)
            frame[f"sd_{name}_model"] = spread
            frame[f"{name}_reference"] = frame[name] + 2 * spread
        for k in range(1, self.n + 1):
            frame[f"tau_{k}"], frame[f"sd_tau_{k}"] = 10.0 * k, 1.0
        frame["in_fit"] = np.sin(2 * np.pi * self.time / CYCLE) > -0.5
        frame["contact"] = np.sin(2 * np.pi * self.time / CYCLE) < -0.6
        if not plates:
            numbers = frame.columns.drop(["time", "in_fit", "contact"])
            frame[numbers], frame["in_fit"] = np.nan, False
        return Table.from_frame(DYNAMICS_TABLE, frame)

    def dynamics_tree(self, *, plates: bool = True) -> Tree:
        full = 4 * (self.n + 1)
        names = ["m1+m2+m3+m4", "mx2", "my2 + p3y*(m3+m4)", "I2 + |p3|^2*(m3+m4)"][: full if plates else 0]
        base = len(names)
        position = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(0, 0.4, 9)), axis=-1).reshape(-1, 2)
        points = len(position) if plates else 0
        data = {
            "base": {
                "name": np.array(names, dtype="U"),
                "value": np.array([71.2, 0.05, 28.1, 11.9])[:base],
                "sd": np.array([0.3, 0.02, 0.4, 0.2])[:base],
                "unit": np.array(["kg", "kg*m", "kg*m", "kg*m^2"][:base], dtype="U"),
                "regrouping": np.eye(base, full),
                "covariance": np.diag(np.array([0.3, 0.02, 0.4, 0.2])[:base] ** 2),
                "verdict": np.array(["known", "weak", "known", "known"][:base], dtype="U"),
                "relative_sd": np.array([0.004, 0.4, 0.014, 0.017])[:base],
                "excitation": np.array([310.0, 4.0, 90.0, 30.0])[:base],
                "own_share": np.array([0.9, 0.05, 0.4, 0.3])[:base],
                "prior_share": np.zeros(base),
            },
            "full": {
                "name": np.array([f"{p}{k}" for k in range(self.n + 1) for p in ("m", "mx", "my", "Izz")]),
                "value": np.ones(full),
                "reference": np.where(np.arange(full) < 3, np.arange(full) + 0.5, np.nan),
            },
            "grid": {
                "segment": np.repeat(np.arange(self.n + 1), points),
                "position": np.tile(position[:points], (self.n + 1, 1)),
                "mass": np.clip(self.random.normal(0.2, 0.3, points * (self.n + 1)), 0, None),
            },
            "held_out": {"base": np.ones((3, base)), "clock_offset": np.full(3, 0.0071)},
        }
        nothing = {"condition_number": None, "clock_offset_s": None, "samples": None, "wrench": None}
        facts = {
            "condition_number": 43.2,
            "condition_number_scaled": 8.1,
            "clock_offset_s": 0.0071,
            "clock_offset_sd_s": 0.0002,
            "wrench": {name: {"bias": 0.5, "sd": 3.2, "r2": 0.991} for name in ("Fx", "Fy", "tauz")},
            "cop_rms_m": 0.006,
            "samples": 900,
            "advice": [
                {"name": name, "change": change, "joint": joint, "sd_ratio": ratio, "text": text}
                for name, (change, joint, ratio, text) in zip(
                    names, (NO_ADVICE, ADVICE, ADVICE, NO_ADVICE), strict=False
                )
            ],
            "reference_table": "winter",
            "consistency": "grid",
            "rivals": {
                name: {
                    "height_m": 1.75,
                    "mass_kg": 71.0,
                    "assumed": ["a mass of 71.0 kg, from the plates"],
                    "wrench": {part: {"bias": 4.5, "sd": 12.5, "r2": 0.9} for part in ("Fx", "Fy", "tauz")},
                    "cop_rms_m": 0.0345,
                }
                for name in ("winter", "de-leva")
            },
            "held_out": {
                "repetitions": 3,
                "folds": 3,
                "samples": 880,
                "model": self._errors(0.6),
                "in_sample": self._errors(0.5),
                "reference": self._errors(4.5),
                "clock_offset_s": [0.0070, 0.0071, 0.0073],
                "unfiltered": None,
                "inside": None,
                "why": None,
            },
            "cutoff_hz": 4.5,
            "motion": {
                "source": "chain",
                "why": "the gaps of all joints are within the noise",
                "joints": {name: {"gap_m": 0.0006, "acceleration_m_s2": 0.012, "pinned": True} for name in self.joints},
            },
            "pins": None,
            "solver": {"name": "osqp", "kkt": 1e-9},
            "why": None,
        }
        return Tree(DYNAMICS_TREE, data, facts if plates else nothing | {"why": "the recording has no force plate"})

    def on_segments(self) -> dict[str, Artefact]:
        """A trial with measured poses: the last two segments are one body, and all other markers form another."""
        tree, last = self.dynamics_tree(), self.n - 1
        share = np.array([0.016, 0.848, 0.182, 0.134])
        gap = {"gap_m": 0.0125, "acceleration_m_s2": 0.731, "pinned": False}
        bodies = [*self.names[:last], "trunk", "others"]
        motion = {
            "source": "segments",
            "why": "the two sides of a joint separate",
            "joints": dict.fromkeys(self.joints, gap) | {"ankle": gap | {"gap_m": 0.0021, "pinned": True}},
            "bands_hz": {"angle": 4.0, "x": 3.5, "y": 6.0},
            "bands_why": "left-out repetitions are predicted best with these",
            "bodies": bodies,
            "used": [*range(last), self.n + 1, self.n + 2],
            "prior": "winter",
            "prior_share": share.tolist(),
        }
        side = {
            "wrench": {name: {"bias": 3.0, "sd": 4.0, "r2": 0.9} for name in ("Fx", "Fy", "tauz")},
            "cop_rms_m": 0.0087,
        }
        pinned = {
            "wrench": {name: {"bias": 6.0, "sd": 8.0, "r2": 0.8} for name in ("Fx", "Fy", "tauz")},
            "cop_rms_m": 0.0261,
        }
        pins = {"why": None, "samples": 654, "chain": pinned, "segments": side, "clock_offset_s": -0.0052}
        held_out = tree.facts["held_out"] | {
            "unfiltered": self._errors(0.8),
            "inside": {"Fx": 0.936, "Fy": 0.968, "tauz": 0.954, "cop_x": 0.931},
        }
        facts = tree.facts | {
            "motion": motion, "pins": pins, "held_out": held_out, "cutoff_hz": 5.0, "consistency": "cone",
            "untold": [f"tau_{self.n}"],
        }  # fmt: skip
        data = dict(tree.data)
        data["base"] = dict(data["base"]) | {"prior_share": share}
        data["grid"] = dict(data["grid"]) | {"mass": np.full_like(data["grid"]["mass"], np.nan)}
        table = self.dynamics_table()
        nothing = np.full(self.frames, np.nan)
        table = table.with_columns(**{f"tau_{self.n}": nothing, f"sd_tau_{self.n}": nothing})
        found = self.artefacts() | {
            "poses.parquet": self.poses(),
            "dynamics.h5": replace(tree, data=data, facts=facts),
            "dynamics.parquet": table,
        }
        return found | {"phases.parquet": average_signals(context(found), self.events(), table)}

    def poses(self) -> Table:
        """One body per segment, one for the last two together, and one for all other markers."""
        own = [{"name": name, "segments": [k]} for k, name in enumerate(self.names)]
        bodies = [*own, {"name": "trunk", "segments": [self.n - 1, self.n]}, {"name": "others", "segments": []}]
        columns = {
            f"{name}_{k}": np.zeros(self.frames) for k in range(1, len(bodies) + 1) for name in ("x", "y", "angle")
        }
        counts = {f"markers_{k}": np.full(self.frames, 4) for k in range(1, len(bodies) + 1)}
        return Table.from_frame(POSES, pd.DataFrame({"time": self.time} | columns | counts), {"bodies": bodies})

    def _errors(self, bias: float) -> dict[str, dict[str, float]]:
        return {name: {"bias": bias, "sd": 3.3, "r2": 0.99} for name in ("Fx", "Fy", "tauz")} | {
            "cop_x": {"bias": 0.001 * bias, "sd": 0.0061, "r2": 0.8}
        }

    def artefacts(self, *, plates: bool = True) -> dict[str, Artefact]:
        """All artefacts of a complete trial, with or without force plates."""
        made: tuple[Artefact, ...] = (
            self.planar(), self.wrench(plates=plates), self.segments(), self.chain(), self.states(), self.markers(),
            self.events(), self.dynamics_table(plates=plates), self.dynamics_tree(plates=plates),
        )  # fmt: skip
        found = {artefact.schema.file: artefact for artefact in made}
        averaged = average_signals(context(found), self.events(), self.dynamics_table(plates=plates))
        return found | {"phases.parquet": averaged}

    def _long(
        self, schema: TableSchema, values: Mapping[str, np.ndarray], facts: Facts, reasons: tuple[Reason, ...]
    ) -> LongTable:
        frames = np.arange(1, self.frames + 1)
        return LongTable(schema, frames, self.time, list(self.labels), values, facts, reasons)


def context(artefacts: Mapping[str, Artefact], refused: Refused | None = None) -> Context:
    """The context that the runner passes to the report."""
    keys = TrialKeys(
        trial="s01-sts",
        recording=Files(markers=Path("somewhere/trial.c3d")),
        protocol="sit-to-stand",
        subject=Subject(height=1.75, sex="female"),
    )
    return Context(keys, ReportSettings(), artefacts, refused, {"planarise": 0.21, "segment": 0.4})


def contents(documents: tuple[Artefact | Document, ...]) -> dict[str, bytes]:
    """The written documents by file name."""
    return {document.file: document.content for document in documents if isinstance(document, Document)}


@cache
def healthy() -> Mapping[str, bytes]:
    """The report of the default trial, cached."""
    return contents(STAGE.function(context(Trial().artefacts())))
