"""Base parameters: the combinations of inertial parameters that a wrench determines (thesis 4.1.1.2).

The columns of the regressor are taken in their natural order: base to tip, and m, mx, my, Izz within a segment. Columns
of zeros are dropped. A column that depends linearly on the columns kept before it is regrouped into these columns. A
different order would give a different set; this order gives eq. 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.regressor import PLANAR_PARAMETERS, planar_regressor

_UNITS = ("kg", "kg*m", "kg*m", "kg*m^2")
_OUTSIDE = 1e-6  # fraction of the largest entry: larger distances from the span are not due to rounding
_ENOUGH = 1000  # number of rows that are tested; in nearly every posture, the answer is the same


@dataclass(frozen=True)
class BaseSet:
    """The identifiable combinations of the full parameters."""

    kept: IntArray  # (b,) linearly independent columns of the full regressor
    # (b, p) matrix M of eq. 4.24: base parameters = M · full parameters, and Y[:, kept] · M = Y.
    regrouping: FloatArray

    def columns(self, regressor: FloatArray) -> FloatArray:
        """Return the kept columns (..., b) of a regressor (..., p), without a copy if all are kept."""
        return regressor if len(self.kept) == regressor.shape[-1] else regressor[..., self.kept]

    def expand(self, base: FloatArray) -> FloatArray:
        """Return the full parameters (p,) with these base parameters (b,) that are zero in all columns not kept."""
        full = np.zeros(self.regrouping.shape[1])
        full[self.kept] = base
        return full


def triangularise(rows: FloatArray) -> FloatArray:
    """Return R (min(r, p), p) of the QR decomposition of rows (r, p), which is all that least squares needs."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)


def regroup_columns(regressor: FloatArray) -> BaseSet:
    """Find the independent columns of a stacked regressor (r, p) and regroup the other columns (eq. 4.8, 4.9, 4.24).

    An unpivoted QR compresses the rows. The columns of its R are then orthogonalised in turn, and dependent columns are
    left out. The diagonal of R alone is not sufficient, because a dependent column leaves an arbitrary direction in Q,
    which can make a later column look dependent.
    """
    factor = triangularise(regressor)
    directions: list[FloatArray] = []
    remainders = np.zeros(factor.shape[1])
    kept: list[int] = []
    # norm below which the independent part of a column counts as zero (eq. 4.8)
    largest_diagonal = float(np.max(np.abs(np.diagonal(factor)), initial=0.0))
    zero = len(regressor) * float(np.finfo(np.float64).eps) * largest_diagonal
    for column in np.flatnonzero(np.any(factor != 0.0, axis=0)):
        rest = factor[:, column]
        for _ in range(2):  # two passes give orthogonality up to rounding errors
            rest = rest - sum((np.dot(d, rest) * d for d in directions), start=np.zeros_like(rest))
        remainders[column] = float(np.linalg.norm(rest))
        if remainders[column] >= zero:
            directions.append(rest / remainders[column])
            kept.append(int(column))
    index = np.array(kept, dtype=np.int64)
    regrouping = np.asarray(np.linalg.lstsq(factor[:, index], factor, rcond=None)[0], dtype=np.float64)
    regrouping[:, index] = np.eye(len(index))
    largest = np.max(np.abs(regrouping), axis=0)
    regrouping[np.abs(regrouping) <= 1e-9 * np.maximum(largest, 1.0)] = 0.0
    return BaseSet(index, regrouping)


def determines_rows(rows: FloatArray, base: BaseSet) -> bool:
    """Return whether base parameters determine what rows (r, p) of a full regressor predict; NaN is missing."""
    known = rows[np.isfinite(rows).all(axis=1)]
    known = known[:: max(1, len(known) // _ENOUGH)]
    # a row outside the span of the rows that gave the base set depends on other parameters too
    off = known[:, base.kept] @ base.regrouping - known
    return float(np.max(np.abs(off), initial=0.0)) <= _OUTSIDE * float(np.max(np.abs(known), initial=0.0))


def structural_base(centres: FloatArray, components: tuple[int, ...] = (0, 1, 2)) -> BaseSet:
    """Return the base set of a planar chain in which every joint moves; no trial can determine more parameters."""
    states = np.random.default_rng(0).normal(size=(3, 50, len(centres)))
    regressor = planar_regressor(centres, *states)[:, list(components), :]
    return regroup_columns(regressor.reshape(-1, regressor.shape[-1]))


def name_parameters(segments: int) -> tuple[str, ...]:
    """Return the names of the full parameters, numbered from 1 for the base as in the thesis: m1, mx1, my1, I1, m2 …"""
    return tuple(f"{symbol}{k}" for k in range(1, segments + 1) for symbol in ("m", "mx", "my", "I"))


def list_base_units(base: BaseSet) -> tuple[str, ...]:
    """Return the SI unit of each base parameter."""
    return tuple(_UNITS[column % len(PLANAR_PARAMETERS)] for column in base.kept)


def base_names(base: BaseSet, centres: FloatArray) -> tuple[str, ...]:
    """Return the names of the base parameters as symbols, as in eq. 6.1.

    Let a mass m_j be regrouped into a parameter of segment k, and let p_{k+1} be the joint at the end of segment k. The
    coefficient is written as 1, p_{k+1,x}, p_{k+1,y} or |p_{k+1}|² if it has this value, otherwise as a number.
    """
    symbols, names = name_parameters(len(centres) + 1), []
    for row, column in zip(base.regrouping, base.kept.tolist(), strict=True):
        segment, kind = divmod(column, len(PLANAR_PARAMETERS))
        terms: dict[str, list[str]] = {}  # regrouped parameters by their common coefficient
        for other in np.setdiff1d(np.arange(len(row)), base.kept).tolist():
            beyond, other_kind = divmod(other, len(PLANAR_PARAMETERS))
            structural = other_kind == 0 and beyond > segment and segment < len(centres)
            value, symbol = 0.0, ""
            if structural:  # value and symbol of the factor of the mass in this kind of parameter
                (x, y), joint = centres[segment].tolist(), segment + 2
                value = (1.0, x, y, x * x + y * y)[kind]
                symbol = ("", f"p{joint}x*", f"p{joint}y*", f"(p{joint}x^2+p{joint}y^2)*")[kind]
            if structural and np.isclose(row[other], value, rtol=1e-6, atol=1e-9):
                terms.setdefault(symbol, []).append(symbols[other])
            elif row[other] != 0.0:
                terms.setdefault(f"{row[other]:.4g}*", []).append(symbols[other])
        name = symbols[column]
        for symbol, masses in terms.items():
            total = "+".join(masses)
            name += f"+{symbol}({total})" if symbol and len(masses) > 1 else f"+{symbol}{total}"
        names.append(name)
    return tuple(names)
