"""A trial's dynamics against its exact truth: parameters, wrench, centre of pressure, torques, and their intervals.

Parameters are compared in the frames that the chain has: +y towards the next joint, which is the truth's frame too, and
in the last segment towards the middle of its markers, to which the truth is turned. What is wrong with a frame because
a joint was placed wrongly therefore counts as an error of the parameters.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from kinematic_sweep import COUNT, JOINTS, group

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics import planar_regressor, structural_base
from mocap_id.geometry import planar
from mocap_id.store import Folder, Table, Tree

BASE = ("Σm", "mx1", "mx2", "my2", "I2", "mx3", "my3", "I3", "mx4", "my4", "I4")
NORMS = ("mass", "mx1", "(mx, my)2", "I2", "(mx, my)3", "I3", "(mx, my)4", "I4")
WRENCH = ("Fx", "Fy", "tauz")
SERIES = (*WRENCH, "CoP", *JOINTS)
UNITS = ("N", "N", "N·m", "mm", "N·m", "N·m", "N·m")
SCALE = np.array([1, 1, 1, 1e3, 1, 1, 1])


@dataclass(frozen=True)
class Finished:
    """A trial that has been through ``identify-dim``, and its truth.

    Parameters
    ----------
    time : (F,) array
        s.
    chain, dynamics : Tree
    states, predicted : Table
        ``states.parquet`` and ``dynamics.parquet``.
    truth : dict
        ``truth.json``.
    true : dict of arrays
        ``truth.npz`` at ``time``.
    """

    time: FloatArray
    chain: Tree
    dynamics: Tree
    states: Table
    predicted: Table
    truth: Mapping[str, Any]
    true: Mapping[str, FloatArray]

    @property
    def off_seat(self) -> BoolArray:
        """(F,) samples between a seat-off and its seat-on, when the chair's force is exactly zero."""
        pairs = [(one["seat_off"], one["seat_on"]) for one in self.truth["reps"]]
        return np.asarray(np.any([(self.time >= start) & (self.time <= end) for start, end in pairs], axis=0))

    @property
    def base(self) -> Mapping[str, FloatArray]:
        """Base parameters: ``value``, ``sd`` and ``regrouping``."""
        node = self.dynamics.data["base"]
        assert isinstance(node, Mapping)
        return {key: np.asarray(node[key], dtype=np.float64) for key in ("value", "sd", "regrouping")}

    @property
    def markers(self) -> Mapping[str, tuple[int, FloatArray]]:
        """Segment and place in its frame, m, of every marker."""
        node = self.chain.data["markers"]
        assert isinstance(node, Mapping)
        rows = zip(np.asarray(node["name"]), np.asarray(node["segment"]), np.asarray(node["local"]), strict=True)
        return {str(name): (int(segment), local) for name, segment, local in rows}


def read(configuration: Path, out: Path) -> Finished | None:
    """A simulated trial's artefacts and truth; None where it has no four segments or no parameters."""
    folder = Folder(out)
    chain, dynamics = folder.read("chain.h5"), folder.read("dynamics.h5")
    states, predicted = folder.read("states.parquet"), folder.read("dynamics.parquet")
    if not (isinstance(chain, Tree) and isinstance(dynamics, Tree)):
        raise TypeError("not the artefacts that were expected")
    if not (isinstance(states, Table) and isinstance(predicted, Table)):
        raise TypeError("not the artefacts that were expected")
    if len(group(chain, "joints")["centre"]) != COUNT - 1 or dynamics.facts["why"] is not None:
        return None
    time = states.frame["time"].to_numpy(dtype=np.float64)
    with np.load(configuration.with_name("truth.npz")) as arrays:
        at = np.searchsorted(arrays["t"], time - 1e-6)
        names = ("q", "qd", "qdd", "wrench", "tau")
        true = {name: arrays[name][at].astype(np.float64) for name in names}
    truth = json.loads(configuration.with_name("truth.json").read_text())
    return Finished(time, chain, dynamics, states, predicted, truth, true)


def last_frame_turn(done: Finished) -> float:
    """Angle, rad, from the truth's frame of the last segment to the one whose y points at its markers' middle."""
    local = {marker["label"]: marker["local_xyz_m"][:2] for marker in done.truth["markers"]}
    own = [local[name] for name, (segment, _) in done.markers.items() if segment == COUNT - 1]
    x, y = np.mean(own, axis=0)
    return float(np.arctan2(-x, y))


def true_centres(done: Finished) -> FloatArray:
    """(n, 2) true joint centres, m."""
    return np.array([segment["p_in_parent_m"] for segment in done.truth["segments"][1:]])


def true_base(done: Finished) -> FloatArray:
    """(b,) base parameters: the true full ones, regrouped with the true lengths, in the chain's frames."""
    full = np.array([[s["m"], s["mx"], s["my"], s["Izz"]] for s in done.truth["segments"]])
    full[-1, 1:3] = planar.rotate(np.array(-last_frame_turn(done)), full[-1, 1:3])
    return np.asarray(structural_base(true_centres(done)).regrouping @ full.reshape(-1))


def norms(base: FloatArray) -> FloatArray:
    """(8,) what does not depend on how frames are turned: mass, mx1, and |(mx, my)| and I of each moving segment."""
    blocks = base[2:].reshape(-1, 3)
    return np.append(base[:2], np.column_stack([np.hypot(blocks[:, 0], blocks[:, 1]), blocks[:, 2]]))


def true_series(done: Finished) -> FloatArray:
    """(F, 7) true wrench, N and N·m, centre of pressure, m, and torques, N·m."""
    wrench = done.true["wrench"]
    return np.column_stack([wrench, wrench[:, 2] / wrench[:, 1], done.true["tau"]])


def series(done: Finished, prefix: str = "") -> FloatArray:
    """(F, 7) the model's, or with ``sd_`` their standard deviations."""
    names = [f"{name}_model" for name in (*WRENCH, "cop_x")] + [f"tau_{j}" for j in range(1, COUNT)]
    return done.predicted.frame[[prefix + name for name in names]].to_numpy(dtype=np.float64)


def carried(fitted: Finished, other: Finished) -> FloatArray:
    """(4(n + 1),) full parameters of one trial of a person in the frames of another.

    Each moving segment is carried by the markers that both trials have on it: a turn and a shift. The base stays, since
    both plane frames lie in the plate and the feet have not moved.
    """
    node = fitted.dynamics.data["full"]
    assert isinstance(node, Mapping)
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


def transferred(done: Finished, base: FloatArray) -> FloatArray:
    """(4,) rms errors off the seat of Fx, Fy, tauz and the centre of pressure (mm) of other base parameters (b,)."""
    joints = range(1, COUNT)
    q, dq, ddq = (
        done.states.frame[[f"{name}_{j}" for j in joints]].to_numpy(dtype=np.float64)
        for name in ("theta", "dtheta", "ddtheta")
    )
    centres = group(done.chain, "joints")["centre"]
    regressor = planar_regressor(centres, q, dq, ddq, done.truth["g"])
    wrench = regressor[:, :, structural_base(centres).kept] @ base
    model = np.column_stack([wrench, wrench[:, 2] / wrench[:, 1]])
    return np.asarray(rms((model - true_series(done)[:, :4])[done.off_seat]) * SCALE[:4])


def rms(values: FloatArray) -> FloatArray:
    """Root mean square along the first axis, over what is known."""
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))
