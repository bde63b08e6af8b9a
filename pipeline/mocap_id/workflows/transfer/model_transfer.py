"""Application of the model of one trial to other trials of the same person (thesis table 6.3)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.comparison import Agreement, agreement
from mocap_id.dynamics.parameter_transfer import LEAST_MARKERS, LEAST_SPREAD, BodyFrames, Registration, register_bodies
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.verdict import Reason
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.matched_bodies import match_bodies
from mocap_id.workflows.moving_bodies import MovingBodies
from mocap_id.workflows.transfer.support import (
    SERIES,
    Support,
    TransferredBody,
    find_support,
    list_doubts,
    make_series,
    predict,
    root_mean_square,
    share_inside,
    stated_sd,
    warn_if_worse_than_stated,
)

OWN, HELD_OUT, TRANSFERRED = "own", "own, held out", "transferred"
"""Names of bodies in the results; the name of the allometric body is the name of its table."""
_MIRRORED = 0.5  # fraction of the residual; if the residual of mirrored markers is smaller, the person turned around
_LARGEST_RESIDUAL = 0.025  # m, rms: skin and posture cause about 1 cm, but markers that were placed again several cm
_UNCONFIRMED = "transfer-nothing"
_MASS_DIFFERENCE = 0.05  # fraction of the standing mass, as for the verdict of a trial


@dataclass(frozen=True)
class BodyErrors:
    """The errors of one body on a trial."""

    name: str  # ``own``, ``own, held out``, ``transferred``, or the name of the allometric table
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
    # evidence for the transfer, without the trial's forces; None if there is no allometric body to compare with
    support: Support | None
    # stated standard deviation of the transferred body's prediction for each of :data:`SERIES`, N, N·m and m, rms over
    # the samples; NaN if unknown
    stated: Mapping[str, float]
    inside: Mapping[str, float]  # fraction of the samples within the stated 95 % intervals; NaN if unknown
    reasons: tuple[Reason, ...]  # reasons against the use of the result

    @property
    def supported(self) -> bool | None:
        """Whether the recordings support the transferred model for this trial; None if unknown.

        False if there is a reason against the transfer. Unknown if there is no such reason, but the forces or the
        allometric body that could confirm the transfer are missing.
        """
        if any(reason.code != _UNCONFIRMED for reason in self.reasons):
            return False
        return True if not self.reasons and self.support is not None else None

    @property
    def registration_residual(self) -> float:
        """Largest residual of the registration of the moving bodies, m; NaN if all residuals are unknown."""
        return max(filter(math.isfinite, self.registration.residual[1:].tolist()), default=math.nan)


@dataclass(frozen=True)
class Transfer:
    """The result of applying the model of one trial to other trials."""

    model: str  # name of the trial on which the model was identified
    segments: tuple[str, ...]  # names of the bodies that were identified on this trial
    trials: tuple[TrialTransfer, ...]

    @property
    def joints(self) -> int:
        """Largest number of joint torques of a trial."""
        return max((len(body.torques) for trial in self.trials for body in trial.bodies), default=0)


def transfer(model: Path, trials: Sequence[Path], progress: runner.Progress = lambda step: None) -> Transfer:
    """Predict ``trials`` with the model that was identified on the trial ``model``, and return the errors.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`.

    Raises
    ------
    ConfigError
        Two trials have too few common markers on a body, or the person faces opposite directions.
    RecordingError
        The model's trial has no identified body.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.workflows.identified_trial.open_identified_trial`.
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

    Raises
    ------
    ConfigError
        As for :func:`transfer`.
    """
    by_segments = source.measured is None and len(source.skeleton.segments) == len(target.chain.skeleton.segments)
    moving = target.chain if by_segments else match_bodies(source, target)
    registration = _register(source, target, moving.skeleton)
    transferred, samples = TransferredBody.of(source, moving, registration), _read_fitted(target)
    bodies = tuple(_compare_bodies(target, transferred, samples))
    sd = stated_sd(source, target, transferred)
    shares = share_inside(predict(target, moving, transferred.parameters), _read_measured(target), sd, samples)
    evidence = find_support(source, target, transferred)
    before = list_doubts(evidence, registration, _describe_joints(source.skeleton))
    return TrialTransfer(
        trial=target.name,
        samples=int(samples.sum()),
        condition=target.facts.get("condition_number"),
        bodies=bodies,
        registration=registration,
        support=evidence,
        stated={name: root_mean_square(sd[samples, k]) for k, name in enumerate(SERIES)},
        inside=shares,
        reasons=(*before, *_list_reasons(source, target, registration, bodies), *warn_if_worse_than_stated(shares)),
    )


def _describe_joints(skeleton: BodyFrames) -> list[str]:
    names = skeleton.segments
    return [f"between {names[below]} and {names[above]}" for below, above in skeleton.between]


def _register(source: IdentifiedTrial, target: IdentifiedTrial, here: BodyFrames) -> Registration:
    """Return the registration of the model's bodies in the target's bodies ``here``.

    ConfigError is raised if a body has too few common markers, or if the markers are mirrored.
    """
    there = source.skeleton
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
    return registration


def errors_at_home(target: IdentifiedTrial) -> tuple[BodyErrors, ...]:
    """Return the errors of a trial's own model, in the fit and on left-out repetitions, and of the allometric body."""
    samples = _read_fitted(target)
    return tuple(body for body in (*_compare_own(target, samples), _compare_table(target, samples)) if body is not None)


