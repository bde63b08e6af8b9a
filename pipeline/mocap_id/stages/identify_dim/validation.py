"""What a trial's repetitions, predicted by models that did not see them, say of its model: facts, columns, reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.folds import parts
from mocap_id.dynamics.held_out import HeldOut, hold_out
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.predict import Agreement, agreement
from mocap_id.dynamics.prepare import Prepared
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.repetitions import Repetition
from mocap_id.verdict import Reason

SERIES = (*WRENCH_COMPONENTS, "cop_x")
"""What is compared, in the order of the columns of `dynamics.parquet`."""
_JUDGED = ("Fy", "tauz", "cop_x")
_FAR = 1.5  # times the error within the fit: what fewer than three independent observations a parameter would give
_NORMAL = 1.96  # standard deviations that hold 95 % of a normal distribution
_NOTICEABLE = 1e-4  # of the measured variance: with less the model is as good as exact, far or not


@dataclass(frozen=True)
class Validation:
    """A trial's model beside models that were fitted without the repetition in question.

    Parameters
    ----------
    repetitions : int
    held_out : HeldOut or None
        None where nothing could be left out.
    why : str or None
        Why not.
    """

    repetitions: int
    held_out: HeldOut | None
    why: str | None


def validate(prepared: Prepared, movement: Movement, found: Identification, model: FloatArray) -> Validation:
    """Leave each repetition out in turn and predict it.

    Parameters
    ----------
    prepared : Prepared
    movement : Movement
    found : Identification
    model : (T, 3) array
        Wrench of the whole fit's model; what it does not tell, NaN throughout, the others do not either.
    """
    found_spans = spans(movement)
    if len(found_spans) < 2:
        many = "no repetition was found" if not found_spans else "only one repetition was found"
        return Validation(len(found_spans), None, f"{many}, and at least two are needed to predict one from the others")
    part = parts(prepared.recorded.time, np.array(found_spans))
    held = hold_out(prepared, movement.free, found.fit, part, found.refit)
    if held is None:
        why = "whichever repetitions are left out, the others do not determine the parameters"
        return Validation(len(found_spans), None, why)
    told = np.isfinite(model).any(axis=0)
    return Validation(len(found_spans), replace(held, wrench=np.where(told, held.wrench, np.nan)), None)


def facts(
    validation: Validation,
    model: FloatArray,
    reference: FloatArray,
    measured: FloatArray,
    threshold: float,
    *,
    filtered: bool = False,
) -> dict[str, Any]:
    """Errors on held-out repetitions, beside those of the whole fit and of the reference on the same samples.

    Parameters
    ----------
    validation : Validation
    model, reference, measured : (T, 3) arrays
        N and N·m; the measured wrench at the whole fit's clock and less its plate bias.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    filtered : bool
        These arrays went through the fit's low-pass, and so do the predictions; ``unfiltered`` is then added.
    """
    held = validation.held_out
    if held is None:
        nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s", "inside"))
        return {"repetitions": validation.repetitions, **nothing, "why": validation.why}

    def compared(wrench: FloatArray, with_: FloatArray) -> dict[str, Any]:
        errors = _errors(wrench, with_, held.samples, threshold)
        return {name: None if error is None else asdict(error) for name, error in errors.items()}

    predicted = (held.filtered, held.filtered_measured) if filtered else (held.wrench, held.measured)
    return {
        "repetitions": validation.repetitions,
        "folds": len(held.base),
        "samples": int(held.samples.sum()),
        "model": compared(*predicted),
        "unfiltered": compared(held.wrench, held.measured) if filtered else None,
        "in_sample": compared(model, measured),
        "reference": compared(reference, measured) if np.isfinite(reference[held.samples]).any() else None,
        "clock_offset_s": held.offset.tolist(),
        "inside": _inside(held, threshold) if filtered else None,
        "why": None,
    }


def _inside(held: HeldOut, threshold: float) -> dict[str, float] | None:
    """Share of the left-out samples inside 95 % intervals whose size comes from the other repetitions."""
    off = held.filtered - held.filtered_measured
    cop = centre_of_pressure(held.filtered, threshold) - centre_of_pressure(held.filtered_measured, threshold)
    series = np.column_stack([off, cop])
    within = np.full(series.shape, np.nan)
    for k in np.unique(held.part[held.samples]):
        own, others = held.samples & (held.part == k), held.samples & (held.part != k)
        if others.any():
            sd = np.sqrt(np.nanmean(series[others] ** 2, axis=0))
            within[own] = np.where(np.isfinite(series[own]), np.abs(series[own]) <= _NORMAL * sd, np.nan)
    if np.isnan(within).all():
        return None
    return dict(zip(SERIES, np.nanmean(within, axis=0).tolist(), strict=True))


def wrench(validation: Validation, samples: int) -> FloatArray:
    """The predictions (T, 3) for `dynamics.parquet`; NaN where there are none."""
    held = validation.held_out
    return np.full((samples, 3), np.nan) if held is None else held.wrench


def data(validation: Validation, base: int) -> dict[str, FloatArray]:
    """The folds' parameters for `dynamics.h5`; no rows where there are none."""
    held = validation.held_out
    if held is None:
        return {"base": np.zeros((0, base)), "clock_offset": np.zeros(0)}
    return {"base": held.base, "clock_offset": held.offset}


