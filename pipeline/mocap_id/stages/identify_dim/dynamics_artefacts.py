"""Columns of dynamics.parquet, datasets and facts of dynamics.h5, for plane and space, and the cross-validation.

What a trial does not have is NaN in columns and datasets, and None in facts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.dynamics.cautions import Excitation
from mocap_id.dynamics.consistency import PointGrid
from mocap_id.dynamics.fit import estimate_drift, number_parts, shorten_rests
from mocap_id.dynamics.identification import Identification, Identified, LeftOutPrediction, predict_left_out
from mocap_id.dynamics.prediction import agreement, centre_of_pressure
from mocap_id.dynamics.preparation import AnyTrial, PreparedTrial
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.protocols.movement import Movement
from mocap_id.stages.base import Findings

SERIES = (*WRENCH_COMPONENTS, "cop_x")
"""Compared quantities, in the order of the columns of `dynamics.parquet`."""

NO_FACTS: Mapping[str, Any] = dict.fromkeys((
    "condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "clock", "wrench",
    "cop_rms_m", "samples", "reference_table", "rivals", "held_out", "consistency", "solver", "reference_pulls",
    "cutoff_hz", "plate_bias_N", "untold", "arc_deg", "contact", "external", "advice",
    "motion", "pins", "scales", "calibration_covariance", "why",
))  # fmt: skip
"""Facts of dynamics.h5 in their order, without an identification; ``why`` says why there is none."""


def make_dynamics_columns(
    time: FloatArray,
    components: Sequence[str],
    series: Mapping[str, tuple[FloatArray, FloatArray]],
    *,
    torque: FloatArray,
    torque_sd: FloatArray,
    in_fit: BoolArray,
) -> dict[str, Any]:
    """Return the columns of dynamics.parquet.

    ``series`` has the wrench (T, C), N and N·m, and the centre of pressure (T,), m, by the form of the columns' names;
    columns of a missing form are NaN. ``torque`` (T, N) is that of each joint coordinate, N·m.
    """
    columns: dict[str, Any] = {"time": time}
    for form in ("{}", "{}_model", "sd_{}_model", "{}_reference", "{}_held_out"):
        if form not in series:
            columns |= {form.format(name): np.full(len(time), np.nan) for name in SERIES}
            continue
        wrench, cop = series[form]
        columns |= {form.format(name): column for name, column in zip(components, wrench.T, strict=True)}
        columns[form.format("cop_x")] = cop
    for j, (value, sd) in enumerate(zip(torque.T, torque_sd.T, strict=True), start=1):
        columns[f"tau_{j}"], columns[f"sd_tau_{j}"] = value, sd
    return columns | {"in_fit": in_fit}


def make_datasets(
    names: Sequence[str],
    value: FloatArray,
    full_names: Sequence[str],
    *,
    units: Sequence[str],
    regrouping: FloatArray,
    sd: FloatArray | None = None,
    covariance: FloatArray | None = None,
    full: FloatArray | None = None,
    reference: FloatArray | None = None,
    excitation: Excitation | None = None,
    prior_share: FloatArray | None = None,
    bodies: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    grid: PointGrid | None = None,
    masses: FloatArray | None = None,
    held_out: tuple[FloatArray, FloatArray] | None = None,
) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5, for b base parameters of a chain with p parameters.

    ``value`` and ``sd`` are those of the base parameters; without a fit, a finite value is known in another way.
    ``regrouping`` (b, p) maps ``full`` to base parameters. ``bodies`` are the parameters (q,) of bodies with measured
    poses, those of the reference body, and their covariance (q, q) without errors of scale; by default those of the
    chain. ``held_out`` are base parameters (f, b) and clock offsets (f,), s, of the f models of the cross-validation.
    """
    absent, unknown = np.full(len(value), np.nan), np.full(len(full_names), np.nan)
    full, reference = (unknown if each is None else each for each in (full, reference))
    verdict: Sequence[str] = ["known" if np.isfinite(each) else "not identifiable" for each in value]
    of_bodies, of_reference, of_errors = bodies or (full, reference, np.full((len(full), len(full)), np.nan))
    segment = np.zeros(0, dtype=np.int64) if grid is None else grid.segment
    models, offsets = held_out or (np.zeros((0, len(value))), np.zeros(0))
    return {
        "base": {
            "name": np.array(names, dtype=object),
            "value": value,
            "sd": absent if sd is None else sd,
            "covariance": np.full((len(value), len(value)), np.nan) if covariance is None else covariance,
            "unit": np.array(units, dtype=object),
            "regrouping": regrouping,
            "verdict": np.array(verdict if excitation is None else excitation.verdict, dtype=object),
            "excitation": absent if excitation is None else excitation.own,
            "own_share": absent if excitation is None else excitation.share,
            "relative_sd": absent if excitation is None else excitation.relative_sd,
            "prior_share": absent if prior_share is None else prior_share,
        },
        "full": {"name": np.array(full_names, dtype=object), "value": full, "reference": reference},
        "bodies": {"value": of_bodies, "reference": of_reference, "covariance": of_errors},
        "grid": {
            "segment": segment,
            "position": np.zeros((0, 2)) if grid is None else grid.position,
            "mass": np.full(len(segment), np.nan) if masses is None else masses,
        },
        "held_out": {"base": models, "clock_offset": offsets},
    }


