"""Inputs from the artefacts, reference bodies, place of a balance board, checks of sensors, what can be identified."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, get_args

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.cautions import WrenchGain, estimate_gains
from mocap_id.dynamics.fit import LEAST_SECONDS, Fit, determines_parameters, fit, select_samples
from mocap_id.dynamics.instrument_errors import KinematicError, propagate_to_parameters
from mocap_id.dynamics.prediction import agreement, centre_of_pressure
from mocap_id.dynamics.preparation import (
    CoarseClock,
    FitSettings,
    PreparedTrial,
    SampledWrench,
    TrialData,
    blank_incomplete,
    measure_arcs,
    prepare,
    profile_offset,
)
from mocap_id.dynamics.priors import TableName, compute_foot_sd, compute_reference_sd, estimate_height, look_up_table
from mocap_id.dynamics.regressor import SEAT, WRENCH_COMPONENTS, ExternalWrench
from mocap_id.errors import ConfigError, StoreError
from mocap_id.protocols.body_names import GROUND, ReferenceBody, build_reference_body, make_empty_reference
from mocap_id.protocols.movement import Movement, find_facing
from mocap_id.protocols.repetitions import measure_standing_angles
from mocap_id.stages import skin_motion
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.store import Table
from mocap_id.store.artefacts import Skeleton, joint_columns
from mocap_id.verdict import Reason

_SEARCH = 0.15  # s: range of the fit's search around the coarse offset, whose error is up to 0.04 s
_VERTICAL = (1, 2)  # Fy and tauz
_POSITION_SD, _ROBOT_POSITION_SD = 0.005, 0.001  # m, of the plate, and of one to which a robot is bolted
_THIGH = "thigh"
_THIGH_NUMBER = 2  # number of the thigh in a chain whose base is the foot


def read_trial_data(context: Context, chain: Skeleton) -> TrialData:
    """Return the joint states and wrenches of a trial in the plane.

    Raises StoreError if states and wrench have different times, ConfigError if a segment does not exist.
    """
    states = context.table("states.parquet")
    wrench, clock = read_wrench(context)
    time = read_common_time(context, "states.parquet")
    joints, board = len(chain.centres), wrench.facts.get("board")
    ground = wrench.stack(WRENCH_COMPONENTS)
    vertical_only = board is not None or not wrench.facts.get("horizontal_measured", True)
    if vertical_only:
        ground[:, 0] = 0.0
    external: dict[str, list[ExternalWrench]] = {"contact": [], "beyond": []}
    wrenches = wrench.facts.get("external") or ()
    for fact in sorted(wrenches, key=lambda each: each.get("measures", "contact") == "beyond"):
        name = fact["name"]
        if name != SEAT:
            segment = _find_segment_number(chain.segments, fact.get("segment"), f"external: {name}: segment")
        elif context.settings.seat_plate:
            segment = find_seat_segment(context, chain.segments)
        else:
            continue
        values = wrench.stack([f"{component}_{fact['columns']}" for component in WRENCH_COMPONENTS])
        one = ExternalWrench(name, segment, values, by_plates=fact["clock"] == "plates")
        external[fact.get("measures", "contact")].append(one)
    recorded = TrialData(
        time=time,
        q=joint_columns(states, "theta", joints),
        dq=joint_columns(states, "dtheta", joints),
        ddq=joint_columns(states, "ddtheta", joints),
        ddq_sd=joint_columns(states, "sd_ddtheta", joints),
        observed=np.logical_and.reduce([states[f"observed_{j}"] for j in range(1, joints + 1)]),
        wrench=np.where(wrench["plate_ok"][:, None], ground, np.nan),
        centres=chain.centres,
        external=tuple(external["contact"]),
        built_in=tuple(external["beyond"]),
        knee=max(0, _find_thigh(chain.segments) - 1),
        measures=_VERTICAL if vertical_only else (0, 1, 2),
        clock=clock,
    )
    averaged = recording.compute_averaging_width(wrench.facts["analog_rate_hz"], recorded.rate)
    if board is None:
        return replace(recorded, averaged=averaged)
    averaged = float(np.hypot(averaged, board["averaged_s"]))
    return replace(recorded, averaged=averaged, surface=float(board["cells_below_surface_m"]))


def read_wrench(context: Context) -> tuple[Table, CoarseClock]:
    """Return wrench.parquet and its coarse clock offset.

    The plates' clock is corrected by this offset, except if the settings forbid the correction or so large an offset.
    """
    table, settings = context.table("wrench.parquet"), context.settings
    found, limit = table.facts.get("clock") or {}, settings.clock_offset_limit_s
    offset, doubt = float(found.get("offset_s") or 0.0), found.get("why")
    search = _SEARCH if limit is None else limit if found.get("peak_s") is None or doubt else min(limit, _SEARCH)
    if limit is not None and abs(offset) > limit:
        doubt = (
            f"the forces follow the movement best at {offset:+.2f} s, but the limit in the settings is ± {limit:g} s"
        )
    elif not offset or settings.apply_clock_offset:
        return table, CoarseClock(offset, doubt, search)
    else:  # the fit finds the whole offset and does not apply it
        search += abs(offset)
    time = table["time"]
    shift = round(offset * (len(time) - 1) / (time[-1] - time[0]))
    sensors = [fact["columns"] for fact in table.facts.get("external") or () if fact["clock"] != "plates"]
    fixed = {"time", *(f"{name}_{sensor}" for name in WRENCH_COMPONENTS for sensor in sensors)}
    columns = {}
    for name in set(table.names) - fixed:
        columns[name] = np.full_like(table[name], False if name == "plate_ok" else np.nan)
        kept = slice(max(-shift, 0), len(time) - max(shift, 0))
        columns[name][kept] = table[name][kept.start + shift : kept.stop + shift]
    return table.with_columns(**columns), CoarseClock(0.0, doubt, search)


def make_fit_settings(settings: IdentifyDimSettings, components: Iterable[int], search: float) -> FitSettings:
    """Return the settings of the fit of some components of the wrench; ``search`` is the largest clock offset, s."""
    return FitSettings(
        components=tuple(components),
        cutoff=settings.cutoff_hz,
        offset_limit=search,
        apply_offset=settings.apply_clock_offset,
        plate_bias=settings.plate_bias,
        plate_zero=(settings.plate_zero_sd_n, settings.plate_zero_sd_nm),
        block=settings.block_s,
        gravity=settings.gravity,
    )


def read_plate_position_sd(context: Context) -> float:
    """Return the standard deviation of the plate's position, m; a robot is bolted to its plate."""
    given: float | None = context.settings.plate_position_sd_m
    usual = _ROBOT_POSITION_SD if context.trial.protocol == "robot-joint" else _POSITION_SD
    return usual if given is None else given


