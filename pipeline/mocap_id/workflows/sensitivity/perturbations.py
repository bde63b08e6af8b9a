"""The kinds of perturbation: those of thesis 5.5.2, and further errors that occur in a laboratory.

From top to bottom: a kind and a perturbation; the inputs of the stages that are run again, which are artefacts, keys
and settings of the trial, whose files are not changed; the functions that change them, for signals, for markers and for
the logs of inertial sensors; the list of all kinds; the perturbations that a user asks for.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from pydantic import Field

from mocap_id import runner
from mocap_id.anatomy.frames import draw_centred_skin_motion
from mocap_id.arrays import GRAVITY, FloatArray, IntArray
from mocap_id.config.parsing import Source, parse, raise_mistakes, read_source, suggest_name
from mocap_id.dynamics.preparation import SampledWrench
from mocap_id.errors import ConfigError, StoreError
from mocap_id.geometry import so3
from mocap_id.geometry.planar import marker_positions, rotate
from mocap_id.recording.imu_log import ImuLog, format_imu_csv, read_imu
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import Subject, TrialKeys, list_sensors
from mocap_id.store import Artefact, Folder, Table, dumps
from mocap_id.store.artefacts import joint_columns
from mocap_id.store.folder import ArtefactReader
from mocap_id.workflows.run_folder import check_provenance, open_run_to

Entry: TypeAlias = Literal["fit-joints", "ukf-smooth", "identify-dim"]
Change: TypeAlias = "Callable[[RerunInputs, Perturbation], RerunInputs]"
ChangeLog: TypeAlias = Callable[[ImuLog, float, np.random.Generator], ImuLog]
"""Changes a log by a level of the perturbation, with a generator of random numbers for this sensor."""

SEED = 1
COMPONENTS = ("Fx", "Fy", "tauz")
JOINTS = ("joints",)
"""Value of :attr:`Kind.targets` for a kind that acts on each joint of the trial, or on all joints."""
ALL = "all"
"""Target for all joints at once."""


@dataclass(frozen=True)
class Kind:
    """One kind of perturbation."""

    name: str  # name in the settings file and the tables
    title: str  # name in texts
    entry: Entry  # first stage that uses the perturbed quantity; this stage and all later stages are run again
    unit: str  # unit of the levels; empty for counts
    levels: tuple[float, ...]  # default levels
    allowed: Callable[[float], bool]  # returns whether a level is valid
    expected: str  # description of a valid level
    targets: tuple[str, ...] = ()  # possible targets, or :data:`JOINTS`; empty if the kind acts on everything
    usual: tuple[str, ...] = ()  # default targets; empty if all targets are the default
    free: bool = False  # whether a target may be any number; ``targets`` are then the defaults
    worse: Literal["more", "less", "either"] = "more"  # direction in which the levels get worse
    random: bool = False  # whether the perturbation is drawn at random, from the seed
    change: Change | None = None  # returns the inputs with the perturbation; None for a kind that changes logs instead
    change_log: ChangeLog | None = None  # returns the log of one inertial sensor with the perturbation


@dataclass(frozen=True)
class Perturbation:
    """One perturbation of a trial: a kind at one level on one target."""

    kind: str
    target: str  # a joint, a component or a marker's standard deviation; empty if the kind acts on everything
    level: float  # in the kind's unit
    seed: int = SEED  # seed of the whole study

    @property
    def definition(self) -> Kind:
        return KINDS[self.kind]

    @property
    def name(self) -> str:
        """Kind, target and level as one text, as in the tables; unique in a study."""
        return " ".join(part for part in (self.kind, self.target, f"{self.level:g}") if part)

    def rng(self) -> np.random.Generator:
        """Return a random generator that depends only on seed, kind and target, so that all levels get equal draws."""
        words = np.frombuffer(hashlib.sha256(f"{self.kind}/{self.target}".encode()).digest(), dtype=np.uint32)
        return np.random.default_rng([self.seed, *words.tolist()])


# The inputs of the stages that are run again.

FIRST: Entry = "fit-joints"
LAST: Entry = "identify-dim"


@dataclass(frozen=True)
class RerunInputs(ArtefactReader):
    """The inputs of the stages that are run again, unperturbed or perturbed."""

    name: str  # name of the trial
    folder: Path  # its run folder
    keys: TrialKeys  # keys of the trial, without the keys for the report's comparison with other systems
    settings: Mapping[str, Settings]  # settings by stage, of the stages that are run again
    artefacts: Mapping[str, Artefact] = field(default_factory=dict)  # artefacts by file name; empty until they are read

    def read(self, file: str) -> Artefact:
        """Return an artefact."""
        return self.artefacts[file]

    def with_artefacts(self, *changed: Artefact) -> RerunInputs:
        return replace(self, artefacts={**self.artefacts, **{one.schema.file: one for one in changed}})

    def with_settings(self, stage: str, **values: object) -> RerunInputs:
        changed = self.settings[stage].model_copy(update=values)
        return replace(self, settings={**self.settings, stage: changed})

    @property
    def joints(self) -> tuple[str, ...]:
        return self.tree("chain.h5").texts("joints/name")

    @property
    def time(self) -> FloatArray:
        """Times of the states (T,), s."""
        return self.table("states.parquet")["time"]

    def states(self, name: str) -> FloatArray:
        """Return a state (T, n) of all n joints; ``name`` is theta, dtheta or ddtheta."""
        return joint_columns(self.table("states.parquet"), name, len(self.joints))

    @property
    def has_plate(self) -> bool:
        return bool(np.isfinite(self.table("wrench.parquet")["Fy"]).any())


def repeated_stages() -> tuple[Stage, ...]:
    """Return the stages that may be run again, from first to last."""
    names = [stage.name for stage in STAGES]
    return STAGES[names.index(FIRST) : names.index(LAST) + 1]


def locate_trial(path: Path, progress: runner.Progress = lambda step: None) -> RerunInputs:
    """Return a trial without its artefacts; if ``path`` is a YAML file, missing artefacts are computed first.

    ``path``, ``progress`` and the errors are as for :func:`mocap_id.workflows.run_folder.open_run_to`. StoreError is
    also raised if a different version of the program made the run folder.
    """
    folder, trial = open_run_to(path, LAST, progress)
    if trial is not None:
        keys = trial.keys.model_copy(update={"compare": None})
        used = {stage.name: trial.settings[stage.name] for stage in repeated_stages()}
        return RerunInputs(trial.name, folder.path, keys, used)
    # The settings from which the artefacts in a run folder were computed.
    settings: dict[str, Settings] = {}
    parameters: dict[str, Any] = {}
    for stage in repeated_stages():
        origin = folder.provenance(stage.outputs[0]).origin
        if origin.stage_version != stage.version:
            raise StoreError(
                f"{path / stage.outputs[0]} was made by version {origin.stage_version} of {stage.name}, but this "
                f"program has version {stage.version}: run the trial again (`mocap-id run TRIAL.yaml`)"
            )
        settings[stage.name] = stage.settings.model_validate_json(dumps(origin.parameters[stage.name]), strict=True)
        parameters |= origin.parameters
    if getattr(settings["ukf-smooth"], "method", None) == "encoder":
        raise ConfigError(f"{path}: a run folder does not contain the encoder's file: give the trial's YAML file")
    if parameters.get("imus"):
        raise ConfigError(f"{path}: a run folder does not contain the sensors' logs: give the trial's YAML file")
    known = {name: parameters[name] for name in ("trial", "protocol")}
    subject = Subject.model_validate(parameters["subject"])
    # No stage that is run again reads the recording.
    keys = TrialKeys.model_construct(**known, recording=None, subject=subject)
    return RerunInputs(str(parameters["trial"]), path, keys, settings)


def read_rerun_inputs(trial: RerunInputs) -> RerunInputs:
    """Return a trial with its artefacts; StoreError is raised if they do not belong together."""
    folder = Folder(trial.folder)
    files = {file for stage in repeated_stages() for file in (*stage.inputs, *stage.outputs)} - {"markers.parquet"}
    check_provenance(folder, sorted(files))
    return replace(trial, artefacts={file: folder.read(file) for file in sorted(files)})


# Perturbations of the signals: noise of the filter, angles, clock offset, wrench.

_HALF_DEPTH_M = 0.119  # distance of the cells of a balance board from its centre, along the motion
STATES, WRENCH = "states.parquet", "wrench.parquet"


def joints_of(trial: RerunInputs, change: Perturbation) -> IntArray:
    """Return the indices of the joints that a perturbation changes."""
    joints = trial.joints
    return np.arange(len(joints)) if change.target == ALL else np.array([joints.index(change.target)])


def angle_bias(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with a constant added to angles, but not to their derivatives."""
    table = trial.table(STATES)
    columns = [f"theta_{j + 1}" for j in joints_of(trial, change)]
    return trial.with_artefacts(table.with_columns(**{name: table[name] + change.level for name in columns}))


