"""Trials of a simulated cohort with their truth, and the errors of every model on every trial of its person."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from dynamic_truth import TrialWithTruth, read_with_truth, stack_true_series
from harness import DYNAMIC, SEGMENTS, Run, compute_share_inside, read_group, rms
from kinematic_sweep import SCORED
from ruamel.yaml import YAML

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.comparison import centre_of_pressure
from mocap_id.dynamics.parameter_transfer import transfer_parameters
from mocap_id.runner import run_stage
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.matched_bodies import match_bodies
from mocap_id.workflows.moving_bodies import MovingBodies
from mocap_id.workflows.transfer import HELD_OUT, OWN, TRANSFERRED, apply_model

WINTER = "winter"
TRUTHS = ("Fy", "tauz", "CoP", "tau_1", "tau_2", "tau_3")
_SUBJECT = ("height", "mass", "sex")
_FOUND = 0.25  # s: an event this far from the true one belongs to another


@dataclass(frozen=True)
class Trial:
    """One row of a study."""

    name: str
    subject: str
    strategy: str


@dataclass(frozen=True)
class Done:
    """A trial that went through ``identify-dim``, and its truth."""

    trial: Trial
    model: IdentifiedTrial
    truth: TrialWithTruth
    run: Run


def configure(study: Path, place: Path, settings: Mapping[str, Any]) -> list[tuple[Trial, Path]]:
    """Write a configuration for every trial of a study, with settings of ``identify-dim``."""
    study_file, made = YAML(typ="safe").load(study), []
    place.mkdir(exist_ok=True)
    for row in study_file["trials"]:
        subject = {key: study_file["subjects"][row["subject"]][key] for key in _SUBJECT}
        keys = {"trial": row["trial"], "recording": str(study.parent / row["recording"]), "subject": subject}
        file = place / f"{row['trial']}.yaml"
        file.write_text(json.dumps(study_file["defaults"] | keys | {"identify-dim": dict(settings)}))
        made.append((Trial(row["trial"], row["subject"], row["strategy"]), file))
    return made


def run(file: Path) -> str | None:
    """Run a trial up to ``identify-dim``; return the code of its refusal, or None."""
    trial = load(file)
    for name in DYNAMIC:
        refused = run_stage(trial, name).refused
        if refused is not None:
            return refused.code
    return None


def read_done(study: Path, trial: Trial, file: Path) -> Done | None:
    """Read a trial and its truth; return None without four segments or without parameters."""
    run = Run(study.parent / "truth" / trial.name / "truth.json", load(file))
    truth = read_with_truth(run)
    return None if truth is None else Done(trial, open_identified_trial(run.trial.out), truth, run)


def compare_models(trials: Sequence[Done]) -> pd.DataFrame:
    """Return the errors of every model on every trial of its person, a row for each pair.

    ``Fy``, ``tauz`` and ``cop`` are compared with the measurement over the samples of the fit. Torques ``t1`` … are
    compared with the torques of the trial's own model. Columns with ``true_`` are compared with the truth over all
    samples off the seat.
    """
    pairs = [(source, target) for target in trials for source in trials if source.trial.subject == target.trial.subject]
    rows = [row for source, target in pairs for row in _compare_pair(source, target)]
    return pd.DataFrame(rows).drop_duplicates(["subject", "action", "trial", "model"], ignore_index=True)


def _compare_pair(source: Done, target: Done) -> Iterator[dict[str, Any]]:
    """Yield a row for one model on one trial, and a row for Winter's model."""
    found = apply_model(source.model, target.model)
    bodies = {body.name: body for body in found.bodies}
    moving = target.model.chain if source.model.measured is None else match_bodies(source.model, target.model)
    of_body = {
        WINTER: (target.model.bodies, target.model.reference),
        TRANSFERRED: (moving, transfer_parameters(source.model.parameters, found.registration)),
    }
    same = source.trial == target.trial
    names = {WINTER: WINTER} | (
        {OWN: target.trial.strategy, HELD_OUT: HELD_OUT} if same else {TRANSFERRED: source.trial.strategy}
    )
    for body, model in names.items():
        row = {"subject": target.trial.subject, "action": target.trial.strategy, "trial": target.trial.name}
        row |= {"model": model, "own": body == OWN, "condition": found.condition}
        for name, short in (("Fy", "Fy"), ("tauz", "tauz"), ("cop_x", "cop")):
            row |= _summarise_error(short, bodies[body].errors[name])
        for j, torque in enumerate(bodies[body].torques, start=1):
            row |= _summarise_error(f"t{j}", torque)
        if body != HELD_OUT:
            row |= _compare_with_truth(target, of_body.get(body))
        yield row


