"""`models`: every model of a person against every action of the same person (thesis table 6.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mocap_id.dynamics.predict import Agreement
from mocap_id.errors import ConfigError
from mocap_id.reporting.cohort.material import COHORT
from mocap_id.workflows.study.cases import Case
from mocap_id.workflows.study.statistics import groups, mean_sd, pooled
from mocap_id.workflows.study.trials_table import condition
from mocap_id.workflows.transfer import CARRIED, HELD_OUT, OWN, SERIES, Body, apply, rms

_OWN = (OWN, HELD_OUT)


def rows(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """The rows of :data:`mocap_id.workflows.study.columns.MODELS`: every person's, then the cohort's."""
    done = [case for case in cases if case.done is not None]
    own = [row for action in done for row in _action(action, [case for case in done if case.subject == action.subject])]
    return [*own, *_cohort(own)]


def _action(action: Case, same_person: Sequence[Case]) -> Iterator[dict[str, Any]]:
    """Every model on one trial."""
    for body in action.at_home:
        yield _row(action, body.name, action.trial.name if body.name in _OWN else "", body)
    for model in same_person:
        if model is not action:
            yield _carried(action, model)


def _carried(action: Case, model: Case) -> dict[str, Any]:
    """The body of another trial; a row that says why where it cannot be carried over."""
    assert action.done is not None
    assert model.done is not None
    name, source = model.strategy, model.trial.name
    if not np.isfinite(model.done.parameters).all():
        why = model.done.facts.get("why") or "its full parameters are not all known"
        return _row(action, name, source, None, why=f"no body to carry over from {source}: {why}")
    try:
        found = apply(model.done, action.done)
    except ConfigError as error:  # it begins with the folder of the trial, which is nobody else's business
        return _row(action, name, source, None, why=str(error).removeprefix(f"{action.done.source}: "))
    body = next(body for body in found.bodies if body.name == CARRIED)
    known = [value for value in found.registration.residual[1:].tolist() if math.isfinite(value)]
    return _row(action, name, source, body) | {
        "registration_residual": max(known, default=math.nan),
        "supported": {True: "yes", False: "no", None: ""}[found.supported],
        "codes": ", ".join(reason.code for reason in found.reasons),
    }


def _row(action: Case, name: str, source: str, body: Body | None, why: str = "") -> dict[str, Any]:
    assert action.done is not None
    nothing = action.done.facts.get("why") if action.parameters is None else None
    row: dict[str, Any] = {
        "subject": action.subject,
        "action": action.strategy,
        "model": name,
        "action_trial": action.trial.name,
        "model_trial": source,
        "subjects": 1,
        "pairs": int(body is not None and any(error is not None for error in body.errors.values())),
        "samples": int(action.done.dynamics["in_fit"].sum()),
        "condition_number_mean": condition(action),
        "why": why or (f"nothing was identified on {action.trial.name}: {nothing}" if nothing else ""),
    }
    if body is not None:
        for series, error in body.errors.items():
            row |= _numbers(series, error, rms(error))
        for j, torque in enumerate(body.torques, start=1):
            row |= _numbers(f"tau_{j}", torque)
    return row


def _numbers(name: str, error: Agreement | None, root: float | None = None) -> dict[str, float]:
    bias, sd = (math.nan, math.nan) if error is None else (error.bias, error.sd)
    return {f"{name}_mean": bias, f"{name}_sd": sd} | ({} if root is None else {f"{name}_rms": root})


def _cohort(own: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Each model of each action over everybody: errors put together, condition numbers' mean and spread."""
    known = [row for row in own if math.isfinite(row.get("Fy_mean", math.nan))]
    series = [
        *SERIES,
        *sorted({name[:-5] for row in own for name in row if name.startswith("tau_") and name.endswith("_mean")}),
    ]
    for alike in groups(
        sorted(known, key=_order(known)), lambda row: "\n".join((row["action"], row["model"]))
    ).values():
        first = alike[0]
        row: dict[str, Any] = {
            "subject": COHORT,
            "action": first["action"],
            "model": first["model"],
            "subjects": len({one["subject"] for one in alike}),
            "pairs": len(alike),
            "samples": sum(one["samples"] for one in alike),
        }
        conditions = {one["action_trial"]: one["condition_number_mean"] for one in alike}
        row["condition_number_mean"], row["condition_number_sd"] = mean_sd(conditions.values())
        for name in series:
            together = pooled([_agreement(one, name) for one in alike])
            row |= {f"{name}_mean": together[0], f"{name}_sd": together[1]}
            if name in SERIES:
                row[f"{name}_rms"] = math.hypot(*together)
        yield row


def _order(known: Sequence[Mapping[str, Any]]) -> Any:
    """Actions as they come; for each the table, the own model, then those of other trials by their strategies."""
    actions = list(dict.fromkeys(row["action"] for row in known))

    def place(row: Mapping[str, Any]) -> tuple[int, int, int]:
        carried = row["model"] not in _OWN and bool(row["model_trial"])
        rank = 2 if carried else 1 if row["model"] in _OWN else 0
        other = actions.index(row["model"]) if carried and row["model"] in actions else 0
        return actions.index(row["action"]), rank, other + (row["model"] == HELD_OUT)

    return place


def _agreement(row: Mapping[str, Any], name: str) -> Agreement | None:
    bias, sd = row.get(f"{name}_mean", math.nan), row.get(f"{name}_sd", math.nan)
    return Agreement(bias, sd, math.nan) if math.isfinite(bias) and math.isfinite(sd) else None
