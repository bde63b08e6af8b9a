"""How much a movement tells of each base parameter, whether that is enough, and which movement would tell more.

A parameter's column in the regressor counts as far as no other column can imitate it: the norm of its part orthogonal
to all others, in standard deviations of the residual, is what noise is held against. What another movement would make
of it follows from the same regressor, with the chain that was found and the parameters that are known so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base import base_names, triangular_factor
from mocap_id.dynamics.fit import DEPENDENT
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.kinematic_error import kinematic_response
from mocap_id.dynamics.prepare import Prepared, Recorded
from mocap_id.dynamics.regressor import planar_regressor

Judgement: TypeAlias = Literal["known", "weak", "not identifiable"]
Change: TypeAlias = Literal["faster", "larger", "alone"]

WEAK = 0.2  # of a parameter's size: its standard deviation
WEAK_ROBOT = 0.05  # a robot's parameters are wanted to per cents
LOST = 1.0
FACTOR = 1.5  # by which a movement is made faster or larger
_HELPS = 0.8  # of the standard deviation: more is within what the foresight is off by
_SAMPLES = 200
_LEAST_LEVER = 0.05  # m


@dataclass(frozen=True)
class Advice:
    """A movement that would tell more of a parameter.

    Parameters
    ----------
    change : {"faster", "larger", "alone"}
        1.5 times as fast, 1.5 times as far, or half of the time with the other joints at rest.
    joint : int or None
        The joint, from 0; None for all of them.
    ratio : float
        Standard deviation with that movement, in a recording as long, by the present one.
    """

    change: Change
    joint: int | None
    ratio: float

    def said(self, joints: Sequence[str]) -> str:
        """The movement in words.

        Parameters
        ----------
        joints : sequence of str
            Their names.
        """
        moved = "the whole movement" if self.joint is None else f"the {joints[self.joint]}'s movement"
        if self.change == "alone":
            return f"{moved} by itself for half of the time (the other joints at rest)"
        step = ", out of step with the others," if self.change == "faster" and self.joint is not None else ""
        return f"{moved} {FACTOR:g} times {self.change}{step}"


@dataclass(frozen=True)
class Excitation:
    """What is known of each base parameter, and why.

    Parameters
    ----------
    names : tuple of str
    verdict : tuple of {"known", "weak", "not identifiable"}
    size : (b,) array
        What the standard deviation is held against, SI.
    relative_sd : (b,) array
        Standard deviation by size.
    own : (b,) array
        Norm of the column's part that is orthogonal to all others, in standard deviations of the residual for one SI
        unit of the parameter.
    share : (b,) array
        Of the whole column's norm, 0 … 1.
    advice : tuple of (Advice or None)
        The best movement for each; None where none of those that were tried takes a fifth off. Empty where every
        parameter is known: then none is looked for, which takes as long as the identification.
    weak : float
        Standard deviation by size above which a parameter is weak.
    """

    names: tuple[str, ...]
    verdict: tuple[Judgement, ...]
    size: FloatArray
    relative_sd: FloatArray
    own: FloatArray
    share: FloatArray
    advice: tuple[Advice | None, ...]
    weak: float = WEAK

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Positions of the parameters that are not known."""
        return tuple(i for i, verdict in enumerate(self.verdict) if verdict != "known")


def excitation(prepared: Prepared, found: Identification, weak: float = WEAK) -> Excitation:
    """Judge every base parameter, and look for the movement that would tell more of it.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    weak : float
        Standard deviation by size above which a parameter is weak.
    """
    size = sizes(prepared, found)
    relative = found.base_sd / np.maximum(size, 1e-300)
    own, share = _own_parts(found.fit.design, found.fit.base)
    verdict = tuple(_verdict(r, s, weak) for r, s in zip(relative, share, strict=True))
    return Excitation(
        names=base_names(prepared.base, prepared.recorded.centres),
        verdict=verdict,
        size=size,
        relative_sd=relative,
        own=own,
        share=share,
        advice=() if set(verdict) == {"known"} else advise(prepared, found),
        weak=weak,
    )


