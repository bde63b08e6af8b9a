"""What a reader must know of an identification before believing it."""

from __future__ import annotations

import numpy as np

from mocap_id.dynamics.base import base_names
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.optimality import PROVEN
from mocap_id.dynamics.prepare import Prepared
from mocap_id.verdict import Reason

_BOUNDED = 0.05  # of the least cost: what physical consistency may cost
_WEAK = 0.2  # of a parameter's size: its standard deviation
_MASS_APART = 0.05  # of the other one


def judge(
    prepared: Prepared, found: Identification, *, given: float | None, standing: float | None
) -> tuple[Reason, ...]:
    """Reasons for the verdict.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    given : float or None
        The subject's mass as the user gave it, kg.
    standing : float or None
        What the plates show while the person stands, kg.
    """
    reasons = (
        _clock(prepared, found),
        _cone(found),
        _solver(found),
        _bounded(found),
        _weakly_known(prepared, found),
        _load_shared(prepared, found, standing),
        _mass(prepared, found, given, standing),
    )
    return tuple(reason for reason in reasons if reason is not None)


def identified_mass(prepared: Prepared, found: Identification) -> float | None:
    """The body's mass, kg; None where Fy was not fitted, without which the wrench says nothing of it."""
    return float(found.full[::4].sum()) if 1 in prepared.settings.components else None


def weak_parameters(prepared: Prepared, found: Identification) -> tuple[str, ...]:
    """Base parameters whose standard deviation is large beside their size.

    First moments are held against (mx, my) together: mx alone may be zero. The base segment has no my; its mx is the
    weight times the centre of pressure of a straight stand, and 5 cm of that count as its least size.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = identified_mass(prepared, found) or 0.0
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


def _cone(found: Identification) -> Reason | None:
    solution = found.solution
    if solution.consistency == solution.asked:
        return None
    return Reason(
        "cone-unproven",
        f"`identify-dim: {{consistency: {solution.asked}}}` was asked for, but Clarabel's answer does not pass the "
        f"optimality check: the parameters are those of the grid (`{solution.consistency}`), whose answer "
        + ("does" if solution.answer.optimality.proven else "does not either"),
    )


def _solver(found: Identification) -> Reason | None:
    answer, other = found.solution.answer, found.solution.other
    if not answer.optimality.proven:
        return Reason(
            "solver-unproven",
            f"no solver's answer passes the optimality check; {answer.solver}'s ({answer.status}) was taken, which may "
            f"be {answer.optimality.excess:.1e} of the cost above the least one",
            value=answer.optimality.excess,
            limit=PROVEN,
        )
    if answer.solver == "nnls":
        return Reason(
            "solver-fallback",
            f"OSQP's answer ({other.status}) is {found.solution.disagreement:.1e} above the least cost; that of "
            "non-negative least squares, which passes the optimality check, was taken",
            level="ok",
        )
    if other.optimality.proven:
        return None
    return Reason(
        "solver-unconfirmed",
        f"the second solver, {other.solver} ({other.status}), does not pass the optimality check and confirms nothing; "
        f"the answer that was taken, {answer.solver}'s, passes it",
        level="ok",
    )


def _bounded(found: Identification) -> Reason | None:
    price = found.solution.price
    if price <= _BOUNDED:
        return None
    return Reason(
        "parameters-bounded",
        f"bodies that can exist fit {_times(price)} than free parameters: joints, markers or plate are off, "
        "or mass lies far outside the markers",
        value=price,
        limit=_BOUNDED,
    )


def _times(price: float) -> str:
    """How much worse a fit is."""
    return f"{100 * price:.0f} % worse" if price < 1 else f"{1 + price:.3g} times worse"


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


def _load_shared(prepared: Prepared, found: Identification, standing: float | None) -> Reason | None:
    """The mass that moves on the plates is not the one that stands on them: something else carries a part."""
    total = identified_mass(prepared, found)
    if total is None or standing is None or abs(total / standing - 1) <= _MASS_APART:
        return None
    return Reason(
        "load-shared",
        f"the movement gives a mass of {total:.1f} kg and the plates show {standing:.1f} kg while the person stands: "
        "something else than the plates carries a part of the body in samples that were identified on. If a chair is "
        "used, set `protocol: sit-to-stand`, which leaves its contact out; otherwise look for a hand on a support, or "
        "give the `window:` without it",
        value=total,
        limit=standing,
    )


def _mass(prepared: Prepared, found: Identification, given: float | None, standing: float | None) -> Reason | None:
    shown = standing if standing is not None else identified_mass(prepared, found)
    if given is None or shown is None or abs(shown / given - 1) <= _MASS_APART:
        return None
    return Reason(
        "mass-contradiction",
        f"the plates show {shown:.1f} kg and `subject: {{mass: …}}` says {given:g} kg: check the plates' calibration, "
        "what else stands on them or carries a part of the body (a chair needs `protocol: sit-to-stand`), or the mass",
        value=shown,
        limit=given,
    )