def read_common_time(context: Context, file: str) -> FloatArray:
    """Return the sample times (T,) of a motion file, s; StoreError if wrench.parquet has other times."""
    time, plate_time = context.table(file)["time"], context.table("wrench.parquet")["time"]
    if len(time) != len(plate_time) or not np.allclose(time, plate_time, atol=1e-6):
        raise StoreError(
            f"trial {context.trial.trial}, identify-dim: {file} ({len(time)} samples) and wrench.parquet "
            f"({len(plate_time)}) have different sample times; run the trial again from planarise"
        )
    return time


def read_cop_threshold(context: Context) -> float:
    """Return the largest vertical force without a centre of pressure, N, as in planarise."""
    return float(context.table("wrench.parquet").facts["cop_threshold_N"])


def find_seat_segment(context: Context, segments: Sequence[str]) -> int:
    """Return the number of the segment on which the chair pushes; ConfigError if the setting names no segment."""
    given = context.settings.seat_segment
    given = _find_thigh(segments) if given is None else given
    return _find_segment_number(segments, given, "identify-dim: seat_segment")


def _find_segment_number(names: Sequence[str], given: str | int, key: str) -> int:
    """Return the number of a segment that is given by name or number; ConfigError if it does not exist."""
    if isinstance(given, int) and 0 <= given < len(names):
        return given
    if given in names:
        return names.index(str(given))
    listed = ", ".join(f"{number} ({name})" for number, name in enumerate(names))
    raise ConfigError(f"{key}: there is no segment {given!r} here; expected one of {listed}")


