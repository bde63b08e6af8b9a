"""Input of the dynamics from the artefacts: joint states, the ground's wrench and other external wrenches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mocap_id import recording
from mocap_id.dynamics.external_wrenches import SEAT, ExternalWrench
from mocap_id.dynamics.kinematic_error import KinematicError
from mocap_id.dynamics.preparation import FitSettings, TrialData
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.errors import ConfigError, StoreError
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.store.views import Skeleton, joint_columns

_VERTICAL = (1, 2)  # Fy and tauz
_THIGH = "thigh"
_THIGH_NUMBER = 2  # number of the thigh in a chain that begins with the foot


def read_skeleton(context: Context) -> Skeleton:
    """Return the chain of chain.h5."""
    return Skeleton.from_tree(context.tree("chain.h5"))


def read_trial_data(context: Context, chain: Skeleton) -> TrialData:
    """Return joint states and wrenches at their common times.

    Raises
    ------
    StoreError
        States and wrench have different times.
    ConfigError
        A setting names a segment that the chain does not have.
    """
    states, wrench = context.table("states.parquet"), context.table("wrench.parquet")
    time, plate_time = states["time"], wrench["time"]
    if len(time) != len(plate_time) or not np.allclose(time, plate_time, atol=1e-6):
        raise StoreError(
            f"trial {context.trial.trial}, identify-dim: states.parquet has {len(time)} samples and wrench.parquet "
            f"{len(plate_time)}, expected the same times; run the trial again from planarise"
        )
    joints, board = len(chain.centres), wrench.facts.get("board")
    ground = wrench.stack(WRENCH_COMPONENTS)
    if board is not None:
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
        external=_external_wrenches(context, chain.segments, "contact"),
        built_in=_external_wrenches(context, chain.segments, "beyond"),
        knee=max(0, _thigh(chain.segments) - 1),
    )
    averaged = recording.compute_averaging_width(wrench.facts["analog_rate_hz"], recorded.rate)
    if board is None:
        return replace(recorded, averaged=averaged)
    averaged, surface = float(np.hypot(averaged, board["averaged_s"])), float(board["cells_below_surface_m"])
    return replace(recorded, averaged=averaged, measures=_VERTICAL, surface=surface)


def _external_wrenches(context: Context, segments: Sequence[str], measures: str) -> tuple[ExternalWrench, ...]:
    """Return the wrenches in wrench.parquet that measure contacts (chair and sensors) or joints, with segments."""
    table, settings = context.table("wrench.parquet"), context.settings
    found = []
    for fact in table.facts.get("external") or ():
        if fact.get("measures", "contact") != measures:
            continue
        wanted, key = fact.get("segment"), f"external: {fact['name']}: segment"
        if fact["name"] == SEAT:
            if not settings.seat_plate:
                continue
            wanted, key = settings.seat_segment, "identify-dim: seat_segment"
            wanted = _thigh(segments) if wanted is None else wanted
        wrench = table.stack([f"{component}_{fact['columns']}" for component in WRENCH_COMPONENTS])
        segment = _segment_number(segments, wanted, key)
        found.append(ExternalWrench(fact["name"], segment, wrench, by_plates=fact["clock"] == "plates"))
    return tuple(found)


def _segment_number(names: Sequence[str], wanted: str | int, key: str) -> int:
    """Return the number of a segment given by name or number."""
    if isinstance(wanted, int) and 0 <= wanted < len(names):
        return wanted
    if wanted in names:
        return names.index(str(wanted))
    listed = ", ".join(f"{number} ({name})" for number, name in enumerate(names))
    raise ConfigError(f"{key}: there is no segment {wanted!r} here; expected one of {listed}")


def _thigh(names: Sequence[str]) -> int:
    """Return the number of the thigh, by its place in the chain if no segment has this name."""
    return names.index(_THIGH) if _THIGH in names else min(_THIGH_NUMBER, len(names) - 1)


def joint_names(context: Context) -> tuple[str, ...]:
    """Return the names of the chain's joints; numbers if they have no names."""
    return read_skeleton(context).joint_names


def read_kinematic_error(context: Context) -> KinematicError:
    """Return the effect of skin motion on the chain and on its angles, in the chain's own frames."""
    skin = skin_artefact.read_skin_tree(context.tree("skin.h5"))
    centres, turned = skin.stored_chain_errors()
    return KinematicError(lambda q: skin.errors(q)[0] + turned, centres)


def fit_settings(settings: IdentifyDimSettings, recorded: TrialData) -> FitSettings:
    """Return the settings of the fit from those of the stage, with the components that are measured."""
    components = (WRENCH_COMPONENTS.index(name) for name in settings.components)
    return FitSettings(
        components=tuple(component for component in components if component in recorded.measures),
        cutoff=settings.cutoff_hz,
        offset_limit=settings.clock_offset_limit_s,
        apply_offset=settings.apply_clock_offset,
        plate_bias=settings.plate_bias,
        plate_zero=(settings.plate_zero_sd_n, settings.plate_zero_sd_nm),
        block=settings.block_s,
        gravity=settings.gravity,
    )
