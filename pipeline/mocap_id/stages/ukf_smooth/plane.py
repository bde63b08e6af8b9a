"""Function of the stage ukf-smooth in the plane: joint states, marker residuals, skin motion and body poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex, chunks
from mocap_id.dynamics.measured_motion import Stretch
from mocap_id.estimation import FRAMEWISE, FilterSettings, States, smooth
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.dropouts import find_rejected_segments
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.estimation.lasting_errors import add_lasting_errors, estimate_camera_sd
from mocap_id.estimation.residual_spectrum import ResidualSpectrum, compute_residual_spectrum
from mocap_id.kinematics import SkinModel
from mocap_id.kinematics.joint_corrections import BENDS_M
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.trial_keys import list_sensors
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.checks import (
    UNKNOWN_SD_HZ,
    bridge_repeated,
    check_uniform_times,
    find_repeated_frames,
    list_rejected,
    report_bend,
    report_filter,
    report_gaps,
    report_oscillations,
    report_rejected,
    report_repeated_frames,
)
from mocap_id.stages.ukf_smooth.columns import marker_columns, state_columns
from mocap_id.stages.ukf_smooth.encoder_states import read_encoder_states, use_encoder
from mocap_id.stages.ukf_smooth.measured_poses import measure_poses
from mocap_id.stages.ukf_smooth.state_errors import (
    NOISE,
    SKIN,
    UNKNOWN,
    assume_skin,
    estimate_lasting_errors,
    estimate_skin,
)
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.schemas import ANGLES, MARKERS, STATES
from mocap_id.store.views import Skeleton, Trajectories
from mocap_id.verdict import Reason

_ENCODER_NOISE = "encoder noise"
_SNAP_RATIO = 2.0  # in people, the hip, which moves fastest, has 1.5 to 1.8 times the median of the joints
_ACCELERATION_SHARE = 0.75  # factor on the sd with sensors, from simulated people: the filter treats skin as noise


def ukf_smooth(context: Context) -> Outputs:
    """Return states.parquet, markers.parquet, skin.h5, encoder.parquet, poses.parquet and an empty angles.parquet."""
    settings: UkfSmoothSettings = context.settings
    tree, bad = context.tree("chain.h5"), context.table("segments.parquet").facts.get("bad_stretches", ())
    view = Trajectories(context.long("planar.parquet"), bad)
    check_uniform_times(view, context.trial.trial)
    skeleton = Skeleton.from_tree(tree)
    chain = MarkerChain(skeleton.centres, skeleton.marker_segment, skeleton.local)
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    moves = chain.segment > 0
    observed = np.ascontiguousarray(view.read_positions(columns[moves], axes="xy"))  # the filter would copy it
    repeated = find_repeated_frames(observed)
    observed[repeated] = np.nan
    moving = MarkerChain(chain.centres, chain.segment[moves], chain.local[moves])
    visible: BoolArray = np.asarray(np.isfinite(observed).all(axis=-1))
    states, sensors = _smooth(context, view, observed, moving, skeleton.segments)
    camera = estimate_camera_sd(observed, states, settings.marker_sd_floor)
    skin = estimate_skin(states, observed, camera) if tree.facts.get("estimator") == "bundle" else None
    spectrum = compute_residual_spectrum(ChainResiduals(states, observed, view.rate))
    poses, shift, thigh = measure_poses(
        view, chain, skeleton, observed=observed, angles=states.mean[:, :, 0], camera=camera
    )
    bend = stretch = None
    if thigh is not None and "hip" in skeleton.joints:
        stretch = (skeleton.joints.index("hip"), thigh)
    if shift.across is not None and abs(shift.place) >= BENDS_M:
        hip = skeleton.joints.index("hip")
        bend = (hip, shift.across / float(np.linalg.norm(chain.centres[hip])))
    states, sd_holds = _add_sd(
        states, observed, skin, camera, bend, stretch=stretch, spectrum=spectrum, settings=settings
    )
    if sensors.joints is not None:
        states.sd[:, sensors.joints, 2] *= _ACCELERATION_SHARE
    del observed
    skin_tree = _make_skin_tree(tree, skeleton, states, skin, camera)
    rejected = find_rejected_segments(moving.segment - 1, len(moving.centres), visible, states.used)
    stretches = list_rejected(rejected, view.time, skeleton.segments[1:])
    states = replace(states, observed=bridge_repeated(states.observed & ~rejected, repeated, view.rate))
    encoder = read_encoder_states(context.trial.encoder, states, view.time, settings)
    if settings.method == "encoder":
        states, sd_holds = use_encoder(states, encoder), _ENCODER_NOISE
    markers = marker_columns(states, view, columns, chain)
    markers["residual"][repeated] = np.nan
    reasons = (
        report_gaps(np.isnan(states.mean[:, :, 0]), view.time, skeleton.joint_names, "angle", settings)
        + _report_method(settings)
        + report_rejected(stretches, view.time)
        + report_repeated_frames(repeated)
        + report_filter(spectrum.cut_off)
        + report_oscillations(spectrum.oscillations, skeleton.segments)
        + (report_bend(shift) if bend else ())
        + sensors.reasons
    )
    facts = _facts(states, markers, moves, settings) | {"sd_holds": sd_holds, "cut_off_hz": spectrum.cut_off}
    facts |= {"imus": sensors.facts} if sensors.facts else {}
    facts |= {"rejected": stretches} if stretches and settings.method != "encoder" else {}
    return (
        Table(STATES, state_columns(view.time, states.mean, states.sd, states.observed), facts, reasons),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, markers),
        skin_tree,
        encoder,
        poses,
        Table(ANGLES, {"time": view.time}),
    )


@dataclass(frozen=True)
class _SensorOutcome:
    """Result of the inertial sensors; empty without sensors."""

    joints: BoolArray | None = None  # (n,) joints with a sensor on both their segments; None without sensors
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)  # facts of each sensor, by segment
    reasons: tuple[Reason, ...] = ()


def _smooth(
    context: Context, view: Trajectories, observed: FloatArray, chain: MarkerChain, names: Sequence[str]
) -> tuple[States, _SensorOutcome]:
    """Return the states from the markers of the moving segments and the inertial sensors, and the sensors' result.

    ``observed`` (F, K, 2) becomes NaN, in place, where a marker is not used; a copy would double the memory. ``names``
    are the segments, base first.
    """
    settings, worn = _filter_settings(context.settings, chain), list_sensors(context.trial.imus)
    geometry, outcome = (chain.centres, chain.segment, chain.local), _SensorOutcome()
    if worn:
        from mocap_id.estimation import inertial_smoothing  # noqa: PLC0415  only with sensors
        from mocap_id.stages.ukf_smooth.inertial import check_method, describe_sensors, read_sensors  # noqa: PLC0415

        check_method(settings.method, settings.engine)
        signals = read_sensors(names, worn)
        states, results = inertial_smoothing.smooth_with_sensors(
            observed, view.time, *geometry, sensors=signals, settings=settings
        )
        used = [0, *(s for s, each in results.items() if each.used is not None)]
        has_sensor = np.isin(np.arange(len(names)), used)
        outcome = _SensorOutcome(has_sensor[1:] & has_sensor[:-1], *describe_sensors(names, worn, signals, results))
    else:
        states = smooth(observed, view.rate, *geometry, settings=settings, overwrite=True)
    observed[~states.used] = np.nan
    return states, outcome


def _filter_settings(settings: UkfSmoothSettings, chain: MarkerChain) -> FilterSettings:
    """Return the settings of the filter; `method: encoder` becomes `rts`, with which the encoder is compared.

    The process noise is limited if all markers of a segment are at one position. A dropout then changes the angle of
    the segment while the markers are missing, and this change is not process noise.
    """
    given = settings.model_dump(include={field.name for field in fields(FilterSettings)})
    if settings.method == "encoder":
        given["method"] = "rts"
    local = as_complex(chain.local)
    if any(count_positions(local[chain.segment == k]) < 2 for k in range(1, len(chain.centres) + 1)):
        given["sigma_v_ratio"] = _SNAP_RATIO
    return FilterSettings(**given)


def _add_sd(
    states: States,
    observed: FloatArray,
    skin: SkinModel | None,
    camera: float,
    bend: tuple[int, FloatArray] | None,
    *,
    stretch: tuple[int, Stretch] | None,
    spectrum: ResidualSpectrum,
    settings: UkfSmoothSettings,
) -> tuple[States, str]:
    """Return the states with standard deviations that include skin motion if ``skin`` is given, and what they contain.

    ``bend`` and ``stretch`` are as for :func:`estimate_lasting_errors`. The second result is ``UNKNOWN``, ``NOISE`` or
    ``SKIN`` of :mod:`mocap_id.stages.ukf_smooth.state_errors`.
    """
    if settings.method in FRAMEWISE:  # the errors of these methods are unknown
        return states, UNKNOWN
    if spectrum.cut_off is not None and spectrum.cut_off < UNKNOWN_SD_HZ:
        return replace(states, sd=np.full_like(states.sd, np.nan)), UNKNOWN
    if skin is None or settings.method == "two-filter":
        return states, NOISE
    errors = estimate_lasting_errors(states, observed, skin, camera, spectrum, bend=bend, stretch=stretch)
    return replace(states, sd=add_lasting_errors(states, spectrum.rate, errors)), SKIN


def _make_skin_tree(chain: Tree, skeleton: Skeleton, states: States, skin: SkinModel | None, camera: float) -> Tree:
    """Return skin.h5 with the estimated skin motion, or with an assumed motion if ``skin`` is None."""
    moves = skeleton.marker_segment > 0
    labels = [skeleton.markers[k] for k in np.flatnonzero(moves)]
    if skin is None:
        assumed = assume_skin(states, chain.array("markers/residual")[moves], skeleton.covariance)
        return skin_artefact.make_skin_tree(assumed, labels, camera, "residuals of the joint fit")
    used = [labels[k] for k in np.flatnonzero(np.any(states.used, axis=0))]
    return skin_artefact.make_skin_tree(skin, used, camera, "residuals of all frames")


def _facts(
    states: States, markers: Mapping[str, FloatArray | BoolArray], moves: BoolArray, settings: UkfSmoothSettings
) -> dict[str, Any]:
    """Return facts for the report; only the residuals of the markers ``moves`` (M,) of moving segments count."""
    residual: FloatArray = np.asarray(markers["residual"], dtype=np.float64)
    used, visible, squares = 0, 0, 0.0
    for part in chunks(len(residual)):
        off = residual[part, moves]
        there = np.isfinite(off)
        counted = off[states.used[part] & there]
        used, visible = used + counted.size, visible + int(np.count_nonzero(there))
        squares += float(counted @ counted)
    return {
        "marker_sd_m": states.noise.marker_sd,
        "sigma_v": states.noise.sigma_v.tolist(),
        "reprojection_rms_m": math.sqrt(squares / used) if used else None,
        "outlier_fraction": (visible - used) / visible if visible else None,
        "bridged_fraction": np.mean(~states.observed, axis=0).tolist(),
        "method": settings.method,
        "engine": settings.engine,
    }


def _report_method(settings: UkfSmoothSettings) -> tuple[Reason, ...]:
    """Return a caution if the method is not the default."""
    if settings.method == "rts":
        return ()
    no_sd = "; they have no standard deviations" if settings.method in FRAMEWISE else ""
    message = (
        f"the states are estimated by `{settings.method}`, which is only meant for comparison{no_sd}. Remove "
        "`ukf-smooth: {method: …}` to use the default, filter and smoother."
    )
    return (Reason("states-method", message),)