def _find_thigh(names: Sequence[str]) -> int:
    """Return the number of the segment named thigh, or else 2, or the last number if there are fewer segments."""
    return names.index(_THIGH) if _THIGH in names else min(_THIGH_NUMBER, len(names) - 1)


def read_kinematic_error(context: Context) -> KinematicError:
    """Return the effect of skin motion on the joint centres and angles of the chain."""
    skin = skin_motion.read_skin_tree(context.tree("skin.h5"))
    centres, turned = skin.stored_chain_errors()
    return KinematicError(lambda q: skin.errors(q)[0] + turned, centres)


@dataclass(frozen=True)
class ReferenceBodies:
    """Reference bodies with the chain of a trial."""

    chosen: ReferenceBody  # body from the table in the settings
    every: tuple[ReferenceBody, ...]  # bodies from all tables, in a fixed order; empty without a reference body


def build_reference_bodies(context: Context, recorded: TrialData, movement: Movement) -> ReferenceBodies:
    """Return the reference bodies of a sit-to-stand trial; for other protocols, there is no reference body."""
    settings, subject, chain = context.settings, context.trial.subject, recorded.centres
    if context.trial.protocol != "sit-to-stand":
        return ReferenceBodies(make_empty_reference(len(chain), None), ())
    why = None
    if context.tree("chain.h5").texts("segments/name")[:1] == (GROUND,):
        why = "the tables are for people whose feet are flat on the ground"
    elif not np.isfinite(recorded.q).all(axis=1).any():
        why = "no sample has all joint angles"
    if why is not None:
        return ReferenceBodies(make_empty_reference(len(chain), why), ())
    mass = context.table("wrench.parquet").facts.get("mass_kg")
    if mass is None and movement.contact is not None and np.isfinite(movement.contact.weight):
        mass = movement.contact.weight / settings.gravity
    bodies = {
        name: build_reference_body(
            name,
            chain,
            find_facing(recorded),
            height=subject.height,
            mass=subject.mass,
            sex=subject.sex,
            plate_mass=mass,
            standing=None if movement.posture is None else measure_standing_angles(recorded.q, movement.posture),
        )
        for name in get_args(TableName)
    }
    chosen = bodies[settings.reference]
    return ReferenceBodies(chosen, () if chosen.table is None else tuple(bodies.values()))


def compare_references(
    bodies: ReferenceBodies,
    regressor: FloatArray,
    measured: FloatArray,
    samples: BoolArray,
    threshold: float,
    *,
    external: FloatArray,
) -> dict[str, Any] | None:
    """Return JSON about the reference bodies and the errors of their wrench, by table; None without reference bodies.

    The wrench by the full ``regressor`` (T, 3, 4(n + 1)) minus ``external`` (T, 3) is compared with that of the ground.
    """
    found = {
        str(body.table): {
            "height_m": body.height,
            "mass_kg": body.mass,
            "assumed": list(body.assumed),
            **describe_errors(regressor @ body.parameters - external, measured, samples, threshold),
        }
        for body in bodies.every
    }
    return found or None