def describe_fit(trial: AnyTrial, found: Identified, requested: str) -> dict[str, Any]:
    """Return JSON about the fit; ``requested`` is the kind of physical consistency that was requested."""
    fit, answer = found.fit, found.solution.answer
    drift, drift_sd = estimate_drift(trial, fit)
    drifts = bool(np.isfinite(drift))
    return {
        "clock_offset_s": fit.total_offset if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "clock": {
            "coarse_s": trial.recorded.clock.offset,
            "applied_s": fit.offset,
            "drift_s_per_s": drift if drifts else None,
            "drift_sd_s_per_s": drift_sd if drifts else None,
        },
        "samples": int(fit.in_fit.sum()),
        "solver": {
            "name": answer.solver,
            "status": answer.status,
            "iterations": answer.iterations or None,
            "kkt": answer.optimality.excess,
            "proven": answer.optimality.proven,
            **asdict(answer.optimality),
            "asked": requested,
            "price_of_consistency": found.solution.price,
        },
        "cutoff_hz": trial.lowpass.cutoff,
    }


_JUDGED = ("Fy", "tauz", "cop_x")
_FAR = 1.5  # times the error within the fit; expected with fewer than three independent observations per parameter
_NOTICEABLE = 1e-4  # share of the measured variance; with a smaller mean square error, the model is practically exact


def validate(
    prepared: PreparedTrial, movement: Movement, found: Identification, model: FloatArray
) -> LeftOutPrediction | str:
    """Return predictions of each repetition by a model fitted to the other repetitions, or why there are none.

    A component with only NaN in the wrench (T, 3) of the whole fit's ``model`` is not predicted.
    """
    spans = find_spans(movement)
    if len(spans) < 2:
        many = "no repetition was found" if not spans else "only one repetition was found"
        return f"{many}, and at least two are needed to predict one from the others"
    part = number_parts(prepared.recorded.time, np.array(spans))
    left_out = predict_left_out(prepared, movement.free, found.fit, part, found.refit)
    if left_out is None:
        return "no subset of the repetitions determines the parameters"
    determined, samples = np.isfinite(model).any(axis=0), left_out.samples.copy()
    judged = np.flatnonzero(samples)
    samples[judged[~shorten_rests(prepared.recorded.dq[judged])]] = False
    return replace(left_out, samples=samples, wrench=np.where(determined, left_out.wrench, np.nan))


