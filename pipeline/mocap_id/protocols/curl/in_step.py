"""The part of an angle that moves in step with the flexion of the elbow, the same in every curl.

An axis of the elbow that errs by (d_x, d_y) turns the upper arm about its y axis by d_y Δsin(flexion) + d_x
Δcos(flexion) from one flexion to another. Skin that slides with the flexion does nearly the same, and so does a person
who turns the upper arm in every curl: no motion tells them apart. The part in the first curl is therefore stated
separately, and the compensation is the motion beyond this part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import NORMAL_95, FloatArray
from mocap_id.protocols.curl.repetitions import Curl

_VARIES = 0.25  # of the uncertainty of a change of the angle: the share that does not return in every curl


@dataclass(frozen=True)
class InStep:
    """What an angle does in step with the flexion, from the first complete curl in which it is known.

    Parameters
    ----------
    curve : (T,) array
        The part in step with the flexion at all times, up to a constant, rad.
    range : float
        Highest minus lowest value of the curve within this curl, rad.
    interval : (float, float)
        95 % interval of the person's own part of it, rad; the lower end is not negative.
    rest_sd : (T,) array
        Standard deviation of the changes of the angle without the curve, rad.
    """

    curve: FloatArray
    range: float
    interval: tuple[float, float]
    rest_sd: FloatArray


def part_in_step(  # noqa: PLR0917
    time: FloatArray,
    angle: FloatArray,
    sd: FloatArray,
    flexion: FloatArray,
    axis: FloatArray | None,
    curls: Sequence[Curl],
) -> InStep | None:
    """Fit the part of an angle that depends on the flexion alone; None if the angle is known in no complete curl.

    Parameters
    ----------
    time, angle, sd, flexion : (T,) arrays
        s; the angle, the standard deviation of its changes and the flexion, rad, NaN where unknown.
    axis : (2, 2) array or None
        Covariance of the elbow's axis along x and y of the upper arm, rad²; None if it is unknown.
    curls : sequence of Curl
    """
    spans = (slice(*np.searchsorted(time, [curl.start, curl.end])) for curl in curls if curl.complete)
    basis = np.stack([np.cos(flexion), np.sin(flexion)], axis=1)
    known = np.isfinite(angle) & np.isfinite(flexion)
    first = next((span for span in spans if span.stop - span.start > basis.shape[1] and known[span].all()), None)
    if first is None:
        return None
    middle = basis[first].mean(axis=0)
    shape, *_ = np.linalg.lstsq(basis[first] - middle, angle[first] - angle[first].mean(), rcond=None)
    curve = basis @ shape
    left = float(np.std(angle[first] - curve[first]))
    size = float(np.ptp(curve[first]))
    half = NORMAL_95 * (np.sqrt(2 * np.mean(sd[first] ** 2)) if axis is None else _largest(basis[first], axis))
    rest = np.sqrt(left**2 + (_VARIES * sd) ** 2 / 2)
    return InStep(curve, size, (max(size - float(half), 0.0), size + float(half)), rest)


def _largest(basis: FloatArray, axis: FloatArray) -> float:
    """Return the largest standard deviation, over a curl, of the turn that an error of the axis makes, rad."""
    lowest = int(np.argmax(basis[:, 0]))  # the most extended sample
    turned = basis - basis[lowest]
    return float(np.sqrt(np.einsum("ti,ij,tj->t", turned, axis, turned).max()))