def clock_offset(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with the plates' samples delayed by the level; the program may estimate this offset."""
    return trial.with_artefacts(_delay(trial.table(WRENCH), change.level))


def clock_offset_ignored(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with the plates' samples delayed by ``change.level``, s, which the program does not correct.

    If the program corrected the clock offset of the unperturbed trial, the samples are first corrected by this offset.
    """
    table, offset = trial.table(WRENCH), trial.tree("dynamics.h5").facts["clock_offset_s"]
    is_applied = getattr(trial.settings[LAST], "apply_clock_offset", False)
    coarse = float((table.facts.get("clock") or {}).get("offset_s") or 0.0)  # already corrected in the table
    corrected = offset - coarse if is_applied and offset is not None else 0.0
    if is_applied and coarse:
        trial = trial.with_artefacts(replace(table, facts={**table.facts, "clock": None}))
    delayed = clock_offset(trial, replace(change, level=change.level - corrected))
    return delayed.with_settings(LAST, apply_clock_offset=False)


def _delay(table: Table, delay: float | FloatArray) -> Table:
    """Return wrench.parquet delayed by ``delay`` (one value or (T,)), s; sensors with their own clock do not change."""
    if not np.any(delay):
        return table
    time = table["time"]
    sensors = [fact["columns"] for fact in table.facts.get("external") or () if fact["clock"] != "plates"]
    fixed = {"time", "plate_ok", *(f"{name}_{sensor}" for name in COMPONENTS for sensor in sensors)}
    delayed = {
        name: SampledWrench(time, table[name][:, None])(time + delay)[:, 0] for name in table.names if name not in fixed
    }
    nearest = np.searchsorted(time, time + delay - (time[1] - time[0]) / 2)
    plate_ok = table["plate_ok"][np.clip(nearest, 0, len(time) - 1)]
    return table.with_columns(**delayed, plate_ok=plate_ok & np.isfinite(delayed["Fy"]))


def wrench_noise(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with white noise, one value for each frame, added to a component of the plates' wrench."""
    return _add_error(trial, change.target, change.level * change.rng().standard_normal(trial.table(WRENCH).length))


def board_steps(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with rounding errors of a balance board's four load cells added to Fy and tauz."""
    error = change.level * (change.rng().random((trial.table(WRENCH).length, 4)) - 0.5) * GRAVITY
    front, back = error[:, :2].sum(axis=1), error[:, 2:].sum(axis=1)
    return _add_error(_add_error(trial, "Fy", front + back), "tauz", _HALF_DEPTH_M * (front - back))


def stamp_jitter(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with random shifts of the plates' sample times; the level is their standard deviation."""
    length = trial.table(WRENCH).length
    return trial.with_artefacts(_delay(trial.table(WRENCH), change.level * change.rng().standard_normal(length)))


def _add_error(trial: RerunInputs, component: str, error: float | FloatArray) -> RerunInputs:
    """Return the trial with an error added to a component, and with updated mass and centre of pressure."""
    table = trial.table(WRENCH)
    table = table.with_columns(**{component: table[component] + error})
    facts = dict(table.facts)
    if component == "Fy" and facts.get("mass_kg") is not None:
        gravity = getattr(trial.settings[LAST], "gravity")  # noqa: B009  the settings are a stage's own
        facts["mass_kg"] = float(facts["mass_kg"] + np.mean(error) / gravity)
    loaded = table["Fy"] > facts["cop_threshold_N"]
    cop = np.divide(table["tauz"], table["Fy"], out=np.full(table.length, np.nan), where=loaded)
    return trial.with_artefacts(replace(table.with_columns(cop_x=cop), facts=facts))


# Perturbations of the markers: noise, skin motion, drop-outs, fewer markers, lower frame rate, noise of the angles.

PLANAR, SEGMENTS = "planar.parquet", "segments.parquet"
_BURST = (0.05, 0.5)  # s, shortest and longest drop-out


def camera_noise(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with white noise added to each coordinate of each marker on a moving segment."""
    moving = _find_moving(trial)
    noise = change.rng().standard_normal((len(trial.time), len(moving), 2))
    return _shift(trial, moving, change.level * noise)


def angle_noise(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with its markers shifted as by white noise in the angles; the chain does not change.

    The shift is the difference between the marker positions (3.18) with and without the noise.
    """
    q = _fill_gaps(trial.states("theta"))
    noisy = q.copy()
    joints = joints_of(trial, change)
    noisy[:, joints] += change.level * change.rng().standard_normal((len(q), len(joints)))
    tree = trial.tree("chain.h5")
    chain = [tree.array(path) for path in ("joints/centre", "markers/segment", "markers/local")]
    columns = _find_columns(trial, tree.texts("markers/name"))
    return _shift(trial, columns, marker_positions(noisy, *chain) - marker_positions(q, *chain))


def soft_tissue(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with simulated skin motion up to the level, m, which depends on the angles and drifts slowly."""
    moving, segment = _find_moving(trial), _read_segments(trial)
    q = _fill_gaps(trial.states("theta"))
    slide = draw_centred_skin_motion(change.rng(), segment[moving], np.ones(len(moving)), q, trial.time)[..., :2]
    angle = np.cumsum(q, axis=1)[:, segment[moving] - 1]  # (T, M) angle of each marker's segment
    return _shift(trial, moving, change.level * rotate(angle, slide))


def drop_outs(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial without bursts of samples of moving markers; the level is the removed fraction of samples."""
    moving, time, rng = _find_moving(trial), trial.time, change.rng()
    missing = np.zeros((len(time), len(moving)), dtype=np.bool_)
    removed, dt = 0, time[1] - time[0]
    while removed < change.level * missing.size:
        start, marker = int(rng.integers(len(time))), int(rng.integers(len(moving)))
        frames = slice(start, start + max(1, round(rng.uniform(*_BURST) / dt)))
        removed += int(np.count_nonzero(~missing[frames, marker]))
        missing[frames, marker] = True
    table = trial.long(PLANAR)
    everywhere = np.zeros((len(time), len(table.labels)), dtype=np.bool_)
    everywhere[:, moving] = missing
    seen = {name: np.where(everywhere, np.nan, table.values[name]) for name in ("x", "y", "z")}
    visible = table.values["visible"].astype(np.bool_) & ~everywhere
    return trial.with_artefacts(replace(table, values={**seen, "visible": visible}))


def marker_count(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with at most ``level`` markers, chosen at random, on each moving segment."""
    table, rng = trial.table(SEGMENTS), change.rng()
    segment = table["segment"].copy()
    for number in sorted(set(segment[segment > 0])):
        segment[rng.permutation(np.flatnonzero(segment == number))[int(change.level) :]] = -1
    return trial.with_artefacts(table.with_columns(segment=segment))


def frame_rate(trial: RerunInputs, change: Perturbation) -> RerunInputs:
    """Return the trial with its frame rate divided by the level; the wrench is averaged as in planarise."""
    every = int(change.level)
    if every == 1:
        return trial
    planar, wrench = trial.long(PLANAR), trial.table(WRENCH)
    thinned = replace(
        planar,
        frames=planar.frames[::every],
        time=planar.time[::every],
        values={name: values[::every] for name, values in planar.values.items()},
        facts={**planar.facts, "rate_hz": planar.facts["rate_hz"] / every},
    )
    return trial.with_artefacts(thinned, _average(wrench, every))


def _average(table: Table, every: int) -> Table:
    """Return each ``every``-th row, as the mean of the ``every`` rows around it.

    If ``every`` is even, the two outer rows of each mean have half the weight.
    """
    weight = np.ones(every) if every % 2 else np.r_[0.5, np.ones(every - 1), 0.5]
    reach = len(weight) // 2
    columns = {}
    for name, values in table.columns.items():
        if name in ("time", "plate_ok"):
            columns[name] = values[::every]
        else:
            windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), len(weight))
            columns[name] = windows[::every] @ (weight / every)
    return replace(table, columns=columns)


def _find_columns(trial: RerunInputs, labels: Sequence[str]) -> IntArray:
    """Return the columns of the markers with these labels in planar.parquet."""
    known = trial.long(PLANAR).labels
    return np.array([known.index(label) for label in labels], dtype=np.int64)


def _read_segments(trial: RerunInputs) -> IntArray:
    """Return the segment of each marker in planar.parquet; -1 for a marker without a segment."""
    table = trial.table(SEGMENTS)
    segment = np.full(len(trial.long(PLANAR).labels), -1)
    segment[_find_columns(trial, list(table["marker"]))] = table["segment"]
    return segment


def _find_moving(trial: RerunInputs) -> IntArray:
    """Return the columns of the markers on moving segments."""
    return np.flatnonzero(_read_segments(trial) > 0)


def _fill_gaps(angles: FloatArray) -> FloatArray:
    """Return the angles (T, n) with linearly interpolated gaps; a column without known values stays NaN."""
    filled = angles.copy()
    for column in filled.T:
        known = np.isfinite(column)
        if not known.all() and known.any():
            column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known])
    return filled


def _shift(trial: RerunInputs, columns: IntArray, shift: FloatArray) -> RerunInputs:
    """Return the trial with the markers in ``columns`` (m,) shifted by ``shift`` (F, m, 2), metres."""
    table = trial.long(PLANAR)
    values = dict(table.values)
    for axis, name in enumerate("xy"):
        values[name] = values[name].copy()
        values[name][:, columns] += shift[..., axis]
    return trial.with_artefacts(replace(table, values=values))


# Perturbations of the logs of inertial sensors. The program estimates a constant offset or drift of a sensor's clock, a
# constant bias and a constant mounting for every trial. The perturbations therefore vary during the trial.

_WANDER_PERIOD = 7.0  # s
_SLIP_TIME = 0.5  # s, in which a sensor rotates on its segment


def perturb_logs(trial: RerunInputs, change: Perturbation, folder: Path) -> RerunInputs:
    """Write perturbed logs of all inertial sensors to ``folder``, and return the trial with these logs."""
    change_log = change.definition.change_log
    assert change_log is not None
    files = {}
    for number, (segment, sensor) in enumerate(list_sensors(trial.keys.imus).items()):
        rng = np.random.default_rng([number, *change.rng().integers(2**32, size=4)])
        files[segment] = folder / f"{number}.csv"
        files[segment].write_bytes(format_imu_csv(change_log(read_imu(sensor.file, sensor.rate_hz), change.level, rng)))
    return replace(trial, keys=trial.keys.model_copy(update={"imus": files}))


def _wander_clock(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log whose time stamps have a sinusoidal error with an amplitude of ``level`` s."""
    phase = rng.uniform(0, 2 * np.pi)
    return replace(log, time=log.time + level * np.sin(2 * np.pi * log.time / _WANDER_PERIOD + phase))


def _drift_bias(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return a log with a bias of the gyroscope from ``-level`` to ``level`` rad/s, along a random direction."""
    ramp = np.interp(log.time, log.time[[0, -1]], [-level, level])
    return replace(log, gyro=log.gyro + ramp[:, None] * _draw_direction(rng))


def _rotate_sensor(log: ImuLog, level: float, rng: np.random.Generator) -> ImuLog:
    """Return the log of a sensor that rotates by ``level`` rad on its segment in the middle of the trial."""
    middle, axis = float(log.time[[0, -1]].mean()), _draw_direction(rng)
    share = np.clip((log.time - middle) / _SLIP_TIME + 0.5, 0.0, 1.0)
    back = so3.exp(-level * share[:, None] * axis)
    speed = level * np.gradient(share, log.time)
    gyro = np.einsum("fij,fj->fi", back, log.gyro) + speed[:, None] * axis
    return replace(log, gyro=gyro, acc=np.einsum("fij,fj->fi", back, log.acc))


def _draw_direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


# The list of all kinds.


def _at_least(least: int) -> Callable[[float], bool]:
    return lambda level: level >= least and level == int(level)


def _both_signs(*levels: float) -> tuple[float, ...]:
    return tuple(sign * level for level in levels for sign in (1, -1))


_THESIS_SD = ("0.0001", "0.001", "0.1")
_ANGLE = (lambda level: abs(level) <= math.pi, "an angle up to ± pi, rad")
_CLOCK = (lambda level: abs(level) <= 1, "a time up to ± 1 s")
_DIVISOR = (_at_least(1), "a whole number by which the frame rate is divided, 1 or more")
_MARKERS = (_at_least(2), "a whole number of markers, 2 or more")
_NUMBER = (math.isfinite, "a number")
_SHARE = (lambda level: 0 <= level < 1, "a fraction of at least 0 and below 1")
_SIZE = (lambda level: level >= 0, "0 or more")
_SNAP = (lambda level: level > 0, "a standard deviation of the snap above 0, rad/s^4")
_IGNORED = _both_signs(0.001, 0.003, 0.01, 0.03, 0.1)
_FIT, _DYN = FIRST, LAST
_UKF: Entry = "ukf-smooth"
# fmt: off
_KINDS = (
    Kind("filter-noise", "the filter's noise", _UKF, "rad/s^4", (1e1, 1e2, 1e3, 1e4), *_SNAP,
         targets=_THESIS_SD, free=True, worse="either",  # Sigma_v and marker sd (3.17), which are otherwise estimated
         change=lambda trial, one: trial.with_settings(_UKF, sigma_v=one.level, marker_sd=float(one.target))),
    Kind("angle-bias", "angle bias", _DYN, "rad", (0.01, 0.03, 0.1), *_ANGLE, targets=JOINTS, change=angle_bias),
    Kind("angle-noise", "angle noise", _UKF, "rad", (0.001, 0.003, 0.01), *_SIZE,
         targets=JOINTS, usual=(ALL,), random=True, change=angle_noise),
    Kind("clock-offset", "clock offset, estimated", _DYN, "s", _both_signs(0.001, 0.01, 0.1), *_CLOCK,
         change=clock_offset),
    Kind("clock-offset-ignored", "clock offset, not estimated", _DYN, "s", _IGNORED, *_CLOCK,
         change=clock_offset_ignored),
    Kind("wrench-bias", "wrench bias", _DYN, "N or N*m", (0.1, 1.0, 10.0), *_NUMBER, targets=COMPONENTS,
         change=lambda trial, one: _add_error(trial, one.target, one.level)),
    Kind("wrench-noise", "wrench noise", _DYN, "N or N*m", (0.01, 0.1, 1.0), *_SIZE,
         targets=COMPONENTS, random=True, change=wrench_noise),
    Kind("board-steps", "steps of a balance board's cells", _DYN, "kg", (0.1, 0.5, 2.0), *_SIZE, random=True,
         change=board_steps),
    Kind("stamp-jitter", "jitter of the force's time stamps", _DYN, "s", (0.003, 0.01, 0.03), *_SIZE, random=True,
         change=stamp_jitter),
    Kind("camera-noise", "camera noise", _FIT, "m", (0.001, 0.003, 0.01), *_SIZE, random=True, change=camera_noise),
    Kind("marker-count", "markers per segment", _FIT, "", (4, 3, 2), *_MARKERS, worse="less", random=True,
         change=marker_count),
    Kind("drop-outs", "drop-outs", _FIT, "of samples", (0.05, 0.2, 0.5), *_SHARE, random=True, change=drop_outs),
    Kind("soft-tissue", "soft tissue", _FIT, "m", (0.001, 0.003, 0.01), *_SIZE, random=True, change=soft_tissue),
    Kind("frame-rate", "frame rate", _FIT, "", (2, 4, 8), *_DIVISOR, change=frame_rate),
    Kind("imu-clock", "wander of the inertial sensors' clocks", _UKF, "s", (0.002, 0.01, 0.05), *_SIZE,
         random=True, change_log=_wander_clock),
    Kind("imu-bias", "drift of the gyroscopes' biases", _UKF, "rad/s", (0.003, 0.01, 0.03), *_SIZE,
         random=True, change_log=_drift_bias),
    Kind("imu-mounting", "rotation of the inertial sensors on the skin", _UKF, "rad", (0.03, 0.1, 0.3), *_ANGLE,
         random=True, change_log=_rotate_sensor),
)
# fmt: on
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _KINDS}
"""Each kind by name, in the order of the tables."""


# The perturbations to run, from the user's options: each kind with each of its levels on each of its targets.


@dataclass(frozen=True)
class KindSelection:
    """A kind of perturbation with levels and targets; an empty tuple means the defaults."""

    kind: str
    levels: tuple[float, ...] = ()
    targets: tuple[str, ...] = ()


ALL_KINDS = tuple(KindSelection(kind) for kind in KINDS)
"""All kinds with their default levels and targets."""


@dataclass(frozen=True)
class SensitivityOptions:
    """The options of a sensitivity study."""

    selections: tuple[KindSelection, ...] = ALL_KINDS
    seed: int = SEED
    tolerance: float = 0.05  # tolerated change of a base parameter, as a fraction of its size

    def only(self, kinds: Sequence[str]) -> SensitivityOptions:
        """Return the options with only the selections of ``kinds``; the same options if ``kinds`` is empty."""
        for name in kinds:
            if name not in KINDS:
                raise ConfigError(
                    f"--only {name}: there is no perturbation of this kind: {suggest_name(name, list(KINDS))}"
                )
        selections = tuple(one for one in self.selections if not kinds or one.kind in kinds)
        if not selections:
            raise ConfigError(f"--only {', '.join(kinds)}: the settings file does not contain these kinds")
        return replace(self, selections=selections)


class _Entry(Settings):
    kind: str = Field(description="what is perturbed")
    levels: tuple[float, ...] = Field((), description="levels to try, in the kind's unit; if not given, its defaults")
    on: tuple[str | float, ...] = Field((), description="joints, components or marker sd; if not given, the defaults")


class _File(Settings):
    seed: int = Field(SEED, ge=0, description="seed of the random numbers")
    tolerance: float = Field(5.0, gt=0, description="tolerated change of a base parameter, % of its size")
    perturbations: tuple[_Entry, ...] = Field((), description="perturbations to try; all kinds if not given")


def read_options(file: Path) -> SensitivityOptions:
    """Read and check a settings file; ConfigError has a line for each mistake."""
    source = read_source(file.absolute())
    if isinstance(source.data, list):
        moved = {("perturbations", *key): line for key, line in source.lines.items()}
        source = Source(source.file, {"perturbations": source.data}, {(): 1, **moved})
    parsed = parse(source, _File, "a list of perturbations, each with a `kind:`")
    selections = tuple(
        KindSelection(one.kind, one.levels, tuple(name if isinstance(name, str) else f"{name:g}" for name in one.on))
        for one in parsed.perturbations
    )
    raise_mistakes(line for number, one in enumerate(selections) for line in _find_mistakes(one, number, source))
    return SensitivityOptions(selections or ALL_KINDS, parsed.seed, parsed.tolerance / 100)


def _find_mistakes(entry: KindSelection, number: int, source: Source) -> Iterator[str]:
    """Yield a message for each mistake in an entry that the types of the settings do not exclude."""
    key = ("perturbations", number)
    kind = KINDS.get(entry.kind)
    if kind is None:
        where = source.where((*key, "kind"))
        yield f"{where}: there is no perturbation `{entry.kind}`: {suggest_name(entry.kind, list(KINDS))}"
        return
    for k, level in enumerate(entry.levels):
        if not kind.allowed(level):
            yield f"{source.where((*key, 'levels', k))}: {kind.name}: the level {level:g} is not {kind.expected}"
    for k, name in enumerate(entry.targets):
        where = source.where((*key, "on", k))
        if kind.free:
            try:
                is_positive = float(name) > 0
            except ValueError:
                is_positive = False
            if not is_positive:
                yield f"{where}: {kind.name}: `on` is {name!r}; expected a marker's standard deviation above 0, m"
        elif not kind.targets:
            yield f"{where}: {kind.name} acts on everything: leave out `on`"
        elif kind.targets != JOINTS and name not in kind.targets:
            yield f"{where}: {kind.name}: there is no {name!r}: {suggest_name(name, list(kind.targets))}"


def plan(selections: Sequence[KindSelection], joints: Sequence[str], seed: int = SEED) -> tuple[Perturbation, ...]:
    """Return the perturbations of a trial with these joints that the selections describe, without duplicates."""
    found: list[Perturbation] = []
    for one in selections:
        kind = KINDS[one.kind]
        possible = (*joints, ALL) if kind.targets == JOINTS else kind.targets
        wrong = [target for target in one.targets if target not in possible and not kind.free]
        if wrong:
            ways = f"expected one of {', '.join(possible)}" if possible else "this kind has no target: leave out `on`"
            raise ConfigError(f"{kind.name}: there is no {wrong[0]!r} to perturb in this trial; {ways}")
        usual = kind.usual or possible or ("",)
        if len(joints) == 1 and kind.targets == JOINTS:
            usual = tuple(joints)  # with a single joint, "all" would be the same target
        found += [
            Perturbation(one.kind, target, float(level), seed)
            for target in one.targets or usual
            for level in one.levels or kind.levels
        ]
    return tuple(dict.fromkeys(found))