def describe_validation(
    movement: Movement,
    left_out: LeftOutPrediction | str,
    model: FloatArray,
    reference: FloatArray,
    *,
    measured: FloatArray,
    threshold: float,
    filtered: bool = False,
) -> dict[str, Any]:
    """Return the errors for left-out repetitions, and those of the whole fit and the reference body for these samples.

    The wrenches (T, 3) of ``model``, ``reference`` body and plate are corrected for clock offset and bias of the whole
    fit. If they are ``filtered`` by the fit's low-pass, the filtered predictions are compared, and the facts also
    contain ``unfiltered`` and ``inside``.
    """
    repetitions = len(find_spans(movement))
    if isinstance(left_out, str):
        nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s", "inside"))
        return {"repetitions": repetitions, **nothing, "why": left_out}
    samples = left_out.samples

    def compare(wrench: FloatArray, with_: FloatArray) -> dict[str, Any]:
        pressures = centre_of_pressure(wrench, threshold), centre_of_pressure(with_, threshold)
        pairs = [*zip(wrench.T, with_.T, strict=True), pressures]
        errors = {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}
        return {name: None if error is None else asdict(error) for name, error in errors.items()}

    inside: dict[str, float] | None = None
    if filtered:
        # shares of the samples in their 95 % intervals, whose widths come from the errors in the other repetitions
        predicted = left_out.filtered, left_out.filtered_measured
        cop = centre_of_pressure(predicted[0], threshold) - centre_of_pressure(predicted[1], threshold)
        series = np.column_stack([predicted[0] - predicted[1], cop])
        seen = [k for k in range(series.shape[1]) if np.isfinite(series[samples, k]).any()]
        series = series[:, seen]
        within = np.full(series.shape, np.nan)
        for k in np.unique(left_out.part[samples]):
            own, others = samples & (left_out.part == k), samples & (left_out.part != k)
            if others.any():
                sd = np.sqrt(np.nanmean(series[others] ** 2, axis=0))
                within[own] = np.where(np.isfinite(series[own]), np.abs(series[own]) <= NORMAL_95 * sd, np.nan)
        if not np.isnan(within).all():
            inside = dict(zip([SERIES[k] for k in seen], np.nanmean(within, axis=0).tolist(), strict=True))
    else:
        predicted = left_out.wrench, left_out.measured
    return {
        "repetitions": repetitions,
        "folds": len(left_out.base),
        "samples": int(samples.sum()),
        "model": compare(*predicted),
        "unfiltered": compare(left_out.wrench, left_out.measured) if filtered else None,
        "in_sample": compare(model, measured),
        "reference": compare(reference, measured) if np.isfinite(reference[samples]).any() else None,
        "clock_offset_s": left_out.offset.tolist(),
        "inside": inside,
        "why": None,
    }


def explain_validation(out: Findings, found: Mapping[str, Any]) -> None:
    """Add cautions about the model, from the facts of :func:`describe_validation`."""
    if found["model"] is None:
        return
    # rms errors; NaN if unknown, so that comparisons with it are false
    rms: list[dict[str, float]] = []
    for kind in ("model", "in_sample", "reference"):
        errors = [found[kind] and found[kind][name] for name in SERIES]
        values = [float(np.hypot(each["bias"], each["sd"])) if each else float("nan") for each in errors]
        rms.append(dict(zip(SERIES, values, strict=True)))
    own, within, table = rms
    worse = {k: own[k] / table[k] for k in _JUDGED if own[k] > table[k]}
    noticeable = [k for k in SERIES if found["model"][k] is not None and found["model"][k]["r2"] < 1 - _NOTICEABLE]
    far = {k: own[k] / within[k] for k in noticeable if own[k] > _FAR * within[k] > 0.0}

    def list_ratios(ratios: Mapping[str, float]) -> str:
        words = {"cop_x": "the centre of pressure"}
        return ", ".join(f"{ratio:.2f} ({words.get(name, name)})" for name, ratio in ratios.items())

    if worse:
        out.say(
            "held-out-worse",
            "the model does not predict left-out repetitions better than the reference body from height and mass: "
            f"the ratio of the errors is {list_ratios(worse)}. This recording does not allow an individual model "
            "of these quantities: errors of markers, loose joints or limbs without markers are larger than the "
            "difference between the person and the reference body",
            max(worse.values()),
            1.0,
        )
    if far:
        out.say(
            "held-out-far",
            "the model predicts left-out repetitions much worse than fitted repetitions: the ratio of the errors "
            f"is {list_ratios(far)}. The parameters depend on peculiarities of single repetitions",
            max(far.values()),
            _FAR,
        )


def find_spans(movement: Movement) -> list[tuple[float, float]]:
    """Return the times of the first and last known event of each repetition that has a known event, s."""
    spans = []
    for each in movement.repetitions:
        events = (each.start, each.seat_off, each.stand, each.seat_on, each.end)
        known = [time for time in events if np.isfinite(time)]
        if known:
            spans.append((min(known), max(known)))
    return spans