def describe_errors(
    model: FloatArray,
    measured: FloatArray,
    samples: BoolArray,
    threshold: float,
    components: Sequence[str] = WRENCH_COMPONENTS,
) -> dict[str, Any]:
    """Return JSON about the errors of a wrench (T, C) and its centre of pressure in some samples (T,)."""
    planar = [components.index(name) for name in WRENCH_COMPONENTS]
    wrench = {name: agreement(model[:, k], measured[:, k], samples) for k, name in enumerate(components)}
    pressures = [centre_of_pressure(each[:, planar], threshold) for each in (model, measured)]
    cop = agreement(pressures[0], pressures[1], samples)
    return {
        "wrench": {name: None if one is None else asdict(one) for name, one in wrench.items()},
        "cop_rms_m": None if cop is None else float(np.hypot(cop.bias, cop.sd)),
    }


_TAUZ = 2
_INERTIA = 3  # index of Izz among the four parameters of a segment
_ROUNDS = 2  # the response depends on the clock offset and the weights, so the shift is estimated twice
FOOT_SD = 0.001
"""Standard deviation of the foot's first moment divided by the body's mass, m; people's feet have 3 % of this mass."""
_REPEATED_SD = 0.0025  # m: joint errors that are the same in all repetitions, from simulated trials
_GIVEN_SD, _FEET_SD = 0.005, 0.03  # m: standard deviation of a position from the configuration, and from the feet
_CLEARLY = 3.0  # smallest ratio of misfits of opposite and assumed direction for certainty; 2 to 200 simulated
_FITTED = 0.9  # smallest r² of tauz; in simulations at least 0.98 for the right direction, at most 0.6 for the opposite
_OPPOSITE = {"forwards": "backwards", "backwards": "forwards", "left": "right", "right": "left"}


def locate_board(
    context: Context, prepared: PreparedTrial, movement: Movement
) -> tuple[PreparedTrial, dict[str, Any] | None]:
    """Return the trial with the board at its estimated position, and the fact ``board`` of dynamics.h5.

    If the board is e away from its assumed position (from the configuration, or under the feet), the moment is e·Fy too
    large. Without a board, the trial is unchanged and the fact is None.
    """
    board = context.table("wrench.parquet").facts.get("board")
    if board is None:
        return prepared, None
    shift = _estimate_shift(context, prepared, movement)
    mirrored = None if shift is None else _estimate_shift(context, _change_moment(prepared, -1.0), movement)
    worse = None if shift is None or mirrored is None else mirrored[2] / shift[2]
    if board["centre_given"] or shift is None:
        sd, by = (_GIVEN_SD, "configuration") if board["centre_given"] else (_FEET_SD, "feet")
        return _change_moment(prepared, sd=sd), {"shift_m": 0.0, "sd_m": sd, "by": by, "mirrored_misfit": worse}
    total = 0.0
    for _ in range(_ROUNDS):
        value, sd, _ = shift
        total, prepared = total + value, _change_moment(prepared, shift=value, sd=sd)
        shift = _estimate_shift(context, prepared, movement) or shift
    return prepared, {"shift_m": total, "sd_m": shift[1], "by": "model", "mirrored_misfit": worse}


def explain_board(out: Findings, context: Context, facts: dict[str, Any]) -> None:
    """Add cautions about the board's direction and position, from the facts of dynamics.h5."""
    fact = facts.get("board")
    if fact is None:
        return
    board, worse = context.table("wrench.parquet").facts["board"], fact["mirrored_misfit"]
    fitted = facts["wrench"]["tauz"]
    poor = fitted is None or fitted["r2"] < _FITTED
    if worse < 1.0 or (worse < _CLEARLY and poor) if worse is not None else not board["top_sure"]:
        out.say(
            "board-direction-unsure",
            f"the top of the balance board is assumed to point {board['top']}, as seen by the person, but this is "
            f"not certain: if it points {_OPPOSITE[board['top']]}, tauz and all parameters are wrong. Give or "
            "check `top:` beside `balance_board:`",
            worse,
            _CLEARLY,
        )
    if fact["by"] == "feet":
        out.say(
            "board-place-unknown",
            "the position of the balance board along the motion is known only to about 3 cm, from the feet: the "
            "first moment of the base segment, the centre of pressure and the torques contain this error. Give "
            "`centre_m:` beside `balance_board:`",
            fact["sd_m"],
        )


