"""A payload's parameters: the difference of two identifications of one chain, with and without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space.base_parameters import SpatialBase
from mocap_id.dynamics.space.identification import SpatialIdentification
from mocap_id.dynamics.uncertainty import unit_covariance

_UNKNOWN = 1e-6  # part of a unit vector in the null space from which a parameter is not determined


@dataclass(frozen=True)
class Payload:
    """Ten parameters of a payload.

    Parameters
    ----------
    value, sd : (10,) arrays
        m, mx, my, mz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz in the frame of its segment about the origin, SI; NaN where the two
        trials do not determine a parameter.
    covariance : (10, 10) array
    """

    value: FloatArray
    sd: FloatArray
    covariance: FloatArray


def identify_payload(
    structure: SpatialBase, loaded: SpatialIdentification, empty: SpatialIdentification, segment: int
) -> Payload:
    """Return the parameters of a payload fixed to one segment.

    Both trials must have the same chain and base, as with ``calibration:``, and the same instruments: their errors are
    common to both, so that they largely cancel.

    Parameters
    ----------
    structure : SpatialBase
        Base parameters of both trials.
    loaded, empty : SpatialIdentification
        With and without the payload.
    segment : int
        Segment that carries the payload, 0 for the base.

    Raises
    ------
    ValueError
        The two identifications have different parameters.
    """
    if len(loaded.base) != len(empty.base) or len(loaded.modes) != len(empty.modes):
        raise ValueError(
            f"the trials with and without payload have {len(loaded.base)} and {len(empty.base)} base parameters, "
            "expected the same chain: give `calibration:` in one of them"
        )
    size = len(loaded.base)
    columns = structure.mapping[:, 10 * segment : 10 * segment + 10]
    spread = sum((_unit(each) for each in (loaded, empty)), np.zeros((size, size)))
    half = np.linalg.cholesky(np.linalg.inv(spread)).T
    gain = np.linalg.pinv(half @ columns, rcond=1e-9) @ half
    covariance = gain @ (loaded.residual_covariance + empty.residual_covariance) @ gain.T
    for one, other in zip(loaded.modes, empty.modes, strict=True):
        change = gain @ (one.parameters - other.parameters)[:size]
        covariance += np.outer(change, change)
    unknown = np.linalg.norm(null_space(columns, rcond=1e-9), axis=1) > _UNKNOWN
    value = np.where(unknown, np.nan, gain @ (loaded.base - empty.base))
    covariance[unknown], covariance[:, unknown] = np.nan, np.nan
    return Payload(value, np.sqrt(np.diag(covariance)), covariance)


def _unit(found: SpatialIdentification) -> FloatArray:
    """Return the covariance (b, b) of the base parameters for independent residuals."""
    rows = found.fit.design.reshape(-1, found.fit.design.shape[-1])
    size = len(found.base)
    return unit_covariance(rows)[:size, :size]
