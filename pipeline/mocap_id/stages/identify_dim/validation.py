"""Cross-validation: every repetition of a trial is predicted by a model that was fitted to the other repetitions."""

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
from mocap_id.verdict import Reason

SERIES = (*WRENCH_COMPONENTS, "cop_x")
"""Compared quantities, in the order of the columns of `dynamics.parquet`."""
_JUDGED = ("Fy", "tauz", "cop_x")
_FAR = 1.5  # times the error within the fit; expected with fewer than three independent observations per parameter
_NOTICEABLE = 1e-4  # share of the measured variance; with a smaller mean square error, the model is practically exact


@dataclass(frozen=True)
class Validation:
    """Predictions of left-out repetitions."""

    repetitions: int  # number of repetitions
    held_out: LeftOutPrediction | None  # predictions; None if no repetition could be left out
    why: str | None  # reason why there are no predictions; None if there are


def validate(prepared: PreparedTrial, movement: Movement, found: Identification, model: FloatArray) -> Validation:
    """Return predictions of each repetition by a model that is fitted to the other repetitions.

    ``model`` (T, 3) is the wrench of the model of the whole fit; a component with only NaN is not predicted.
    """
    spans = find_spans(movement)
    if len(spans) < 2:
        many = "no repetition was found" if not spans else "only one repetition was found"
        return Validation(len(spans), None, f"{many}, and at least two are needed to predict one from the others")
    part = number_parts(prepared.recorded.time, np.array(spans))
    left_out = predict_left_out(prepared, movement.free, found.fit, part, found.refit)
    if left_out is None:
        return Validation(len(spans), None, "no subset of the repetitions determines the parameters")
    determined, samples = np.isfinite(model).any(axis=0), left_out.samples.copy()
    judged = np.flatnonzero(samples)
    samples[judged[~shorten_rests(prepared.recorded.dq[judged])]] = False
    predicted = np.where(determined, left_out.wrench, np.nan)
    return Validation(len(spans), replace(left_out, samples=samples, wrench=predicted), None)


def make_facts(
    validation: Validation,
    model: FloatArray,
    reference: FloatArray,
    measured: FloatArray,
    threshold: float,
    *,
    filtered: bool = False,
) -> dict[str, Any]:
    """Return the errors for left-out repetitions, and those of the whole fit and the reference body for these samples.

    Parameters
    ----------
    model, reference, measured : (T, 3) arrays
        Wrenches of model, reference body and plate, N and N·m, with clock offset and bias of the whole fit corrected.
    threshold : float
        Largest vertical force without a centre of pressure, N.
    filtered : bool
        True if these arrays are filtered by the fit's low-pass. The filtered predictions are then compared, and the
        facts also contain ``unfiltered``.
    """
    left_out = validation.held_out
    if left_out is None:
        nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s", "inside"))
        return {"repetitions": validation.repetitions, **nothing, "why": validation.why}

    def compared(wrench: FloatArray, with_: FloatArray) -> dict[str, Any]:
        errors = _compute_errors(wrench, with_, left_out.samples, threshold)
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
        "inside": _measure_coverage(left_out, threshold) if filtered else None,
        "why": None,
    }


def _measure_coverage(left_out: LeftOutPrediction, threshold: float) -> dict[str, float] | None:
    """Return the shares of left-out samples that are in their 95 % intervals, by quantity; None if unknown.

    The widths of the intervals in a repetition are estimated from the errors in the other repetitions.
    """
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


def get_wrench(validation: Validation, samples: int) -> FloatArray:
    """Return the wrench (T, 3) predicted for left-out repetitions; NaN in other samples."""
    left_out = validation.held_out
    return np.full((samples, 3), np.nan) if left_out is None else left_out.wrench


def get_parameters(validation: Validation, base: int) -> dict[str, FloatArray]:
    """Return base parameters and clock offsets of the models of the cross-validation, one row for each model."""
    left_out = validation.held_out
    if left_out is None:
        return {"base": np.zeros((0, base)), "clock_offset": np.zeros(0)}
    return {"base": left_out.base, "clock_offset": left_out.offset}


def explain_validation(found: Mapping[str, Any]) -> tuple[Reason, ...]:
    """Return cautions about the model, from the facts of :func:`make_facts`."""
    if found["model"] is None:
        return ()
    own, within, table = ({k: _rms(found[name], k) for k in SERIES} for name in ("model", "in_sample", "reference"))
    worse = {k: own[k] / table[k] for k in _JUDGED if own[k] > table[k]}
    noticeable = [k for k in SERIES if found["model"][k] is not None and found["model"][k]["r2"] < 1 - _NOTICEABLE]
    far = {k: own[k] / within[k] for k in noticeable if own[k] > _FAR * within[k] > 0.0}
    reasons = []
    if worse:
        reasons.append(
            Reason(
                "held-out-worse",
                "the model does not predict left-out repetitions better than the reference body from height and mass: "
                f"the ratio of the errors is {_list_ratios(worse)}. This recording does not allow an individual model "
                "of these quantities: errors of markers, loose joints or limbs without markers are larger than the "
                "difference between the person and the reference body",
                value=max(worse.values()),
                limit=1.0,
            )
        )
    if far:
        reasons.append(
            Reason(
                "held-out-far",
                "the model predicts left-out repetitions much worse than fitted repetitions: the ratio of the errors "
                f"is {_list_ratios(far)}. The parameters depend on peculiarities of single repetitions",
                value=max(far.values()),
                limit=_FAR,
            )
        )
    return tuple(reasons)


def find_spans(movement: Movement) -> list[tuple[float, float]]:
    """Return the times of the first and last known event of each repetition that has a known event, s."""
    spans = []
    for each in movement.repetitions:
        events = (each.start, each.seat_off, each.stand, each.seat_on, each.end)
        known = [time for time in events if np.isfinite(time)]
        if known:
            spans.append((min(known), max(known)))
    return spans


def _compute_errors(
    model: FloatArray, measured: FloatArray, samples: BoolArray, threshold: float
) -> dict[str, Agreement | None]:
    pressures = centre_of_pressure(model, threshold), centre_of_pressure(measured, threshold)
    pairs = [*zip(model.T, measured.T, strict=True), pressures]
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _rms(errors: Mapping[str, Any] | None, name: str) -> float:
    """Return the rms error of a quantity; NaN if unknown, so that comparisons with it are false."""
    error = None if errors is None else errors[name]
    return float("nan") if error is None else float(np.hypot(error["bias"], error["sd"]))


def _list_ratios(ratios: Mapping[str, float]) -> str:
    words = {"cop_x": "the centre of pressure"}
    return ", ".join(f"{ratio:.2f} ({words.get(name, name)})" for name, ratio in ratios.items())