def _change_moment(
    prepared: PreparedTrial, sign: float = 1.0, *, shift: float = 0.0, sd: float | None = None
) -> PreparedTrial:
    """Return the trial as if its board were rotated by 180° (``sign`` -1) or shifted by ``shift`` ± ``sd``, m."""
    wrench = prepared.recorded.wrench.copy()
    wrench[:, _TAUZ] = sign * wrench[:, _TAUZ] + shift * wrench[:, 1]
    return prepare(replace(prepared.recorded, wrench=wrench, position_sd=sd), prepared.settings)


def _estimate_shift(context: Context, prepared: PreparedTrial, movement: Movement) -> tuple[float, float, float] | None:
    """Return the board's shift for which the fitted first moments agree best with the reference body; None if unknown.

    The result is the shift along the motion and its standard deviation, m, and the misfit: the remaining sum of squares
    divided by the degrees of freedom.

    Fit and reference body are weighted by their covariances. The data determine trunk and thigh, whose angles change
    most; the reference body determines foot and shank, whose first moments along the motion are small. Moments of
    inertia are left out, because a person's accelerations hardly determine them for single segments.
    """
    reference = build_reference_bodies(context, prepared.recorded, movement).chosen.parameters
    if _TAUZ not in prepared.settings.components or not np.isfinite(reference).all():
        return None
    found, base = fit(prepared, movement.free), prepared.base.regrouping
    values, relative = found.problem.free_solution()[: found.base], context.settings.reference_sd
    deviations = compute_reference_sd(reference, relative)
    deviations[:2] = compute_foot_sd(reference, FOOT_SD * float(reference[::4].sum()), relative)[:2]
    skin = propagate_to_parameters(prepared, found, values, read_kinematic_error(context))[: found.base]
    spread = base @ np.diag(deviations**2) @ base.T + found.covariance[: found.base, : found.base] + skin @ skin.T
    kept = np.asarray(prepared.base.kept)
    spread[kept == 1, kept == 1] += (prepared.settings.plate_zero[1] / prepared.settings.gravity) ** 2
    used = np.flatnonzero(kept % 4 != _INERTIA)
    # change of the fitted base parameters for a board that is one metre away from its position
    row = prepared.settings.components.index(_TAUZ)
    moment = np.zeros((*found.target.shape, 1))
    stamped = prepared.recorded.time[found.samples] - found.offset
    moment[:, row, 0] = prepared.filtered_measured(found.samples, stamped)[:, 1] * found.weights[row]
    response, spread = found.response(moment)[: found.base, 0][used], spread[np.ix_(used, used)]
    away = (values - base @ reference)[used]
    precision = float(response @ np.linalg.solve(spread, response))
    excess = float(response @ np.linalg.solve(spread, away)) / precision
    rest = away - excess * response
    misfit = float(rest @ np.linalg.solve(spread, rest)) / max(len(used) - 1, 1)
    return -excess, float(np.sqrt(_REPEATED_SD**2 + max(misfit, 1.0) / precision)), misfit


_SENSOR_RANGE = 1.0  # s, largest clock offset of a sensor that is tried, in both directions
_SENSOR_LEAST = 2.0  # s, shortest duration of the samples for this
_SENSOR_LATE, _SENSOR_BETTER = 0.02, 1.2  # smallest offset that is reported, s, and smallest ratio of the residuals


