"""Excitation of each base parameter, and cautions about an identification, from which its verdict follows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.base_parameters import base_names, unit_covariance
from mocap_id.dynamics.cone_solver import PROVEN
from mocap_id.dynamics.consistency import ConsistentSolution
from mocap_id.dynamics.fit import DEPENDENT, Fit, estimate_drift
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.instrument_errors import PlanarCalibration
from mocap_id.dynamics.preparation import AnyTrial, PreparedTrial
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.dynamics.space.identification import SpatialIdentification

Identifiability: TypeAlias = Literal["known", "weak", "not identifiable"]

# relative standard deviation above which a parameter is weak by default, also of a robot, and not identifiable
WEAK, WEAK_ROBOT, NOT_IDENTIFIABLE = 0.2, 0.05, 1.0
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
    names = base_names(prepared.base, prepared.recorded.centres)
    return classify_parameters(names, result.fit, result.base_sd, measure_sizes(prepared, result), weak)


def classify_parameters(
    names: tuple[str, ...], result: Fit, base_sd: FloatArray, size: FloatArray, weak: float = WEAK
) -> Excitation:
    """Classify the base parameters of a fit; ``base_sd`` and ``size`` (b,) are in SI units."""
    relative = base_sd / np.maximum(size, 1e-300)
    # norm (b,) of the independent part of each base column, and this norm divided by the column's norm
    rows = result.design.reshape(-1, result.design.shape[-1])
    own = 1.0 / np.sqrt(np.diag(unit_covariance(rows))[: result.base])
    share = own / np.maximum(np.linalg.norm(rows, axis=0)[: result.base], 1e-300)
    verdict: tuple[Identifiability, ...] = tuple(
        "not identifiable" if s < 1.0 / DEPENDENT else classify(r, weak) for r, s in zip(relative, share, strict=True)
    )
    return Excitation(names, verdict, size, relative, own, share, weak)


def measure_sizes(prepared: PreparedTrial, result: Identification) -> FloatArray:
    """Return the size of each base parameter (b,), SI, with which its standard deviation is compared.

    The size of a first moment is the norm of (mx, my), because mx alone may be zero. The base segment has no my, and
    its mx is the body's mass times the centre of pressure in the upright posture; its size is at least the mass times 5
    cm. The size of any other parameter is its absolute value.
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


AnyIdentification: TypeAlias = "Identification | SpatialIdentification"
OFFSET_LARGE = 0.02  # s: largest clock offset of synchronised devices
_BOUNDED = 0.05  # relative increase of the cost because of physical consistency
_MASS_APART = 0.05  # relative difference of two masses
_OFFSET_OF_DELAYS = 0.15  # s, largest offset by filters, export and a late start; only a note, because it is corrected
_DRIFT_SEEN, _DRIFT_LEAST = 5.0, 0.005  # significant change of the offset in a trial: in standard deviations, and in s
_OFFSET_SEEN, _OFFSET_LEAST = 3.0, 5e-4  # significant clock offset: in standard deviations, and in s


def find_cautions_in_space(
    trial: AnyTrial, result: AnyIdentification, excited: Excitation, recommendation: str
) -> tuple[Reason, ...]:
    """Return the cautions about clock, solver, consistency and weak parameters, in the plane or in space."""
    return (*_check_clock(trial, result), *_check_solution(result), *_check_parameters(excited, recommendation))


def find_cautions(
    prepared: PreparedTrial,
    result: Identification,
    excited: Excitation,
    recommendation: str = "",
    *,
    given: float | None,
    standing: float | None,
    calibration: PlanarCalibration | None = None,
) -> tuple[Reason, ...]:
    """Return the cautions about a trial in the plane: those of :func:`find_cautions_in_space`, and about the mass.

    ``given`` is the mass of the person from the configuration, kg, and ``standing`` the mass that the plates measure
    while the person stands, kg; None if not given or not measured. ``calibration`` are the errors of plate and scale,
    which give the allowed difference of these masses; by default those of the stage.
    """
    limits = calibration or PlanarCalibration()
    of_mass = _check_mass(get_identified_mass(prepared, result), standing, given, limits)
    return (*find_cautions_in_space(prepared, result, excited, recommendation), *of_mass)


