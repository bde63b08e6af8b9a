"""What an identification from another movement of the same body would be worth.

The chain, the parameters, the noise and the skin are those of a trial; the regressor is set up anew for the other
movement. The part of the covariance that comes from the residuals follows (XᵀX)⁻¹, the part of joints and skin is
carried through the fit anew, and the plate's zero stays. All of it is taken in proportion to what the same computation
says of the trial's own movement, so that this one is foreseen exactly as it was found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base import triangular_factor
from mocap_id.dynamics.course import Course
from mocap_id.dynamics.fit import conditions
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.kinematic_error import KinematicError, kinematic_response
from mocap_id.dynamics.lowpass import LowPass, cutoff_from_velocity, erode
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.dynamics.uncertainty import variance

SAMPLES = 200
"""Of a movement, that its variances are computed from."""


@dataclass(frozen=True)
class Foreseen:
    """What is foreseen of a movement.

    Parameters
    ----------
    sd : (b,) array
        Standard deviation of each base parameter, SI.
    covariance : (b, b) array
        Of the base parameters.
    condition, condition_scaled : float
        Of the stacked, gated minimal regressor, in SI and with unit columns.
    samples : float
        Length of what would be fitted, s.
    fixed : (b,) array
        Variance in it that no movement changes: that of the plate's zero.
    """

    sd: FloatArray
    covariance: FloatArray
    condition: float
    condition_scaled: float
    samples: float
    fixed: FloatArray


@dataclass(frozen=True)
class Body:
    """Everything about a trial that another movement would leave as it is.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    """

    prepared: Prepared
    found: Identification

    def regressor(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Base columns of all three components (T, 3, b)."""
        rows = planar_regressor(self.prepared.recorded.centres, q, dq, ddq, self.prepared.settings.gravity)
        return rows[:, :, self.prepared.base.kept]

    def wrench(self, course: Course) -> FloatArray:
        """(T, 3) wrench of the ground, N and N·m."""
        return np.asarray(self.regressor(course.q, course.dq, course.ddq) @ self.found.base)

    def moment_sd(self, course: Course) -> FloatArray:
        """(T,) how well the moment of that wrench is known, by the parameters' covariance, N·m."""
        rows = self.regressor(course.q, course.dq, course.ddq)[:, 2]
        return np.asarray(np.sqrt(variance(rows, self.found.covariance)))

    def rows(self, regressor: FloatArray, rate_of_change: FloatArray) -> FloatArray:
        """Weighted rows (R, c, b + k + 1) as those of the fit.

        Parameters
        ----------
        regressor, rate_of_change : (R, 3, b) arrays
            Base columns, and their derivative in time: along the wrench's rate of change a clock offset shifts it.
        """
        fit, chosen = self.found.fit, list(self.prepared.settings.components)
        rows, rate = regressor[:, chosen], rate_of_change[:, chosen] @ self.found.base
        bias = np.zeros((*rows.shape[:2], fit.problem.factor.shape[1] - fit.base))
        if bias.shape[-1]:
            bias[:, chosen.index(0), 0] = 1.0
        return np.asarray(np.concatenate([rows, bias, rate[..., None]], axis=-1) * fit.weights[:, None])

    def response(self, states: FloatArray, rows: FloatArray, error: KinematicError) -> FloatArray:
        """(b, S) what every mode of the geometry's error would do to the parameters; infinite where nothing is told.

        Parameters
        ----------
        states : (R, 3, n) array
        rows : (R, c, b + k + 1) array
        error : KinematicError
        """
        q, dq, ddq = np.swapaxes(states, 0, 1)
        moved = replace(self.prepared, recorded=replace(self.prepared.recorded, q=q, dq=dq, ddq=ddq))
        found = replace(self.found.fit, samples=np.arange(len(rows)), design=rows)
        try:
            return kinematic_response(moved, found, self.found.base, error)[: found.base]
        except np.linalg.LinAlgError:
            return np.full((found.base, 1), np.inf)


@dataclass(frozen=True)
class _Shape:
    """What a movement's rows say before anything is put in proportion."""

    noise: FloatArray  # (b, b), of unit residuals over one second
    geometry: FloatArray  # (b, b)