def check_chair(prepared: PreparedTrial) -> tuple[PreparedTrial, tuple[Reason, ...]]:
    """Return the trial, without the chair's wrench if it contradicts the body's motion, and a note or caution."""
    recorded = prepared.recorded
    if recorded.seat is None:
        return prepared, ()
    everything = np.ones(len(recorded.time), dtype=bool)
    determined = determines_parameters(prepared, everything)
    gains = estimate_gains(prepared, fit(prepared, everything)) if determined else ()
    wrong = [gain for gain in gains if gain.name == SEAT and gain.contradicts]
    if not wrong:
        text = (
            f"the chair is on its own force plate: its wrench on segment {recorded.seat.segment} is measured, so "
            "samples with contact are also used for the identification"
        )
        return prepared, (Reason("seat-measured", text, level="ok"),)
    without = replace(recorded, external=tuple(each for each in recorded.external if each.name != SEAT))
    gain = max(wrong, key=_compute_effect)
    text = (
        f"the forces of ground and chair add up best with the chair's {gain.component} times {gain.value:.2f} ± "
        f"{gain.sd:.2f}, expected 1: its plate does not measure the wrench of the chair on the body (wrong sign, "
        "corners or units, another object on the plate, or a chair leg beside it). It was left out, with all samples "
        "with contact"
    )
    return prepare(without, prepared.settings), (Reason("seat-contradiction", text, gain.value, 1.0),)


def check_sensors(prepared: PreparedTrial, found: Fit) -> list[Reason]:
    """Return a caution for every sensor whose wrench or clock contradicts the motion of the body."""
    clocks = (_check_clock(prepared, found, each) for each in prepared.recorded.external if not each.by_plates)
    reasons = [reason for reason in clocks if reason is not None]
    wrong: dict[str, list[WrenchGain]] = {}
    for each in estimate_gains(prepared, found):
        if each.name != SEAT and each.contradicts:
            wrong.setdefault(each.name, []).append(each)
    for name, gains in wrong.items():
        gain = max(gains, key=_compute_effect)
        text = (
            f"the forces add up best with the {gain.component} of `{name}` times {gain.value:.2f} ± {gain.sd:.2f}, "
            "expected 1: check its sign (`force: on-sensor`), its axes, its point of application (`at:`), its segment "
            "and its clock (`clock_offset_s:`) under `external:`. It was used without a change"
        )
        reasons.append(Reason("external-contradiction", text, gain.value, 1.0))
    return reasons


def _check_clock(prepared: PreparedTrial, found: Fit, sensor: ExternalWrench) -> Reason | None:
    """Return a caution if the forces add up clearly better with another clock offset of a sensor."""
    components, time = list(prepared.settings.components), prepared.recorded.time
    filtered = prepared.lowpass(blank_incomplete(sensor.wrench))[:, components]
    sampled = SampledWrench(time, filtered)
    around = np.linspace(-_SENSOR_RANGE, _SENSOR_RANGE, 21)
    known = np.isfinite(sampled(time[found.samples] - around[:, None])).all(axis=(0, 2))
    samples = found.samples[known]
    if len(samples) * prepared.lowpass.step < _SENSOR_LEAST * prepared.recorded.rate:
        return None
    rest = prepared.filtered_measured(samples, time[samples] - found.offset)[:, components] - filtered[samples]
    rows = found.design[known, :, :-1]

    def measured(times: FloatArray) -> FloatArray:
        return (rest + sampled(times)) * found.weights

    every = np.ones(len(components))
    offset, at_end = profile_offset(rows, measured, time[samples], every, _SENSOR_RANGE, prior=found.prior)
    flat = rows.reshape(-1, rows.shape[-1])
    targets = np.stack([measured(time[samples] - each).reshape(-1) for each in (0.0, offset)], axis=1)
    left = np.linalg.norm(targets - flat @ np.linalg.lstsq(flat, targets, rcond=None)[0], axis=0)
    if at_end or abs(offset) <= _SENSOR_LATE or left[0] < _SENSOR_BETTER * left[1]:
        return None
    return Reason(
        "external-clock",
        f"the forces add up best if the clock of `{sensor.name}` is moved by {offset:+.2f} s, expected at most ± "
        f"{_SENSOR_LATE:g} s (residual {left[0] / left[1]:.1f} times as large without). It was not moved: add this "
        "time to its `clock_offset_s:` under `external:`, and check its start",
        value=offset,
        limit=_SENSOR_LATE,
    )