def get_identified_mass(prepared: PreparedTrial, result: Identification) -> float | None:
    """Return the identified mass of the body, kg; None if Fy was not fitted, because only Fy determines it."""
    return float(result.full[::4].sum()) if 1 in prepared.settings.components else None


def _check_clock(prepared: AnyTrial, result: AnyIdentification) -> Iterator[Reason]:
    """Yield reasons about a clock offset that is unknown, large or left in the data, and about a drift."""
    clock, fit, limit = prepared.recorded.clock, result.fit, prepared.settings.offset_limit
    if clock.doubt is not None:
        yield Reason(
            "clock-offset-unknown",
            f"the clock offset between cameras and plate is not known: {clock.doubt}. The forces were used with an "
            f"offset of {1e3 * (clock.offset + fit.offset):+.0f} ms, and all results are right only if this is right: "
            "check that markers and forces belong to the same recording, and synchronise the clocks, or correct the "
            "times of the forces in the file",
            value=fit.total_offset,
            limit=limit,
        )
        return
    if not fit.offset_known:
        around = f" around {clock.offset:+.2f} s" if clock.offset else ""
        yield Reason(
            "clock-offset-unknown",
            f"the clock offset between cameras and plate is not within ± {limit:g} s{around}, or this movement does "
            f"not determine it (standard deviation {1e3 * result.offset_sd:.0f} ms). "
            f"{f'Only {clock.offset:+.2f} s was' if clock.offset else 'No offset was'} corrected: check that markers "
            "and forces belong to the same recording, or increase `identify-dim: {clock_offset_limit_s: …}`",
            value=fit.total_offset,
            limit=limit,
        )
        return
    # one offset is corrected for the whole trial, so it should not change
    drift, sd = estimate_drift(prepared, fit)
    time = prepared.recorded.time[fit.samples]
    seconds = float(time[-1] - time[0])
    change, most = drift * seconds, max(_DRIFT_SEEN * sd * seconds, _DRIFT_LEAST)
    if abs(change) > most:
        yield Reason(
            "clock-drift",
            f"the clock offset between cameras and plate changes by {1e3 * change:+.0f} ms during the trial "
            f"({1e3 * drift:+.2f} ± {1e3 * sd:.2f} ms/s), expected at most {1e3 * most:.0f} ms. One offset is "
            "corrected for the whole trial: the devices do not share a clock, or a frame rate is not exactly as the "
            "file says",
            value=change,
            limit=most,
        )
    if not prepared.settings.apply_offset:
        offset, seen = abs(fit.total_offset), max(_OFFSET_SEEN * result.offset_sd, _OFFSET_LEAST)
        if not offset <= seen:
            yield Reason(
                "clock-offset-kept",
                f"the clocks of cameras and plate are {1e3 * fit.total_offset:.2f} ms apart (standard deviation "
                f"{1e3 * result.offset_sd:.2f} ms), but `identify-dim: {{apply_clock_offset: false}}` prevents the "
                "correction. In a person's movement, one millisecond changes a parameter by up to a third: remove the "
                "setting, or synchronise the clocks",
                value=offset,
                limit=seen,
            )
        return
    if abs(fit.total_offset) <= OFFSET_LARGE:
        return
    board = isinstance(prepared, PreparedTrial) and len(prepared.recorded.measures) < prepared.recorded.wrench.shape[1]
    late = "late" if fit.total_offset < 0 else "early"
    yield Reason(
        "clock-offset-large",
        f"the forces come {1e3 * abs(fit.total_offset):.0f} ms too {late} in relation to the cameras (standard "
        f"deviation {1e3 * result.offset_sd:.1f} ms), expected at most {1e3 * OFFSET_LARGE:.0f} ms. This was corrected"
        + ("" if board else ", but the clocks are not synchronised: check trigger, delays and export of the plates")
        + (". At the ends of the trial, frames without force are left out" if clock.offset else ""),
        value=fit.total_offset,
        limit=OFFSET_LARGE,
        level="ok" if board or abs(fit.total_offset) <= _OFFSET_OF_DELAYS else "caution",
    )


