"""``mocap-id transfer`` and ``mocap-id payload``: the models of several trials together.

First the model of one trial, applied to other trials of the same person (thesis table 6.3); then what a robot carries,
from two trials in space.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from mocap_id import runner
from mocap_id.arrays import NORMAL_95, BoolArray, FloatArray
from mocap_id.dynamics.prediction import (
    LEAST_MARKERS,
    LEAST_SPREAD,
    Agreement,
    Registration,
    agreement,
    centre_of_pressure,
    centre_of_pressure_rows,
    register_bodies,
    transfer_covariance,
    transfer_parameters,
)
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS, variance
from mocap_id.dynamics.space import identification as dynamics
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.reporting.results import to_finite
from mocap_id.store.artefacts import SpatialSkeleton
from mocap_id.verdict import Reason
from mocap_id.workflows.identified_trial import IdentifiedTrial, MovingBodies, match_bodies, open_identified_trial
from mocap_id.workflows.run_folder import open_run

SERIES = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
"""Units of the compared series by name."""
AT_HOME = ("Fy", "tauz", "cop_x")
"""Series that the model must predict better than the allometric body, on its own trial."""
_DISTINCT = ("tauz", "cop_x")
"""Series in which the model must differ from the allometric body; Fy differs mainly by the mass, known from a plate."""
_TIMES = 2.0  # least difference from the allometric body's prediction, in standard deviations
_JOINTS = 0.03  # m: positions of joints that bend enough agree within a few mm, with skin motion within two cm
_ELSEWHERE = 1.4  # error on another movement divided by the error on the own trial, from twenty pairs of real trials
_INSIDE = 0.8  # least fraction of the samples in the 95 % intervals
OWN, HELD_OUT, TRANSFERRED = "own", "own, held out", "transferred"
"""Names of bodies in the results; the name of the allometric body is the name of its table."""
_MIRRORED = 0.5  # fraction of the residual; if the residual of mirrored markers is smaller, the person turned around
_LARGEST_RESIDUAL = 0.025  # m, rms: skin and posture cause about 1 cm, but markers that were placed again several cm
_UNCONFIRMED = "transfer-nothing"
_MASS_DIFFERENCE = 0.05  # fraction of the standing mass, as for the verdict of a trial


@dataclass(frozen=True)
class BodyErrors:
    """The errors of one body on a trial."""

    name: str  # OWN, HELD_OUT, TRANSFERRED, or the name of the allometric table
    errors: Mapping[str, Agreement | None]  # model minus measurement for each of :data:`SERIES`; None if unknown
    # each joint torque minus the torque of the trial's own model, N·m, from joint 1; None if unknown. The tuple of the
    # own model is empty
    torques: tuple[Agreement | None, ...]


@dataclass(frozen=True)
class TrialTransfer:
    """The result of applying a model to one trial."""

    trial: str
    samples: int  # number of samples to which the trial's own model was fitted, without contact to the chair
    condition: float | None  # condition number of the regressor over these samples
    bodies: tuple[BodyErrors, ...]
    registration: Registration  # pose of the model's bodies in the trial's bodies
    # evidence for the transfer without the trial's forces, as by :func:`find_support`; None if there is no allometric
    # body to compare with
    support: Mapping[str, Mapping[str, float]] | None
    stated: Mapping[str, float]  # stated sd of the prediction for each of :data:`SERIES`, rms; NaN if unknown
    inside: Mapping[str, float]  # fraction of the samples within the stated 95 % intervals; NaN if unknown
    reasons: tuple[Reason, ...]  # reasons against the use of the result

    @property
    def supported(self) -> bool | None:
        """Whether the recordings support the transferred model for this trial.

        None if no reason is against it, but the forces or the allometric body that could confirm it are missing.
        """
        if any(reason.code != _UNCONFIRMED for reason in self.reasons):
            return False
        return True if not self.reasons and self.support is not None else None

    @property
    def registration_residual(self) -> float:
        """Largest residual of the registration of the moving bodies, m; NaN if all residuals are unknown."""
        return max(filter(math.isfinite, self.registration.residual[1:].tolist()), default=math.nan)

    def as_json(self, segments: Sequence[str]) -> dict[str, Any]:
        """Return the result as JSON values; ``segments`` are the names of the model's bodies."""
        registration, support = self.registration, self.support
        return {
            "trial": self.trial,
            "samples": self.samples,
            "condition_number": self.condition,
            "bodies": [
                {
                    "body": body.name,
                    "errors": {name: _describe_error(error) for name, error in body.errors.items()},
                    "torques": [_describe_error(difference) for difference in body.torques] or None,
                }
                for body in self.bodies
            ],
            "registration": [
                {
                    "segment": name,
                    "angle_deg": math.degrees(registration.angle[k]),
                    "shift_m": registration.shift[k].tolist(),
                    "markers": int(registration.markers[k]),
                    "residual_m": to_finite(registration.residual[k]),
                }
                for k, name in enumerate(segments)
            ],
            "joint_apart_m": [to_finite(distance) for distance in registration.joint.tolist()],
            "supported": self.supported,
            "support": None
            if support is None
            else {
                name: {key: to_finite(value) for key, value in each.items()} | {"unit": SERIES[name]}
                for name, each in support.items()
            },
            "intervals": {
                name: {"sd_rms": to_finite(self.stated[name]), "inside": to_finite(self.inside[name]), "unit": unit}
                for name, unit in SERIES.items()
            },
            "reasons": [reason.as_dict() for reason in self.reasons],
        }


