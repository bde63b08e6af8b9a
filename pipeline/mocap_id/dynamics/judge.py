"""What a reader must know of an identification before believing it."""

from __future__ import annotations

from collections.abc import Sequence

from mocap_id.dynamics.excitation import LOST, Advice, Excitation
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.optimality import PROVEN
from mocap_id.dynamics.prepare import Prepared
from mocap_id.verdict import Reason

_BOUNDED = 0.05  # of the least cost: what physical consistency may cost
_MASS_APART = 0.05  # of the other one
_OFFSET_SEEN, _OFFSET_LEAST = 3.0, 5e-4  # standard deviations; s


def judge(
    prepared: Prepared,
    found: Identification,
    told: Excitation,
    *,
    given: float | None,
    standing: float | None,
    joints: Sequence[str] = (),
) -> tuple[Reason, ...]:
    """Reasons for the verdict.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    told : Excitation
        What is known of each base parameter.
    given : float or None
        The subject's mass as the user gave it, kg.
    standing : float or None
        What the plates show while the person stands, kg.
    joints : sequence of str
        Their names; numbers where none are given.
    """
    names = tuple(joints) or tuple(f"joint {j}" for j in range(1, prepared.recorded.q.shape[1] + 1))
    reasons = (
        _clock(prepared, found),
        _cone(found),
        _solver(found),
        _bounded(found),
        _weakly_known(told, names),
        _load_shared(prepared, found, standing),
        _mass(prepared, found, given, standing),
    )
    return tuple(reason for reason in reasons if reason is not None)


def identified_mass(prepared: Prepared, found: Identification) -> float | None:
    """The body's mass, kg; None where Fy was not fitted, without which the wrench says nothing of it."""
    return float(found.full[::4].sum()) if 1 in prepared.settings.components else None


def _clock(prepared: Prepared, found: Identification) -> Reason | None:
    if found.fit.offset_known:
        return None if prepared.settings.apply_offset else _kept(found)
    limit = prepared.settings.offset_limit
    return Reason(
        "clock-offset-unknown",
        f"the clock offset between cameras and plate is not within ± {limit:g} s, or this movement does not show it "
        f"(standard deviation {1e3 * found.offset_sd:.0f} ms); it was taken as zero: check that markers and forces "
        "belong together, or widen `identify-dim: {clock_offset_limit_s: …}`",
        value=found.fit.found,
        limit=limit,
    )


def _kept(found: Identification) -> Reason | None:
    """A clock offset that was found and, as the settings ask, left in."""
    offset, limit = abs(found.fit.found), max(_OFFSET_SEEN * found.offset_sd, _OFFSET_LEAST)
    if offset <= limit:
        return None
    return Reason(
        "clock-offset-kept",
        f"cameras and plate are {1e3 * found.fit.found:.2f} ms apart (standard deviation {1e3 * found.offset_sd:.2f}), "
        "and `identify-dim: {apply_clock_offset: false}` leaves that in: on a person's movement one millisecond moves "
        "a parameter by up to a third; leave the setting away, or mend the clocks",
        value=offset,
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
    answer = found.solution.answer
    if not answer.optimality.proven:
        return Reason(
            "solver-unproven",
            f"no solver's answer passes the optimality check; {answer.solver}'s ({answer.status}) was taken, which may "
            f"be {answer.optimality.excess:.1e} of the cost above the least one",
            value=answer.optimality.excess,
            limit=PROVEN,
        )
    if answer.solver != "osqp":
        return None
    return Reason(
        "solver-fallback",
        "non-negative least squares' answer does not pass the optimality check; OSQP's, which passes it, was taken",
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


def _weakly_known(told: Excitation, joints: Sequence[str]) -> Reason | None:
    """The parameters that are not known, with the movement that would tell most of each."""
    doubtful = told.doubtful
    if not doubtful:
        return None
    lost = [told.names[i] for i in doubtful if told.verdict[i] == "not identifiable"]
    listed = ", ".join(f"{told.names[i]} ({100 * told.relative_sd[i]:.0f} %)" for i in doubtful)
    none = f"; not identifiable, above {100 * LOST:.0f} %: {', '.join(lost)}" if lost else ""
    return Reason(
        "parameters-weak",
        f"weakly known, with a standard deviation above {100 * told.weak:.0f} % of their size: {listed}{none}. "
        + " ".join(_recommended(told, doubtful, joints)),
        value=float(len(doubtful)),
    )


def _recommended(told: Excitation, doubtful: Sequence[int], joints: Sequence[str]) -> list[str]:
    """A sentence for each movement that is the best one for some of the parameters."""
    best: dict[tuple[str, int | None], list[tuple[int, Advice]]] = {}
    for i in doubtful:
        advice = told.advice[i]
        if advice is not None:
            best.setdefault((advice.change, advice.joint), []).append((i, advice))
    found = [
        f"{_capital(group[0][1].said(joints))} would take "
        + ", ".join(f"{told.names[i]} to {100 * advice.ratio * told.relative_sd[i]:.0f} %" for i, advice in group)
        + "."
        for group in best.values()
    ]
    beyond = [told.names[i] for i in doubtful if told.advice[i] is None]
    if beyond:
        found.append(
            f"No other movement of these joints would tell more of {', '.join(beyond)}: what limits them is the "
            "plate's zero, or joints and skin."
        )
    return found


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


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