def _check_solution(result: AnyIdentification) -> Iterator[Reason]:
    """Yield reasons about the solver, and about a wrench that possible bodies fit badly."""
    solution, answer = result.solution, result.solution.answer
    if isinstance(solution, ConsistentSolution) and solution.consistency != solution.requested:
        yield Reason(
            "cone-unproven",
            f"`identify-dim: {{consistency: {solution.requested}}}` was set, but Clarabel's solution does not pass the "
            f"optimality check; the solution on the grid (`{solution.consistency}`) is used instead, which "
            + ("passes the check" if answer.optimality.proven else "does not pass the check either"),
        )
    if not answer.optimality.proven:
        yield Reason(
            "solver-unproven",
            f"no solver's solution passes the optimality check; the solution of {answer.solver} ({answer.status}) is "
            f"used, although its cost may exceed the least cost by a fraction of {answer.optimality.excess:.1e}",
            value=answer.optimality.excess,
            limit=PROVEN,
        )
    elif answer.solver == "osqp":
        yield Reason(
            "solver-fallback",
            "the solution of non-negative least squares does not pass the optimality check; the solution of OSQP "
            "passes the check and is used",
            level="ok",
        )
    price = solution.price
    if not price <= _BOUNDED:
        worse = f"{100 * price:.0f} % worse" if price < 1 else f"{1 + price:.3g} times worse"
        yield Reason(
            "parameters-bounded",
            f"physically possible parameters fit the wrench {worse} than unconstrained parameters: check "
            "joints, markers and plate, and whether a part of the mass is far from the markers",
            value=price,
            limit=_BOUNDED,
        )


def _check_parameters(excited: Excitation, recommendation: str) -> Iterator[Reason]:
    if not (doubtful := excited.doubtful):
        return
    unknown = [excited.names[i] for i in doubtful if excited.verdict[i] == "not identifiable"]
    listed = ", ".join(f"{excited.names[i]} ({100 * excited.relative_sd[i]:.0f} %)" for i in doubtful)
    none = f"; not identifiable (above {100 * NOT_IDENTIFIABLE:.0f} %): {', '.join(unknown)}" if unknown else ""
    yield Reason(
        "parameters-weak",
        f"these base parameters have a standard deviation above {100 * excited.weak:.0f} % of their size: "
        f"{listed}{none}. " + recommendation,
        value=float(len(doubtful)),
    )


def _check_mass(
    total: float | None, standing: float | None, given: float | None, calibration: PlanarCalibration
) -> Iterator[Reason]:
    """Yield reasons if the masses from the movement, from standing and from the configuration differ."""
    # if movement and standing give different masses, something else carries weight
    if total is not None and standing is not None and not abs(total / standing - 1) <= _MASS_APART:
        unknown = ". Until then, the joint torques are unknown (NaN)" if total < standing else ""
        yield Reason(
            "load-shared",
            f"the movement gives a mass of {total:.1f} kg, but the plates measure {standing:.1f} kg while the person "
            "stands: in some of the fitted samples, something other than the plates carries a part of the body. If a "
            "chair is used, set `protocol: sit-to-stand`, which leaves its contact out; otherwise look for a hand on a "
            f"support, or exclude the contact with `window:`{unknown}",
            value=total,
            limit=standing,
        )
    measured = total if standing is None else standing
    if given is not None and measured is not None and not abs(measured / given - 1) <= calibration.mass_limit(measured):
        yield Reason(
            "mass-contradiction",
            f"the plates measure {measured:.1f} kg, but `subject: {{mass: …}}` is {given:g} kg: check the mass, the "
            "calibration of the plates, and whether anything else stands on them or carries a part of the body (a "
            "chair needs `protocol: sit-to-stand`)",
            value=measured,
            limit=given,
        )