@dataclass(frozen=True)
class Transfer:
    """The result of applying the model of one trial to other trials."""

    model: str  # name of the trial on which the model was identified
    segments: tuple[str, ...]  # names of the bodies that were identified on this trial
    trials: tuple[TrialTransfer, ...]

    def as_frame(self) -> pd.DataFrame:
        """Return a data frame with one row for each trial and body.

        The errors are model minus measurement; a torque tau_1 … is minus the torque of the trial's own model.
        """
        joints = max((len(body.torques) for trial in self.trials for body in trial.bodies), default=0)
        unknown, rows = {"mean": math.nan, "sd": math.nan, "rms": math.nan}, []
        for trial in self.trials:
            for body in trial.bodies:
                row: dict[str, Any] = {
                    "trial": trial.trial,
                    "model": self.model,
                    "body": body.name,
                    "samples": trial.samples,
                    "condition_number": trial.condition,
                }
                for name in SERIES:
                    error = _describe_error(body.errors.get(name)) or unknown
                    row |= {f"{name}_{part}": value for part, value in error.items()}
                for j in range(joints):
                    torque = _describe_error(body.torques[j] if j < len(body.torques) else None) or unknown
                    row |= {f"tau_{j + 1}_{part}": torque[part] for part in ("mean", "sd")}
                row |= {"registration_residual": trial.registration_residual, "supported": trial.supported}
                rows.append(row)
        return pd.DataFrame(rows).astype({"supported": "boolean"})

    def format_table(self, ending: str) -> bytes:
        """Return the content of a CSV or Parquet file; the units are in the Parquet file's field metadata."""

        def find_unit(column: str) -> str:
            stem = column.rpartition("_")[0]
            other = "m" if column == "registration_residual" else ""
            return SERIES.get(stem) or ("N*m" if stem.startswith("tau_") else other)

        table = pa.Table.from_pandas(self.as_frame(), preserve_index=False)
        fields = [field.with_metadata({"unit": find_unit(field.name)}) for field in table.schema]
        table, stream = table.cast(pa.schema(fields)), io.BytesIO()
        if ending == ".csv":
            pyarrow.csv.write_csv(table, stream)
        else:
            pyarrow.parquet.write_table(table, stream)
        return stream.getvalue()

    def as_json(self) -> dict[str, Any]:
        """Return the errors, the registration of every segment and the reasons as JSON; null for an unknown number."""
        return {
            "schema": "mocap-id/transfer",
            "version": 1,
            "model": self.model,
            "segments": list(self.segments),
            "trials": [trial.as_json(self.segments) for trial in self.trials],
        }


