"""Excitation: how well a movement determines each base parameter.

The independent part of a regressor column is the part that is orthogonal to all other columns. The larger the norm of
this part, in standard deviations of the residual, the less noise affects the parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import base_names
from mocap_id.dynamics.fit import DEPENDENT, Fit
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.uncertainty import unit_covariance

Identifiability: TypeAlias = Literal["known", "weak", "not identifiable"]

WEAK = 0.2
"""Default limit of the relative standard deviation above which a parameter is weak."""
WEAK_ROBOT = 0.05
"""Default limit for robots, whose parameters should be accurate to a few per cent."""
NOT_IDENTIFIABLE = 1.0
"""Relative standard deviation above which a parameter is not identifiable."""
_LEAST_LEVER = 0.05  # m: least lever of the base's first moment


@dataclass(frozen=True)
class Excitation:
    """Accuracy of each base parameter, and how strongly the movement excites the parameter."""

    names: tuple[str, ...]  # names of the base parameters
    verdict: tuple[Identifiability, ...]  # class of each parameter
    size: FloatArray  # (b,) size of each parameter, with which its standard deviation is compared, SI
    relative_sd: FloatArray  # (b,) standard deviation divided by the size
    # (b,) norm of the part of the column that is orthogonal to all others, in standard deviations of the residual per
    # SI unit of the parameter
    own: FloatArray
    share: FloatArray  # (b,) `own` as a fraction of the norm of the whole column, 0 to 1
    weak: float = WEAK  # relative standard deviation above which a parameter is weak

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Indices of the parameters that are weak or not identifiable."""
        return tuple(i for i, verdict in enumerate(self.verdict) if verdict != "known")


def measure_excitation(prepared: PreparedTrial, result: Identification, weak: float = WEAK) -> Excitation:
    """Measure the excitation of every base parameter; a relative standard deviation above ``weak`` makes it weak."""
    size = measure_sizes(prepared, result)
    return classify_parameters(
        base_names(prepared.base, prepared.recorded.centres), result.fit, result.base_sd, size, weak
    )


def classify_parameters(
    names: tuple[str, ...], result: Fit, base_sd: FloatArray, size: FloatArray, weak: float = WEAK
) -> Excitation:
    """Classify the base parameters of a fit; ``base_sd`` and ``size`` (b,) are standard deviations and sizes, SI."""
    relative = base_sd / np.maximum(size, 1e-300)
    own, share = _measure_own_parts(result.design, result.base)
    return Excitation(
        names=names,
        verdict=tuple(
            "not identifiable" if s < 1.0 / DEPENDENT else classify(r, weak)
            for r, s in zip(relative, share, strict=True)
        ),
        size=size,
        relative_sd=relative,
        own=own,
        share=share,
        weak=weak,
    )


def measure_sizes(prepared: PreparedTrial, result: Identification) -> FloatArray:
    """Return the size of each base parameter (b,), SI, with which its standard deviation is compared.

    The size of a first moment is the norm of (mx, my), because mx alone may be zero. The base segment has no my, and
    its mx is the body's mass times the centre of pressure in the upright posture. The size of this mx is at least the
    mass times 5 cm. The size of any other parameter is its absolute value.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = float(result.full[::4].sum()) if 1 in prepared.settings.components else 0.0
    size = np.abs(result.base)
    for i in np.flatnonzero((kind == 1) | (kind == 2)):
        pair = result.base[(segment == segment[i]) & ((kind == 1) | (kind == 2))]
        size[i] = np.linalg.norm(pair) if segment[i] else max(size[i], _LEAST_LEVER * mass)
    return np.asarray(size)


def classify(relative_sd: float, weak: float = WEAK) -> Identifiability:
    """Return the class of a parameter; a relative standard deviation above ``weak``, up to 1, makes it weak."""
    if not np.isfinite(relative_sd) or relative_sd > NOT_IDENTIFIABLE:
        return "not identifiable"
    return "weak" if relative_sd > weak else "known"


def _measure_own_parts(design: FloatArray, base: int) -> tuple[FloatArray, FloatArray]:
    """Return the norm (b,) of the independent part of each base column, and this norm divided by the column's norm."""
    rows = design.reshape(-1, design.shape[-1])
    own = 1.0 / np.sqrt(np.diag(unit_covariance(rows))[:base])
    return own, own / np.maximum(np.linalg.norm(rows, axis=0)[:base], 1e-300)