def _compute_effect(gain: WrenchGain) -> float:  # of the deviation from 1, relative to its limit
    return abs(gain.value - 1.0) * gain.size / gain.limit


MASS_CONTRADICTS = 0.2
"""Relative difference of two masses of one person from which the trial is refused."""

_THIN, _HEAVY = ((1.1, 1.5), (12.0, 14.0)), 42.0
"""Least body mass index for the heights in the first tuple, and largest one, kg/m²."""

_UNUSUAL, _POUND_KG = 36.0, 0.4536
"""Body mass index from which the mass is to be confirmed: a thin person's mass in pounds gives such an index too."""

_BESIDE_M, _BESIDE_SHARE = 0.05, 0.2
"""A foot this far beside all plates, m, is certainly not measured if the force is also this near to the other foot, as
a fraction of the distance of the feet.
"""

_ABSURD = (10.0, 75.0)
"""Range of the body mass index outside which a mass is not used."""


@dataclass(frozen=True)
class NotIdentifiable:
    """Code and text of the reason why nothing can be identified; ``mass`` is the mass, kg, or None if unknown."""

    code: str
    why: str
    mass: float | None = None


def check_wrench(context: Context, recorded: TrialData) -> NotIdentifiable | None:
    """Return the reason why the data do not suffice for an identification; None if they do."""
    facts = context.table("wrench.parquet").facts
    if facts.get("unusable"):
        text = f"the inertial parameters need the moments of the ground's wrench: {facts['unusable']}"
        return NotIdentifiable("no-wrench", text, facts.get("mass_kg"))
    measured = np.isfinite(recorded.surroundings).all(axis=1)
    if not measured.any():
        why = facts.get("why") or "the recording has no usable force plate"
        return NotIdentifiable("no-wrench", f"the inertial parameters need the ground's wrench: {why}")
    standing, given = facts.get("mass_kg"), context.trial.subject.mass
    implausible = judge_mass(context, standing)
    if implausible is not None and implausible.code != "mass-implausible":
        implausible = None
    absurd = implausible is not None and not _ABSURD[0] <= (implausible.value or 0.0) <= _ABSURD[1]
    beside = (facts.get("registration") or {}).get("foot_beside")
    confirmed = standing is not None and given is not None and abs(standing / given - 1.0) <= MASS_CONTRADICTS
    clear = beside is not None and (beside["beside_m"] or 0.0) > _BESIDE_M and abs(beside["share"]) < _BESIDE_SHARE
    if implausible is not None and (absurd or beside is not None):
        text = f"the inertial parameters need the whole wrench of the ground: {implausible.message}"
        return NotIdentifiable("mass-implausible", text)
    if clear and not confirmed:
        text = (
            "the inertial parameters need the whole wrench of the ground, but one foot stands beside the plates "
            "(`foot-off-plate`). If the corners of the plates are wrong instead, give `subject: {mass: …}`"
        )
        return NotIdentifiable("no-wrench", text)
    known = np.isfinite(recorded.ddq).all(axis=1)
    if (measured & known).sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "no-common-samples",
            f"wrench and joint angles are both known for {(measured & known).sum() / recorded.rate:.2f} s, expected at "
            f"least {LEAST_SECONDS:g} s",
            facts.get("mass_kg"),
        )
    return None


