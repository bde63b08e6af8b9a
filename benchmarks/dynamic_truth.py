"""Dynamics of a simulated trial and the exact truth: parameters, wrench, centre of pressure and torques.

Parameters are compared in the frames of the chain. There +y points to the next joint, as in the truth, and in the last
segment to the centroid of its markers. The truth is rotated to that frame. A misplaced joint also rotates a frame, and
this error counts as an error of the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from harness import JOINTS, SEGMENTS, Run, read_group, rms, stack_states

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics import planar_regressor, structural_base
from mocap_id.geometry import planar
from mocap_id.store import Table, Tree

BASE = ("Σm", "mx1", "mx2", "my2", "I2", "mx3", "my3", "I3", "mx4", "my4", "I4")
NORMS = ("mass", "mx1", "(mx, my)2", "I2", "(mx, my)3", "I3", "(mx, my)4", "I4")
WRENCH = ("Fx", "Fy", "tauz")
SERIES = (*WRENCH, "CoP", *JOINTS)
TITLES = (*WRENCH, "CoP", *(f"{joint} torque" for joint in JOINTS))
UNITS = ("N", "N", "N·m", "mm", "N·m", "N·m", "N·m")
SCALE = np.array([1, 1, 1, 1e3, 1, 1, 1])


@dataclass(frozen=True)
class TrialWithTruth:
    """A simulated trial that went through ``identify-dim``, and its truth."""

    time: FloatArray  # (F,) s
    chain: Tree
    dynamics: Tree
    states: Table
    predicted: Table  # dynamics.parquet
    truth: Mapping[str, Any]  # truth.json
    true: Mapping[str, FloatArray]  # truth.npz at ``time``

    @property
    def off_seat(self) -> BoolArray:
        """(F,) samples from a seat-off to its seat-on, where the force of the chair is exactly zero."""
        return find_off_seat(self.time, self.truth)

    @property
    def base(self) -> Mapping[str, FloatArray]:
        """Base parameters: ``value``, ``sd`` and ``regrouping``."""
        node: Any = self.dynamics.data["base"]
        return {key: np.asarray(node[key], dtype=np.float64) for key in ("value", "sd", "regrouping")}

    @property
    def markers(self) -> Mapping[str, tuple[int, FloatArray]]:
        """Segment of every marker, and its position in the segment's frame, m."""
        node = read_group(self.chain, "markers")
        rows = zip(node["name"], node["segment"], node["local"], strict=True)
        return {str(name): (int(segment), local) for name, segment, local in rows}


def find_off_seat(time: FloatArray, truth: Mapping[str, Any]) -> BoolArray:
    """Return which samples (F,) are between a seat-off and its seat-on."""
    inside = [(time >= one["seat_off"]) & (time <= one["seat_on"]) for one in truth["reps"]]
    return np.asarray(np.any(inside, axis=0))


def read_with_truth(done: Run) -> TrialWithTruth | None:
    """Read a simulated trial and its truth; return None without four segments or without parameters."""
    names = ("chain.h5", "dynamics.h5", "states.parquet", "dynamics.parquet")
    chain, dynamics, states, predicted = done.read(*names)
    if len(read_group(chain, "joints")["centre"]) != SEGMENTS - 1 or dynamics.facts["why"] is not None:
        return None
    keys, time = ("q", "qd", "qdd", "wrench", "tau"), states["time"]
    true = dict(zip(keys, done.true(time, *keys), strict=True))
    return TrialWithTruth(time, chain, dynamics, states, predicted, done.truth, true)


def find_last_frame_turn(truth: Mapping[str, Any], chain: Tree) -> float:
    """Return the angle, rad, from the true frame of the last segment to the frame whose y points to its markers."""
    markers, last = read_group(chain, "markers"), len(truth["segments"]) - 1
    local = {marker["label"]: marker["local_xyz_m"][:2] for marker in truth["markers"]}
    own = [local[str(name)] for name, k in zip(markers["name"], markers["segment"], strict=True) if k == last]
    x, y = np.mean(own, axis=0)
    return float(np.arctan2(-x, y))