def _describe_error(error: Agreement | None) -> dict[str, float] | None:
    return None if error is None else {"mean": error.bias, "sd": error.sd, "rms": rms_error(error)}


def transfer_model(model: Path, trials: Sequence[Path], progress: runner.Progress = lambda step: None) -> Transfer:
    """Predict ``trials`` with the model that was identified on the trial ``model``, and return the errors.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`. RecordingError is raised if the
    model's trial has no identified body, ConfigError as by :func:`apply_model`, and the errors of
    :func:`mocap_id.workflows.identified_trial.open_identified_trial`.
    """
    source = open_identified_trial(model, progress)
    if not np.isfinite(source.parameters).all():
        raise RecordingError(
            f"{model}: there is no body to transfer from trial {source.name}: "
            f"{source.facts.get('why') or 'some of its full parameters are unknown'}"
        )
    targets = [open_identified_trial(path, progress) for path in trials]
    return Transfer(source.name, source.skeleton.segments, tuple(apply_model(source, target) for target in targets))


def apply_model(source: IdentifiedTrial, target: IdentifiedTrial) -> TrialTransfer:
    """Predict the trial ``target`` with the body that was identified on the trial ``source``, and return the errors.

    A model of the pinned chain is transferred segment by segment if the target's chain has the same number of segments.
    Any other model is transferred with measured poses: the markers of its bodies determine their poses in the target,
    whatever segments the target has. The transferred and the allometric body are compared with the forces in the
    frequency band of the target's own fit, with the clock offset of this fit.

    ConfigError is raised if the trials have too few common markers on a body, or if the person faces opposite
    directions.
    """
    by_segments = source.measured is None and len(source.skeleton.segments) == len(target.chain.skeleton.segments)
    moving = target.chain if by_segments else match_bodies(source, target)
    here, there = moving.skeleton, source.skeleton
    registration = register_bodies(there, here)
    for k, name in enumerate(here.segments[1:], start=1):
        if registration.markers[k] < LEAST_MARKERS or registration.spread[k] < LEAST_SPREAD:
            raise ConfigError(
                f"{target.source}: trials {source.name} and {target.name} have {registration.markers[k]} common "
                f"markers on the {name}, with a spread of {100 * registration.spread[k]:.1f} cm; expected at least "
                f"{LEAST_MARKERS} with a spread of {100 * LEAST_SPREAD:g} cm. Markers are matched by label: give "
                "markers at the same position the same label"
            )
    mirrored, residual = (
        root_mean_square(each[there.jointed]) for each in (registration.mirrored, registration.residual)
    )
    if mirrored < _MIRRORED * residual:
        raise ConfigError(
            f"{target.source}: the person faces opposite directions in trials {target.name} and {source.name}, because "
            "only the mirrored markers fit: set `planarise: {facing: …}` in one of the two trials"
        )
    parameters = transfer_parameters(source.parameters, registration)
    predicted = predict_series(target, moving, parameters)
    parameters_sd = predict_sd(target, moving, parameters, transfer_covariance(source.covariance, registration))
    samples = target.dynamics["in_fit"].to_numpy(dtype=np.bool_)
    bodies = errors_at_home(target, _compare_full(target, TRANSFERRED, moving, parameters, samples))
    sd = stated_sd(source, target, parameters_sd)
    shares = share_inside(predicted, _read_measured(target), sd, samples)
    support = find_support(source, target, predicted, parameters_sd)
    return TrialTransfer(
        trial=target.name,
        samples=int(samples.sum()),
        condition=target.facts.get("condition_number"),
        bodies=bodies,
        registration=registration,
        support=support,
        stated={name: root_mean_square(sd[samples, k]) for k, name in enumerate(SERIES)},
        inside=shares,
        reasons=(
            *_list_reasons(source, target, registration, support, bodies),
            *warn_if_worse_than_stated(shares),
        ),
    )


