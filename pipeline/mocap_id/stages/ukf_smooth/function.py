"""Function of the stage ukf-smooth: estimates joint states, marker residuals, skin motion and body poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, as_complex, chunks
from mocap_id.estimation import FRAMEWISE, FilterSettings, States, smooth
from mocap_id.estimation.chain_residuals import ChainResiduals
from mocap_id.estimation.inverse_kinematics import MarkerChain
from mocap_id.estimation.lasting_errors import add_lasting_errors, estimate_camera_sd
from mocap_id.estimation.residual_spectrum import ResidualSpectrum, residual_spectrum
from mocap_id.kinematics import SkinModel
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.columns import predicted_markers, state_columns
from mocap_id.stages.ukf_smooth.encoder_states import ENCODER_NOISE, beside_cameras, by_encoder
from mocap_id.stages.ukf_smooth.gap_reasons import gap_reasons
from mocap_id.stages.ukf_smooth.measured_poses import measured_poses
from mocap_id.stages.ukf_smooth.noise_reasons import (
    LOST_HZ,
    bridge_repeated,
    filter_reason,
    find_repeated_frames,
    oscillation_reason,
    repeated_reason,
)
from mocap_id.stages.ukf_smooth.state_errors import NOISE, SKIN, UNKNOWN, assumed_skin, known_skin, lasting_errors
from mocap_id.stages.ukf_smooth.uniform_times import check_uniform
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.schemas import ANGLES, MARKERS, STATES
from mocap_id.store.views import Skeleton, Trajectories
from mocap_id.verdict import Reason

_SNAP_RATIO = 2.0  # people: the hip, which moves fastest, has 1.5 to 1.8 times the median of the joints
_ACCELERATION_SHARE = 0.75  # of the standard deviation with sensors, in simulated people: skin is taken for noise


def ukf_smooth(context: Context) -> Outputs:
    """Return states.parquet, markers.parquet, skin.h5, encoder.parquet, poses.parquet and an empty angles.parquet."""
    settings: UkfSmoothSettings = context.settings
    tree, bad = context.tree("chain.h5"), context.table("segments.parquet").facts.get("bad_stretches", ())
    view = Trajectories(context.long("planar.parquet"), bad)
    check_uniform(view, context.trial.trial)
    skeleton = Skeleton.from_tree(tree)
    chain = MarkerChain(skeleton.centres, skeleton.marker_segment, skeleton.local)
    columns = np.array([view.labels.index(label) for label in skeleton.markers], dtype=np.int64)
    moves = chain.segment > 0
    observed, repeated = _samples(view, columns[moves])
    given = _of_cameras(settings, chain)
    chain_moves = MarkerChain(chain.centres, chain.segment[moves], chain.local[moves])
    states, sensed = _states(context, view, observed, chain_moves, skeleton.segments, given)
    camera = estimate_camera_sd(observed, states, settings.marker_sd_floor)
    skin = known_skin(states, observed, camera) if tree.facts.get("estimator") == "bundle" else None
    spectrum = residual_spectrum(ChainResiduals(states, observed, view.rate))
    states, sd_holds = _with_sd(states, observed, skin, camera, spectrum=spectrum, settings=settings)
    if sensed.joints is not None:
        states.sd[:, sensed.joints, 2] *= _ACCELERATION_SHARE
    poses = measured_poses(view, chain, skeleton, observed=observed, angles=states.mean[:, :, 0])
    del observed
    slips = _skin_tree(tree, skeleton, states, skin, camera)
    states = replace(states, observed=bridge_repeated(states.observed, repeated, view.rate))
    encoder = beside_cameras(context.trial.encoder, states, view.time, settings)
    if settings.method == "encoder":
        states, sd_holds = by_encoder(states, encoder), ENCODER_NOISE
    markers = predicted_markers(states, view, columns, chain)
    markers["residual"][repeated] = np.nan
    reasons = (
        gap_reasons(np.isnan(states.mean[:, :, 0]), view.time, skeleton.joint_names, "angle", settings)
        + _for_comparison(settings)
        + repeated_reason(repeated)
        + filter_reason(spectrum.cut_off)
        + oscillation_reason(spectrum.oscillations, skeleton.segments)
        + sensed.reasons
    )
    facts = _facts(states, markers, moves, settings) | {"sd_holds": sd_holds, "cut_off_hz": spectrum.cut_off}
    facts |= {"imus": sensed.imus} if sensed.imus else {}
    return (
        Table(STATES, state_columns(view.time, states.mean, states.sd, states.observed), facts, reasons),
        LongTable(MARKERS, view.frames, view.time, skeleton.markers, markers),
        slips,
        encoder,
        poses,
        Table(ANGLES, {"time": view.time}),
    )


@dataclass(frozen=True)
class _Sensed:
    """Joints (n,) with inertial sensors on both sides, facts of the sensors and reasons; empty without any."""

    joints: BoolArray | None = None
    imus: dict[str, dict[str, Any]] = field(default_factory=dict)
    reasons: tuple[Reason, ...] = ()


def _samples(view: Trajectories, columns: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return the samples (F, M, 2) of some columns (M,), m, NaN where not used, and the repeated frames (F,)."""
    observed = view.read_positions(columns, axes="xy")
    repeated = find_repeated_frames(observed)
    observed[repeated] = np.nan
    return observed, repeated


