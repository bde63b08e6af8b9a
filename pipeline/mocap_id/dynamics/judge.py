"""What a reader must know of an identification before believing it."""

from __future__ import annotations

import numpy as np

from mocap_id.dynamics.base import base_names
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.prepare import Prepared
from mocap_id.verdict import Reason

_BOUNDED = 0.05  # of the least cost: what physical consistency may cost
_WEAK = 0.2  # of a parameter's size: its standard deviation
_MASS_APART = 0.05


def judge(prepared: Prepared, found: Identification, given_mass: float | None) -> tuple[Reason, ...]:
    """Reasons for the verdict.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    given_mass : float or None
        The subject's mass as the user gave it, kg.
    """
    reasons = (
        _clock(prepared, found),
        _solver(found),
        _bounded(found),
        _weakly_known(prepared, found),
        _mass(found, given_mass),
    )
    return tuple(reason for reason in reasons if reason is not None)


def weak_parameters(prepared: Prepared, found: Identification) -> tuple[str, ...]:
    """Base parameters whose standard deviation is large beside their size.

    First moments are held against (mx, my) together: mx alone may be zero. The base segment has no my; its mx is the
    weight times the centre of pressure of a straight stand, and 5 cm of that count as its least size.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = float(found.full[::4].sum())
    weak = []
    for i, name in enumerate(base_names(prepared.base, prepared.recorded.centres)):
        size = abs(float(found.base[i]))
        if kind[i] in (1, 2):
            pair = found.base[(segment == segment[i]) & ((kind == 1) | (kind == 2))]
            size = float(np.linalg.norm(pair)) if segment[i] else max(size, 0.05 * mass)
        if found.base_sd[i] > _WEAK * size:
            weak.append(name)
    return tuple(weak)


def _clock(prepared: Prepared, found: Identification) -> Reason | None:
    if found.fit.offset_known:
        return None
    limit = prepared.settings.offset_limit
    return Reason(
        "clock-offset-unknown",
        f"the clock offset between cameras and plate is not within ± {limit:g} s, or this movement does not show it "
        f"(standard deviation {1e3 * found.offset_sd:.0f} ms); it was taken as zero: check that markers and forces "
        "belong together, or widen `identify-dim: {clock_offset_limit_s: …}`",
        value=found.fit.found,
        limit=limit,
    )


def _solver(found: Identification) -> Reason | None:
    if found.solution.solver == "osqp":
        return None
    return Reason(
        "solver-fallback",
        f"OSQP's answer ({found.solution.status}) is {found.solution.disagreement:.1e} above the least cost; that of "
        "non-negative least squares, which passes the optimality check, was taken",
        level="ok",
    )


def _bounded(found: Identification) -> Reason | None:
    price = found.solution.price
    if price <= _BOUNDED:
        return None
    return Reason(
        "parameters-bounded",
        f"bodies that can exist fit {100 * price:.0f} % worse than free parameters: joints, markers or plate are off, "
        "or mass lies far outside the markers",
        value=price,
        limit=_BOUNDED,
    )


def _weakly_known(prepared: Prepared, found: Identification) -> Reason | None:
    weak = weak_parameters(prepared, found)
    if not weak:
        return None
    return Reason(
        "parameters-weak",
        f"weakly known, with a standard deviation above {100 * _WEAK:.0f} % of their size: {', '.join(weak)}; a faster "
        "and larger movement of those segments would tell more",
        value=float(len(weak)),
    )


def _mass(found: Identification, given: float | None) -> Reason | None:
    total = float(found.full[::4].sum())
    if given is None or abs(total / given - 1) <= _MASS_APART:
        return None
    return Reason(
        "mass-contradiction",
        f"the plates show {total:.1f} kg and `subject: {{mass: …}}` says {given:g} kg: check the plates' calibration, "
        "what else stands on them, or the mass",
        value=total,
        limit=given,
    )
