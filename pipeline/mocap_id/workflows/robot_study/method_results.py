"""The result of one trial by one method for the joint states.

The cameras determine the plane up to a rotation about the vertical, and the coordinate frame of the last segment up to
a constant angle. Parameters and series are therefore expressed in the robot's own frame if the encoder or the truth
determines it. In this frame, the angle is zero with the arm stretched upwards, and positive in the encoder's direction.
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
from mocap_id.workflows.trial_outcome import number_or_nan

STATES = ("theta", "dtheta", "ddtheta")
WRENCH = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class SeriesErrors:
    """Bias and standard deviation of a series minus its reference, and r²; NaN if unknown."""

    bias: float
    sd: float
    r2: float

    @classmethod
    def of(cls, difference: FloatArray, reference: FloatArray) -> SeriesErrors:
        """Return the errors of a series from its differences (N,) to a ``reference`` (N,); NaN samples do not count."""
        both = np.isfinite(difference) & np.isfinite(reference)
        if np.count_nonzero(both) < 2:
            return NO_ERRORS
        difference, spread = difference[both], float(np.var(reference[both]))
        r2 = 1.0 - float(np.mean(difference**2)) / spread if spread > 0 else np.nan
        return cls(float(np.mean(difference)), float(np.std(difference)), r2)


NO_ERRORS = SeriesErrors(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class RobotFrame:
    """The robot's coordinate frame in the plane: angle in the plane = sign * robot's angle + zero."""

    sign: int = 1
    zero: float = 0.0  # rad

    def from_plane(self, parameters: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return base parameters (5,) and their covariance (5, 5), transformed from the plane to the robot's frame."""
        matrix = self._matrix()
        return matrix @ parameters, matrix @ covariance @ matrix.T

    def into_plane(self, parameters: FloatArray) -> FloatArray:
        """Return base parameters (5,), transformed from the robot's frame to the plane."""
        return np.asarray(np.linalg.solve(self._matrix(), parameters))

    def _matrix(self) -> FloatArray:
        c, s = np.cos(self.zero), np.sin(self.zero)
        matrix = np.diag([1.0, self.sign, 1.0, 1.0, 1.0])
        matrix[2:4, 2:4] = [[self.sign * c, -self.sign * s], [s, c]]
        return matrix


@dataclass(frozen=True)
class MethodResult:
    """The result of one trial with one method; a number is NaN if unknown."""

    identified: IdentifiedTrial
    frame: RobotFrame
    parameters: FloatArray  # (5,) base parameters in the order of PARAMETERS
    sds: FloatArray  # (5,) their standard deviations
    verdicts: tuple[str, ...]  # known, weak or not identifiable
    condition: float  # condition number of the regressor
    clock_offset: float  # s
    states: Mapping[str, SeriesErrors]  # errors of the series in :data:`STATES`
    against: str  # reference of the states: ``truth`` or ``encoder``; empty without a reference
    wrench: Mapping[str, SeriesErrors]  # model minus measurement over the samples of the fit
    torque: SeriesErrors  # model minus encoder

    @property
    def folder(self) -> Folder:
        """The run folder."""
        return Folder(self.identified.folder)

    @property
    def time(self) -> FloatArray:
        """Times of the samples (T,), s."""
        return self.identified.dynamics["time"].to_numpy(dtype=np.float64)

    @property
    def joint_states(self) -> FloatArray:
        """Angle, velocity and acceleration (T, 3) of the joint in the plane, rad, rad/s and rad/s²."""
        return _read_joint_states(self.identified)


def read_method_result(folder: Folder, truth: Truth | None, *, by_encoder: bool) -> MethodResult:
    """Read the result of a trial with one method from its run folder.

    If ``by_encoder``, the states come from the encoder, so they cannot be compared with the encoder.
    """
    identified, frame = open_identified_trial(folder.path), _find_robot_frame(folder, truth)
    tree, facts, count = folder.tree("dynamics.h5"), identified.facts, len(PARAMETERS)
    value, covariance = tree.numbers("base/value"), tree.array("base/covariance").astype(np.float64)
    verdicts = tree.texts("base/verdict")
    if len(value) != count:
        value, covariance = np.full(count, np.nan), np.full((count, count), np.nan)
        verdicts = ("not identifiable",) * count
    else:
        value, covariance = frame.from_plane(value, covariance)
    states, against = _compare_states(folder, identified, frame, truth, by_encoder=by_encoder)
    return MethodResult(
        identified=identified,
        frame=frame,
        parameters=value,
        sds=np.sqrt(np.diagonal(covariance)),
        verdicts=verdicts,
        condition=number_or_nan(facts.get("condition_number")),
        clock_offset=number_or_nan(facts.get("clock_offset_s")),
        states=states,
        against=against,
        wrench={name: _read_errors((facts.get("wrench") or {}).get(name)) for name in WRENCH},
        torque=_read_errors(facts.get("torque")),
    )


def _find_robot_frame(folder: Folder, truth: Truth | None) -> RobotFrame:
    """Return the robot's frame from its encoder, or else from the truth, or else the frame of the plane."""
    encoder = folder.read("encoder.parquet").facts
    if encoder.get("sign") is not None:
        return RobotFrame(int(encoder["sign"]), float(encoder["zero_rad"]))
    if truth is None:
        return RobotFrame()
    states = folder.table("states.parquet")
    angle, true = states["theta_1"], truth.at(states["time"])[:, 0]
    both = np.isfinite(angle) & np.isfinite(true)
    sign = 1 if np.cov(angle[both], true[both])[0, 1] >= 0 else -1
    return RobotFrame(sign, float(np.mean(angle[both] - sign * true[both])))


def _compare_states(
    folder: Folder, trial: IdentifiedTrial, frame: RobotFrame, truth: Truth | None, *, by_encoder: bool
) -> tuple[dict[str, SeriesErrors], str]:
    """Return the errors of the states and the name of their reference.

    The mean error of the angle is removed, because the zero of the angle depends on the coordinate frame.
    """
    encoder = folder.table("encoder.parquet")
    if truth is not None:
        time = trial.dynamics["time"].to_numpy(dtype=np.float64)
        reference, against = frame.sign * truth.at(time), "truth"
    elif encoder.length and not by_encoder:
        reference, against = encoder.stack(STATES), "encoder"
    else:
        return dict.fromkeys(STATES, NO_ERRORS), ""
    errors = _read_joint_states(trial) - reference
    known: BoolArray = np.isfinite(errors[:, 0])
    errors[:, 0] -= np.mean(errors[known, 0]) if known.any() else 0.0
    return {name: SeriesErrors.of(errors[:, d], reference[:, d]) for d, name in enumerate(STATES)}, against


def _read_joint_states(trial: IdentifiedTrial) -> FloatArray:
    return np.column_stack([trial.q[:, 0], trial.dq[:, 0], trial.ddq[:, 0]])


def _read_errors(facts: Mapping[str, Any] | None) -> SeriesErrors:
    if facts is None:
        return NO_ERRORS
    return SeriesErrors(*(number_or_nan(facts.get(name)) for name in ("bias", "sd", "r2")))
