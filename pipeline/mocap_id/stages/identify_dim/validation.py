"""Cross-validation over the repetitions of a trial: columns, facts and reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.dynamics.comparison import Agreement, agreement, centre_of_pressure
from mocap_id.dynamics.cross_validation import LeftOutPrediction, predict_left_out
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.preparation import PreparedTrial
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.dynamics.sample_choice import number_parts, shorten_rests
from mocap_id.protocols.movement import Movement
from mocap_id.protocols.repetitions import Repetition
from mocap_id.verdict import Reason

SERIES = (*WRENCH_COMPONENTS, "cop_x")
"""Compared quantities, in the order of the columns of `dynamics.parquet`."""
_JUDGED = ("Fy", "tauz", "cop_x")
_FAR = 1.5  # times the error within the fit; expected with fewer than three independent observations a parameter
_NOTICEABLE = 1e-4  # share of the measured variance; with a smaller error the model is practically exact


@dataclass(frozen=True)
class Validation:
    """Predictions of each repetition by models that were fitted without it.

    Parameters
    ----------
    repetitions : int
    held_out : LeftOutPrediction or None
        None if no repetition could be left out.
    why : str or None
        Reason in that case.
    """

    repetitions: int
    held_out: LeftOutPrediction | None
    why: str | None


def validate(prepared: PreparedTrial, movement: Movement, found: Identification, model: FloatArray) -> Validation:
    """Leave each repetition out in turn and predict it.

    Parameters
    ----------
    prepared : PreparedTrial
    movement : Movement
    found : Identification
    model : (T, 3) array
        Wrench of the model of the whole fit; a component that is NaN throughout is not predicted.
    """
    found_spans = spans(movement)
    if len(found_spans) < 2:
        many = "no repetition was found" if not found_spans else "only one repetition was found"
        return Validation(len(found_spans), None, f"{many}, and at least two are needed to predict one from the others")
    part = number_parts(prepared.recorded.time, np.array(found_spans))
    left_out = predict_left_out(prepared, movement.free, found.fit, part, found.refit)
    if left_out is None:
        why = "no subset of the repetitions determines the parameters"
        return Validation(len(found_spans), None, why)
    determined, samples = np.isfinite(model).any(axis=0), left_out.samples.copy()
    judged = np.flatnonzero(samples)
    samples[judged[~shorten_rests(prepared.recorded.dq[judged])]] = False
    predicted = np.where(determined, left_out.wrench, np.nan)
    return Validation(len(found_spans), replace(left_out, samples=samples, wrench=predicted), None)


def facts(
    validation: Validation,
    model: FloatArray,
    reference: FloatArray,
    measured: FloatArray,
    threshold: float,
    *,
    filtered: bool = False,
) -> dict[str, Any]:
    """Return errors on left-out repetitions, and those of the whole fit and the reference on the same samples.

    Parameters
    ----------
    validation : Validation
    model, reference, measured : (T, 3) arrays
        N and N·m; the measured wrench with clock offset and plate bias of the whole fit corrected.
    threshold : float
        Vertical force up to which there is no centre of pressure, N.
    filtered : bool
        The arrays are filtered by the fit's low-pass; the predictions are too, and ``unfiltered`` is added.
    """
    left_out = validation.held_out
    if left_out is None:
        nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s", "inside"))
        return {"repetitions": validation.repetitions, **nothing, "why": validation.why}

    def compared(wrench: FloatArray, with_: FloatArray) -> dict[str, Any]:
        errors = _errors(wrench, with_, left_out.samples, threshold)
        return {name: None if error is None else asdict(error) for name, error in errors.items()}

    predicted = (left_out.filtered, left_out.filtered_measured) if filtered else (left_out.wrench, left_out.measured)
    return {
        "repetitions": validation.repetitions,
        "folds": len(left_out.base),
        "samples": int(left_out.samples.sum()),
        "model": compared(*predicted),
        "unfiltered": compared(left_out.wrench, left_out.measured) if filtered else None,
        "in_sample": compared(model, measured),
        "reference": compared(reference, measured) if np.isfinite(reference[left_out.samples]).any() else None,
        "clock_offset_s": left_out.offset.tolist(),
        "inside": _inside(left_out, threshold) if filtered else None,
        "why": None,
    }


def _inside(left_out: LeftOutPrediction, threshold: float) -> dict[str, float] | None:
    """Return the share of left-out samples inside 95 % intervals whose size comes from the other repetitions."""
    off = left_out.filtered - left_out.filtered_measured
    cop = centre_of_pressure(left_out.filtered, threshold) - centre_of_pressure(left_out.filtered_measured, threshold)
    series = np.column_stack([off, cop])
    seen = [k for k in range(series.shape[1]) if np.isfinite(series[left_out.samples, k]).any()]
    series = series[:, seen]
    within = np.full(series.shape, np.nan)
    for k in np.unique(left_out.part[left_out.samples]):
        own, others = left_out.samples & (left_out.part == k), left_out.samples & (left_out.part != k)
        if others.any():
            sd = np.sqrt(np.nanmean(series[others] ** 2, axis=0))
            within[own] = np.where(np.isfinite(series[own]), np.abs(series[own]) <= NORMAL_95 * sd, np.nan)
    if np.isnan(within).all():
        return None
    return dict(zip([SERIES[k] for k in seen], np.nanmean(within, axis=0).tolist(), strict=True))


def wrench(validation: Validation, samples: int) -> FloatArray:
    """Return the predictions (T, 3) for `dynamics.parquet`; NaN where there are none."""
    left_out = validation.held_out
    return np.full((samples, 3), np.nan) if left_out is None else left_out.wrench


def data(validation: Validation, base: int) -> dict[str, FloatArray]:
    """Return the parameters of the folds for `dynamics.h5`; no rows without folds."""
    left_out = validation.held_out
    if left_out is None:
        return {"base": np.zeros((0, base)), "clock_offset": np.zeros(0)}
    return {"base": left_out.base, "clock_offset": left_out.offset}


def reasons(found: Mapping[str, Any]) -> tuple[Reason, ...]:
    """Return cautions about the model, from the facts of :func:`facts`."""
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
                "left-out repetitions are predicted no better than by the reference body, made from height and mass: "
                f"the error relative to that of the reference is {_times(worse)}. This recording does not support an "
                "individual model of these quantities: marker errors, loose joints or unmodelled limbs cause larger "
                "errors than the difference between the person and the reference",
                value=max(worse.values()),
                limit=1.0,
            )
        )
    if far:
        out.append(
            Reason(
                "held-out-far",
                f"left-out repetitions are predicted much worse than fitted ones: the error relative to that within "
                f"the fit is {_times(far)}. The parameters depend on peculiarities of single repetitions",
                value=max(far.values()),
                limit=_FAR,
            )
        )
    return tuple(out)


def spans(movement: Movement) -> list[tuple[float, float]]:
    """Return first and last event of every repetition that has any, s."""
    return [span for span in map(_span, movement.repetitions) if span is not None]


def _span(repetition: Repetition) -> tuple[float, float] | None:
    """Return first and last event of a repetition, s; None without a known event."""
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
    """Return the rms error; NaN if unknown, so that comparisons with it are false."""
    error = None if errors is None else errors[name]
    return float("nan") if error is None else float(np.hypot(error["bias"], error["sd"]))


def _times(ratios: Mapping[str, float]) -> str:
    words = {"cop_x": "the centre of pressure"}
    return ", ".join(f"{ratio:.2f} ({words.get(name, name)})" for name, ratio in ratios.items())
