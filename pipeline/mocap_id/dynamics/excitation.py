"""How much a movement tells of each base parameter, whether that is enough, and which movement would tell more.

A parameter's column in the regressor counts as far as no other column can imitate it: the norm of its part orthogonal
to all others, in standard deviations of the residual, is what noise is held against. What another movement would make
of it follows from the same regressor, with the chain that was found and the parameters that are known so far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import base_names
from mocap_id.dynamics.course import Course, joined, recorded_course
from mocap_id.dynamics.fit import DEPENDENT
from mocap_id.dynamics.foresight import SAMPLES, Body, Foresight, unit_variances
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.prepare import Prepared

Judgement: TypeAlias = Literal["known", "weak", "not identifiable"]
Change: TypeAlias = Literal["faster", "larger", "alone"]

WEAK = 0.2  # of a parameter's size: its standard deviation
WEAK_ROBOT = 0.05  # a robot's parameters are wanted to per cents
LOST = 1.0
FACTOR = 1.5  # by which a movement is made faster or larger
_HELPS = 0.8  # of the standard deviation: more is within what the foresight is off by
_FEW, _MAYBE = 40, 1.1
"""Samples that tell whether a movement may help, and by how much they may be off: most movements need no more."""
_RATE = 40.0  # Hz; movements are below 3 Hz
_LEAST_LEVER = 0.05  # m


@dataclass(frozen=True)
class Advice:
    """A movement that would tell more of a parameter.

    Parameters
    ----------
    change : {"faster", "larger", "alone"}
        1.5 times as fast, 1.5 times as far, or half of the time with the other joints at rest.
    joint : int or None
        The joint, from 0; None for all of them.
    ratio : float
        Standard deviation with that movement, in a recording as long, by the present one.
    """

    change: Change
    joint: int | None
    ratio: float

    def said(self, joints: Sequence[str]) -> str:
        """The movement in words.

        Parameters
        ----------
        joints : sequence of str
            Their names.
        """
        moved = "the whole movement" if self.joint is None else f"the {joints[self.joint]}'s movement"
        if self.change == "alone":
            return f"{moved} by itself for half of the time (the other joints at rest)"
        step = ", out of step with the others," if self.change == "faster" and self.joint is not None else ""
        return f"{moved} {FACTOR:g} times {self.change}{step}"


@dataclass(frozen=True)
class Excitation:
    """What is known of each base parameter, and why.

    Parameters
    ----------
    names : tuple of str
    verdict : tuple of {"known", "weak", "not identifiable"}
    size : (b,) array
        What the standard deviation is held against, SI.
    relative_sd : (b,) array
        Standard deviation by size.
    own : (b,) array
        Norm of the column's part that is orthogonal to all others, in standard deviations of the residual for one SI
        unit of the parameter.
    share : (b,) array
        Of the whole column's norm, 0 … 1.
    advice : tuple of (Advice or None)
        The best movement for each; None where none of those that were tried takes a fifth off. Empty where every
        parameter is known: then none is looked for, which takes as long as the identification.
    weak : float
        Standard deviation by size above which a parameter is weak.
    """

    names: tuple[str, ...]
    verdict: tuple[Judgement, ...]
    size: FloatArray
    relative_sd: FloatArray
    own: FloatArray
    share: FloatArray
    advice: tuple[Advice | None, ...]
    weak: float = WEAK

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Positions of the parameters that are not known."""
        return tuple(i for i, verdict in enumerate(self.verdict) if verdict != "known")


def excitation(prepared: Prepared, found: Identification, weak: float = WEAK) -> Excitation:
    """Judge every base parameter, and look for the movement that would tell more of it.

    Parameters
    ----------
    prepared : Prepared
    found : Identification
    weak : float
        Standard deviation by size above which a parameter is weak.
    """
    size = sizes(prepared, found)
    relative = found.base_sd / np.maximum(size, 1e-300)
    own, share = _own_parts(found.fit.design, found.fit.base)
    verdict = tuple(_verdict(r, s, weak) for r, s in zip(relative, share, strict=True))
    return Excitation(
        names=base_names(prepared.base, prepared.recorded.centres),
        verdict=verdict,
        size=size,
        relative_sd=relative,
        own=own,
        share=share,
        advice=() if set(verdict) == {"known"} else advise(prepared, found, np.array(verdict) != "known"),
        weak=weak,
    )


