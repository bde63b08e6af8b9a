"""Validation inside a trial: fit on some repetitions, predict the others.

An error over the very samples of a fit says how well the model can follow them, not what it is worth elsewhere. Here
every repetition is predicted by parameters, clock offset and plate bias that were fitted without it. Joints, joint
angles and the samples off the chair come from the whole trial: what is left out are the forces of the repetition.

Nothing is filtered or searched anew. The filtered, weighted rows of the whole fit, with the column along which the
clock offset shifts the wrench, are compressed by QR once for each stretch that the folds use alike; a fold stacks the
triangular factors of its own. What lies within the filter's reach of the repetition that is left out holds some of it
and takes no part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray
from mocap_id.dynamics.base import triangular_factor
from mocap_id.dynamics.fit import DEPENDENT, Fit
from mocap_id.dynamics.folds import LEAST_SECONDS, without
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.solve import Compressed


@dataclass(frozen=True)
class HeldOut:
    """Predictions of repetitions by models that did not see their forces.

    Parameters
    ----------
    samples : (T,) bool array
        Samples of the fit that were predicted: those of every fold that determined a model.
    part : (T,) int array
        Part of each sample.
    wrench, measured : (T, 3) arrays
        The predictions of the ground's wrench, and the measured one at the clock and less the plate bias that the fold
        found without the repetition, N and N·m; NaN elsewhere.
    filtered, filtered_measured : (T, 3) arrays
        The same after the low-pass of the fit.
    base : (K, b) array
        Base parameters of each fold.
    offset : (K,) array
        Clock offset of each fold, s.
    """

    samples: BoolArray
    part: IntArray
    wrench: FloatArray
    measured: FloatArray
    filtered: FloatArray
    filtered_measured: FloatArray
    base: FloatArray
    offset: FloatArray


def hold_out(
    prepared: Prepared, gate: BoolArray, found: Fit, part: IntArray, solve: Callable[[Compressed], FloatArray]
) -> HeldOut | None:
    """Predict every part by a model of the others.

    Parameters
    ----------
    prepared : Prepared
    gate : (T,) bool array
        That of the whole fit.
    found : Fit
        The whole fit; its weights are kept.
    part : (T,) int array
        Part of each sample, as :func:`mocap_id.dynamics.folds.parts` numbers them.
    solve : callable
        From a compressed problem of b + k columns to its parameters (b + k,), consistent ones.

    Returns
    -------
    HeldOut or None
        None where no part can be left out: there is but one, or without it the parameters are not determined.
    """
    seen = np.stack([without(prepared, gate, part, k) for k in range(int(part.max()) + 1)])  # (K, T)
    stacks = _stacks(found, seen[:, found.samples])
    samples, series = np.zeros(len(part), dtype=bool), np.full((4, len(part), 3), np.nan)
    base, offset = [], []
    for k, stack in enumerate(stacks):
        if not _determined(stack, found, int(seen[k].sum()), prepared.recorded.rate):
            continue
        problem, shift = _at_own_clock(stack, found)
        parameters, out = solve(problem), found.in_fit & (part == k)
        base.append(parameters[: found.base])
        offset.append(found.offset + shift)
        samples |= out
        bias = parameters[found.base :].sum() * np.array([1.0, 0.0, 0.0])
        for row, (rows, wrench) in enumerate(_sides(prepared, out, offset[-1])):
            series[2 * row, out], series[2 * row + 1, out] = rows @ base[-1], wrench - bias
        elsewhere = prepared.elsewhere(offset[-1])[out]
        series[:2, out] -= elsewhere
    if not samples.any():
        return None
    wrench, measured, filtered, filtered_measured = series
    return HeldOut(samples, part, wrench, measured, filtered, filtered_measured, np.array(base), np.array(offset))


def _sides(prepared: Prepared, out: BoolArray, offset: float) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Regressor (R, 3, b) and wrench (R, 3) of all surroundings at some samples (T,): as they are, and filtered."""
    filtered = prepared.filtered_measured(np.flatnonzero(out), prepared.recorded.time[out] - offset)
    return (prepared.rows[out], prepared.measured(offset)[out]), (prepared.filtered[out], filtered)


def _stacks(found: Fit, seen: BoolArray) -> list[FloatArray]:
    """Triangular factors of each fold's rows, on top of each other, from which samples (R,) it sees (K, R).

    Columns are those of the design, then the target. Samples that the same folds see are compressed together.
    """
    rows = np.concatenate([found.design, found.target[..., None]], axis=-1)  # (R, c, b + k + 2)
    prior = np.zeros((0, rows.shape[-1]))
    if found.prior is not None:  # it counts in every fold as in the whole fit
        prior = np.column_stack([np.pad(found.prior[0], ((0, 0), (0, 1))), found.prior[1]])
    patterns, pattern = np.unique(seen, axis=1, return_inverse=True)
    factors = [triangular_factor(rows[pattern == p].reshape(-1, rows.shape[-1])) for p in range(patterns.shape[1])]
    return [
        triangular_factor(np.concatenate([prior, *(f for f, has in zip(factors, fold, strict=True) if has)]))
        for fold in patterns
    ]


def _determined(stack: FloatArray, found: Fit, samples: int, rate: float) -> bool:
    """Whether a fold tells the base parameters apart: the rule of :func:`mocap_id.dynamics.fit.determined`."""
    if samples < LEAST_SECONDS * rate or len(stack) < stack.shape[1]:
        return False
    columns = stack[:, : found.base]
    size = np.linalg.norm(columns, axis=0)
    return bool(np.all(size > 0.0) and np.linalg.cond(columns / np.where(size > 0.0, size, 1.0)) < DEPENDENT)


def _at_own_clock(stack: FloatArray, found: Fit) -> tuple[Compressed, float]:
    """A fold's problem at the clock offset that it finds, and how far that is from the whole fit's, s.

    One step of Gauss-Newton from the whole fit's offset: the wrench changes by at most a few milliseconds' worth of
    its rate of change. Where the whole fit takes no offset out the folds do not either.
    """
    rate, target = stack[:, -2], stack[:, -1]
    free = np.linalg.lstsq(stack[:, :-1], target, rcond=None)[0]
    shift = float(free[-1]) if found.applied else 0.0
    return Compressed.of(stack[:, :-2], target - shift * rate), shift
