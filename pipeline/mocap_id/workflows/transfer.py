"""``mocap-id transfer``: the model of one trial on other trials of the same person (thesis table 6.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.carry import LEAST_MARKERS, LEAST_SPREAD, Registration, carry, register
from mocap_id.dynamics.predict import Agreement, agreement
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.verdict import Reason
from mocap_id.workflows.finished import Finished, finished
from mocap_id.workflows.transfer_support import Support, doubts, support

SERIES = {"Fx": "N", "Fy": "N", "tauz": "N*m", "cop_x": "m"}
"""What is compared, with units."""
OWN, HELD_OUT, CARRIED = "own", "own, held out", "transferred"
"""Names of bodies; that of a table of people is its own."""
_TURNED_OVER = 0.5  # of the residual: markers that fit so much better when turned over belong to a turned person
_APART = 0.025  # m rms: skin and posture leave 1 cm, markers that were placed anew several
_UNSHOWN = "transfer-nothing"
_MASS_APART = 0.05  # of the standing mass, as for the verdict of a trial


@dataclass(frozen=True)
class Body:
    """One body's errors on a trial.

    Parameters
    ----------
    name : str
        ``own``, ``own, held out``, ``transferred``, or the table of people.
    errors : mapping
        Model less measurement of each of :data:`SERIES`; None where it is not known.
    torques : tuple
        What the joint torques differ from those of the trial's own model, N·m, joint 1 first; empty for the own model,
        None where a torque is not known.
    """

    name: str
    errors: Mapping[str, Agreement | None]
    torques: tuple[Agreement | None, ...]


@dataclass(frozen=True)
class Applied:
    """A model on one trial.

    Parameters
    ----------
    trial : str
    samples : int
        Those that the trial's own model was fitted to: off the chair.
    condition : float or None
        Of the regressor over them.
    bodies : tuple of Body
    registration : Registration
        Of the model's segments in the trial's.
    support : Support or None
        What speaks for the transfer without the trial's forces; None where there is no table's body.
    reasons : tuple of Reason
        What to know before believing it.
    """

    trial: str
    samples: int
    condition: float | None
    bodies: tuple[Body, ...]
    registration: Registration
    support: Support | None
    reasons: tuple[Reason, ...]

    @property
    def supported(self) -> bool | None:
        """Whether the recordings support an individual model of this trial.

        They do where nothing speaks against it beforehand, and it is closer to the forces than the table's body. None
        where nothing speaks against it but there are no forces, or no table, to show it.
        """
        if any(reason.code != _UNSHOWN for reason in self.reasons):
            return False
        return True if not self.reasons and self.support is not None else None


@dataclass(frozen=True)
class Transfer:
    """A model on other trials.

    Parameters
    ----------
    model : str
        Name of the trial that it comes from.
    segments : tuple of str
    trials : tuple of Applied
    """

    model: str
    segments: tuple[str, ...]
    trials: tuple[Applied, ...]


def transfer(model: Path, trials: Sequence[Path], progress: runner.Progress = lambda step: None) -> Transfer:
    """Apply the model of one trial to others.

    Parameters
    ----------
    model : Path
        YAML file or run folder of the trial whose body is carried over.
    trials : sequence of Path
        Those to predict, likewise.
    progress : callable, optional
        Told of the stages that have to run.

    Raises
    ------
    ConfigError
        The trials have other segments, too few markers in common, or the person faces the other way.
    RecordingError
        The model's trial has no identified body.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.workflows.finished.finished`.
    """
    source = finished(model, progress)
    if not np.isfinite(source.parameters).all():
        raise RecordingError(
            f"{model}: there is no body to carry over from trial {source.name}: "
            f"{source.facts.get('why') or 'its full parameters are not all known'}"
        )
    others = [finished(path, progress) for path in trials]
    return Transfer(source.name, source.skeleton.segments, tuple(apply(source, other) for other in others))


def apply(source: Finished, target: Finished) -> Applied:
    """The body of one finished trial on another.

    Raises
    ------
    ConfigError
        As for :func:`transfer`.
    """
    registration = _registered(source, target)
    samples = _samples(target)
    bodies = tuple(_bodies(target, carry(source.parameters, registration), samples))
    known = support(source, target, registration)
    before = doubts(known, registration, _joints(target.skeleton.segments))
    return Applied(
        trial=target.name,
        samples=int(samples.sum()),
        condition=target.facts.get("condition_number"),
        bodies=bodies,
        registration=registration,
        support=known,
        reasons=(*before, *_reasons(source, target, registration, bodies)),
    )


def _joints(segments: Sequence[str]) -> list[str]:
    return [f"between {below} and {above}" for below, above in pairwise(segments)]


def _registered(source: Finished, target: Finished) -> Registration:
    """How the model's segments lie in the trial's; an error where that cannot be told."""
    there, here = source.skeleton, target.skeleton
    if there.segments != here.segments:
        raise ConfigError(
            f"{target.source}: trial {target.name} has the segments {', '.join(here.segments)}, the model of trial "
            f"{source.name} {', '.join(there.segments)}: a body is carried over segment by segment. Give both the same "
            "with `segment: {count: …}` of the smaller number, or with markers that are `together` or `apart`"
        )
    found = register(there, here)
    for k, name in enumerate(here.segments[1:], start=1):
        if found.markers[k] < LEAST_MARKERS or found.spread[k] < LEAST_SPREAD:
            raise ConfigError(
                f"{target.source}: trials {source.name} and {target.name} have {found.markers[k]} markers in common on "
                f"the {name}, spread by {100 * found.spread[k]:.1f} cm; expected at least {LEAST_MARKERS}, spread by "
                f"{100 * LEAST_SPREAD:g} cm, to tell how it lies in both. Markers are matched by label: markers of the "
                "same place need the same one"
            )
    if np.sqrt(np.mean(found.mirrored[1:] ** 2)) < _TURNED_OVER * np.sqrt(np.mean(found.residual[1:] ** 2)):
        raise ConfigError(
            f"{target.source}: the person of trial {target.name} faces the other way than in trial {source.name}: the "
            "markers fit when turned over. Set `planarise: {facing: …}` in one of them"
        )
    return found


def at_home(target: Finished) -> tuple[Body, ...]:
    """The bodies that a trial has without any other's: its own, the same on repetitions left out, the table's."""
    samples = _samples(target)
    return tuple(body for body in (*_own(target, samples), _table(target, samples)) if body is not None)


def _samples(target: Finished) -> BoolArray:
    return target.dynamics["in_fit"].to_numpy(dtype=np.bool_)


def _bodies(target: Finished, carried: FloatArray, samples: BoolArray) -> Iterator[Body]:
    """The trial's own model, the same on repetitions left out, the carried body and the table's."""
    yield from _own(target, samples)
    yield _full(target, CARRIED, carried, samples)
    table = _table(target, samples)
    if table is not None:
        yield table


def _own(target: Finished, samples: BoolArray) -> Iterator[Body]:
    yield Body(OWN, _errors(_columns(target, "_model"), _columns(target, ""), samples), ())
    held_out = (target.facts.get("held_out") or {}).get("model")
    if held_out is not None:
        known = {name: None if held_out[name] is None else Agreement(**held_out[name]) for name in SERIES}
        yield Body(HELD_OUT, known, ())


def _table(target: Finished, samples: BoolArray) -> Body | None:
    name = target.facts.get("reference_table")
    return None if name is None else _full(target, str(name), target.reference, samples)


def _full(target: Finished, name: str, full: FloatArray, samples: BoolArray) -> Body:
    """A body by its full parameters, in the frames of the trial."""
    regressor = target.regressor()
    torque_regressor = target.torque_regressor(regressor)
    torque = target.dynamics[[f"tau_{j}" for j in range(1, regressor.shape[-1] // 4)]].to_numpy(dtype=np.float64)
    wrench = regressor @ full
    pressure = centre_of_pressure(wrench, target.cop_threshold)
    pairs = zip((torque_regressor @ full).T, torque.T, strict=True)
    return Body(
        name,
        _errors(np.column_stack([wrench, pressure]), _columns(target, ""), samples),
        tuple(agreement(ours, own, samples) for ours, own in pairs),
    )


def _columns(target: Finished, suffix: str) -> FloatArray:
    return target.dynamics[[f"{name}{suffix}" for name in SERIES]].to_numpy(dtype=np.float64)


def _errors(model: FloatArray, measured: FloatArray, samples: BoolArray) -> dict[str, Agreement | None]:
    pairs = zip(model.T, measured.T, strict=True)
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _reasons(source: Finished, target: Finished, found: Registration, bodies: Sequence[Body]) -> Iterator[Reason]:
    """What to know before believing the carried body's errors."""
    if not target.dynamics["in_fit"].any():
        yield Reason(
            "transfer-nothing",
            f"nothing was identified on this trial, so there are no samples to compare on: {target.facts.get('why')}",
        )
    worst = float(np.nanmax(found.residual[1:]))
    if worst > _APART:
        segment = target.skeleton.segments[1 + int(np.nanargmax(found.residual[1:]))]
        yield Reason(
            "transfer-markers",
            f"the markers of the {segment} lie {1e3 * worst:.0f} mm (rms) from where they lay among each other in the "
            "model's trial: they were placed anew, carry other labels, or this is another person",
            value=worst,
            limit=_APART,
        )
    mass = float(source.parameters[::4].sum())
    if target.mass is not None and abs(mass / target.mass - 1) > _MASS_APART:
        yield Reason(
            "transfer-mass",
            f"the model has {mass:.1f} kg and the plates show {target.mass:.1f} kg while the person stands: this is "
            "another person, or something is carried",
            value=mass,
            limit=target.mass,
        )
    errors = {body.name: body.errors for body in bodies}
    table = errors.get(str(target.facts.get("reference_table")), {})
    ratios = {name: rms(errors[CARRIED][name]) / rms(table.get(name)) for name in SERIES}
    worse = {name: ratio for name, ratio in ratios.items() if ratio > 1.0}
    if worse:
        told = ", ".join(f"{name} ({ratio:.2f} times its error)" for name, ratio in worse.items())
        yield Reason(
            "transfer-worse",
            f"the body of trial {source.name} predicts this one no better than the table's, which knows height and "
            f"mass alone, in {told}: these two recordings do not support an individual model of that",
            value=max(worse.values()),
            limit=1.0,
        )


def rms(error: Agreement | None) -> float:
    """Root mean square of an error; NaN where it is not known."""
    return float("nan") if error is None else float(np.hypot(error.bias, error.sd))