def sizes(prepared: Prepared, found: Identification) -> FloatArray:
    """Size of each base parameter (b,), SI, against which its standard deviation counts.

    First moments are held against (mx, my) together: mx alone may be zero. The base segment has no my; its mx is the
    weight times the centre of pressure of a straight stand, and 5 cm of that count as its least size.
    """
    kept = prepared.base.kept
    segment, kind = kept // 4, kept % 4
    mass = float(found.full[::4].sum()) if 1 in prepared.settings.components else 0.0
    size = np.abs(found.base)
    for i in np.flatnonzero((kind == 1) | (kind == 2)):
        pair = found.base[(segment == segment[i]) & ((kind == 1) | (kind == 2))]
        size[i] = np.linalg.norm(pair) if segment[i] else max(size[i], _LEAST_LEVER * mass)
    return np.asarray(size)


def _verdict(relative: float, share: float, weak: float) -> Judgement:
    return "not identifiable" if share < 1.0 / DEPENDENT else standing(relative, weak)


def standing(relative: float, weak: float = WEAK) -> Judgement:
    """What a standard deviation by the parameter's size makes of it; above ``weak`` it is weak."""
    if not np.isfinite(relative) or relative > LOST:
        return "not identifiable"
    return "weak" if relative > weak else "known"


def _own_parts(design: FloatArray, base: int) -> tuple[FloatArray, FloatArray]:
    """Norm of each base column's part that is orthogonal to all others (b,), and its share of the whole column's."""
    rows = design.reshape(-1, design.shape[-1])
    own = 1.0 / np.sqrt(unit_variances(rows)[:base])
    return own, own / np.maximum(np.linalg.norm(rows, axis=0)[:base], 1e-300)


def advise(prepared: Prepared, found: Identification, wanted: BoolArray | None = None) -> tuple[Advice | None, ...]:
    """For each parameter the change of the movement that takes most off its standard deviation.

    Parameters
    ----------
    prepared, found
        As for :func:`excitation`.
    wanted : (b,) bool array, optional
        Parameters that need it; all by default.

    Returns
    -------
    tuple of (Advice or None)
        b long.
    """
    wanted = np.ones(len(found.base), dtype=np.bool_) if wanted is None else wanted
    sight = Foresight.of(Body(prepared, found), recorded_course(prepared.recorded, found.fit.in_fit).thinned(_RATE))
    best: list[Advice | None] = [None] * len(found.base)
    for change, joint in changes(len(prepared.recorded.centres)):
        movement = changed(sight.own, change, joint)
        if np.min(_ratios(sight, movement, _FEW)[wanted]) > _MAYBE * _HELPS:
            continue
        ratios = _ratios(sight, movement, SAMPLES)
        for i in np.flatnonzero(wanted):
            value = ratios[i]
            least = best[i].ratio if best[i] is not None else _HELPS  # type: ignore[union-attr]
            if value < least:
                best[i] = Advice(change, joint, float(value))
    return tuple(best)


def _ratios(sight: Foresight, movement: Course, samples: int) -> FloatArray:
    """Standard deviations (b,) after a movement that lasts as long as the trial's own, by those of the trial."""
    after = sight.foresee(movement, seconds=sight.now.samples, samples=samples, exactly=False).sd
    return np.asarray(after / np.maximum(sight.now.sd, 1e-300))


def changes(joints: int) -> list[tuple[Change, int | None]]:
    """Changes of the movement to try: of all joints, then of one."""
    each: list[tuple[Change, int | None]] = [("faster", None), ("larger", None)]
    if joints > 1:
        each += [(change, joint) for joint in range(joints) for change in ("faster", "larger", "alone")]
    return each


def changed(own: Course, change: Change, joint: int | None) -> Course:
    """The movement if one joint moved so, or all of them; of a joint by itself every other sample is taken.

    Parameters
    ----------
    own : Course
        With the samples that were fitted.
    change : {"faster", "larger", "alone"}
    joint : int or None
        None for all.
    """
    joints = own.q.shape[1]
    ones, chosen = np.ones(joints), np.arange(joints) == joint if joint is not None else np.ones(joints, bool)
    if change == "alone":
        assert own.fitted is not None
        half = np.arange(len(own.time)) % 2 == 0
        alone = own.scaled(ones, np.where(chosen, 1.0, 0.0))
        return joined(replace(own, fitted=own.fitted & half), replace(alone, fitted=own.fitted & ~half))
    more = np.where(chosen, FACTOR, 1.0)
    return own.scaled(more, ones) if change == "faster" else own.scaled(ones, more)
