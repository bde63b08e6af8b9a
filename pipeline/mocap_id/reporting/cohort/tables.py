"""The cohort's tables as text, in the form of the thesis's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from mocap_id.reporting.cohort.material import CohortMaterial
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.reporting.numbers import UNKNOWN, known, show, show_fixed
from mocap_id.reporting.tables import Grid, grid

_FATES = {"ok": "good", "caution": "usable with care", "refused": "refused", "failed": "failed"}


def trials(material: CohortMaterial) -> Grid:
    """A row a trial."""
    frame = material.tables["trials"]
    rows = [
        (
            row["trial"],
            row["subject"],
            row["strategy"],
            _FATES[row["verdict"]],
            _count(row["complete"], row["repetitions"]),
            show_fixed(_times(row["five_times"], 1), 2),
            show_fixed(_times(row["reprojection"], 1e3), 1),
            show(row["condition_number"]),
            show_fixed(_times(row["cop_x_own_rms"], 1e3), 1),
            show_fixed(_times(row["cop_x_held_out_rms"], 1e3), 1),
            show_fixed(_times(row["cop_x_reference_rms"], 1e3), 1),
        )
        for row in frame.to_dict("records")
    ]
    head = (
        "trial", "subject", "strategy", "verdict", "complete repetitions", "five times (s)", "re-projection (mm)",
        "condition number", "CoP, own (mm)", "held out (mm)", "allometric (mm)",
    )  # fmt: skip
    shown = [k for k in range(len(head)) if k < 4 or any(row[k] != UNKNOWN for row in rows)]
    caption = "Every trial; errors of the centre of pressure are rms, off the chair"
    return grid(caption, [head[k] for k in shown], ([row[k] for k in shown] for row in rows), range(4))


def lengths(material: CohortMaterial) -> Grid:
    """Table 6.1: methods against their reference, and every person's."""
    frame = pd.concat([material.of_cohort("lengths"), material.of_people("lengths")])
    rows = [
        (
            row["subject"],
            row["segment"],
            row["method"],
            row["reference"] or UNKNOWN,
            str(row["subjects"] if row["subject"] == "cohort" else row["trials"] or UNKNOWN),
            show_fixed(_times(row["length_mean"], 100), 2),
            show_fixed(_times(row["reference_length"], 100), 2),
            _spread(row, "error"),
            row["why"],
        )
        for row in frame.to_dict("records")
    ]
    head = (
        "", "segment", "method", "against", "people, or trials", "length (cm)", "reference (cm)", "difference (%)", "",
    )  # fmt: skip
    caption = "Lengths against their reference (thesis table 6.1): mean ± sd over the people, of one person over trials"
    return grid(caption, head, rows, (0, 1, 2, 3, 8))


def strategies(material: CohortMaterial) -> Grid:
    """Table 6.2."""
    return _strategies(material.of_cohort("strategies"), "By strategy (thesis table 6.2): mean ± sd over the people")


def strategies_of_people(material: CohortMaterial) -> Grid:
    """Table 6.2 of every person."""
    return _strategies(material.of_people("strategies"), "By person and strategy: mean ± sd over the person's trials")


def _strategies(frame: pd.DataFrame, caption: str) -> Grid:
    rows = [
        (
            row["subject"],
            row["strategy"],
            row["reference"] or UNKNOWN,
            str(row["trials"]),
            _spread(row, "shank_error"),
            _spread(row, "thigh_error"),
            _spread(row, "reprojection", 1e3),
            _spread(row, "condition_number"),
        )
        for row in frame.to_dict("records")
    ]
    head = (
        "", "strategy", "lengths against", "trials", "shank (%)", "thigh (%)", "re-projection (mm)", "condition number",
    )  # fmt: skip
    return grid(caption, head, rows, (0, 1, 2))


def models(material: CohortMaterial) -> Grid:
    """Table 6.3."""
    caption = (
        "Every model on every action of the same person (thesis table 6.3), model less measurement off the chair, "
        "bias ± sd over all people; torques against those of the action's own model"
    )
    return _models(material.of_cohort("models"), caption)


