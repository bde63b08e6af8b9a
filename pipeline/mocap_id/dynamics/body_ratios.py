"""Ratios of base parameters that are almost the same in all people.

All mass above the shank acts at the knee. The first moment of the shank together with this mass is therefore nearly the
mass of the body times the length of the shank. The ratio is .931 ± .007 (Winter .931, de Leva .934 and .932). For the
thigh it is .78 ± .022. Both moments are along the segments. The mass of the foot shifts the centre of pressure by only
a few millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import BaseSet
from mocap_id.dynamics.instrument_errors import Calibration

_FOOT = (1, 0.003)  # column of the full parameters, and standard deviation, m
_SEGMENTS = (
    (5, 0.0056, 1),
    (6, 0.007, 1),
    (9, 0.0064, 2),
    (10, 0.022, 2),
)  # column, standard deviation relative to the segment's length, and joint at the segment's end


@dataclass(frozen=True)
class BodyRatios:
    """Linear relations between the parameters of any person, each divided by its standard deviation."""

    rows: FloatArray  # (r, b) coefficients of the parameters
    target: FloatArray  # (r,) value of each relation
    by_cause: dict[str, FloatArray]  # effect (r,) of each error of scale on the relations
    weighed: bool  # whether the person's mass is known from a scale


def find_body_ratios(
    base: BaseSet,
    centres: FloatArray,
    reference: FloatArray,
    mass: float,
    calibration: Calibration,
    *,
    chain: tuple[FloatArray, FloatArray] | None = None,
) -> BodyRatios:
    """Return the relations between the parameters of a person.

    Parameters
    ----------
    reference : (4(n + 1),) array
        Full parameters of a reference table on the chain, which give the ratios.
    mass : float
        Identified mass, kg.
    calibration : Calibration
        Errors of the instruments, and the mass from a scale if the person was weighed.
    chain : ((4(n + 1), p) array, (4(n + 1),) array), optional
        Matrix and constant that map the fitted parameters to full parameters of the chain; by default, the base
        parameters are fitted.
    """
    usual, place = base.regrouping @ reference, {int(column): i for i, column in enumerate(base.kept)}
    matrix, constant = np.eye(len(base.kept)), np.zeros(len(base.kept))
    if chain is not None:
        matrix, constant = base.regrouping @ chain[0], base.regrouping @ chain[1]
    ratios = [(_FOOT[0], _FOOT[1], 1.0, -float(centres[0, 1]))]
    ratios += [(column, sd, float(np.linalg.norm(centres[k])), 0.0) for column, sd, k in _SEGMENTS if k < len(centres)]
    rows, target, lengths, tilt = [], [], [], []
    for column, sd, length, tilted in ratios:
        if column not in place or 0 not in place:
            continue
        own, ratio = place[column], float(usual[place[column]] / usual[place[0]])
        size = sd * length * mass
        rows.append((matrix[own] - ratio * matrix[place[0]]) / size)
        target.append(-(constant[own] - ratio * constant[place[0]]) / size)
        lengths.append(ratio * mass / size)
        tilt.append(tilted * mass / size)
    gain = np.zeros(len(rows))
    if calibration.mass is not None and 0 in place:
        rows.append(matrix[place[0]] / calibration.mass_sd)
        target.append((calibration.mass - constant[place[0]]) / calibration.mass_sd)
        gain = np.append(gain, -calibration.mass / calibration.mass_sd)
        lengths, tilt = [*lengths, 0.0], [*tilt, 0.0]
    return BodyRatios(
        rows=np.array(rows).reshape(-1, matrix.shape[1]),
        target=np.array(target),
        by_cause={"lengths": np.array(lengths), "tilt": np.array(tilt), "gain": gain},
        weighed=calibration.mass is not None and 0 in place,
    )
