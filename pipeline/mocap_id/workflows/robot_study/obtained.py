"""What one trial gave by one method: numbers for the tables, and series for the figures.

Parameters and series are in the robot's own frame, wherever its encoder or the truth tells that frame: its angle is
zero with the arm stretched upwards and positive where the encoder's is. The plane and the last segment's frame are
gauges of the recovery, turned about the vertical and by an angle against it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.store import Folder, Table, Tree
from mocap_id.workflows.finished import Finished, finished
from mocap_id.workflows.robot_study.truth import Truth

PARAMETERS = ("mass", "mx1", "mx2", "my2", "Izz2")
STATES = ("theta", "dtheta", "ddtheta")
WRENCH = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class Errors:
    """Of a series against another: bias, standard deviation, and r² about the other."""

    bias: float
    sd: float
    r2: float

    @classmethod
    def of(cls, off: FloatArray, reference: FloatArray) -> Errors:
        """From differences and what they are differences from, (N,) each; NaN does not count."""
        both = np.isfinite(off) & np.isfinite(reference)
        if np.count_nonzero(both) < 2:
            return NO_ERRORS
        off, spread = off[both], float(np.var(reference[both]))
        r2 = 1.0 - float(np.mean(off**2)) / spread if spread > 0 else np.nan
        return cls(float(np.mean(off)), float(np.std(off)), r2)


NO_ERRORS = Errors(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Gauge:
    """The plane's angles and x in the robot's: angle = sign * own + zero.

    ``known`` is False where neither encoder nor truth tells: the plane's own frame is then kept.
    """

    sign: int
    zero: float
    known: bool

    def turned(self, parameters: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Base parameters (5,) and their covariance in the robot's frame."""
        matrix = self._matrix()
        return matrix @ parameters, matrix @ covariance @ matrix.T

    def into_plane(self, parameters: FloatArray) -> FloatArray:
        """Base parameters (5,) of the robot's frame in the plane's."""
        return np.asarray(np.linalg.solve(self._matrix(), parameters))

    def _matrix(self) -> FloatArray:
        c, s = np.cos(self.zero), np.sin(self.zero)
        matrix = np.diag([1.0, self.sign, 1.0, 1.0, 1.0])
        matrix[2:4, 2:4] = [[self.sign * c, -self.sign * s], [s, c]]
        return matrix


@dataclass(frozen=True)
class Obtained:
    """One trial by one method.

    Parameters
    ----------
    done : Finished
    gauge : Gauge
    parameters, sds : (5,) arrays
        Of :data:`PARAMETERS`; NaN where unknown.
    verdicts : tuple of str
        known, weak or not identifiable.
    condition, clock_offset : float
    states : mapping of str to Errors
        Of :data:`STATES` against ``against``.
    against : str
        truth, encoder, or empty where there is neither.
    wrench : mapping of str to Errors
        Model less measurement over the samples of the fit.
    torque : Errors
        Model less encoder.
    """

    done: Finished
    gauge: Gauge
    parameters: FloatArray
    sds: FloatArray
    verdicts: tuple[str, ...]
    condition: float
    clock_offset: float
    states: Mapping[str, Errors]
    against: str
    wrench: Mapping[str, Errors]
    torque: Errors


def gauge_of(folder: Folder, truth: Truth | None) -> Gauge:
    """The robot's frame by its encoder, or else by the truth."""
    told = folder.read("encoder.parquet").facts
    if told.get("sign") is not None:
        return Gauge(int(told["sign"]), float(told["zero_rad"]), known=True)
    if truth is None:
        return Gauge(1, 0.0, known=False)
    states = _table(folder, "states.parquet")
    angle, true = states["theta_1"], truth.at(states["time"])[:, 0]
    both = np.isfinite(angle) & np.isfinite(true)
    sign = 1 if np.cov(angle[both], true[both])[0, 1] >= 0 else -1
    return Gauge(sign, float(np.mean(angle[both] - sign * true[both])), known=True)


def obtained(folder: Folder, truth: Truth | None, *, own: bool) -> Obtained:
    """Read what a trial left by one method.

    Parameters
    ----------
    folder : Folder
    truth : Truth or None
    own : bool
        The states are the encoder's, which is then nothing to hold them against.
    """
    done, gauge = finished(folder.path), gauge_of(folder, truth)
    tree = folder.read("dynamics.h5")
    assert isinstance(tree, Tree)
    base: Any = tree.data["base"]
    value, covariance = (np.asarray(base[name], dtype=np.float64) for name in ("value", "covariance"))
    five = len(value) == len(PARAMETERS)
    parameters, spread = gauge.turned(value, covariance) if five else _unknown()
    states, against = _state_errors(folder, done, gauge, truth, own=own)
    facts = done.facts
    return Obtained(
        done=done,
        gauge=gauge,
        parameters=parameters,
        sds=np.sqrt(np.diagonal(spread)),
        verdicts=tuple(map(str, base["verdict"])) if five else ("not identifiable",) * len(PARAMETERS),
        condition=_number(facts.get("condition_number")),
        clock_offset=_number(facts.get("clock_offset_s")),
        states=states,
        against=against,
        wrench={name: _errors((facts.get("wrench") or {}).get(name)) for name in WRENCH},
        torque=_errors(facts.get("torque")),
    )


def _unknown() -> tuple[FloatArray, FloatArray]:
    count = len(PARAMETERS)
    return np.full(count, np.nan), np.full((count, count), np.nan)


def _state_errors(
    folder: Folder, done: Finished, gauge: Gauge, truth: Truth | None, *, own: bool
) -> tuple[dict[str, Errors], str]:
    """Errors of the states, a constant of the angle apart: where the angle is zero is the frame's."""
    found = np.column_stack([done.q[:, 0], done.dq[:, 0], done.ddq[:, 0]])
    time = done.dynamics["time"].to_numpy(dtype=np.float64)
    encoder = _table(folder, "encoder.parquet")
    if truth is not None:
        reference, against = gauge.sign * truth.at(time), "truth"
    elif encoder.length and not own:
        reference, against = encoder.stack(STATES), "encoder"
    else:
        return dict.fromkeys(STATES, NO_ERRORS), ""
    off = found - reference
    both: BoolArray = np.isfinite(off[:, 0])
    off[:, 0] -= np.mean(off[both, 0]) if both.any() else 0.0
    return {name: Errors.of(off[:, d], reference[:, d]) for d, name in enumerate(STATES)}, against


def _errors(facts: Mapping[str, Any] | None) -> Errors:
    if facts is None:
        return NO_ERRORS
    return Errors(*(_number(facts.get(name)) for name in ("bias", "sd", "r2")))


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)


def _table(folder: Folder, file: str) -> Table:
    artefact = folder.read(file)
    assert isinstance(artefact, Table)
    return artefact
