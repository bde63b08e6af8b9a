"""Inputs of the identification from the artefacts: joint states, wrench of the ground, and other external wrenches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.external_wrenches import SEAT, ExternalWrench
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.preparation import CoarseClock, FitSettings, TrialData
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import ConfigError, StoreError
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.store import Table
from mocap_id.store.views import Skeleton, joint_columns

_SEARCH = 0.15  # s: range of the fit's search around the coarse offset, whose error is up to 0.04 s
_VERTICAL = (1, 2)  # Fy and tauz
_THIGH = "thigh"
_THIGH_NUMBER = 2  # number of the thigh in a chain whose base is the foot


def read_skeleton(context: Context) -> Skeleton:
    """Return the chain in chain.h5."""
    return Skeleton.from_tree(context.tree("chain.h5"))


def read_trial_data(context: Context, chain: Skeleton) -> TrialData:
    """Return the joint states and wrenches of a trial in the plane.

    Raises
    ------
    StoreError
        States and wrench have different times.
    ConfigError
        A segment in the settings does not exist.
    """
    states = context.table("states.parquet")
    wrench, clock = read_wrench(context)
    time = read_common_time(context, "states.parquet")
    joints, board = len(chain.centres), wrench.facts.get("board")
    ground = wrench.stack(WRENCH_COMPONENTS)
    vertical_only = board is not None or not wrench.facts.get("horizontal_measured", True)
    if vertical_only:
        ground[:, 0] = 0.0
    recorded = TrialData(
        time=time,
        q=joint_columns(states, "theta", joints),
        dq=joint_columns(states, "dtheta", joints),
        ddq=joint_columns(states, "ddtheta", joints),
        ddq_sd=joint_columns(states, "sd_ddtheta", joints),
        observed=np.logical_and.reduce([states[f"observed_{j}"] for j in range(1, joints + 1)]),
        wrench=np.where(wrench["plate_ok"][:, None], ground, np.nan),
        centres=chain.centres,
        external=_read_external_wrenches(context, wrench, chain.segments, "contact"),
        built_in=_read_external_wrenches(context, wrench, chain.segments, "beyond"),
        knee=max(0, _find_thigh(chain.segments) - 1),
        measures=_VERTICAL if vertical_only else (0, 1, 2),
        clock=clock,
    )
    averaged = recording.compute_averaging_width(wrench.facts["analog_rate_hz"], recorded.rate)
    if board is None:
        return replace(recorded, averaged=averaged)
    averaged, surface = float(np.hypot(averaged, board["averaged_s"])), float(board["cells_below_surface_m"])
    return replace(recorded, averaged=averaged, surface=surface)


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


def _read_external_wrenches(
    context: Context, table: Table, segments: Sequence[str], measures: str
) -> tuple[ExternalWrench, ...]:
    """Return the external wrenches whose key `measures` is ``measures``: "contact" or "beyond"."""
    settings, wrenches = context.settings, []
    for fact in table.facts.get("external") or ():
        if fact.get("measures", "contact") != measures:
            continue
        given, key = fact.get("segment"), f"external: {fact['name']}: segment"
        if fact["name"] == SEAT:
            if not settings.seat_plate:
                continue
            given, key = find_seat_segment(context, segments), "identify-dim: seat_segment"
        wrench = table.stack([f"{component}_{fact['columns']}" for component in WRENCH_COMPONENTS])
        segment = _find_segment_number(segments, given, key)
        wrenches.append(ExternalWrench(fact["name"], segment, wrench, by_plates=fact["clock"] == "plates"))
    return tuple(wrenches)


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


def read_joint_names(context: Context) -> tuple[str, ...]:
    """Return the names of the joints of the chain; joints without names are numbered."""
    return read_skeleton(context).joint_names


def read_kinematic_error(context: Context) -> KinematicError:
    """Return the effect of skin motion on the joint centres and angles of the chain."""
    skin = skin_artefact.read_skin_tree(context.tree("skin.h5"))
    centres, turned = skin.stored_chain_errors()
    return KinematicError(lambda q: skin.errors(q)[0] + turned, centres)


def make_fit_settings(settings: IdentifyDimSettings, recorded: TrialData) -> FitSettings:
    """Return the settings of the fit, with the wrench components that the trial measures."""
    components = (WRENCH_COMPONENTS.index(name) for name in settings.components)
    return FitSettings(
        components=tuple(component for component in components if component in recorded.measures),
        cutoff=settings.cutoff_hz,
        offset_limit=recorded.clock.search,
        apply_offset=settings.apply_clock_offset,
        plate_bias=settings.plate_bias,
        plate_zero=(settings.plate_zero_sd_n, settings.plate_zero_sd_nm),
        block=settings.block_s,
        gravity=settings.gravity,
    )