def _states(  # noqa: PLR0917
    context: Context,
    view: Trajectories,
    observed: FloatArray,
    chain: MarkerChain,
    names: Sequence[str],
    settings: FilterSettings,
) -> tuple[States, _Sensed]:
    """Return the states from the markers of the moving segments and from inertial sensors, if any.

    ``observed`` becomes NaN, in place, where a marker is not used: a copy would double the memory.
    """
    sensed = _Sensed()
    if context.trial.imus:
        from mocap_id.stages.ukf_smooth.inertial import smooth_with_imus_in_plane  # noqa: PLC0415  only with sensors

        files = context.trial.imus
        states, joints, imus, reasons = smooth_with_imus_in_plane(observed, view.time, chain, names, files, settings)
        sensed = _Sensed(joints, imus, reasons)
    else:
        states = smooth(
            observed, view.rate, chain.centres, chain.segment, chain.local, settings=settings, overwrite=True
        )
    observed[~states.used] = np.nan
    return states, sensed


def _of_cameras(settings: UkfSmoothSettings, chain: MarkerChain) -> FilterSettings:
    """Return the settings of the filter for the markers; `method: encoder` is compared with the smoother.

    If a segment has markers at one place only, a drop-out changes its angle for as long as it lasts, which is not
    process noise.
    """
    given = settings.model_dump(include={field.name for field in fields(FilterSettings)})
    if settings.method == "encoder":
        given["method"] = "rts"
    local = as_complex(chain.local)
    if any(count_positions(local[chain.segment == k]) < 2 for k in range(1, len(chain.centres) + 1)):
        given["sigma_v_ratio"] = _SNAP_RATIO
    return FilterSettings(**given)


def _with_sd(
    states: States,
    observed: FloatArray,
    skin: SkinModel | None,
    camera: float,
    *,
    spectrum: ResidualSpectrum,
    settings: UkfSmoothSettings,
) -> tuple[States, str]:
    """Return the states with standard deviations that include known skin motion, and what these include."""
    if settings.method in FRAMEWISE:  # the errors of these methods are unknown
        return states, UNKNOWN
    if spectrum.cut_off is not None and spectrum.cut_off < LOST_HZ:
        return replace(states, sd=np.full_like(states.sd, np.nan)), UNKNOWN
    if skin is None or settings.method == "two-filter":
        return states, NOISE
    errors = lasting_errors(states, observed, skin, camera, spectrum)
    return replace(states, sd=add_lasting_errors(states, spectrum.rate, errors)), SKIN


def _skin_tree(chain: Tree, skeleton: Skeleton, states: States, skin: SkinModel | None, camera: float) -> Tree:
    """Return skin.h5 with the estimated skin motion, or else with an assumed one."""
    moves = skeleton.marker_segment > 0
    labels = [skeleton.markers[k] for k in np.flatnonzero(moves)]
    if skin is None:
        assumed = assumed_skin(states, chain.array("markers/residual")[moves], skeleton.covariance)
        return skin_artefact.make_skin_tree(assumed, labels, camera, "residuals of the joint fit")
    counted = [labels[k] for k in np.flatnonzero(np.any(states.used, axis=0))]
    return skin_artefact.make_skin_tree(skin, counted, camera, "residuals of all frames")


def _facts(
    states: States, markers: Mapping[str, FloatArray | BoolArray], moves: BoolArray, settings: UkfSmoothSettings
) -> dict[str, Any]:
    """Return facts for the report; residuals (F, M) count only for markers on moving segments, ``moves`` (M,)."""
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


def _for_comparison(settings: UkfSmoothSettings) -> tuple[Reason, ...]:
    """Return a caution if the method is not the default."""
    if settings.method == "rts":
        return ()
    spread = "; they have no standard deviations" if settings.method in FRAMEWISE else ""
    return (
        Reason(
            "states-method",
            f"the states are estimated by `{settings.method}`, which is only for comparison{spread}. Remove "
            "`ukf-smooth: {method: …}` to use the filter and its smoother.",
        ),
    )