def errors_at_home(target: IdentifiedTrial, *others: BodyErrors) -> tuple[BodyErrors, ...]:
    """Return the errors of a trial's own model, in the fit and on left-out repetitions, and of the allometric body.

    The errors of the ``others`` come before those of the allometric body, which is on the bodies of the own model.
    """
    samples = target.dynamics["in_fit"].to_numpy(dtype=np.bool_)
    model = target.dynamics[["Fx_model", "Fy_model", "tauz_model"]].to_numpy(dtype=np.float64)
    errors = [BodyErrors(OWN, _compare_series(make_series(target, model), _read_measured(target), samples), ())]
    held_out = (target.facts.get("held_out") or {}).get("model")
    if held_out is not None:
        known = {name: None if held_out[name] is None else Agreement(**held_out[name]) for name in SERIES}
        errors.append(BodyErrors(HELD_OUT, known, ()))
    errors += others
    table = target.facts.get("reference_table")
    if table is not None:
        errors.append(_compare_full(target, str(table), target.bodies, target.reference, samples))
    return tuple(errors)


def _compare_full(
    target: IdentifiedTrial, name: str, bodies: MovingBodies, full: FloatArray, samples: BoolArray
) -> BodyErrors:
    """Return the errors of K ``bodies`` with parameters ``full`` (4K,), and their torques minus the own torques."""
    torques = target.dynamics[[f"tau_{j + 1}" for j in range(target.q.shape[1])]].to_numpy(dtype=np.float64)
    own = target.bodies.torque_regressor @ target.parameters
    pairs = zip((bodies.torque_regressor @ full).T, np.where(np.isfinite(torques), own, np.nan).T, strict=True)
    return BodyErrors(
        name,
        _compare_series(predict_series(target, bodies, full), _read_measured(target), samples),
        tuple(agreement(ours, theirs, samples) for ours, theirs in pairs),
    )


def _read_measured(target: IdentifiedTrial) -> FloatArray:
    """Return the measured :data:`SERIES`, (T, 4)."""
    return make_series(target, target.dynamics[["Fx", "Fy", "tauz"]].to_numpy(dtype=np.float64))


def _compare_series(model: FloatArray, measured: FloatArray, samples: BoolArray) -> dict[str, Agreement | None]:
    pairs = zip(model.T, measured.T, strict=True)
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _list_reasons(
    source: IdentifiedTrial,
    target: IdentifiedTrial,
    registration: Registration,
    support: Mapping[str, Mapping[str, float]] | None,
    bodies: Sequence[BodyErrors],
) -> Iterator[Reason]:
    """Yield reasons against the use of the transferred body."""
    # These reasons do not use the target's forces.
    if support is not None:
        worse = {name: each["at_home"] for name, each in support.items() if each["at_home"] > 1.0}
        if worse:
            yield Reason(
                "transfer-not-at-home",
                f"on left-out repetitions of its own trial, the model predicts no better than the allometric body in "
                f"{_name_ratios(worse)}: there is no individual information to transfer",
                value=max(worse.values()),
                limit=1.0,
            )
        times = {name: support[name]["apart_rms"] / support[name]["sd_rms"] for name in _DISTINCT}
        near = {name: ratio for name, ratio in times.items() if not ratio >= _TIMES}
        if near:
            listed = ", ".join(f"{name} ({ratio:.1f} standard deviations)" for name, ratio in near.items())
            yield Reason(
                "transfer-not-told-apart",
                "on this movement the prediction of the transferred body does not differ enough from the prediction of "
                f"the allometric body in {listed}; at least {_TIMES:g} are needed. The model's trial determines too "
                "little for this movement",
                value=min(near.values()),
                limit=_TIMES,
            )
    distances = np.nan_to_num(registration.joint)
    if len(distances) and distances.max() > _JOINTS:
        joint = int(distances.argmax())
        below, above = (source.skeleton.segments[k] for k in source.skeleton.between[joint])
        yield Reason(
            "transfer-joints",
            f"the positions of the joint between {below} and {above} in the two trials differ by "
            f"{1e3 * registration.joint[joint]:.0f} mm relative to the same markers: in one trial, the joint does not "
            "bend enough or the markers moved on the skin",
            value=float(registration.joint[joint]),
            limit=_JOINTS,
        )
    if not target.dynamics["in_fit"].any():
        yield Reason(
            "transfer-nothing",
            "no parameters were identified on this trial, so there are no samples to compare: "
            f"{target.facts.get('why')}",
        )
    jointed = source.skeleton.jointed
    worst = float(np.nanmax(registration.residual[jointed]))
    if worst > _LARGEST_RESIDUAL:
        body = source.skeleton.segments[jointed[int(np.nanargmax(registration.residual[jointed]))]]
        yield Reason(
            "transfer-markers",
            f"the markers of the {body} differ by {1e3 * worst:.0f} mm (rms) from their relative positions in the "
            "model's trial: they were placed again, have different labels, or this is a different person",
            value=worst,
            limit=_LARGEST_RESIDUAL,
        )
    mass = float(source.parameters[::4].sum())
    if target.mass is not None and abs(mass / target.mass - 1) > _MASS_DIFFERENCE:
        yield Reason(
            "transfer-mass",
            f"the mass of the model is {mass:.1f} kg, but the plates measure {target.mass:.1f} kg while the person "
            "stands: this is a different person, or the person carries something",
            value=mass,
            limit=target.mass,
        )
    errors = {body.name: body.errors for body in bodies}
    table = errors.get(str(target.facts.get("reference_table")), {})
    ratios = {name: rms_error(errors[TRANSFERRED][name]) / rms_error(table.get(name)) for name in SERIES}
    worse = {name: ratio for name, ratio in ratios.items() if ratio > 1.0}
    if worse:
        yield Reason(
            "transfer-worse",
            f"for {_name_ratios(worse)}, the body of trial {source.name} predicts this trial worse than the allometric "
            "body, which uses only height and mass: these two recordings do not support an individual model",
            value=max(worse.values()),
            limit=1.0,
        )


