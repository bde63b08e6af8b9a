"""Rows of the table `models`: each model of a person applied to each trial of the same person (thesis table 6.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.dynamics.comparison import Agreement
from mocap_id.errors import ConfigError
from mocap_id.reporting.study.page_data import COHORT
from mocap_id.workflows.study.statistics import group_by, named_mean_sd, pool_errors
from mocap_id.workflows.study.trial_results import TrialResult
from mocap_id.workflows.transfer import HELD_OUT, OWN, SERIES, TRANSFERRED, BodyErrors, apply_model, rms_error

_OWN = (OWN, HELD_OUT)


def model_rows(trials: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return the rows of the table `models`: first the rows of all people, then the rows of the cohort."""
    identified = [trial for trial in trials if trial.identified is not None]
    people = group_by(identified, lambda trial: trial.subject)
    rows = [row for trial in identified for row in _predict_trial(trial, people[trial.subject])]
    return [*rows, *_average_cohort(rows)]


def _predict_trial(action: TrialResult, same_person: Sequence[TrialResult]) -> Iterator[dict[str, Any]]:
    """Yield a row for each model that predicts the trial ``action``."""
    for body in action.bodies:
        yield _make_row(action, body.name, action.name if body.name in _OWN else "", body)
    for model in same_person:
        if model is not action:
            yield _transfer(action, model)


def _transfer(action: TrialResult, model: TrialResult) -> dict[str, Any]:
    """Return the row for the body of trial ``model`` on trial ``action``, or for why it cannot be transferred."""
    assert action.identified is not None and model.identified is not None
    name, source = model.strategy, model.name
    if not np.isfinite(model.identified.parameters).all():
        why = model.identified.facts.get("why") or "some of its full parameters are unknown"
        return _make_row(action, name, source, None, why=f"there is no body to transfer from {source}: {why}")
    try:
        result = apply_model(model.identified, action.identified)
    except ConfigError as error:  # the message begins with the trial's folder, which is not published
        return _make_row(action, name, source, None, why=str(error).removeprefix(f"{action.identified.source}: "))
    body = next(body for body in result.bodies if body.name == TRANSFERRED)
    return _make_row(action, name, source, body) | {
        "registration_residual": result.registration_residual,
        "supported": {True: "yes", False: "no", None: ""}[result.supported],
        "codes": ", ".join(reason.code for reason in result.reasons),
    }


def _make_row(action: TrialResult, name: str, source: str, body: BodyErrors | None, why: str = "") -> dict[str, Any]:
    assert action.identified is not None
    not_identified = action.identified.facts.get("why") if action.parameters is None else None
    row: dict[str, Any] = {
        "subject": action.subject,
        "action": action.strategy,
        "model": name,
        "action_trial": action.name,
        "model_trial": source,
        "subjects": 1,
        "pairs": int(body is not None and any(error is not None for error in body.errors.values())),
        "samples": int(action.identified.dynamics["in_fit"].sum()),
        "condition_number_mean": action.value("dynamics", "condition_number"),
        "why": why or (f"no parameters were identified on {action.name}: {not_identified}" if not_identified else ""),
    }
    if body is not None:
        for series, error in body.errors.items():
            row |= _bias_sd(series, error) | {f"{series}_rms": rms_error(error)}
        for j, torque in enumerate(body.torques, start=1):
            row |= _bias_sd(f"tau_{j}", torque)
    return row


def _bias_sd(name: str, error: Agreement | None) -> dict[str, float]:
    bias, sd = (math.nan, math.nan) if error is None else (error.bias, error.sd)
    return {f"{name}_mean": bias, f"{name}_sd": sd}


def _average_cohort(people: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row for each strategy and model, with the pooled errors of all people."""
    known = [row for row in people if math.isfinite(row.get("Fy_mean", math.nan))]
    torques = {name.removesuffix("_mean") for row in people for name in row if name.startswith("tau_")}
    series = [*SERIES, *sorted(name for name in torques if not name.endswith("_sd"))]
    for (action, model), rows in group_by(_sort(known), lambda row: (row["action"], row["model"])).items():
        row: dict[str, Any] = {
            "subject": COHORT,
            "action": action,
            "model": model,
            "subjects": len({one["subject"] for one in rows}),
            "pairs": len(rows),
            "samples": sum(one["samples"] for one in rows),
        }
        conditions = {one["action_trial"]: one["condition_number_mean"] for one in rows}
        row |= named_mean_sd("condition_number", conditions.values())
        for name in series:
            mean, sd = pool_errors([_read_agreement(one, name) for one in rows])
            row |= {f"{name}_mean": mean, f"{name}_sd": sd}
            if name in SERIES:
                row[f"{name}_rms"] = math.hypot(mean, sd)
        yield row


def _sort(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return rows sorted by strategy, then: allometric body, own model, models of other trials by their strategy."""
    actions = list(dict.fromkeys(row["action"] for row in rows))

    def rank(row: Mapping[str, Any]) -> tuple[int, int, int]:
        transferred = row["model"] not in _OWN and bool(row["model_trial"])
        kind = 2 if transferred else 1 if row["model"] in _OWN else 0
        other = actions.index(row["model"]) if transferred and row["model"] in actions else 0
        return actions.index(row["action"]), kind, other + (row["model"] == HELD_OUT)

    return sorted(rows, key=rank)


def _read_agreement(row: Mapping[str, Any], name: str) -> Agreement | None:
    bias, sd = row.get(f"{name}_mean", math.nan), row.get(f"{name}_sd", math.nan)
    return Agreement(bias, sd, math.nan) if math.isfinite(bias) and math.isfinite(sd) else None