def _read_fitted(target: IdentifiedTrial) -> BoolArray:
    return target.dynamics["in_fit"].to_numpy(dtype=np.bool_)


def _compare_bodies(target: IdentifiedTrial, transferred: TransferredBody, samples: BoolArray) -> Iterator[BodyErrors]:
    """Yield the errors of the own model (fit, left-out repetitions), of the transferred and of the allometric body."""
    yield from _compare_own(target, samples)
    yield _compare_full(target, TRANSFERRED, transferred.bodies, transferred.parameters, samples)
    table = _compare_table(target, samples)
    if table is not None:
        yield table


def _compare_own(target: IdentifiedTrial, samples: BoolArray) -> Iterator[BodyErrors]:
    model = target.dynamics[["Fx_model", "Fy_model", "tauz_model"]].to_numpy(dtype=np.float64)
    yield BodyErrors(OWN, _compare_series(make_series(target, model), _read_measured(target), samples), ())
    held_out = (target.facts.get("held_out") or {}).get("model")
    if held_out is not None:
        known = {name: None if held_out[name] is None else Agreement(**held_out[name]) for name in SERIES}
        yield BodyErrors(HELD_OUT, known, ())


def _compare_table(target: IdentifiedTrial, samples: BoolArray) -> BodyErrors | None:
    """Return the errors of the allometric body on the bodies of the trial's own model; None without this body."""
    name = target.facts.get("reference_table")
    return None if name is None else _compare_full(target, str(name), target.bodies, target.reference, samples)


def _compare_full(
    target: IdentifiedTrial, name: str, bodies: MovingBodies, full: FloatArray, samples: BoolArray
) -> BodyErrors:
    """Return the errors of K ``bodies`` with parameters ``full`` (4K,), and their torques minus the own torques."""
    torques = target.dynamics[[f"tau_{j + 1}" for j in range(target.q.shape[1])]].to_numpy(dtype=np.float64)
    own = target.bodies.torque_regressor @ target.parameters
    pairs = zip((bodies.torque_regressor @ full).T, np.where(np.isfinite(torques), own, np.nan).T, strict=True)
    return BodyErrors(
        name,
        _compare_series(predict(target, bodies, full), _read_measured(target), samples),
        tuple(agreement(ours, theirs, samples) for ours, theirs in pairs),
    )


def _read_measured(target: IdentifiedTrial) -> FloatArray:
    """Return the measured :data:`SERIES`, (T, 4)."""
    return make_series(target, target.dynamics[["Fx", "Fy", "tauz"]].to_numpy(dtype=np.float64))


def _compare_series(model: FloatArray, measured: FloatArray, samples: BoolArray) -> dict[str, Agreement | None]:
    pairs = zip(model.T, measured.T, strict=True)
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _list_reasons(
    source: IdentifiedTrial, target: IdentifiedTrial, registration: Registration, bodies: Sequence[BodyErrors]
) -> Iterator[Reason]:
    """Yield reasons against the use of the transferred body."""
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
        listed = ", ".join(f"{name} (error ratio {ratio:.2f})" for name, ratio in worse.items())
        yield Reason(
            "transfer-worse",
            f"for {listed}, the body of trial {source.name} predicts this trial worse than the allometric body, which "
            "uses only height and mass: these two recordings do not support an individual model",
            value=max(worse.values()),
            limit=1.0,
        )


def rms_error(error: Agreement | None) -> float:
    """Return the root mean square of an error; NaN if unknown."""
    return float("nan") if error is None else float(np.hypot(error.bias, error.sd))