def read_true_centres(done: TrialWithTruth) -> FloatArray:
    """Return (n, 2) true joint centres, m."""
    return np.array([segment["p_in_parent_m"] for segment in done.truth["segments"][1:]])


def compute_true_base(done: TrialWithTruth) -> FloatArray:
    """Return (b,) true base parameters, regrouped with the true lengths, in the frames of the chain."""
    full = np.array([[s["m"], s["mx"], s["my"], s["Izz"]] for s in done.truth["segments"]])
    full[-1, 1:3] = planar.rotate(np.array(-find_last_frame_turn(done.truth, done.chain)), full[-1, 1:3])
    return np.asarray(structural_base(read_true_centres(done)).regrouping @ full.reshape(-1))


def compute_norms(base: FloatArray) -> FloatArray:
    """Return (8,) mass, mx1, and |(mx, my)| and I of each moving segment, independent of rotations of frames."""
    blocks = base[2:].reshape(-1, 3)
    return np.append(base[:2], np.column_stack([np.hypot(blocks[:, 0], blocks[:, 1]), blocks[:, 2]]))


def stack_true_series(true: Mapping[str, FloatArray]) -> FloatArray:
    """Return (F, 7) true wrench, N and N·m, centre of pressure, m, and torques, N·m."""
    wrench = true["wrench"]
    return np.column_stack([wrench, wrench[:, 2] / wrench[:, 1], true["tau"]])


def stack_series(predicted: Table, prefix: str = "") -> FloatArray:
    """Return (F, 7) wrench, centre of pressure and torques of the model, or with ``sd_`` their standard deviations."""
    names = [f"{name}_model" for name in (*WRENCH, "cop_x")] + [f"tau_{j}" for j in range(1, SEGMENTS)]
    return predicted.stack([prefix + name for name in names])


def transfer_parameters(fitted: TrialWithTruth, other: TrialWithTruth) -> FloatArray:
    """Return (4(n + 1),) full parameters of one trial of a person in the frames of another trial.

    The common markers of a moving segment give its rotation and shift. The base does not change, since both plane
    frames lie in the plate and the feet do not move.
    """
    node: Any = fitted.dynamics.data["full"]
    full = np.array(node["value"], dtype=np.float64).reshape(-1, 4)
    here, there = fitted.markers, other.markers
    for k in range(1, len(full)):
        both = [name for name in here if here[name][0] == k and there.get(name, (-1,))[0] == k]
        own, theirs = (np.array([side[name][1] for name in both]) @ [1, 1j] for side in (here, there))
        turn = float(np.angle(np.sum(np.conj(own - own.mean()) * (theirs - theirs.mean()))))
        shift = theirs.mean() - np.exp(1j * turn) * own.mean()
        mass, first = full[k, 0], (full[k, 1] + 1j * full[k, 2]) * np.exp(1j * turn)
        full[k, 3] += 2 * (np.conj(shift) * first).real + mass * abs(shift) ** 2
        full[k, 1:3] = (first + mass * shift).real, (first + mass * shift).imag
    return full.reshape(-1)


def compute_wrench_errors(done: TrialWithTruth, base: FloatArray) -> FloatArray:
    """Return (4,) rms errors off the seat of Fx, Fy, tauz and centre of pressure (mm) with base parameters (b,)."""
    q, dq, ddq = np.moveaxis(stack_states(done.states), 2, 0)
    centres = read_group(done.chain, "joints")["centre"]
    regressor = planar_regressor(centres, q, dq, ddq, done.truth["g"])
    wrench = regressor[:, :, structural_base(centres).kept] @ base
    model = np.column_stack([wrench, wrench[:, 2] / wrench[:, 1]])
    return np.asarray(rms((model - stack_true_series(done.true)[:, :4])[done.off_seat]) * SCALE[:4])