@dataclass(frozen=True)
class Foresight:
    """Foresees other movements of a trial's body.

    Parameters
    ----------
    body : Body
    geometry : callable
        What is uncertain of the geometry if it were found from postures (T, n), rad.
    own : Course
        The trial's movement.
    now : Foreseen
        What it is worth.
    """

    body: Body
    geometry: Callable[[FloatArray], KinematicError]
    own: Course
    now: Foreseen
    _shape: _Shape

    @classmethod
    def of(
        cls,
        body: Body,
        own: Course,
        geometry: Callable[[FloatArray], KinematicError] | None = None,
    ) -> Foresight:
        """Set up on a trial.

        Parameters
        ----------
        body : Body
        own : Course
            What was recorded.
        geometry : callable, optional
            See :class:`Foresight`; the geometry's errors stay as they are where it is not given.
        """
        found, fit = body.found, body.found.fit
        known = found.error
        of_postures = (lambda q: known) if geometry is None else geometry
        now = Foreseen(
            sd=found.base_sd,
            covariance=found.covariance,
            condition=fit.condition,
            condition_scaled=fit.condition_scaled,
            samples=float(fit.in_fit.sum()) / body.prepared.recorded.rate,
            fixed=_parts(found)[2],
        )
        nothing = _Shape(np.zeros((0, 0)), np.zeros((0, 0)))
        bare = cls(body, of_postures, own, now, nothing)
        return replace(bare, _shape=bare._shape_of(own, bare.fitted(own), SAMPLES))

    def foresee(
        self, course: Course, seconds: float | None = None, samples: int = SAMPLES, exactly: bool = True
    ) -> Foreseen:
        """What a movement would be worth.

        Parameters
        ----------
        course : Course
        seconds : float, optional
            How much of it would be fitted; as much as it has where not given.
        samples : int
            To compute the variances from: fewer are faster.
        exactly : bool
            Filter as the identification does before the condition number is taken, which takes longer.
        """
        fitted = self.fitted(course)
        seconds = float(fitted.sum()) / course.rate if seconds is None else seconds
        if not len(_chosen(course, fitted, samples)):
            lost = np.full_like(self.now.covariance, np.inf)
            return Foreseen(np.full(len(lost), np.inf), lost, np.inf, np.inf, 0.0, self.now.fixed)
        shape = self._shape_of(course, fitted, samples)
        covariance = self._covariance(shape, seconds)
        condition, scaled = self._filtered_conditions(course, fitted) if exactly else self.conditions(course)
        return Foreseen(np.sqrt(np.diag(covariance)), covariance, condition, scaled, seconds, self.now.fixed)

    def conditions(self, course: Course, samples: int = SAMPLES) -> tuple[float, float]:
        """Condition numbers of a movement, in SI and with unit columns, from some samples and unfiltered."""
        chosen = _chosen(course, self.fitted(course), samples)
        if not len(chosen):
            return np.inf, np.inf
        rows = self.body.regressor(course.q[chosen], course.dq[chosen], course.ddq[chosen])
        return conditions(rows[:, list(self.body.prepared.settings.components)])

    def fitted(self, course: Course) -> BoolArray:
        """Samples (T,) that an identification would use: known, and clear of gaps and ends."""
        if course.fitted is not None:
            return course.fitted
        lost = self.body.prepared.lowpass.reach + self.body.prepared.settings.offset_limit
        return erode(course.known, int(np.ceil(lost * course.rate)) + 1)

    def _shape_of(self, course: Course, fitted: BoolArray, samples: int) -> _Shape:
        body, chosen = self.body, _chosen(course, fitted, samples)
        before, now, after = (
            body.regressor(course.q[at], course.dq[at], course.ddq[at]) for at in (chosen - 1, chosen, chosen + 1)
        )
        rows = body.rows(now, (after - before) * course.rate / 2)
        states = np.stack([course.q[chosen], course.dq[chosen], course.ddq[chosen]], axis=1)
        noise = _unit_covariance(rows.reshape(-1, rows.shape[-1]))[: len(self.now.sd), : len(self.now.sd)]
        response = body.response(states, rows, self.geometry(course.q[fitted & course.known]))
        return _Shape(noise * len(chosen), response @ response.T)

    def _covariance(self, shape: _Shape, seconds: float) -> FloatArray:
        """In proportion to what was found of the trial: its residuals, its geometry's errors, its plate's zero."""
        residual, moving, fixed = _parts(self.body.found)
        scatter = np.sqrt(residual / np.diag(self._shape.noise))
        slip = np.sqrt(moving / np.maximum(np.diag(self._shape.geometry), 1e-300))
        length = self.now.samples / seconds
        return np.asarray(
            length * shape.noise * np.outer(scatter, scatter) + shape.geometry * np.outer(slip, slip) + np.diag(fixed)
        )

    def _filtered_conditions(self, course: Course, fitted: BoolArray) -> tuple[float, float]:
        if course is self.own:
            return self.now.condition, self.now.condition_scaled
        settings = self.body.prepared.settings
        cutoff = settings.cutoff if settings.cutoff is not None else cutoff_from_velocity(course.dq, course.rate)
        lowpass = LowPass(cutoff, course.rate)
        regressor = lowpass(self.body.regressor(course.q, course.dq, course.ddq))
        rows = regressor[fitted & np.isfinite(regressor).all(axis=(1, 2))][:: lowpass.step]
        return conditions(rows[:, list(settings.components)])


def _parts(found: Identification) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Variances (b,) by where they come from: residuals, joints and skin, and what no movement changes."""
    residual = np.diag(found.residual_covariance)
    rest = np.maximum(np.diag(found.covariance) - residual, 0.0)
    moving = np.minimum(np.sum(found.response**2, axis=1), rest)
    return residual, moving, rest - moving


def _chosen(course: Course, fitted: BoolArray, samples: int) -> IntArray:
    """Some of the fitted samples, evenly, whose neighbours are known too."""
    known = course.known
    inner = fitted & known
    inner[1:-1] &= known[:-2] & known[2:]
    inner[[0, -1]] = False
    chosen = np.flatnonzero(inner)
    return chosen[:: max(1, len(chosen) // samples)]


def unit_variances(rows: FloatArray) -> FloatArray:
    """Diagonal of (XᵀX)⁻¹ of rows X (r, p), with columns scaled so that it holds at any condition; infinite if lost."""
    return np.diag(_unit_covariance(rows))


def _unit_covariance(rows: FloatArray) -> FloatArray:
    """(XᵀX)⁻¹ of rows X (r, p), with columns scaled so that it holds at any condition."""
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    _, size, turned = np.linalg.svd(triangular_factor(rows / length))
    half = turned / (np.maximum(size, 1e-12 * size[0])[:, None] * length)
    return np.asarray(half.T @ half)