def _name_ratios(ratios: Mapping[str, float]) -> str:
    return ", ".join(f"{name} (error ratio {ratio:.2f})" for name, ratio in ratios.items())


def rms_error(error: Agreement | None) -> float:
    """Return the root mean square of an error; NaN if unknown."""
    return float("nan") if error is None else float(np.hypot(error.bias, error.sd))


def find_support(
    source: IdentifiedTrial, target: IdentifiedTrial, predicted: FloatArray, parameters_sd: FloatArray
) -> dict[str, dict[str, float]] | None:
    """Return the comparison of the transferred and the allometric body on the target's states, without the forces.

    For each of :data:`AT_HOME`: ``apart_rms``, the difference between the series (T, 4) that the transferred and the
    allometric body predict, rms, N, N·m or m; ``sd_rms``, the standard deviation of the former from the covariance of
    its parameters, rms; ``at_home``, the error on left-out repetitions of the model's own trial, divided by the
    allometric body's error, NaN if unknown.

    None if there is no allometric body to compare with, or if the covariance of the model is unknown.
    """
    if not (np.isfinite(target.reference).all() and np.isfinite(source.covariance).all()):
        return None
    difference = predicted - predict_series(target, target.bodies, target.reference)
    model, allometric = ((source.facts.get("held_out") or {}).get(body) for body in ("model", "reference"))
    return {
        name: {
            "apart_rms": root_mean_square(difference[:, k]),
            "sd_rms": root_mean_square(parameters_sd[:, k]),
            "at_home": _read_error(model, name) / _read_error(allometric, name),
        }
        for k, name in enumerate(SERIES)
        if name in AT_HOME
    }


