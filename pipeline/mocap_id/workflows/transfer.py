"""``mocap-id transfer``: the model of one trial on other trials of the same person (thesis table 6.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocap_id import runner
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.carry import LEAST_MARKERS, LEAST_SPREAD, Registration, Skeleton, register
from mocap_id.dynamics.predict import Agreement, agreement
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.verdict import Reason
from mocap_id.workflows import transfer_support
from mocap_id.workflows.finished import Finished, finished
from mocap_id.workflows.followed_bodies import followed
from mocap_id.workflows.moving_bodies import MovingBodies
from mocap_id.workflows.transfer_support import (
    Carried,
    Support,
    doubts,
    inside,
    predicted,
    series,
    stated_sd,
    support,
    worse_than_stated,
)

SERIES = transfer_support.SERIES
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
        Of the model's bodies in the trial's.
    support : Support or None
        What speaks for the transfer without the trial's forces; None where there is no table's body.
    stated : mapping
        rms over the samples of the standard deviation that is stated for the transferred body's prediction, of each of
        :data:`SERIES`, N, N·m and m; NaN where unknown.
    inside : mapping
        Share of the samples that its 95 % intervals hold; NaN where unknown.
    reasons : tuple of Reason
        What to know before believing it.
    """

    trial: str
    samples: int
    condition: float | None
    bodies: tuple[Body, ...]
    registration: Registration
    support: Support | None
    stated: Mapping[str, float]
    inside: Mapping[str, float]
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
        The bodies that were identified on it.
    trials : tuple of Applied
    """

    model: str
    segments: tuple[str, ...]
    trials: tuple[Applied, ...]

    @property
    def joints(self) -> int:
        """The most joints that a trial has torques of."""
        return max((len(body.torques) for trial in self.trials for body in trial.bodies), default=0)


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
        A body has too few markers in common, or the person faces the other way.
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

    A model that was identified on the pinned chain is carried from segment to segment of the other trial's chain,
    where that has as many of them. Every other model is carried on measured poses: its bodies are followed through the
    other trial by their markers, whatever segments that has. Every body, the carried one and the table's, is compared
    with the forces in the band of the trial's own fit, at the clock offset that it found.

    Raises
    ------
    ConfigError
        As for :func:`transfer`.
    """
    by_segments = source.measured is None and len(source.skeleton.segments) == len(target.chain.skeleton.segments)
    moving = target.chain if by_segments else followed(source, target)
    registration = _registered(source, target, moving.skeleton)
    carried, samples = Carried.of(source, moving, registration), _samples(target)
    bodies = tuple(_bodies(target, carried, samples))
    sd = stated_sd(source, target, carried)
    shares = inside(predicted(target, moving, carried.parameters), _measured(target), sd, samples)
    known = support(source, target, carried)
    before = doubts(known, registration, _joints(source.skeleton))
    return Applied(
        trial=target.name,
        samples=int(samples.sum()),
        condition=target.facts.get("condition_number"),
        bodies=bodies,
        registration=registration,
        support=known,
        stated={name: _root_mean_square(sd[samples, k]) for k, name in enumerate(SERIES)},
        inside=shares,
        reasons=(*before, *_reasons(source, target, registration, bodies), *worse_than_stated(shares)),
    )


def _joints(skeleton: Skeleton) -> list[str]:
    names = skeleton.segments
    return [f"between {names[below]} and {names[above]}" for below, above in skeleton.between]


def _registered(source: Finished, target: Finished, here: Skeleton) -> Registration:
    """How the model's bodies lie in the trial's; an error where that cannot be told."""
    there = source.skeleton
    found = register(there, here)
    for k, name in enumerate(here.segments[1:], start=1):
        if found.markers[k] < LEAST_MARKERS or found.spread[k] < LEAST_SPREAD:
            raise ConfigError(
                f"{target.source}: trials {source.name} and {target.name} have {found.markers[k]} markers in common on "
                f"the {name}, spread by {100 * found.spread[k]:.1f} cm; expected at least {LEAST_MARKERS}, spread by "
                f"{100 * LEAST_SPREAD:g} cm, to tell how it lies in both. Markers are matched by label: markers of the "
                "same place need the same one"
            )
    mirrored, residual = (_root_mean_square(each[there.jointed]) for each in (found.mirrored, found.residual))
    if mirrored < _TURNED_OVER * residual:
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


def _bodies(target: Finished, carried: Carried, samples: BoolArray) -> Iterator[Body]:
    """The trial's own model, the same on repetitions left out, the carried body and the table's."""
    yield from _own(target, samples)
    yield _full(target, CARRIED, carried.bodies, carried.parameters, samples)
    table = _table(target, samples)
    if table is not None:
        yield table


def _own(target: Finished, samples: BoolArray) -> Iterator[Body]:
    model = target.dynamics[["Fx_model", "Fy_model", "tauz_model"]].to_numpy(dtype=np.float64)
    yield Body(OWN, _errors(series(target, model), _measured(target), samples), ())
    held_out = (target.facts.get("held_out") or {}).get("model")
    if held_out is not None:
        known = {name: None if held_out[name] is None else Agreement(**held_out[name]) for name in SERIES}
        yield Body(HELD_OUT, known, ())


def _table(target: Finished, samples: BoolArray) -> Body | None:
    """The table's body, on the bodies of the trial's own model."""
    name = target.facts.get("reference_table")
    return None if name is None else _full(target, str(name), target.bodies, target.reference, samples)


def _full(target: Finished, name: str, bodies: MovingBodies, full: FloatArray, samples: BoolArray) -> Body:
    """A body by its full parameters (4K,); its torques beside those of the trial's own model."""
    told = target.dynamics[[f"tau_{j + 1}" for j in range(target.q.shape[1])]].to_numpy(dtype=np.float64)
    own = target.bodies.torque_regressor @ target.parameters
    pairs = zip((bodies.torque_regressor @ full).T, np.where(np.isfinite(told), own, np.nan).T, strict=True)
    return Body(
        name,
        _errors(predicted(target, bodies, full), _measured(target), samples),
        tuple(agreement(ours, theirs, samples) for ours, theirs in pairs),
    )


def _measured(target: Finished) -> FloatArray:
    """(T, 4) of :data:`SERIES` as the plates measured them."""
    return series(target, target.dynamics[["Fx", "Fy", "tauz"]].to_numpy(dtype=np.float64))


def _errors(model: FloatArray, measured: FloatArray, samples: BoolArray) -> dict[str, Agreement | None]:
    pairs = zip(model.T, measured.T, strict=True)
    return {name: agreement(*pair, samples) for name, pair in zip(SERIES, pairs, strict=True)}


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def _reasons(source: Finished, target: Finished, found: Registration, bodies: Sequence[Body]) -> Iterator[Reason]:
    """What to know before believing the carried body's errors."""
    if not target.dynamics["in_fit"].any():
        yield Reason(
            "transfer-nothing",
            f"nothing was identified on this trial, so there are no samples to compare on: {target.facts.get('why')}",
        )
    jointed = source.skeleton.jointed
    worst = float(np.nanmax(found.residual[jointed]))
    if worst > _APART:
        body = source.skeleton.segments[jointed[int(np.nanargmax(found.residual[jointed]))]]
        yield Reason(
            "transfer-markers",
            f"the markers of the {body} lie {1e3 * worst:.0f} mm (rms) from where they lay among each other in the "
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
