"""Parameters of a payload: the difference of two identifications of one chain, with and without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray

_UNKNOWN = 1e-6  # part of a unit vector in the null space above which a parameter is not determined


@dataclass(frozen=True)
class BaseEstimate:
    """Base parameters of one trial."""

    value: FloatArray  # (b,) base parameters, SI
    # unit_covariance, residual_covariance: (b, b) as in
    # `space.identification.SpatialIdentification`
    unit_covariance: FloatArray
    residual_covariance: FloatArray
    modes: FloatArray  # (k, b) change of the parameters with one standard deviation of each instrument's error, SI


@dataclass(frozen=True)
class Payload:
    """Ten parameters of a payload."""

    # value, sd: (10,) m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the origin of the segment's frame and their
    # standard deviations, SI; NaN where the two trials do not determine a parameter
    value: FloatArray
    sd: FloatArray
    covariance: FloatArray  # (10, 10) covariance of the parameters

    def centre(self) -> tuple[FloatArray, FloatArray]:
        """Return the centre of mass (3,) in the segment's frame and its standard deviation (3,), m; NaN if unknown."""
        mass, moments = self.value[0], self.value[1:4]
        centre = moments / mass
        jacobian = np.column_stack([-centre / mass, np.eye(3) / mass])
        own = np.stack([self.covariance[np.ix_([0, k], [0, k])] for k in (1, 2, 3)])
        rows = jacobian[np.arange(3)[:, None], np.array([[0, 1], [0, 2], [0, 3]])]
        return centre, np.sqrt(np.einsum("ki,kij,kj->k", rows, own, rows))


def identify_payload(mapping: FloatArray, loaded: BaseEstimate, empty: BaseEstimate, segment: int) -> Payload:
    """Return the parameters of a payload fixed to one segment.

    They are a weighted least-squares fit to the change of the base parameters (eq. 4.24). Both trials must have the
    same instruments, and the same chain and base, for example because one trial names the other under ``calibration:``.
    The errors of the instruments are the same in both trials, so they largely cancel.

    Parameters
    ----------
    mapping : (b, 10K) array
        Matrix from the full parameters of all segments to the base parameters of both trials.
    loaded, empty : BaseEstimate
        Base parameters with and without the payload.
    segment : int
        Segment that carries the payload, 0 for the base.

    Raises
    ------
    ValueError
        The two identifications have different parameters.
    """
    if loaded.modes.shape != empty.modes.shape or loaded.modes.shape[1] != len(mapping):
        raise ValueError(
            f"the trials with and without payload have {len(loaded.value)} and {len(empty.value)} base parameters and "
            "do not match; expected the same chain: give `calibration:` in one of the trials"
        )
    columns = mapping[:, 10 * segment : 10 * segment + 10]
    half = np.linalg.cholesky(np.linalg.inv(loaded.unit_covariance + empty.unit_covariance)).T
    gain = np.linalg.pinv(half @ columns, rcond=1e-9) @ half
    change = (loaded.modes - empty.modes) @ gain.T
    covariance = gain @ (loaded.residual_covariance + empty.residual_covariance) @ gain.T + change.T @ change
    unknown = np.linalg.norm(null_space(columns, rcond=1e-9), axis=1) > _UNKNOWN
    value = np.where(unknown, np.nan, gain @ (loaded.value - empty.value))
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return Payload(value, np.sqrt(np.diag(covariance)), covariance)
