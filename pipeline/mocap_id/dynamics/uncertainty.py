"""Standard deviations of parameters from residuals that are correlated in time."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.dynamics.base_parameters import triangularise


def number_blocks(time: FloatArray, length: float) -> IntArray:
    """Return the number (R,), from 0, of the block of each time (R,), s; empty blocks get no number.

    Blocks are ``length`` s long.
    """
    _, block = np.unique(np.floor((time - time[0]) / length), return_inverse=True)
    return block.astype(np.int64)


def estimate_covariance(
    design: FloatArray,
    residual: FloatArray,
    block: IntArray,
    prior: FloatArray | None = None,
    spread: FloatArray | float = 1.0,
) -> FloatArray:
    """Return the covariance (b, b) of least-squares parameters from residuals that are correlated within blocks.

    It is the sandwich (XᵀX)⁻¹ (Σ_g X_gᵀ r_g r_gᵀ X_g) (XᵀX)⁻¹ over blocks g, to which a block bootstrap converges.
    Residuals may be correlated and heteroscedastic within a block. Blocks count as independent, so they must be longer
    than the correlation time of the residuals. The factor G/(G - 1) · (r - 1)/(r - b) corrects for few blocks, where G
    is the number of blocks and r = R c.

    Parameters
    ----------
    design : (R, c, b) array
        Weighted regressor.
    residual : (R, c) array
        Weighted residuals.
    block : (R,) int array
        Block of each sample, 0 … G - 1.
    prior : (p, b) array, optional
        Rows P of a prior that is part of the fit, in standard deviations. The covariance is then (XᵀX + PᵀP)⁻¹ (Σ_g
        X_gᵀ r_g r_gᵀ X_g + PᵀS²P) (XᵀX + PᵀP)⁻¹.
    spread : (p,) array or float
        Diagonal of S: standard deviations of the prior's errors, divided by those in P; below 1 for a prior that is
        wider than its errors.
    """
    columns = design.shape[-1]
    rows = design.reshape(-1, columns)
    factor = triangularise(rows if prior is None else np.concatenate([rows, prior]))
    scores = np.einsum("rcb,rc->rb", design, residual)
    count = int(block.max()) + 1
    sums = np.zeros((count, columns))
    np.add.at(sums, block, scores)
    half = solve_triangular(factor, solve_triangular(factor, sums.T, trans="T"))  # (XᵀX)⁻¹ per block, (b, G)
    correction = count / max(count - 1, 1) * (residual.size - 1) / max(residual.size - columns, 1)
    covariance: FloatArray = correction * (half @ half.T)
    if prior is None:
        return covariance
    rest = solve_triangular(factor, solve_triangular(factor, prior.T * spread, trans="T"))
    return np.asarray(covariance + rest @ rest.T)


def unit_covariance(rows: FloatArray) -> FloatArray:
    """Return (XᵀX)⁻¹ (p, p) of rows X (r, p). The columns are scaled internally, so that the result is accurate."""
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    _, size, right = np.linalg.svd(triangularise(rows / length))
    half = right / (np.maximum(size, 1e-12 * size[0])[:, None] * length)
    return np.asarray(half.T @ half)


def variance(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance (...) of the products of rows (..., b) and parameters with the given covariance (b, b)."""
    values: FloatArray = np.einsum("...b,...b->...", rows @ covariance, rows)
    return np.maximum(values, 0.0)
