"""The result of one trial by one method for the joint states.

Parameters and series are in the robot's own frame if the encoder or the truth shows what it is: its angle is zero with
the arm stretched upwards, and positive in the encoder's direction. The recovery finds the plane up to a rotation about
the vertical, and the frame of the last segment up to a constant angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.store import Folder
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.robot_study.truth import PARAMETERS, Truth

STATES = ("theta", "dtheta", "ddtheta")
WRENCH = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class SeriesErrors:
    """Bias, standard deviation and r² of a series less its reference."""

    bias: float
    sd: float
    r2: float

    @classmethod
    def of(cls, difference: FloatArray, reference: FloatArray) -> SeriesErrors:
        """Return the errors of differences (N,) from a reference (N,); samples with NaN do not count."""
        both = np.isfinite(difference) & np.isfinite(reference)
        if np.count_nonzero(both) < 2:
            return NO_ERRORS
        difference, spread = difference[both], float(np.var(reference[both]))
        r2 = 1.0 - float(np.mean(difference**2)) / spread if spread > 0 else np.nan
        return cls(float(np.mean(difference)), float(np.std(difference)), r2)


NO_ERRORS = SeriesErrors(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class RobotFrame:
    """The robot's frame in the plane: angle in the plane = sign * robot's angle + zero.

    ``known`` is False if neither encoder nor truth shows it: the plane's own frame is then used.
    """

    sign: int
    zero: float
    known: bool

    def from_plane(self, parameters: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return base parameters (5,) of the plane and their covariance in the robot's frame."""
        matrix = self._matrix()
        return matrix @ parameters, matrix @ covariance @ matrix.T

    def into_plane(self, parameters: FloatArray) -> FloatArray:
        """Return base parameters (5,) of the robot's frame in the plane."""
        return np.asarray(np.linalg.solve(self._matrix(), parameters))

    def _matrix(self) -> FloatArray:
        c, s = np.cos(self.zero), np.sin(self.zero)
        matrix = np.diag([1.0, self.sign, 1.0, 1.0, 1.0])
        matrix[2:4, 2:4] = [[self.sign * c, -self.sign * s], [s, c]]
        return matrix


@dataclass(frozen=True)
class MethodResult:
    """The result of one trial by one method."""

    identified: IdentifiedTrial
    frame: RobotFrame
    parameters: FloatArray  # (5,) in the order of PARAMETERS; NaN if unknown
    sds: FloatArray  # (5,) their standard deviations
    verdicts: tuple[str, ...]  # known, weak or not identifiable
    condition: float
    clock_offset: float
    states: Mapping[str, SeriesErrors]  # errors of :data:`STATES` against ``against``
    against: str  # truth, encoder, or empty if there is neither
    wrench: Mapping[str, SeriesErrors]  # model less measurement over the samples of the fit
    torque: SeriesErrors  # model less encoder

    @property
    def folder(self) -> Folder:
        """The run folder."""
        return Folder(self.identified.folder)

    @property
    def time(self) -> FloatArray:
        """Times of the samples, (T,), s."""
        return self.identified.dynamics["time"].to_numpy(dtype=np.float64)

    @property
    def joint_states(self) -> FloatArray:
        """Angle, velocity and acceleration of the joint in the plane, (T, 3)."""
        trial = self.identified
        return np.column_stack([trial.q[:, 0], trial.dq[:, 0], trial.ddq[:, 0]])


def read_method_result(folder: Folder, truth: Truth | None, *, by_encoder: bool) -> MethodResult:
    """Read the result of a trial by one method from its folder.

    Parameters
    ----------
    folder : Folder
    truth : Truth or None
    by_encoder : bool
        The states come from the encoder, so they cannot be compared with it.
    """
    identified, frame = open_identified_trial(folder.path), _robot_frame(folder, truth)
    tree, facts, count = folder.tree("dynamics.h5"), identified.facts, len(PARAMETERS)
    value, covariance = tree.numbers("base/value"), tree.array("base/covariance").astype(np.float64)
    verdicts = tree.texts("base/verdict")
    if len(value) != count:
        value, covariance = np.full(count, np.nan), np.full((count, count), np.nan)
        verdicts = ("not identifiable",) * count
    else:
        value, covariance = frame.from_plane(value, covariance)
    states, against = _state_errors(folder, identified, frame, truth, by_encoder=by_encoder)
    return MethodResult(
        identified=identified,
        frame=frame,
        parameters=value,
        sds=np.sqrt(np.diagonal(covariance)),
        verdicts=verdicts,
        condition=_number(facts.get("condition_number")),
        clock_offset=_number(facts.get("clock_offset_s")),
        states=states,
        against=against,
        wrench={name: _errors((facts.get("wrench") or {}).get(name)) for name in WRENCH},
        torque=_errors(facts.get("torque")),
    )


def _robot_frame(folder: Folder, truth: Truth | None) -> RobotFrame:
    """Return the robot's frame by its encoder, or else by the truth."""
    encoder = folder.read("encoder.parquet").facts
    if encoder.get("sign") is not None:
        return RobotFrame(int(encoder["sign"]), float(encoder["zero_rad"]), known=True)
    if truth is None:
        return RobotFrame(1, 0.0, known=False)
    states = folder.table("states.parquet")
    angle, true = states["theta_1"], truth.at(states["time"])[:, 0]
    both = np.isfinite(angle) & np.isfinite(true)
    sign = 1 if np.cov(angle[both], true[both])[0, 1] >= 0 else -1
    return RobotFrame(sign, float(np.mean(angle[both] - sign * true[both])), known=True)


def _state_errors(
    folder: Folder, trial: IdentifiedTrial, frame: RobotFrame, truth: Truth | None, *, by_encoder: bool
) -> tuple[dict[str, SeriesErrors], str]:
    """Return the states' errors; the mean error of the angle is removed, since its zero depends on the frame."""
    found = np.column_stack([trial.q[:, 0], trial.dq[:, 0], trial.ddq[:, 0]])
    encoder = folder.table("encoder.parquet")
    if truth is not None:
        time = trial.dynamics["time"].to_numpy(dtype=np.float64)
        reference, against = frame.sign * truth.at(time), "truth"
    elif encoder.length and not by_encoder:
        reference, against = encoder.stack(STATES), "encoder"
    else:
        return dict.fromkeys(STATES, NO_ERRORS), ""
    off = found - reference
    both: BoolArray = np.isfinite(off[:, 0])
    off[:, 0] -= np.mean(off[both, 0]) if both.any() else 0.0
    return {name: SeriesErrors.of(off[:, d], reference[:, d]) for d, name in enumerate(STATES)}, against


def _errors(facts: Mapping[str, Any] | None) -> SeriesErrors:
    if facts is None:
        return NO_ERRORS
    return SeriesErrors(*(_number(facts.get(name)) for name in ("bias", "sd", "r2")))


def _number(value: Any) -> float:
    return np.nan if value is None else float(value)