def _summarise_error(name: str, error: Any) -> dict[str, float]:
    bias, sd = (np.nan, np.nan) if error is None else (error.bias, error.sd)
    return {f"{name}_mean": bias, f"{name}_sd": sd, f"{name}_rms": float(np.hypot(bias, sd))}


def _compare_with_truth(target: Done, of_body: tuple[MovingBodies, FloatArray] | None) -> dict[str, float]:
    """Return errors against the truth off the seat.

    ``of_body`` has moving bodies and their full parameters; None for the trial's own model, which also has intervals.
    """
    model, truth = target.model, target.truth
    columns = ["Fy_model", "tauz_model", "cop_x_model", *(f"tau_{j}" for j in range(1, SEGMENTS))]
    if of_body is None:
        series = model.dynamics[columns].to_numpy(dtype=np.float64)
    else:
        bodies, full = of_body
        predicted = bodies.regressor @ full
        pressure = centre_of_pressure(predicted, model.cop_threshold)
        series = np.column_stack([predicted[:, 1:], pressure, bodies.torque_regressor @ full])
    off = (series - stack_true_series(truth.true)[:, 1:])[truth.off_seat]
    parts = [("mean", np.nanmean(off, axis=0)), ("sd", np.nanstd(off, axis=0)), ("rms", rms(off))]
    if of_body is None:
        sd = model.dynamics[[f"sd_{name}" for name in columns]].to_numpy(dtype=np.float64)[truth.off_seat]
        inside = [compute_share_inside(*each) for each in zip(off.T, sd.T, strict=True)]
        parts.append(("inside", np.array(inside)))
    return {f"true_{name}_{part}": values[k] for part, values in parts for k, name in enumerate(TRUTHS)}


def compare_skeletons(trials: Sequence[Done]) -> pd.DataFrame:
    """Return a row for each trial: errors of the lengths, %, errors of lengths from stature, %, and marker rms, mm."""
    rows = []
    for each in trials:
        lengths = read_group(each.truth.chain, "segments")["length"]
        height = each.truth.truth["subject"]["height_m"]
        row: dict[str, Any] = {"subject": each.trial.subject, "strategy": each.trial.strategy}
        for name, length, share in zip(SCORED, lengths, (0.246, 0.245), strict=True):
            true = each.truth.truth["segment_lengths_m"][name]
            row |= {name: 100 * (length / true - 1), f"{name} of stature": 100 * (share * height / true - 1)}
        (markers,) = each.run.read("markers.parquet")
        rows.append(row | {"markers": 1e3 * float(rms(markers.values["residual"].ravel()))})
    return pd.DataFrame(rows)


def compare_repetitions(trials: Sequence[Done]) -> pd.DataFrame:
    """Return a row for each true repetition: whether it was found, and the errors of its events, ms."""
    rows = []
    for each in trials:
        (events,) = each.run.read("events.parquet")
        true = each.truth.truth["reps"]
        for k, one in enumerate(true):
            row: dict[str, Any] = {"strategy": each.trial.strategy, "trial": each.trial.name, "right": False}
            if len(events.frame) == len(true):
                row |= _compare_events(events.frame.iloc[k], one)
            rows.append(row)
    return pd.DataFrame(rows)


def _compare_events(found: Any, true: Mapping[str, float]) -> dict[str, Any]:
    names = {"start": "rise_start", "seat_off": "seat_off", "stand": "rise_end", "seat_on": "seat_on", "end": "sit_end"}
    errors = {name: 1e3 * (float(found[name]) - true[key]) for name, key in names.items()}
    near = abs(errors["seat_off"]) < 1e3 * _FOUND and abs(errors["seat_on"]) < 1e3 * _FOUND
    return {"right": bool(found["complete"]) and near, **errors}
