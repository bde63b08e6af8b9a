"""Wrenches on the body: of the ground (plates or a balance board), of a chair on its plate, and of force sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import GRAVITY, BoolArray, FloatArray, find_complete_rows
from mocap_id.errors import ConfigError, RecordingError, Refused
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics.base_motion import BaseMotion
from mocap_id.kinematics.plane import find_feet
from mocap_id.plates.choice import (
    PlateChoice,
    ZeroRule,
    compare_directions,
    find_contradictions,
    measure_empty_chair,
    weigh_person,
)
from mocap_id.plates.placement import (
    FootLoad,
    compare_with_feet,
    find_foot_beside,
    find_pinned_pressure,
    measure_lean,
    measure_load_share,
)
from mocap_id.recording import CELLS_BELOW_SURFACE_M, BoardLog, Plate, PlateSamples, Recording, ThinnedFrames
from mocap_id.recording.model import rotate_plate
from mocap_id.recording.sample_checks import describe_held, find_upright
from mocap_id.stages.base import Findings, find_markers
from mocap_id.stages.trial_keys import BalanceBoard, ExternalForce
from mocap_id.verdict import Reason

if TYPE_CHECKING:
    from mocap_id.stages.planarise.plane import UsedPart

# largest accepted distance of the force outside the outermost markers of a foot; up to 27 mm in good recordings
_MARGIN_M = 0.05
# largest accepted lean of the force under a standing person; up to 0.7° in good ones, due to the plate's bias
_LEAN = np.radians(2.0)
# largest accepted inclination of a plate according to its corners; up to 0.25° if they were measured with a marker
_INCLINED = np.radians(1.5)
# largest accepted angle about the vertical between force and acceleration: for all plates together, and for the plate
# of one foot, which also pushes sideways
_TURNED, _TURNED_ALONE = np.radians(30.0), np.radians(90.0)
# smallest coherence with the movement and smallest force for which a direction is judged
_COHERENT, _FORCE_N = 0.7, 5.0
# A horizontal force smaller than this fraction of the expected one is missing; good recordings have 0.4 to 1.2. It is
# judged if the expected one is at least the second value, N.
_WEAK, _EXPECTED_N = 0.15, 6.0
# least cosine of the angle between a dead channel and the motion, so that the motion plane depends on the channel
_ALONG = 0.2
# the lowest marker of a foot must not be below the surface, nor higher above it than an ankle
_SUNK_M, _HOVERING_M = 0.008, 0.12
# Share of the load on one foot below which the load of two feet is uneven. Healthy people have 0.4 to 0.5.
_UNEVEN = 0.25
# Largest accepted distance of the centre of pressure from the middle of the body, along the line from foot to foot: a
# length, and a fraction of the distance of the feet. In good recordings it is up to 0.013 m and 0.04.
_BODY_M, _BODY_SHARE = 0.035, 0.12


# faults that move the centre of pressure, so that it cannot be compared with the body
_EXPLAIN = ("plate-misplaced", "plate-moments-missing")
# distance of the centre of pressure from the feet above which nothing is identified: a unit or a position is wrong
_FAR_OFF_M = 1.0


def check_registration(
    plates: Sequence[Plate],
    samples: Sequence[PlateSamples],
    positions: FloatArray,
    rate: float,
    *,
    person: bool,
    yaw: float | None = 0.0,
    labels: Sequence[str] = (),
    others: Sequence[str] = (),
    follows: bool = False,
) -> tuple[Findings, str | None, bool]:
    """Compare the feet's plates with the markers.

    The results are facts for wrench.parquet with reasons to doubt the plates' positions; the reason why no
    parameter can be identified, or None; and whether the horizontal force along the plane is
    measured.

    ``samples`` are the plates' wrenches at the times of ``positions`` (F, M, 3), lab axes with Z up, m. ``person`` is
    False for a robot, which has no feet. ``yaw`` is the angle of the plane's x from the lab's X, rad; None in space,
    where every component of the force is needed. ``labels``, the M names of the markers, and ``others``, the plates
    that are not used and why, are for messages. If the vertical force ``follows`` the body, the size of the horizontal
    force is checked too.
    """
    out = Findings()
    if not plates:
        return out, None, True
    total = np.sum([each.force for each in samples], axis=0)
    found = compare_with_feet(plates, samples, positions) if person else []
    lean = measure_lean(total, positions, rate) if person else None
    whole = compare_directions(total, positions, rate)
    alone = [compare_directions(each.force, positions, rate) for each in samples] if len(plates) > 1 else []
    out.fact(
        plates=[
            {
                "index": each.index,
                "cop_off_feet_m": each.off_feet,
                "cop_off_feet_limit_m": None if each.off_feet is None else _MARGIN_M + each.allowance,
                "feet_over_surface_m": each.over_surface,
                "inclined_deg": None if each.inclined is None else float(np.degrees(each.inclined)),
            }
            for each in found
        ],
        standing_lean_deg=None if lean is None else np.degrees(lean).tolist(),
        turned=None
        if whole is None
        else {"angle_deg": float(np.degrees(whole.angle)), "coherence": whole.coherence, "rms": whole.size},
    )

    # centres of pressure that only wrong moments explain: beside the feet, or never away from the plate's centre
    pinned = {
        plate.index: away
        for plate, each in zip(plates, samples, strict=True)
        if (person or yaw is None) and (away := find_pinned_pressure(plate, each, positions)) is not None
    }
    unusable = None
    for each in found:
        limit, over = _MARGIN_M + each.allowance, each.over_surface
        if each.off_feet is not None and each.off_feet > limit and not pinned:
            text = (
                f"the centre of pressure of plate {each.index} lies up to {100 * each.off_feet:.0f} cm outside the "
                f"markers of the feet that stand on it, expected at most {100 * limit:.0f} cm: the ground cannot push "
                "there. The plate's corners (or its ORIGIN, moments or points of application) do not match the "
                "cameras' axes; measure them again and correct the file. Until then tauz, the centre of pressure and "
                "all parameters are wrong"
            )
            out.say("plate-misplaced", text, each.off_feet, limit)
            if each.off_feet > _FAR_OFF_M:
                unusable = unusable or text
        if over is not None and not -_SUNK_M <= over <= _HOVERING_M:
            sunk = over < 0
            out.say(
                "plate-height",
                f"the lowest marker of the feet is {abs(100 * over):.1f} cm {'below' if sunk else 'above'} the surface "
                f"of plate {each.index}, expected {'above it' if sunk else f'at most {100 * _HOVERING_M:.0f} cm'}: the "
                "corners' heights do not match the cameras' floor; measure them again. The moment is wrong by this "
                "height times Fx",
                over,
                -_SUNK_M if sunk else _HOVERING_M,
            )
    unknown = [each for each in found if each.unknown is not None]
    if unknown:
        numbers = " and ".join(str(each.index) for each in unknown)
        out.say(
            "plate-unchecked",
            f"it could not be checked whether plate {numbers} {'is' if len(unknown) == 1 else 'are'} where the file "
            f"says: {unknown[0].unknown}. The check needs markers on heel and toes of both feet; for a robot bolted to "
            "the plate, set `protocol: robot-joint`",
            level="ok",
        )

    # corners that are not level, or a force under a standing person that is not vertical
    inclined = max((each.inclined for each in found if each.inclined is not None), default=0.0)
    steepest, limit = float(np.degrees(inclined)), float(np.degrees(_INCLINED))
    leaning = 0.0 if lean is None else float(np.degrees(np.hypot(*lean)))
    corners = f"the corners incline a plate by {steepest:.1f}°, expected under {limit:.1f}°"
    confirmed = True  # whether the force leans as it would if the plates were level and their corners were wrong
    if inclined > _INCLINED and lean is not None:
        load = sum(each.load for each in found)
        expected = sum((each.normal[:2] * each.load for each in found if each.normal is not None), np.zeros(2)) / load
        confirmed = bool(lean @ expected > 0.5 * (expected @ expected))
    if inclined > _INCLINED and confirmed:
        evidence = ", and nobody stands still, so the force cannot confirm this"
        if lean is not None:
            evidence = (
                ", and the force under the standing person leans in the same direction, by "
                f"{leaning:.1f}°: the corners are wrong"
            )
        text = f"{corners}{evidence}. Measure them again; part of the weight may count as Fx and affect all parameters"
        out.say("plate-tilted", text, steepest, limit)
    elif lean is not None and np.hypot(*lean) > _LEAN:
        text = (
            f"the force under the standing person leans by {leaning:.1f}° from the vertical, expected under "
            f"{np.degrees(_LEAN):.1f}°: a plate is tilted, has crosstalk, or was not zeroed. Level and zero it; part "
            "of the weight counts as Fx, which makes all parameters wrong"
        )
        out.say("plate-tilted", text, leaning, float(np.degrees(_LEAN)))
    elif inclined > _INCLINED:
        text = f"{corners}; the force under the standing person is vertical, so the plate is assumed to be inclined"
        out.say("plate-tilted", text, steepest, limit, "ok")

    # horizontal forces that do not point along the acceleration of the body; one caution if their sum does not
    names = [("the plates" if len(plates) > 1 else f"plate {plates[0].index}", whole, _TURNED)]
    names += [(f"plate {plate.index}", each, _TURNED_ALONE) for plate, each in zip(plates, alone, strict=False)]
    for k, (name, force, limit) in enumerate(names):
        if force is None or not (force.coherence >= _COHERENT and force.size >= _FORCE_N and abs(force.angle) > limit):
            continue
        angle = float(np.degrees(force.angle))
        out.say(
            "plate-turned",
            f"the horizontal force of {name} points {angle:.0f}° away from the acceleration of the body (about the "
            f"vertical), expected within ± {np.degrees(limit):.0f}°: the corners are in another order, the plate's "
            "axes are rotated, or Fx and Fy have the wrong sign. Correct the file; Fx, tauz and all parameters are "
            "wrong",
            abs(angle),
            float(np.degrees(limit)),
        )
        if k == 0:
            break

    if pinned:
        unusable = (
            f"the centre of pressure never leaves the centre of plate {' and '.join(map(str, pinned))} (it moves by at "
            f"most {1e3 * max(pinned.values()):.1f} mm), expected some centimetres: the moments of the plate are "
            "missing or a thousand times too small. Check the moment channels (Mx, My) and their unit, and set "
            "`planarise: {moment_unit: …}` if the unit in the file is wrong"
        )
        out.say("plate-moments-missing", unusable, max(pinned.values()))

    # a foot beside the plates, or with a plate that reads too little
    off = find_foot_beside(plates, samples, positions) if person else None
    if off is not None:
        foot, beside, share = off
        out.fact(foot_beside={"beside_m": beside if np.isfinite(beside) else None, "share": share})
        outside = f" stands {100 * beside:.0f} cm beside every plate that is used" if beside > 0 else ""
        unused = f". Not used: {'; '.join(others)}" if others else ""
        out.say(
            "foot-off-plate",
            "the plates do not measure one foot: the foot with the markers "
            f"{_name_markers(foot, positions, labels)}{outside or ' carries no load'}, and the force acts under "
            f"the other foot ({100 * abs(share):.0f} % of the way to this foot, expected 30 to 70 %){unused}. "
            "Mass, wrench, torques and parameters are then far too small. Record with both feet on plates that "
            "are used; check the unused plates, and `plates: {feet: …}`, and whether the file contains all plates",
            abs(share),
            0.3,
        )
    uneven = measure_load_share(plates, samples, positions) if person else None
    if uneven is not None:
        out.fact(load_share={"measured": uneven.measured, "expected": uneven.expected})
        if off is None and not any(each.code in _EXPLAIN for each in out.reasons):
            _check_load(out, plates, _name_markers(uneven.foot, positions, labels), uneven)

    # horizontal channels that are dead; the results in the plane may not need them
    weak = None
    if follows and whole is not None and whole.expected >= _EXPECTED_N and whole.size < _WEAK * whole.expected:
        weak = whole
    direction = np.zeros(3) if yaw is None else np.array([np.cos(yaw), np.sin(yaw), 0.0])
    dead = {plate.index: plate.dead for plate in plates if plate.dead}
    along = any(yaw is None or abs(axis @ direction) > _ALONG for pairs in dead.values() for _, axis in pairs)
    listed = "; ".join(f"plate {index}: {', '.join(name for name, _ in pairs)}" for index, pairs in dead.items())
    channels = f"channels of horizontal force read the same value in every sample ({listed})"
    if weak is not None or along:
        if not dead:
            channels = "the horizontal force hardly varies"
        if weak is not None:
            channels += f" (it varies by {weak.size:.1f} N, expected about {weak.expected:.0f} N from the movement)"
        effect = (
            "A trial in space needs all components of the force, so no parameter can be identified"
            if yaw is None
            else "Fx is left out, as it is unmeasured. The parameters are fitted to Fy and tauz, and the moment "
            "contains an error of Fx times the depth of the plate's sensors"
        )
        text = (
            f"{channels}: a channel is dead, not connected or in a wrong unit. {effect}. Check cable, amplifier and "
            "`force_unit`"
        )
        out.say("plate-channel-dead", text)
        if yaw is None:
            unusable = unusable or text
    elif dead:
        text = (
            f"{channels}: they are dead. They measure across the motion, so the results in its plane do not depend on "
            "them"
        )
        out.say("plate-channel-dead", text, level="ok")
    return out, unusable, weak is None and not along


def _name_markers(foot: FloatArray, positions: FloatArray, labels: Sequence[str]) -> str:
    """Return the names of up to three markers at the mean positions ``foot`` (K, 3), m."""
    with np.errstate(invalid="ignore"):
        usual = np.nanmedian(positions[:: max(1, len(positions) // 1000)], axis=0)
    near = [int(np.nanargmin(np.linalg.norm(usual - point, axis=1))) for point in foot]
    names = [labels[k] for k in dict.fromkeys(near) if k < len(labels)]
    return ", ".join(names[:3]) + (" …" if len(names) > 3 else "")


def _check_load(out: Findings, plates: Sequence[Plate], markers: str, load: FootLoad) -> None:
    """Add a caution if one foot carries little load or the body is elsewhere; a note if the body confirms this."""
    measured, expected = load.measured, load.expected
    away = 0.0 if expected is None else abs(expected - measured)
    contradicts = away * load.width > _BODY_M and away > _BODY_SHARE
    if measured >= _UNEVEN and not contradicts:
        return
    loads = " and ".join(f"{load:.0f} N on plate {plate.index}" for plate, load in zip(plates, load.loads, strict=True))
    found = f"the foot with the markers {markers} carries {100 * measured:.0f} % of the load ({loads})"
    if expected is None:
        text = (
            f"{found}, expected at least {100 * _UNEVEN:.0f} %. Either the person unloads this leg, as patients do, or "
            "a plate has a wrong unit or gain; then mass, wrench, torques and parameters are wrong. The markers do not "
            "show the middle of the body, which would tell the two apart. Check units and gains of both plates, and "
            "compare the mass with `subject: {mass: …}`"
        )
        out.say("load-uneven", text, measured, _UNEVEN)
    elif contradicts:
        share = min(max(expected, 0.01), 0.99)
        factor = measured * (1.0 - share) / (max(share, 0.01) * (1.0 - measured))
        text = (
            f"{found}, but the body stands where this foot carries {100 * expected:.0f} %: who unloads a leg moves the "
            f"body over the other foot. Probably the plate of this foot reads {factor:.2f} times the true force "
            "compared with the other one: a wrong unit (pounds-force declared as newtons: 0.22) or gain; or the "
            "corners of the two plates are exchanged. Then wrench, torques and parameters are wrong, and with a wrong "
            "unit also the mass. It is no fault if the person leans on a support, or holds a "
            "load on one side. Check units and gains of both plates, and compare the mass with `subject: {mass: …}`"
        )
        out.say("load-uneven", text, measured, expected)
    else:
        text = (
            f"{found}. The body stands over the other foot as well (the middle of its markers gives "
            f"{100 * expected:.0f} %), so the person unloads this leg"
        )
        out.say("load-uneven", text, measured, _UNEVEN, "ok")


_UNRELATED, FOLLOWS = 0.62, 0.7
"""Correlation of vertical force and acceleration below which the two do not belong together, or are doubtful. It is at
least 0.86 in good recordings, and at most 0.57 with the forces of another movement."""

_BELONGS_LATE = 0.85  # correlation from which the forces belong to the markers with a clock offset above 1 s
# least variation of the vertical force, expected from the movement, for which the correlation is judged, N
_MOVES_N = 15.0
_FEW = 0.05  # fraction of the frames; fewer frames without plate samples give a note, more give a caution


def describe_plates(
    out: Findings,
    source: Recording,
    thinned: ThinnedFrames,
    choice: PlateChoice,
    external: ExternalWrenches,
    *,
    threshold: float,
) -> None:
    """Add facts about the plates and the standing mass, and reasons if a unit is assumed or no plate can be used."""
    plates, feet = source.plates, choice.indices("feet")
    for assumption in (text for index in feet for text in plates[index].assumptions):
        out.say(  # all forces and masses depend on the unit
            "plate-unit-assumed",
            f"{assumption}; if the unit is different, set `planarise: {{force_unit: …, moment_unit: …}}`.",
        )
    mass: float | None = None
    spread: list[float] | None = None
    why: str | None = "the recording has no force plates"
    if feet:
        vertical = sum((thinned.samples[index].force[:, 2] for index in feet), np.zeros(len(thinned.time)))
        vertical = vertical + external.vertical
        mass, why = weigh_person(thinned.positions, thinned.rate, vertical)
        upright = vertical[find_upright(thinned.positions)[0] & np.isfinite(vertical)]
        if mass is not None:
            spread = (np.percentile(upright, [10, 90]) / GRAVITY).tolist()
    else:
        if plates:
            causes = "; ".join(f"plate {plate.index}: {text}" for plate, text in zip(plates, choice.why, strict=True))
            why = f"none of the force plates is under the feet ({causes})"
        advice = " If there is a MOT file, name it: `recording: {markers: …, forces: …}`."
        message = f"{why}: only the kinematics can be identified."
        out.say("no-plate", message + (advice if source.format == "TRC" and not plates else ""))
    out.fact(
        plates=[
            {
                "index": plate.index,
                "kind": plate.kind,
                "use": use,
                "mean_vertical_N": None if not np.isfinite(load) else load,
                "why": text,
            }
            for plate, use, load, text in zip(plates, choice.uses, choice.loads, choice.why, strict=True)
        ],
        external=external.facts,
        mass_kg=mass,
        mass_range_kg=spread,  # 10th and 90th percentile while upright: a load in the hands widens it
        why=why,
        analog_rate_hz=source.analog_rate,
        cop_threshold_N=threshold,
    )


def describe_losses(
    out: Findings, plates: Sequence[Plate], time: FloatArray, dropout: BoolArray, corrected: float
) -> None:
    """Add reasons for samples of the feet's plates that cannot be used in an identification.

    ``time`` (F,) are the marker times, s; ``dropout`` (F,) marks the frames from
    :func:`mocap_id.plates.choice.find_dropouts`; ``corrected`` is the clock offset by which the times of the plates
    were corrected, s.
    """
    for plate in plates:
        if plate.saturated is not None:
            stamped = plate.start + np.arange(len(plate.ok)) / plate.rate
            share = float(plate.saturated[(stamped >= time[0]) & (stamped <= time[-1])].mean())
            if share != 0.0:
                out.say(
                    "plate-saturated",
                    f"plate {plate.index} is at the end of its range in {100 * share:.1f} % of its samples, expected "
                    "none: they are left out, and with them the largest forces of the movement. Choose a larger range "
                    "of its amplifier",
                    share,
                    0.0,
                )
        # frames before the plate's first sample or after its last by more than one interval
        slack = 1.0 / plate.rate + float(np.median(np.diff(time)))
        end = plate.start + (len(plate.ok) - 1) / plate.rate
        share = float(np.mean((time < plate.start - slack) | (time > end + slack)))
        if share != 0.0:
            clocks = f" (on the cameras' clock: {corrected:+.2f} s)" if corrected else ""
            out.say(
                "plate-short",
                f"the forces of plate {plate.index} run from {plate.start:.2f} to {end:.2f} s{clocks} and the markers "
                f"from {time[0]:.2f} to {time[-1]:.2f} s: {100 * share:.0f} % of the frames have no force and are not "
                "used for the identification. Export both completely, and check that they belong to the same trial",
                share,
                _FEW,
                "caution" if share > _FEW else "ok",
            )
    if dropout.any():
        out.say(
            "plate-dropout",
            f"the plates show no load in {100 * dropout.mean():.0f} % of the frames, from "
            f"{time[np.argmax(dropout)]:.2f} s on, while the person stands on them; possible causes are a loose cable, "
            "a reset of the amplifier, or a step off the plates. These frames are left out; check the plates' signal "
            "there, or set a `window:` without them",
            float(dropout.mean()),
            0.0,
        )


def judge_course(
    course: tuple[float, float, float] | None, markers: Sequence[Path], forces: Path | BalanceBoard | None
) -> tuple[Reason, ...]:
    """Return a caution if the vertical force hardly follows the body; raise Refused if it does not follow it at all.

    ``course`` is the result of :func:`mocap_id.plates.choice.compare_courses`.
    """
    if course is None:
        return ()
    correlation, correlation_far, expected = course
    if expected < _MOVES_N or correlation >= FOLLOWS or correlation_far >= _BELONGS_LATE:
        return ()  # if they fit late, the forces belong to the markers; the clock offset is estimated in identify-dim
    file = forces.balance_board if isinstance(forces, BalanceBoard) else forces
    of = f"{file.name} and {markers[0].name}" if file is not None else f"the forces and markers of {markers[0].name}"
    found = (
        "the vertical force does not follow the vertical acceleration of the body: their correlation is "
        f"{correlation:.2f} for clock offsets up to 1 s, and at most {correlation_far:.2f} for all "
        "others, expected above 0.9"
    )
    if correlation >= _UNRELATED:
        text = (
            f"{found}. Check that {of} belong to the same recording, the rates of both, and whether something other "
            "than the plates carries the person"
        )
        return (Reason("forces-unrelated", text, correlation, FOLLOWS),)
    raise Refused(
        "forces-unrelated",
        f"{of} do not belong together: {found}. Give the forces of this recording, check that both have the right "
        "rate, or leave the forces out to get the kinematics alone",
        correlation,
        _UNRELATED,
    )


COMPONENTS = ("Fx", "Fy", "tauz")
"""Components of a wrench in the plane."""

_IN_SPACE = ("Fx", "Fy", "Fz", "taux", "tauy", "tauz")
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])  # of a wrench, for z → -z: moments are axial vectors


@dataclass
class ExternalWrenches:
    """External wrenches at the F frames, for wrench.parquet; they are added one after another."""

    columns: dict[str, FloatArray] = field(default_factory=dict)  # (F,) by name
    facts: list[dict[str, Any]] = field(default_factory=list)  # fact ``external``
    reasons: list[Reason] = field(default_factory=list)
    vertical: FloatArray | float = 0.0  # upward force at the thinned frames, N

    def add(self, name: str, suffix: str, wrench: FloatArray, **fact: Any) -> None:
        """Add a wrench (F, 3) in the plane, the suffix of its columns, and the rest of its fact."""
        self.columns |= {f"{each}_{suffix}": column for each, column in zip(COMPONENTS, wrench.T.copy(), strict=True)}
        self.facts.append({"name": name, "columns": suffix, **fact})


def add_wrenches(
    samples: Sequence[PlateSamples], plates: Sequence[int], frame: PlaneFrame
) -> tuple[FloatArray, BoolArray]:
    """Return the sum of the wrenches of ``plates`` in the plane (F, 3), and the samples (F,) in which all are valid."""
    each = [frame.wrench_to_plane(samples[index].force, samples[index].moment) for index in plates]
    return sum(each[1:], each[0]), np.logical_and.reduce([samples[index].ok for index in plates], axis=0)


def measure_seat(
    external: ExternalWrenches,
    choice: PlateChoice,
    samples: Sequence[PlateSamples],
    thinned: ThinnedFrames,
    frame: PlaneFrame,
    *,
    zero: ZeroRule,
    time: FloatArray,
    base: BaseMotion | None = None,
) -> None:
    """Add the chair's wrench on the body, measured by the plates under the chair; no columns if there are none.

    ``samples`` are the wrenches of all plates at the marker times ``time`` (F,), s; ``base`` is None if the base never
    moves.
    """
    doubts = find_contradictions(thinned.samples, choice, thinned.positions)
    for index, why in doubts.items():
        advice = "it looks like a chair's, but was added to the feet's; if a chair stands on it, name it under `seat:`"
        if choice.uses[index] == "seat":
            advice = (
                "a chair does not do this; its wrench was left out. Are they swapped in `plates: {feet: …, seat: …}`?"
            )
        text = f"plate {index + 1}, named under `{choice.uses[index]}:`, {why}: {advice}"
        external.reasons.append(Reason("plates-doubtful", text))
    plates = [index for index in choice.indices("seat") if index not in doubts]
    if not plates:
        return
    wrench, ok = add_wrenches(samples, plates, frame)
    reading, spread = measure_empty_chair(
        *add_wrenches(thinned.samples, plates, frame), thinned.positions, thinned.rate, zero
    )
    if reading is None:
        text = (
            "the person never stands in these frames, so the reading of the empty chair's plate is not known. It was "
            "not corrected, and the chair's weight counts as the person's. If the plate was zeroed with the chair on "
            "it, set `planarise: {seat_zero: none}`"
        )
        external.reasons.append(Reason("seat-zero-unknown", text))
    else:
        wrench = wrench - reading
    if base is not None:  # the base moves, and the chair does not
        chair = np.zeros(3) if reading is None else reading
        x, y, z = frame.axes
        weight = chair[0] * x + chair[1] * y
        force = sum((samples[index].force for index in plates), -weight)
        moment = sum((samples[index].moment for index in plates), -chair[2] * z - np.cross(frame.origin, weight))
        wrench = frame.wrench_to_plane(*base.undo_wrench(force, moment, time))
    wrench[~ok] = np.nan
    named = [None if each is None else dict(zip(COMPONENTS, each.tolist(), strict=True)) for each in (reading, spread)]
    numbers = [index + 1 for index in plates]
    external.add("seat", "seat", wrench, clock="plates", plates=numbers, zero=named[0], zero_sd=named[1])


def measure_sensors(  # noqa: PLR0917
    external: ExternalWrenches,
    sensors: Sequence[ExternalForce],
    part: UsedPart,
    thinned: ThinnedFrames,
    frame: PlaneFrame,
    base: BaseMotion | None,
) -> None:
    """Add the wrenches of the sensors in the configuration.

    Raises ConfigError if the marker at which a force acts does not exist. Raises RecordingError if a sensor's file is
    unusable or shares no time with the recording.
    """
    time, to_z_up = part.time, recording.to_z_up(part.source.vertical)
    for number, sensor in enumerate(sensors, start=1):
        (log, held), offset = recording.read_force_log(sensor.file), sensor.clock_offset_s
        turn = to_z_up * (-1.0 if sensor.force == "on-sensor" else 1.0)
        plate = replace(rotate_plate(log, turn), start=log.start + offset)
        sampled = recording.decimate(plate, time, part.source.rate)
        if not sampled.ok.any():
            end = log.start + (len(log.ok) - 1) / log.rate + offset
            raise RecordingError(
                f"{sensor.file}: it has no sample between {time[0]:g} and {time[-1]:g} s, the times of the "
                f"recording; it runs from {plate.start:g} to {end:g} s on the same clock (with "
                f"`clock_offset_s: {offset:g}`): check `time_s` and the offset"
            )
        if isinstance(sensor.at, str):
            found = find_markers(part.labels, (sensor.at,), f"external: {sensor.name}: at")
            if len(found) > 1:
                raise ConfigError(
                    f"external: {sensor.name}: at: {sensor.at} matches {len(found)} markers, expected one"
                )
            point = part.positions[:, found[0]]
        else:
            point = np.asarray(to_z_up @ np.array(sensor.at))
        acting = sampled.force, sampled.moment + np.cross(point, sampled.force)
        if base is not None:
            acting = base.undo_wrench(*acting, time)
        wrench = frame.wrench_to_plane(*acting)
        known = find_complete_rows(wrench)
        wrench[~known] = np.nan
        external.add(
            sensor.name,
            f"external_{number}",
            wrench,
            clock="cameras",
            segment=sensor.segment,
            file=sensor.file.name,
            rate_hz=log.rate,
            known_fraction=float(known.mean()),
            measures=sensor.measures,
        )
        external.reasons += describe_held(held, time[0] - offset, time[-1] - offset)
        if sensor.measures != "beyond":  # a force of the surroundings
            vertical = recording.decimate(plate, thinned.time, thinned.rate).force[:, 2]
            external.vertical = external.vertical + vertical


def compute_ground_wrench(
    time: FloatArray, samples: Sequence[PlateSamples], choice: PlateChoice, frame: PlaneFrame, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns of wrench.parquet: the sum of the feet's plates and, if several plates exist, each plate alone.

    ``samples`` are the wrenches of all plates at the marker times ``time`` (F,), s. The centre of pressure is NaN up to
    the vertical force ``threshold``, N.
    """
    feet, count = choice.indices("feet"), len(time)
    total, ok = add_wrenches(samples, feet, frame) if feet else (np.empty((count, 3)), np.zeros(count, np.bool_))
    columns = _build_columns(time, COMPONENTS, total, ok, threshold)
    if len(samples) > 1:
        for number, plate in enumerate(samples, start=1):
            alone = frame.wrench_to_plane(plate.force, plate.moment).T.copy()
            columns |= {f"{name}_p{number}": each for name, each in zip(COMPONENTS, alone, strict=True)}
    return columns