def stated_sd(source: IdentifiedTrial, target: IdentifiedTrial, parameters_sd: FloatArray) -> FloatArray:
    """Return the stated standard deviations (T, 4) of the predicted :data:`SERIES`, N, N·m and m.

    They combine the standard deviations ``parameters_sd`` (T, 4) from the parameters with the rms error on left-out
    repetitions of the model's trial (or of the fit if no repetition could be left out). The factor 1.4 accounts for the
    different movement.
    """
    facts = source.facts
    held_out = facts.get("held_out") or {}
    # Unless the target has measured poses, the errors on left-out repetitions are those of the unfiltered series.
    errors = (None if target.measured is not None else held_out.get("unfiltered")) or held_out.get("model")
    if errors is None:
        cop = facts.get("cop_rms_m")
        errors = {**(facts.get("wrench") or {}), "cop_x": None if cop is None else {"bias": 0.0, "sd": cop}}
    residual = np.array([_read_error(errors, name) for name in SERIES])
    return np.asarray(_ELSEWHERE * np.hypot(parameters_sd, residual))


def share_inside(model: FloatArray, measured: FloatArray, sd: FloatArray, samples: BoolArray) -> dict[str, float]:
    """Return the fraction of ``samples`` (T,) whose measurement (T, 4) is in the stated 95 % interval, by series.

    ``sd`` (T, 4) are the stated standard deviations of the prediction. A fraction is NaN if no sample is known.
    """
    times = np.abs(model - measured)[samples] / sd[samples]
    known = np.isfinite(times)
    count = known.sum(axis=0)
    share = np.sum(known & (np.nan_to_num(times) <= NORMAL_95), axis=0) / np.where(count, count, np.nan)
    return dict(zip(SERIES, share.tolist(), strict=True))


def warn_if_worse_than_stated(shares: Mapping[str, float]) -> Iterator[Reason]:
    """Yield a reason if the stated intervals contain too few samples; ``shares`` is from :func:`share_inside`."""
    few = {name: share for name, share in shares.items() if share < _INSIDE}
    if few:
        listed = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in few.items())
        yield Reason(
            "transfer-worse-than-stated",
            f"the transferred body is less accurate than stated: its 95 % intervals contain too few samples of "
            f"{listed}",
            value=min(few.values()),
            limit=_INSIDE,
        )


def make_series(target: IdentifiedTrial, ground: FloatArray) -> FloatArray:
    """Return :data:`SERIES` (T, 4) from a ground wrench (T, 3), in the frequency band of :meth:`in_band`."""
    banded = np.column_stack([target.in_band(component) for component in ground.T])
    return np.column_stack([banded, centre_of_pressure(banded, target.cop_threshold)])


def predict_series(target: IdentifiedTrial, bodies: MovingBodies, parameters: FloatArray) -> FloatArray:
    """Return the :data:`SERIES` (T, 4) that K bodies with ``parameters`` (4K,) predict for the ground alone.

    The wrench of chair and sensors is subtracted.
    """
    columns = [f"{name}_external" for name in WRENCH_COMPONENTS]
    external = target.dynamics[columns].to_numpy(dtype=np.float64) if columns[0] in target.dynamics else 0.0
    return make_series(target, bodies.regressor @ parameters - external)


