"""Cautions about an identification: the reasons that its verdict is made of."""

from __future__ import annotations

from typing import Protocol

from mocap_id.dynamics.calibration import Calibration
from mocap_id.dynamics.excitation import LOST, Excitation
from mocap_id.dynamics.filtered_trial import FilteredTrial
from mocap_id.dynamics.fit import Fit
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.optimality import PROVEN, SolverAnswer
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.verdict import Reason

_BOUNDED = 0.05  # relative increase of the cost by physical consistency
_MASS_APART = 0.05  # relative difference of two masses
_OFFSET_SEEN, _OFFSET_LEAST = 3.0, 5e-4  # standard deviations; s


class CheckedSolution(Protocol):
    """A solution among possible bodies, with the solver's report."""

    @property
    def answer(self) -> SolverAnswer: ...

    @property
    def price(self) -> float: ...


class FittedModel(Protocol):
    """An identification in the plane or in space."""

    @property
    def fit(self) -> Fit: ...

    @property
    def offset_sd(self) -> float: ...

    @property
    def solution(self) -> CheckedSolution: ...


def find_cautions_in_space(
    trial: FilteredTrial, found: FittedModel, excited: Excitation, recommendation: str
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict of a trial in space: clock, solver, consistency and weak parameters.

    Parameters
    ----------
    trial : FilteredTrial
    found : FittedModel
    excited : Excitation
    recommendation : str
        Sentence on the movement that would determine the weak parameters better.
    """
    reasons = (_clock(trial, found), _solver(found), _bounded(found), _weakly_known(excited, recommendation))
    return tuple(reason for reason in reasons if reason is not None)


def find_cautions(
    prepared: PreparedTrial,
    found: Identification,
    excited: Excitation,
    recommendation: str = "",
    *,
    given: float | None,
    standing: float | None,
    calibration: Calibration | None = None,
) -> tuple[Reason, ...]:
    """Return the reasons for the verdict.

    Parameters
    ----------
    prepared : PreparedTrial
    found : Identification
    excited : Excitation
        How well each base parameter is known.
    recommendation : str
        Sentences on the movements that would determine the weak parameters better.
    given : float or None
        The subject's mass as given by the user, kg.
    standing : float or None
        The mass that the plates measure while the person stands, kg.
    calibration : Calibration, optional
        Errors of plate and scale, which limit the difference of these masses; by default those of the stage.
    """
    reasons = (
        _clock(prepared, found),
        _cone(found),
        _solver(found),
        _bounded(found),
        _weakly_known(excited, recommendation),
        _load_shared(prepared, found, standing),
        _mass(prepared, found, given, standing, calibration or Calibration()),
    )
    return tuple(reason for reason in reasons if reason is not None)


def identified_mass(prepared: PreparedTrial, found: Identification) -> float | None:
    """Return the body's mass, kg; None if Fy was not fitted, since no other component determines it."""
    return float(found.full[::4].sum()) if 1 in prepared.settings.components else None


def _clock(prepared: FilteredTrial, found: FittedModel) -> Reason | None:
    if found.fit.offset_known:
        return None if prepared.settings.apply_offset else _offset_kept(found)
    limit = prepared.settings.offset_limit
    return Reason(
        "clock-offset-unknown",
        f"the clock offset between cameras and plate is not within ± {limit:g} s, or this movement does not determine "
        f"it (standard deviation {1e3 * found.offset_sd:.0f} ms); it was taken as zero: check that markers and forces "
        "belong together, or widen `identify-dim: {clock_offset_limit_s: …}`",
        value=found.fit.found,
        limit=limit,
    )


def _offset_kept(found: FittedModel) -> Reason | None:
    """Return a caution if the settings leave a significant clock offset uncorrected."""
    offset, limit = abs(found.fit.found), max(_OFFSET_SEEN * found.offset_sd, _OFFSET_LEAST)
    if offset <= limit:
        return None
    return Reason(
        "clock-offset-kept",
        f"cameras and plate are {1e3 * found.fit.found:.2f} ms apart (standard deviation {1e3 * found.offset_sd:.2f}), "
        "and `identify-dim: {apply_clock_offset: false}` leaves the offset uncorrected: in a person's movement, one "
        "millisecond changes a parameter by up to a third; remove the setting, or synchronise the clocks",
        value=offset,
        limit=limit,
    )


def _cone(found: Identification) -> Reason | None:
    solution = found.solution
    if solution.consistency == solution.requested:
        return None
    return Reason(
        "cone-unproven",
        f"`identify-dim: {{consistency: {solution.requested}}}` was set, but Clarabel's solution does not pass the "
        f"optimality check: the parameters are those of the grid (`{solution.consistency}`), whose solution "
        + ("passes" if solution.answer.optimality.proven else "does not pass either"),
    )


def _solver(found: FittedModel) -> Reason | None:
    answer = found.solution.answer
    if not answer.optimality.proven:
        return Reason(
            "solver-unproven",
            f"no solver's solution passes the optimality check; that of {answer.solver} ({answer.status}) was taken; "
            f"its cost may exceed the least one by a fraction of {answer.optimality.excess:.1e}",
            value=answer.optimality.excess,
            limit=PROVEN,
        )
    if answer.solver != "osqp":
        return None
    return Reason(
        "solver-fallback",
        "the solution of non-negative least squares does not pass the optimality check; OSQP's, which passes it, was "
        "taken",
        level="ok",
    )


def _bounded(found: FittedModel) -> Reason | None:
    price = found.solution.price
    if price <= _BOUNDED:
        return None
    return Reason(
        "parameters-bounded",
        f"physically possible bodies fit {_times(price)} than free parameters: joints, markers or plate are wrong, "
        "or mass lies far outside the markers",
        value=price,
        limit=_BOUNDED,
    )


def _times(price: float) -> str:
    return f"{100 * price:.0f} % worse" if price < 1 else f"{1 + price:.3g} times worse"


def _weakly_known(excited: Excitation, recommendation: str) -> Reason | None:
    doubtful = excited.doubtful
    if not doubtful:
        return None
    lost = [excited.names[i] for i in doubtful if excited.verdict[i] == "not identifiable"]
    listed = ", ".join(f"{excited.names[i]} ({100 * excited.relative_sd[i]:.0f} %)" for i in doubtful)
    none = f"; not identifiable, above {100 * LOST:.0f} %: {', '.join(lost)}" if lost else ""
    return Reason(
        "parameters-weak",
        f"weakly known, with a standard deviation above {100 * excited.weak:.0f} % of their size: {listed}{none}. "
        + recommendation,
        value=float(len(doubtful)),
    )


def _load_shared(prepared: PreparedTrial, found: Identification, standing: float | None) -> Reason | None:
    """Return a caution if the identified and the standing mass differ: something else carries a part of the body."""
    total = identified_mass(prepared, found)
    if total is None or standing is None or abs(total / standing - 1) <= _MASS_APART:
        return None
    return Reason(
        "load-shared",
        f"the movement gives a mass of {total:.1f} kg, but the plates measure {standing:.1f} kg while the person "
        "stands: in some of the fitted samples, something other than the plates carries a part of the body. If a "
        "chair is used, set `protocol: sit-to-stand`, which leaves its contact out; otherwise look for a hand on a "
        "support, or exclude the contact with `window:`",
        value=total,
        limit=standing,
    )


def _mass(
    prepared: PreparedTrial,
    found: Identification,
    given: float | None,
    standing: float | None,
    calibration: Calibration,
) -> Reason | None:
    shown = standing if standing is not None else identified_mass(prepared, found)
    if given is None or shown is None or abs(shown / given - 1) <= calibration.mass_limit(shown):
        return None
    return Reason(
        "mass-contradiction",
        f"the plates measure {shown:.1f} kg and `subject: {{mass: …}}` says {given:g} kg: check the plates' "
        "calibration, what else stands on them or carries a part of the body (a chair needs `protocol: sit-to-stand`), "
        "or the mass",
        value=shown,
        limit=given,
    )
