"""A row for every trial and method, and one for the reference parameters on the same states."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.config.robot_study import RobotReference, RobotTrial
from mocap_id.dynamics.clock import SampledWrench
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.store import Folder, LongTable
from mocap_id.workflows.performing import Performed
from mocap_id.workflows.robot_study.obtained import PARAMETERS, STATES, WRENCH, Errors, Obtained, obtained
from mocap_id.workflows.robot_study.truth import Labels, Truth, labels_of, reference_of, truth_beside
from mocap_id.workflows.robot_study.variants import CAMERAS, ENCODER, METHODS, of_method

REFERENCE = "reference"


@dataclass(frozen=True)
class Case:
    """A trial with all that came of it.

    Parameters
    ----------
    entry : RobotTrial
        Its run folder is the study's.
    performed : Performed
    labels : Labels
    truth : Truth or None
    reference : mapping of str to float
        Parameters, and ``base``; those that are known.
    summary : mapping or None
        summary.json; None where the trial failed.
    by_method : mapping of str to Obtained
        Empty where it failed or was refused.
    """

    entry: RobotTrial
    performed: Performed
    labels: Labels
    truth: Truth | None
    reference: Mapping[str, float]
    summary: Mapping[str, Any] | None
    by_method: Mapping[str, Obtained]

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.entry.trial.name


def case(entry: RobotTrial, performed: Performed, reference: Mapping[str, RobotReference]) -> Case:
    """Read what a trial left in its folders."""
    trial, told = entry.trial, performed.exit_code in (0, 4)
    truth = truth_beside(trial.keys.recording.markers)
    labels = Labels(entry.joint, entry.speed, entry.orientation).over(labels_of(truth))
    given = reference.get(labels.joint)
    known = reference_of(truth) if given is None else given.model_dump(exclude_none=True)
    found = {}
    if performed.exit_code == 0:
        for method in METHODS:
            if method is not ENCODER or trial.keys.encoder is not None:
                found[method.name] = obtained(Folder(of_method(trial, method).out), truth, own=method is ENCODER)
    summary = json.loads((trial.out / SUMMARY_FILE).read_text("utf-8")) if told else None
    return Case(entry, performed, labels, truth, known, summary, found)


def trial_rows(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Rows of `trials`; a trial that did not go through has one, without numbers."""
    return [row for one in cases for row in _rows(one)]


def _rows(one: Case) -> Iterator[dict[str, Any]]:
    if not one.by_method:
        yield _labels(one) | {"method": CAMERAS.name}
    for name, found in one.by_method.items():
        yield _labels(one) | {"method": name} | _numbers(one, found)
    through = one.by_method.get(ENCODER.name) or one.by_method.get(CAMERAS.name)
    if through is not None and all(name in one.reference for name in PARAMETERS):
        yield _labels(one) | {"method": REFERENCE} | _of_reference(one, through)


def _labels(one: Case) -> dict[str, Any]:
    verdict = (one.summary or {}).get("verdict") or {}
    orientation = one.labels.orientation
    return {
        "trial": one.name,
        "joint": one.labels.joint,
        "speed": one.labels.speed,
        "orientation": np.nan if orientation is None else orientation,
        "verdict": verdict.get("level", "failed"),
        "codes": ", ".join(reason["code"] for reason in verdict.get("reasons", ())),
    }


def _numbers(one: Case, found: Obtained) -> dict[str, Any]:
    row: dict[str, Any] = {"against": found.against, "condition": found.condition, "clock_offset": found.clock_offset}
    for k, name in enumerate(PARAMETERS):
        row |= {name: found.parameters[k], f"{name}_sd": found.sds[k], f"{name}_verdict": found.verdicts[k]}
        row[f"{name}_reference"] = one.reference.get(name, np.nan)
    for name in STATES:
        row |= _spread(name, found.states[name])
    for name in WRENCH:
        row |= _spread(name, found.wrench[name])
    return row | _spread("torque", found.torque) | _kinematics(one, found)


def _kinematics(one: Case, found: Obtained) -> dict[str, Any]:
    folder = Folder(found.done.source)
    assert one.summary is not None
    length = one.summary["lengths_m"]["base"]
    base = np.nan if length["value"] is None else length["value"]
    encoder = folder.read("encoder.parquet").facts
    told = {} if one.truth is None else one.truth.told.get("encoder", {})
    return {
        "base": base,
        "base_sd": np.nan if length["sd"] is None else length["sd"],
        "base_error": base - one.reference.get("base", np.nan),
        **_markers(folder, found),
        "encoder_offset": encoder.get("clock_offset_s", np.nan),
        "encoder_offset_sd": encoder.get("clock_offset_sd_s", np.nan),
        "encoder_offset_truth": told.get("clock_offset_s", np.nan),
    }


def _markers(folder: Folder, found: Obtained) -> dict[str, float]:
    """Mean and standard deviation of the moving markers' distances from where the states have them, m."""
    artefact, skeleton = folder.read("markers.parquet"), found.done.skeleton
    assert isinstance(artefact, LongTable)
    moving = [name for name, segment in zip(skeleton.markers, skeleton.segment, strict=True) if segment > 0]
    own = np.isin(artefact.labels, moving) & artefact.values["used"].astype(np.bool_)
    off = artefact.values["residual"][own & np.isfinite(artefact.values["residual"])]
    return {"marker_bias": float(np.mean(off)), "marker_sd": float(np.std(off))} if len(off) else {}


def _spread(name: str, errors: Errors) -> dict[str, float]:
    return {f"{name}_bias": errors.bias, f"{name}_sd": errors.sd, f"{name}_r2": errors.r2}


def _of_reference(one: Case, found: Obtained) -> dict[str, Any]:
    """What the reference parameters say of the wrench and the torque on the same states."""
    wrench, torque = reference_series(one, found)
    row: dict[str, Any] = {name: one.reference[name] for name in PARAMETERS}
    row |= {f"{name}_reference": one.reference[name] for name in PARAMETERS}
    dynamics = found.done.dynamics
    fitted = dynamics["in_fit"].to_numpy(dtype=np.bool_)
    for k, name in enumerate(WRENCH):
        measured = dynamics[name].to_numpy(dtype=np.float64)[fitted]
        row |= _spread(name, Errors.of(wrench[fitted, k] - measured, measured))
    return row | _spread("torque", _torque(one, found, torque))


def reference_series(one: Case, found: Obtained) -> tuple[FloatArray, FloatArray]:
    """Wrench (T, 3) and torque (T,) of the reference parameters on a method's states, in the plane."""
    done = found.done
    base = found.gauge.into_plane(np.array([one.reference[name] for name in PARAMETERS]))
    tree: Any = Folder(done.source).read("dynamics.h5")
    full = np.linalg.pinv(np.asarray(tree.data["base"]["regrouping"], dtype=np.float64)) @ base
    return done.chain.regressor @ full, (done.chain.torque_regressor @ full)[:, 0]


def _torque(one: Case, found: Obtained, torque: FloatArray) -> Errors:
    """Of a torque (T,) in the plane against the encoder's, at the encoder's own times."""
    file, matched = one.entry.trial.keys.encoder, Folder(found.done.source).read("encoder.parquet").facts
    log = None if file is None else recording.read_encoder(file)
    if log is None or log.torque is None or matched.get("sign") is None:
        return Errors(np.nan, np.nan, np.nan)
    time, told = found.done.dynamics["time"].to_numpy(dtype=np.float64), matched["sign"] * log.torque
    model = SampledWrench.of(time, torque[:, None])(log.time + matched["clock_offset_s"])[:, 0]
    return Errors.of(model - told, told)
