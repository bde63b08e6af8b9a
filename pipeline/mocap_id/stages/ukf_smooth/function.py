"""ukf-smooth: joint states of the whole chain by an unscented Kalman filter and smoother."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks
from mocap_id.errors import RecordingError
from mocap_id.estimation import BRIDGE_LIMIT, FRAMEWISE, FilterSettings, States, smooth
from mocap_id.estimation.inverse import Chain
from mocap_id.estimation.skin import camera_sd, with_lasting_errors
from mocap_id.kinematics import SkinModel
from mocap_id.stages import skin_artefact
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.trajectories import PlanarView
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.stages.ukf_smooth.encoder_states import ENCODER_NOISE, beside_cameras, by_encoder
from mocap_id.stages.ukf_smooth.measured_poses import measured_poses
from mocap_id.stages.ukf_smooth.predicted_markers import beside_measured
from mocap_id.stages.ukf_smooth.state_errors import NOISE, SKIN, UNKNOWN, known_skin, lasting_errors, supposed_skin
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.schemas import MARKERS, STATES
from mocap_id.verdict import Reason

_JITTER = 0.25  # of a frame: what rounding to milliseconds does at 500 Hz


def ukf_smooth(context: Context) -> Outputs:
    """Estimate the states of every joint at every frame, and where the markers should have been."""
    settings: UkfSmoothSettings = context.settings
    view, tree = PlanarView(context.long("planar.parquet")), context.tree("chain.h5")
    _check_uniform(view, context.trial.trial)
    labels, names = ([str(label) for label in _node(tree, f"{group}/name")] for group in ("markers", "joints"))
    chain = Chain(_node(tree, "joints/centre"), _node(tree, "markers/segment"), _node(tree, "markers/local"))
    columns = np.array([view.labels.index(label) for label in labels], dtype=np.int64)
    moves = chain.segment > 0
    states, observed = _states(view, columns[moves], chain, settings)
    camera = camera_sd(observed, states, settings.marker_sd_floor)
    skin = known_skin(states, observed, camera) if tree.facts.get("estimator") == "bundle" else None
    states, sd_holds = _with_sd(states, observed, skin, camera, rate=view.rate, settings=settings)
    segments = [str(name) for name in _node(tree, "segments/name")]
    poses = measured_poses(
        view, chain, labels=labels, segments=segments, observed=observed, angles=states.mean[:, :, 0]
    )
    del observed
    slips = _skin_tree(tree, states, skin, camera)
    encoder = beside_cameras(context.trial.encoder, states, view.time, settings)
    if settings.method == "encoder":
        states, sd_holds = by_encoder(states, encoder), ENCODER_NOISE
    markers = beside_measured(states, view, columns, chain)
    reasons = _gaps(states, view.time, names, settings) + _for_comparison(settings)
    facts = _facts(states, markers, moves, settings) | {"sd_holds": sd_holds}
    return (
        Table(STATES, _state_columns(states, view.time), facts, reasons),
        LongTable(MARKERS, view.frames, view.time, labels, markers),
        slips,
        encoder,
        poses,
    )


def _states(
    view: PlanarView, columns: IntArray, chain: Chain, settings: UkfSmoothSettings
) -> tuple[States, FloatArray]:
    """States from the markers of the moving segments, and what they rest on (F, M, 2), NaN elsewhere, m.

    Parameters
    ----------
    columns : (M,) int array
        Those markers in the view.
    """
    moves = chain.segment > 0
    observed = view.without_bursts(columns)
    states = smooth(
        observed,
        view.rate,
        chain.centres,
        chain.segment[moves],
        chain.local[moves],
        settings=_of_cameras(settings),
        overwrite=True,
    )
    observed[~states.used] = np.nan  # in its place: a copy would be as large as all the rest
    return states, observed


def _of_cameras(settings: UkfSmoothSettings) -> FilterSettings:
    """What the markers are filtered by; an encoder is held against the smoother."""
    given = settings.model_dump(include={field.name for field in fields(FilterSettings)})
    return FilterSettings(**given | ({"method": "rts"} if settings.method == "encoder" else {}))


def _with_sd(
    states: States,
    observed: FloatArray,
    skin: SkinModel | None,
    camera: float,
    *,
    rate: float,
    settings: UkfSmoothSettings,
) -> tuple[States, str]:
    """States with standard deviations that hold skin where it is known, and what they hold."""
    if settings.method in FRAMEWISE:  # what such a method lets pass is not known
        return states, UNKNOWN
    if skin is None or settings.method == "two-filter":
        return states, NOISE
    errors = lasting_errors(states, observed, skin, camera, rate)
    return replace(states, sd=with_lasting_errors(states, rate, errors)), SKIN


def _skin_tree(chain: Tree, states: States, skin: SkinModel | None, camera: float) -> Tree:
    """What is known of the skin, or else supposed."""
    moves = _node(chain, "markers/segment") > 0
    labels = [str(label) for label in _node(chain, "markers/name")[moves]]
    if skin is None:
        supposed = supposed_skin(states, _node(chain, "markers/residual")[moves], _node(chain, "joints/covariance"))
        return skin_artefact.as_tree(supposed, labels, camera, "residuals of the joint fit")
    counted = [labels[k] for k in np.flatnonzero(np.any(states.used, axis=0))]
    return skin_artefact.as_tree(skin, counted, camera, "residuals of all frames")


def _node(tree: Tree, path: str) -> np.ndarray[Any, Any]:
    group, name = path.split("/")
    found = tree.data[group]
    assert isinstance(found, dict)
    return np.asarray(found[name])


def _check_uniform(view: PlanarView, trial: str) -> None:
    """Refuse time stamps that are not one period apart: the process model has one time step."""
    time, period = view.time, 1.0 / view.rate
    off = np.abs(time - time[0] - period * np.arange(len(time))) / period
    if not np.all(off <= _JITTER):
        k = int(np.argmax(~(off <= _JITTER)))
        raise RecordingError(
            f"trial {trial}: ukf-smooth: time stamps are not uniform: frame {view.frames[k]} is at "
            f"{time[k]:.4f} s where {view.rate:g} frames per second put it at {time[0] + period * k:.4f} s; "
            "export the trial at a constant rate, with a row for every frame, or use a `window:` without the break"
        )


def _facts(
    states: States, markers: Mapping[str, FloatArray | BoolArray], moves: BoolArray, settings: UkfSmoothSettings
) -> dict[str, Any]:
    """What the report reads, from the residuals (F, M), of which those of the markers that move (M,) count."""
    residual: FloatArray = np.asarray(markers["residual"], dtype=np.float64)
    used, seen, squares = 0, 0, 0.0
    for part in chunks(len(residual)):
        off = residual[part, moves]
        there = np.isfinite(off)
        counted = off[states.used[part] & there]
        used, seen = used + counted.size, seen + int(np.count_nonzero(there))
        squares += float(counted @ counted)
    return {
        "marker_sd_m": states.noise.marker_sd,
        "sigma_v": states.noise.sigma_v.tolist(),
        "reprojection_rms_m": math.sqrt(squares / used) if used else None,
        "outlier_fraction": (seen - used) / seen if seen else None,
        "bridged_fraction": np.mean(~states.observed, axis=0).tolist(),
        "method": settings.method,
        "engine": settings.engine,
    }


def _state_columns(states: States, time: FloatArray) -> dict[str, FloatArray | BoolArray]:
    columns: dict[str, FloatArray | BoolArray] = {"time": time}
    for j in range(states.mean.shape[1]):
        for d, name in enumerate(("theta", "dtheta", "ddtheta", "dddtheta")):
            columns[f"{name}_{j + 1}"] = states.mean[:, j, d]
        for d, name in enumerate(("theta", "dtheta", "ddtheta")):
            columns[f"sd_{name}_{j + 1}"] = states.sd[:, j, d]
        columns[f"observed_{j + 1}"] = states.observed[:, j]
    return columns


def _gaps(states: States, time: FloatArray, names: list[str], settings: UkfSmoothSettings) -> tuple[Reason, ...]:
    """A caution for every joint whose angle is not given throughout."""
    reasons = []
    for j, name in enumerate(names):
        missing = np.isnan(states.mean[:, j, 0])
        if not missing.any():
            continue
        starts, stops = _stretches(missing)
        longest = int(np.argmax(stops - starts))
        seconds = np.count_nonzero(missing) * (time[-1] - time[0]) / max(len(time) - 1, 1)
        where = "throughout" if missing.all() else f"{len(starts)} times, longest from {time[starts[longest]]:.2f} s"
        message = f"the angle of the {name} is not given for {seconds:.2f} s ({where}): {_limit(settings)}."
        reasons.append(Reason("gap", message, float(seconds), 0.0))
    return tuple(reasons)


def _limit(settings: UkfSmoothSettings) -> str:
    """Why an angle is not given, and what helps."""
    if settings.method == "encoder":
        return "the encoder's record does not reach there. Record it longer, or leave the stretch out with `window:`"
    limit = f"it would be uncertain by more than {settings.angle_sd_limit:g} rad (standard deviation)"
    if settings.method in FRAMEWISE:
        limit = f"`{settings.method}`, which bridges up to {BRIDGE_LIMIT:g} s, leaves the gap"
    return (
        f"its markers were missing, or did not fit the chain, for so long that {limit}. Fill or re-label them, or "
        "leave the stretch out with `window:`"
    )


def _for_comparison(settings: UkfSmoothSettings) -> tuple[Reason, ...]:
    """A caution where the states are not those that the program would give by itself."""
    if settings.method == "rts":
        return ()
    spread = "; they have no standard deviations" if settings.method in FRAMEWISE else ""
    return (
        Reason(
            "states-method",
            f"the states are estimated by `{settings.method}`, which is there to be compared with{spread}. Leave "
            "`ukf-smooth: {method: …}` away for the filter and its smoother.",
        ),
    )


def _stretches(flags: BoolArray) -> tuple[IntArray, IntArray]:
    """First samples, and samples after the last, of the runs of true."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int64))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