def predict_sd(
    target: IdentifiedTrial, bodies: MovingBodies, parameters: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return the standard deviations (T, 4) of the predicted :data:`SERIES` from the covariance of the parameters."""
    rows = target.in_band(bodies.regressor)
    pressure = centre_of_pressure_rows(rows, rows @ parameters, target.cop_threshold)
    return np.sqrt(variance(np.concatenate([rows, pressure[:, None]], axis=1), covariance))


def _read_error(errors: Mapping[str, Any] | None, name: str) -> float:
    """Return the root mean square of an error in the facts; NaN if unknown."""
    one = None if errors is None else errors.get(name)
    return float("nan") if one is None else float(np.hypot(one["bias"], one["sd"]))


def root_mean_square(values: FloatArray) -> float:
    """Return the root mean square of the finite values; NaN if there are none."""
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


# What a robot carries, from two trials in space.

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
_SIGNIFICANT = 2.0  # number of standard deviations above which a negative mass is significant
_SAME = 0.02  # largest difference of two trials in the axes of a coordinate frame, or in the lever of a joint, m


@dataclass(frozen=True)
class FoundPayload:
    """The payload that was identified from two trials."""

    loaded: str  # name of the trial with the payload
    empty: str  # name of the trial without the payload
    segment: str  # name of the segment that carries the payload
    payload: dynamics.Payload  # in the coordinate frame of this segment in ``chain.h5`` of the loaded trial
    cautions: Mapping[str, tuple[str, ...]]  # codes of the cautions by trial

    @property
    def negative(self) -> bool:
        """Whether the mass is significantly negative; probably the trials were swapped, or something else changed."""
        return bool(self.payload.value[0] < -_SIGNIFICANT * self.payload.sd[0])

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values; None for a number that the trials do not determine."""
        centre, centre_sd = self.payload.centre()
        rows = zip(PARAMETERS, UNITS, self.payload.value, self.payload.sd, strict=True)
        return {
            "loaded": self.loaded,
            "empty": self.empty,
            "segment": self.segment,
            "cautions": {name: list(codes) for name, codes in self.cautions.items()},
            "parameters": {
                name: {"value": to_finite(value), "sd": to_finite(sd), "unit": unit} for name, unit, value, sd in rows
            },
            "centre_m": {"value": list(map(to_finite, centre)), "sd": list(map(to_finite, centre_sd))},
        }


def find_payload(
    loaded: Path, empty: Path, segment: str | None = None, progress: runner.Progress = lambda step: None
) -> FoundPayload:
    """Return the parameters of the payload of ``segment``, by default the last, from two trials with the same chain.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`. ConfigError is raised if a trial
    has no parameters in space, if the trials have different chains, or if there is no such segment.
    """
    runs = [open_run(path, progress) for path in (loaded, empty)]
    trees = []
    for run in runs:
        if not run.in_space:
            raise ConfigError(f"{run.source}: the trial is in the plane; a payload needs trials with `space: 3d`")
        tree = run.tree("dynamics.h5")
        if tree is None or "error_modes" not in tree.facts:
            raise ConfigError(f"{run.source}: the trial has no inertial parameters: {run.why_missing('dynamics.h5')}")
        if "unit_covariance" not in tree.facts:
            raise ConfigError(
                f"{run.source}: an earlier version of the program made this run: run the trial again from its YAML file"
            )
        trees.append(tree)
    # The mappings (b, 10K) from the full to the b base parameters, which must be the same.
    errors, other_errors = ([name for name, _ in tree.facts["error_modes"]] for tree in trees)
    mapping, other = (np.asarray(tree.array("base/regrouping"), dtype=np.float64) for tree in trees)
    frames, other_frames = (np.asarray(tree.facts["frames"]) for tree in trees)
    same = mapping.shape == other.shape and frames.shape == other_frames.shape and errors == other_errors
    if not same or max(np.abs(mapping - other).max(), np.abs(frames - other_frames).max()) > _SAME:
        raise ConfigError(
            f"{runs[0].source} and {runs[1].source} have different chains, so their parameters cannot be subtracted: "
            f"write `calibration:` with the YAML file of {runs[1].name} into the file of the trial with the payload"
        )
    chain = runs[0].tree("chain.h5")
    segments = SpatialSkeleton(chain).segments if chain else ()
    carrier = segments[-1] if segment is None else segment
    if carrier not in segments:
        raise ConfigError(f"{loaded}: there is no segment {carrier!r}; the segments are {', '.join(segments)}")
    estimates = [
        (
            tree.numbers("base/value"),
            np.asarray(tree.facts["unit_covariance"], dtype=np.float64),
            np.asarray(tree.facts["residual_covariance"], dtype=np.float64),
            np.array([parameters for _, parameters in tree.facts["error_modes"]], dtype=np.float64),
        )
        for tree in trees
    ]
    found = dynamics.identify_payload(mapping, estimates[0], estimates[1], segments.index(carrier))
    cautions = {}
    for run in runs:
        reasons = run.summary.get("verdict", {}).get("reasons", ())
        cautions[run.name] = tuple(reason["code"] for reason in reasons if reason["level"] != "ok")
    return FoundPayload(runs[0].name, runs[1].name, carrier, found, cautions)