def reasons(found: Mapping[str, Any]) -> tuple[Reason, ...]:
    """What the facts of :func:`facts` say against the model."""
    if found["model"] is None:
        return ()
    own, within, table = ({k: _rms(found[name], k) for k in SERIES} for name in ("model", "in_sample", "reference"))
    worse = {k: own[k] / table[k] for k in _JUDGED if own[k] > table[k]}
    noticeable = [k for k in SERIES if found["model"][k] is not None and found["model"][k]["r2"] < 1 - _NOTICEABLE]
    far = {k: own[k] / within[k] for k in noticeable if own[k] > _FAR * within[k] > 0.0}
    out = []
    if worse:
        out.append(
            Reason(
                "held-out-worse",
                "repetitions that the model was not fitted to are predicted no better than by the body from tables, "
                f"which knows height and mass alone: the error is {_times(worse)} the table's. This recording does not "
                "support an individual model of these: markers, joints or limbs that move by themselves leave more "
                "error than the individual differs from the table",
                value=max(worse.values()),
                limit=1.0,
            )
        )
    if far:
        out.append(
            Reason(
                "held-out-far",
                f"repetitions that the model was not fitted to are predicted much worse than those that it was: "
                f"{_times(far)} the error within the fit. The parameters follow what is particular to each repetition",
                value=max(far.values()),
                limit=_FAR,
            )
        )
    return tuple(out)


def spans(movement: Movement) -> list[tuple[float, float]]:
    """First and last event of every repetition that has any, s."""
    return [span for span in map(_span, movement.repetitions) if span is not None]


def _span(repetition: Repetition) -> tuple[float, float] | None:
    """First and last event of a repetition, s; None where it has no known one."""
    events = (repetition.start, repetition.seat_off, repetition.stand, repetition.seat_on, repetition.end)
    known = [time for time in events if np.isfinite(time)]
    return (min(known), max(known)) if known else None


def _errors(
    model: FloatArray, measured: FloatArray, samples: BoolArray, threshold: float
) -> dict[str, Agreement | None]:
    pressures = centre_of_pressure(model, threshold), centre_of_pressure(measured, threshold)
    pairs = [*zip(model.T, measured.T, strict=True), pressures]
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _rms(errors: Mapping[str, Any] | None, name: str) -> float:
    """NaN where it is unknown: comparisons with it are false."""
    error = None if errors is None else errors[name]
    return float("nan") if error is None else float(np.hypot(error["bias"], error["sd"]))


def _times(ratios: Mapping[str, float]) -> str:
    words = {"cop_x": "the centre of pressure"}
    return ", ".join(f"{ratio:.2f} times (of {words.get(name, name)})" for name, ratio in ratios.items())