def models_of_people(material: CohortMaterial) -> Grid:
    """Table 6.3 of every person."""
    frame = material.of_people("models")
    caption = "Every model on every trial of the same person, model less measurement off the chair, bias ± sd"
    return _models(frame[frame["pairs"] > 0], caption)


def _models(frame: pd.DataFrame, caption: str) -> Grid:
    torques = [name[:-5] for name in frame.columns if name.startswith("tau_") and name.endswith("_mean")]
    rows = [
        (
            row["action_trial"] or row["action"],
            _spread(row, "condition_number", decimals=0),
            row["model"] if row["model"].startswith("own") else row["model_trial"] or row["model"],
            str(row["pairs"]),
            _spread(row, "Fy"),
            _spread(row, "tauz"),
            _spread(row, "cop_x", 1e3),
            *(_spread(row, torque) for torque in torques),
        )
        for row in frame.to_dict("records")
    ]
    joints = tuple(f"τ{name[4:]} (N·m)" for name in torques)
    head = ("action", "condition number", "model", "predictions", "Fy (N)", "τz (N·m)", "CoP (mm)", *joints)
    return grid(caption, head, rows, (0, 2))


def doubtful(material: CohortMaterial) -> Grid:
    """Models of other trials that could not be applied, or should not be believed, and why."""
    frame = material.of_people("models")
    frame = frame[(frame["why"] != "") | (frame["codes"] != "")]
    rows = [
        (row["action_trial"], row["model_trial"] or row["model"], row["why"] or _titles(row["codes"]))
        for row in frame.to_dict("records")
    ]
    caption = "Predictions that could not be made, or that the recordings do not support"
    return grid(caption, ("action", "model", "why"), rows, (0, 1, 2))


def variation(material: CohortMaterial) -> Grid:
    """Figure 6.8 as a table."""
    caption = (
        "Coefficient of variation of base and modified base parameters over each person's trials (thesis figure 6.8): "
        "mean ± sd over the people. The allometric body varies with the chain that it is put on, and with nothing else"
    )
    return _variation(material.of_cohort("variation"), caption)


def variation_of_people(material: CohortMaterial) -> Grid:
    """Figure 6.8 of every person."""
    frame = material.of_people("variation")
    return _variation(frame[frame["trials"] > 1], "Coefficient of variation over each person's trials")


def _variation(frame: pd.DataFrame, caption: str) -> Grid:
    rows = [
        (
            row["subject"],
            row["set"],
            row["parameter"],
            row["expression"],
            str(row["trials"]),
            _percent(row, "cv"),
            _percent(row, "reference_cv"),
        )
        for row in frame.to_dict("records")
    ]
    head = ("", "set", "parameter", "which is", "trials", "own models (%)", "allometric body (%)")
    return grid(caption, head, rows, (0, 1, 2, 3))


def _titles(codes: str) -> str:
    """What codes mean, in their explanations' words."""
    found = [EXPLANATIONS[code].title if code in EXPLANATIONS else code for code in codes.split(", ")]
    return "; ".join(found)


def _times(value: Any, factor: float) -> float | None:
    number = known(value)
    return None if number is None else factor * number


def _spread(row: Mapping[Any, Any], name: str, factor: float = 1.0, decimals: int = 1) -> str:
    """``mean ± sd`` of two columns; the mean alone where one case has no spread."""
    mean, sd = (_times(row[f"{name}_{part}"], factor) for part in ("mean", "sd"))
    return show_fixed(mean, decimals) if sd is None else f"{show_fixed(mean, decimals)} ± {show_fixed(sd, decimals)}"


def _percent(row: Mapping[Any, Any], name: str) -> str:
    mean, sd = _times(row[name], 100), _times(row[f"{name}_sd"], 100)
    return show(mean, 2) if sd is None else f"{show(mean, 2)} ± {show(sd, 2)}"


def _count(part: Any, whole: Any) -> str:
    return UNKNOWN if pd.isna(whole) else f"{part} of {whole}"