def sizes(prepared: Prepared, found: Identification) -> FloatArray:
    """Size of each base parameter (b,), SI, against which its standard deviation counts.

    First moments are held against (mx, my) together: mx alone may be zero. The base segment has no my; its mx is the
    weight times the centre of pressure of a straight stand, and 5 cm of that count as its least size.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = float(found.full[::4].sum()) if 1 in prepared.settings.components else 0.0
    size = np.abs(found.base)
    for i in np.flatnonzero((kind == 1) | (kind == 2)):
        pair = found.base[(segment == segment[i]) & ((kind == 1) | (kind == 2))]
        size[i] = np.linalg.norm(pair) if segment[i] else max(size[i], _LEAST_LEVER * mass)
    return np.asarray(size)


def _verdict(relative: float, share: float, weak: float) -> Judgement:
    if not np.isfinite(relative) or relative > LOST or share < 1.0 / DEPENDENT:
        return "not identifiable"
    return "weak" if relative > weak else "known"


def _own_parts(design: FloatArray, base: int) -> tuple[FloatArray, FloatArray]:
    """Norm of each base column's part that is orthogonal to all others (b,), and its share of the whole column's."""
    rows = design.reshape(-1, design.shape[-1])
    own = 1.0 / np.sqrt(_unit_variances(rows)[:base])
    return own, own / np.maximum(np.linalg.norm(rows, axis=0)[:base], 1e-300)


def _unit_variances(rows: FloatArray) -> FloatArray:
    """Diagonal of (XᵀX)⁻¹ of rows X (r, p), with columns scaled so that it holds at any condition; infinite if lost."""
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    _, size, turned = np.linalg.svd(triangular_factor(rows / length))
    inverse = 1.0 / np.maximum(size, 1e-12 * size[0])
    return np.asarray(np.sum((inverse[:, None] * turned) ** 2, axis=0) / length**2)


def advise(prepared: Prepared, found: Identification) -> tuple[Advice | None, ...]:
    """For each parameter the change of the movement that takes most off its standard deviation.

    Parameters
    ----------
    prepared, found
        As for :func:`excitation`.

    Returns
    -------
    tuple of (Advice or None)
        b long.
    """
    trial = _Trial.of(prepared, found)
    noise, geometry = trial.now
    residual = np.diag(found.residual_covariance)
    rest = np.maximum(np.diag(found.covariance) - residual, 0.0)
    moving = np.minimum(geometry, rest)  # what is left of it is the plate's zero, which no movement tells
    best: list[Advice | None] = [None] * len(found.base)
    for change, joint in _changes(len(prepared.recorded.centres)):
        new_noise, new_geometry = trial.changed(change, joint)
        after = residual * new_noise / noise + moving * new_geometry / np.maximum(geometry, 1e-300) + rest - moving
        ratio = np.sqrt(after / np.maximum(residual + rest, 1e-300))
        for i, value in enumerate(ratio):
            least = best[i].ratio if best[i] is not None else _HELPS  # type: ignore[union-attr]
            if value < least:
                best[i] = Advice(change, joint, float(value))
    return tuple(best)


def _changes(joints: int) -> list[tuple[Change, int | None]]:
    """Changes of the movement to try: of all joints, then of one."""
    each: list[tuple[Change, int | None]] = [("faster", None), ("larger", None)]
    if joints > 1:
        each += [(change, joint) for joint in range(joints) for change in ("faster", "larger", "alone")]
    return each


@dataclass(frozen=True)
class _Trial:
    """The samples of the fit, and what they would be in another movement."""

    prepared: Prepared
    found: Identification
    time: FloatArray
    now: tuple[FloatArray, FloatArray]

    @classmethod
    def of(cls, prepared: Prepared, found: Identification) -> _Trial:
        samples = found.fit.samples[:: max(1, len(found.fit.samples) // _SAMPLES)]
        empty = np.zeros(0)
        trial = cls(prepared, found, prepared.recorded.time[samples], (empty, empty))
        ones = np.ones(prepared.recorded.q.shape[1])
        return replace(trial, now=trial._variances(*trial._rows(ones, ones)))

    def changed(self, change: Change, joint: int | None) -> tuple[FloatArray, FloatArray]:
        """Variances (b,) with unit noise, and by the geometry, if one joint moved so, or all of them."""
        joints = self.prepared.recorded.q.shape[1]
        ones, chosen = np.ones(joints), np.arange(joints) == joint if joint is not None else np.ones(joints, bool)
        if change == "alone":
            parts = self._rows(ones, ones), self._rows(ones, np.where(chosen, 1.0, 0.0))
            return self._variances(*(np.concatenate([a[::2], b[1::2]]) for a, b in zip(*parts, strict=True)))
        more = np.where(chosen, FACTOR, 1.0)
        return self._variances(*(self._rows(more, ones) if change == "faster" else self._rows(ones, more)))

    def _rows(self, speed: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States (R, 3, n) and weighted rows (R, c, b + k + 1) with each joint at its own speed and size (n,).

        A joint that is faster than the others runs to and fro over its own recording; all together they pass through
        the same postures. The wrench's rate of change, along which a clock offset shifts it, is a difference.
        """
        fit, settings = self.found.fit, self.prepared.settings
        step = 1.0 / self.prepared.recorded.rate
        time = self.time - self.prepared.recorded.time[0]
        if np.all(speed == speed[0]):
            time = time / speed[0]
        before, states, after = (self._states(time + shift, speed, size) for shift in (-step, 0.0, step))
        rows = self._regressor(states)
        rate = (self._regressor(after) - self._regressor(before)) @ self.found.base / (2 * step)
        bias = np.zeros((*rows.shape[:2], fit.problem.factor.shape[1] - fit.base))
        if bias.shape[-1]:
            bias[:, settings.components.index(0), 0] = 1.0
        return states, np.concatenate([rows, bias, rate[..., None]], axis=-1) * fit.weights[:, None]

    def _regressor(self, states: FloatArray) -> FloatArray:
        """Base columns of the fitted components (R, c, b)."""
        q, dq, ddq = np.swapaxes(states, 0, 1)
        rows = planar_regressor(self.prepared.recorded.centres, q, dq, ddq, self.prepared.settings.gravity)
        return rows[:, list(self.prepared.settings.components)][:, :, self.prepared.base.kept]

    def _states(self, time: FloatArray, speed: FloatArray, size: FloatArray) -> FloatArray:
        """Angles, velocities and accelerations (R, 3, n) at times (R,) from the beginning, s."""
        recorded = self.prepared.recorded
        length = float(recorded.time[-1] - recorded.time[0])
        middle = np.nanmedian(recorded.q[self.found.fit.samples], axis=0)
        clock = np.multiply.outer(time, speed)
        forth = np.floor_divide(clock, length) % 2 == 0
        clock = np.where(forth, clock % length, length - clock % length)
        return np.stack(
            [
                middle + size * (_at(recorded, recorded.q, clock) - middle),
                np.where(forth, 1.0, -1.0) * size * speed * _at(recorded, recorded.dq, clock),
                size * speed**2 * _at(recorded, recorded.ddq, clock),
            ],
            axis=1,
        )

    def _variances(self, states: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Diagonals (b,) of what noise and geometry make of the parameters, for as many samples as now."""
        known = np.isfinite(rows).all(axis=(1, 2)) & np.isfinite(states).all(axis=(1, 2))
        fit, base = self.found.fit, self.found.fit.base
        if not known.any():
            return np.full(base, np.inf), np.full(base, np.inf)
        states, rows = states[known], rows[known]
        noise = _unit_variances(rows.reshape(-1, rows.shape[-1]))[:base] * known.mean()
        q, dq, ddq = np.swapaxes(states, 0, 1)
        moved = replace(self.prepared, recorded=replace(self.prepared.recorded, q=q, dq=dq, ddq=ddq))
        found = replace(fit, samples=np.arange(len(rows)), design=rows)
        try:
            response = kinematic_response(moved, found, self.found.base, self.found.error)[:base]
        except np.linalg.LinAlgError:
            return noise, np.full(base, np.inf)
        return noise, np.asarray(np.sum(response**2, axis=1))


def _at(recorded: Recorded, values: FloatArray, clock: FloatArray) -> FloatArray:
    """Series (T, n) at every joint's own times (R, n) from the beginning, s."""
    stamped = recorded.time - recorded.time[0]
    return np.stack([np.interp(own, stamped, column) for own, column in zip(clock.T, values.T, strict=True)], axis=1)