def compute_ground_wrench_in_space(
    time: FloatArray,
    samples: Sequence[PlateSamples],
    choice: PlateChoice,
    frame: PlaneFrame,
    threshold: float,
    *,
    mirrored: bool = False,
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the same columns in space, with six components, about the origin of the trial's frame (y up).

    ``mirrored`` says whether the trial is mirrored, z → -z.
    """
    feet, count = choice.indices("feet"), len(time)
    ok = np.logical_and.reduce([samples[index].ok for index in feet]) if feet else np.zeros(count, np.bool_)
    force = sum((samples[index].force for index in feet), np.zeros((count, 3)))
    moment = sum((samples[index].moment for index in feet), np.zeros((count, 3))) - np.cross(frame.origin, force)
    total = np.concatenate([force @ frame.axes.T, moment @ frame.axes.T], axis=1)
    if mirrored:
        total *= _MIRROR
    return _build_columns(time, _IN_SPACE, total, ok, threshold)


def _build_columns(
    time: FloatArray, names: Sequence[str], total: FloatArray, ok: BoolArray, threshold: float
) -> dict[str, np.ndarray[Any, Any]]:
    """Return the columns of a wrench (F, len(names)) whose second component is Fy and whose last is tauz."""
    total[~ok] = np.nan
    with np.errstate(invalid="ignore"):
        vertical = np.where(total[:, 1] > threshold, total[:, 1], np.nan)
    components = dict(zip(names, total.T.copy(), strict=True))
    return {"time": time, **components, "cop_x": total[:, -1] / vertical, "plate_ok": ok}


def find_plates_centre(
    plates: Sequence[Plate], choice: PlateChoice, frame: PlaneFrame, *, mirrored: bool
) -> list[float] | None:
    """Return the centre (3,) of the feet's plates in the frame of a trial in space, m; None if it is not known."""
    centres = [plates[index].centre for index in choice.indices("feet")]
    known = [each for each in centres if each is not None]
    if not known or len(known) < len(centres):
        return None
    centre = frame.to_plane(np.mean(known, axis=0))
    return [float(x) for x in (centre * [1.0, 1.0, -1.0] if mirrored else centre)]


_LOADED = 0.9  # fraction of the usual largest load above which the person is off the chair
_SMOOTH_S = 0.15
_MOSTLY_ALONG = 2.0  # smallest ratio of the movements of the centre of pressure along and across the motion
_EXPLAINED = 0.5  # smallest fraction of the variance of the centre of pressure that the movement of the body explains
_DIRECTIONS = {"forwards": (1.0, 0.0), "backwards": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
_FEW_GAPS = 0.02
_STANDS_N = 50.0


def read_board_plate(board: Path | BalanceBoard | None, source: Recording) -> tuple[BoardLog | None, Recording]:
    """Return the log, and the recording with the board as its only plate, whose moments are still zero.

    Without a board, the log is None and the recording does not change. Raises RecordingError if the log is unusable or
    shares no time with the recording.
    """
    if not isinstance(board, BalanceBoard):
        return None, source
    log = recording.read_board(board.balance_board, board.loads)
    start, end = log.start + board.clock_offset_s, log.start + board.clock_offset_s + (len(log.ok) - 1) / log.rate
    if start > source.time[-1] or end < source.time[0]:
        raise RecordingError(
            f"{board.balance_board}: the log shares no time with the recording: with `clock_offset_s: "
            f"{board.clock_offset_s:g}` it runs from {start:g} to {end:g} s, but the recording from "
            f"{source.time[0]:g} to {source.time[-1]:g} s. Correct `clock_offset_s:` to about 0.1 s; it is the "
            "recording's time minus `time_s`"
        )
    force = np.column_stack([np.zeros((len(log.force), 2)), log.force])
    ok = log.ok if not log.problem else np.zeros_like(log.ok)
    force[~ok] = np.nan
    plate = Plate(1, "balance board", None, force, np.zeros_like(force), ok, log.rate, start, log.problem)
    return log, replace(source, plates=(plate,), analog_rate=log.rate, held=source.held + log.held)


def place_board(
    board: BalanceBoard, log: BoardLog, source: Recording, thinned: ThinnedFrames, frame: PlaneFrame, *, faces: float
) -> tuple[Plate, FloatArray, dict[str, Any], tuple[Reason, ...]]:
    """Determine the board's position from the configuration, or else from the movement of the body and the feet.

    The position along the motion is only a first estimate; identify-dim improves it with the model. ``source`` contains
    the board's plate. ``faces`` is 1 if the person faces the plane's x, and -1 if the person faces the opposite
    direction.

    Return the plate, whose horizontal force is 0 because it is not measured; the origin (3,) of the plane frame at the
    height of the cells, so that tauz needs no horizontal force, m; the fact ``board`` of wrench.parquet; and reasons.
    """
    plate, load = source.plates[0], thinned.samples[0].force[:, 2]
    forwards = faces * frame.axes[0, :2]
    basis = np.stack([forwards, [-forwards[1], forwards[0]]])
    on_board = replace(plate, force=np.pad(log.moment, ((0, 0), (0, 1))))
    sampled = recording.decimate(on_board, thinned.time, thinned.rate).force[:, :2]
    pressure = sampled / np.where(load > _STANDS_N, load, np.nan)[:, None]
    top, sure = _find_direction(pressure, load, thinned.positions @ np.append(forwards, 0.0), thinned.rate)
    if board.top is not None:
        top, sure = board.top, True
    up = np.array(_DIRECTIONS[top]) @ basis
    axes = np.stack([[up[1], -up[0]], up])  # to the right, towards the top
    usual = np.nan_to_num(np.nanmedian(pressure @ axes, axis=0))
    if board.centre_m is not None:
        centre = np.asarray(recording.to_z_up(source.vertical) @ np.array(board.centre_m))
    else:
        feet = find_feet(thinned.positions)
        lowest = float(np.nanmin(np.nanmedian(thinned.positions[:, :, 2], axis=0)))
        height = CELLS_BELOW_SURFACE_M if lowest >= CELLS_BELOW_SURFACE_M else 0.0  # on the floor, or sunk into it
        centre = np.array([*(feet[:2] - usual), height])
    lever = log.force[:, None] * centre[:2] + log.moment @ axes
    moment = np.column_stack([lever[:, 1], -lever[:, 0], np.zeros(len(lever))])
    facts = {
        "file": board.balance_board.name,
        "top": top,
        "top_sure": sure,
        "centre_m": centre.tolist(),
        "centre_given": board.centre_m is not None,
        "cells_below_surface_m": CELLS_BELOW_SURFACE_M,
        "averaged_s": log.averaged,
        "interval_s": log.interval,
    }
    out = Findings()
    out.say(
        "board-vertical-only",
        "the ground's force comes from a balance board, which measures the vertical force and the centre of pressure "
        "at its cells. The parameters are fitted to Fy and tauz; Fx is computed by the model, and no measurement "
        "checks it",
        level="ok",
    )
    if log.gaps:
        share = float(1.0 - log.ok.mean())
        out.say(
            "board-gaps",
            f"the balance board sent no data {log.gaps} times for more than 0.15 s ({100 * share:.1f} % of its time): "
            "these samples are left out. Bring the receiver closer, and close other programs",
            share,
            _FEW_GAPS,
            "caution" if share > _FEW_GAPS else "ok",
        )
    origin = np.array([0.0, 0.0, centre[2] - CELLS_BELOW_SURFACE_M])
    return replace(plate, moment=moment), origin, facts, tuple(out.reasons)


def _find_direction(pressure: FloatArray, load: FloatArray, along: FloatArray, rate: float) -> tuple[str, bool]:
    """Return the direction from the board's centre to its top as seen by the person, and whether it is certain.

    The centre of pressure moves mostly along the motion. While the person is off the chair, it follows the body, minus
    a part that is proportional to the body's acceleration. ``pressure`` (F, 2) is its position to the right of the
    board's centre and towards the top, m; ``load`` (F,) is in N; ``along`` (F, M) are the coordinates of the markers in
    the direction in which the person faces, m; ``rate`` is in Hz.
    """
    body = np.nanmean(along - np.nanmean(along, axis=0), axis=1)
    width = max(1, round(_SMOOTH_S * rate))
    kernel = np.convolve(np.ones(width) / width, np.ones(width) / width)
    body = np.convolve(np.nan_to_num(body), kernel, mode="same")
    with np.errstate(invalid="ignore"):
        chosen = (load > _LOADED * np.nanpercentile(load, 95)) & np.isfinite(pressure).all(axis=1)
    chosen[:width] = chosen[-width:] = False
    if chosen.sum() < rate or np.ptp(body[chosen]) == 0.0:
        return "forwards", False
    series = pressure[chosen] - pressure[chosen].mean(axis=0)
    spread = series.std(axis=0)
    axis = int(np.argmax(spread))
    rows = np.column_stack([np.ones(len(series)), body[chosen], np.gradient(np.gradient(body))[chosen]])
    slope, *_ = np.linalg.lstsq(rows, series[:, axis], rcond=None)
    explained = 1.0 - float(np.var(series[:, axis] - rows @ slope)) / float(spread[axis] ** 2)
    name = (("left", "forwards") if slope[1] > 0.0 else ("right", "backwards"))[axis]
    return name, bool(spread[axis] > _MOSTLY_ALONG * spread[1 - axis] and explained > _EXPLAINED)