def judge_mass(context: Context, mass: float | None) -> Reason | None:
    """Return a caution, with the body mass index, if a mass, kg, does not fit the person's height; None if unknown.

    The height is that in the configuration, or else follows from shank and thigh. The given mass may confirm the mass.
    """
    subject, chain = context.trial.subject, Skeleton(context.tree("chain.h5"))
    if mass is None or context.trial.protocol == "robot-joint":
        return None
    if subject.mass is not None and abs(mass / subject.mass - 1.0) <= MASS_CONTRADICTS:
        return None
    height, source = subject.height, "`subject: {height: …}`"
    if height is None:
        if not {"shank", "thigh"} <= set(chain.segments):
            return None
        ends = [chain.centres[chain.segments.index(name)] for name in ("shank", "thigh")]
        height = estimate_height(look_up_table("winter", None), *(float(np.linalg.norm(end)) for end in ends))
        source = "the lengths of shank and thigh"
    index = mass / height**2
    low = float(np.interp(height, *_THIN))
    if low <= index <= _UNUSUAL:
        return None
    if _UNUSUAL < index <= _HEAVY:
        return Reason(
            "mass-unusual",
            f"the plates measure {mass:.1f} kg, and the height is {height:.2f} m (from {source}): a body mass index of "
            f"{index:.1f} kg/m². This is right for a very heavy person, but loads in pounds give the same for a person "
            f"of {_POUND_KG * mass:.1f} kg, and forces alone cannot tell the two apart. Weigh the person and give "
            "`subject: {mass: …}`",
            value=index,
            limit=_UNUSUAL,
        )
    unit = "the plates measure only a part of the weight, or have a wrong gain or unit"
    if index > _HEAVY:
        unit = "the loads have a wrong gain or unit (such as pounds), or the plates carry something else"
    return Reason(
        "mass-implausible",
        f"the plates measure {mass:.1f} kg, but the height is {height:.2f} m (from {source}): a body mass index of "
        f"{index:.1f} kg/m², expected {low:g} to {_HEAVY:g}. Probably {unit}; then all forces, masses and torques are "
        "wrong. Check that both feet are on plates that are used, and the units. If the mass is right, give `subject: "
        "{mass: …}`",
        value=index,
        limit=_HEAVY if index > _HEAVY else low,
    )


def check_excitation(context: Context, prepared: PreparedTrial, movement: Movement) -> NotIdentifiable | None:
    """Return the reason why the usable samples do not determine the parameters; None if they do."""
    settings, recorded = context.settings, prepared.recorded
    chosen = select_samples(prepared, movement.free)
    mass = context.table("wrench.parquet").facts.get("mass_kg")
    if not movement.free.any():
        return NotIdentifiable(
            "not-free",
            "the person may touch the chair in every sample, and its force is not measured. Use a window in which the "
            "person rises and stands",
            mass,
        )
    if chosen.sum() < LEAST_SECONDS * recorded.rate:
        return NotIdentifiable(
            "too-few-samples",
            f"{chosen.sum() / recorded.rate:.2f} s are usable, expected at least {LEAST_SECONDS:g} s: usable samples "
            f"are off the chair and at least {prepared.lowpass.reach:.2f} s from gaps, which the low-pass spreads. "
            "Record longer or with fewer gaps",
            mass,
        )
    arc = np.degrees(np.max(measure_arcs(recorded.q, chosen)))
    if arc < settings.still_arc_deg:
        # whether measurements, and not only assumptions, exclude contacts with unmeasured force
        excluded = context.trial.protocol == "robot-joint" or recorded.seat is not None
        excluded = excluded or (movement.contact is not None and movement.contact.chair is not None)
        if mass is None and excluded:
            mass = float(np.nanmedian(recorded.surroundings[chosen, 1])) / settings.gravity
        result = "nothing" if mass is None else "only the mass"
        return NotIdentifiable(
            "standing-still",
            f"no joint rotates more than {arc:.1f}° while only the ground touches the body, expected at least "
            f"{settings.still_arc_deg:g}°: {result} is known; record a movement",
            mass,
        )
    if not determines_parameters(prepared, movement.free):
        return NotIdentifiable(
            "not-excited",
            "a joint does not move while only the ground touches the body, so the parameters of its two segments "
            "cannot be separated; record a movement of every joint",
            mass,
        )
    return None
