"""Function of the stage fit-joints: fits joint centres, marker coordinates and lengths of the whole chain."""

from __future__ import annotations

from collections.abc import Collection, Container, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, IntArray, as_xy
from mocap_id.errors import ConfigError
from mocap_id.kinematics import ChainFit, fit_chain, fit_links, frames_along_motion, orient_frames
from mocap_id.kinematics.chain_equations import ChainState
from mocap_id.kinematics.links import chain_angles
from mocap_id.kinematics.rigid_body import count_positions
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_MARKED_SD = 0.005  # m; for a joint that a marker represents, and for a first joint with few markers beyond it
_FEW_PLACES = 3


def fit_joints(context: Context) -> Outputs:
    """Return chain.h5."""
    settings: FitJointsSettings = context.settings
    segments = context.table("segments.parquet")
    view = Trajectories(context.long("planar.parquet"), segments.facts.get("bad_stretches", ()))
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    points, own = view.read_plane(), _columns(view, labels)
    joint_names = segments.facts["joint_names"]
    named: Mapping[str, list[str]] = segments.facts["joint_markers"]
    at_joint = {joint_names.index(name) + 1: _columns(view, about) for name, about in named.items()}
    links = segments.facts.get("links")
    tracks = {joint: points[:, about].mean(axis=1) for joint, about in at_joint.items()}
    start = None if links is None else _start(links, points[:, own], segment, labels, tracks)
    useful = np.flatnonzero(_shown(points, own, segment) if start is None else np.isfinite(start.angles).all(axis=1))
    if len(useful) > settings.frames:
        frames = frames_along_motion(points, settings.frames, useful)
        points = points[frames]
        start = None if start is None else replace(start, angles=start.angles[frames])
        tracks = {joint: track[frames] for joint, track in tracks.items()}
    fit = orient_frames(_estimate(points[:, own], segment, tracks, settings, start))
    data = {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.arange(len(fit.centres)),
            "centre": as_xy(fit.centres),
            "covariance": fit.covariance,
            "arc": fit.arcs,
        },
        "segments": {
            "name": np.array(segments.facts["names"], dtype=object),
            "length": fit.lengths,
            "length_sd": fit.length_sd,
        },
        "markers": {
            "name": np.array(labels, dtype=object),
            "segment": segment,
            "local": as_xy(fit.local),
            "residual": fit.residual,
        },
    }
    facts = {
        "estimator": settings.estimator,
        "iterations": fit.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(fit.residual[segment > 0] ** 2))),
        "single_markers": links is not None,
    }
    reasons = (
        _for_comparison(settings)
        + _pulled(named, settings)
        + _weak_joints(fit, joint_names, settings, _closely(fit, joint_names, () if links is None else named))
    )
    return (Tree(CHAIN, data, facts, reasons),)


def _columns(view: Trajectories, labels: list[str]) -> IntArray:
    return np.array([view.labels.index(label) for label in labels], dtype=np.int64)


def _shown(points: ComplexArray, own: IntArray, segment: IntArray) -> BoolArray:
    """Return whether each frame (F,) shows at least two markers of every moving segment."""
    visible = np.isfinite(points)
    moving = [own[segment == k] for k in range(1, segment.max() + 1)]
    return np.asarray(np.all([visible[:, markers].sum(axis=1) >= 2 for markers in moving], axis=0))


def _start(
    links: Mapping[str, Any],
    points: ComplexArray,
    segment: IntArray,
    labels: list[str],
    tracks: Mapping[int, ComplexArray],
) -> ChainState:
    """Return the chain that segment found, with the angles of all frames."""
    centres = np.array([complex(x, y) for x, y in links["centres"]])
    local = np.array([complex(*links["local"][label]) for label in labels])
    return ChainState(centres, local, chain_angles(points, segment, centres, local, tracks))


def _estimate(
    points: ComplexArray,
    segment: IntArray,
    auxiliary: Mapping[int, ComplexArray],
    settings: FitJointsSettings,
    start: ChainState | None,
) -> ChainFit:
    if settings.estimator == "bundle":
        return fit_chain(points, segment, auxiliary, settings.lambda_a, start)
    if start is not None:
        raise ConfigError(
            f"fit-joints: a segment has a single marker, and `estimator: {settings.estimator}` needs two of each; "
            "expected `estimator: bundle`"
        )
    if auxiliary:
        raise ConfigError(f"segment: joint_markers: `fit-joints: {{estimator: {settings.estimator}}}` cannot use them")
    return fit_links(points, segment, "circle" if settings.estimator == "circle" else "rigid-body")


def _for_comparison(settings: FitJointsSettings) -> tuple[Reason, ...]:
    """Return a caution if the estimator is not the default."""
    if settings.estimator == "bundle":
        return ()
    spread = "; its joints and lengths have no standard deviations" if settings.estimator == "circle" else ""
    return (
        Reason(
            "estimator",
            f"the joints are fitted by `{settings.estimator}`, which is only for comparison{spread}. Remove "
            "`fit-joints: {estimator: …}` to fit the whole chain.",
        ),
    )


def _pulled(named: Mapping[str, list[str]], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """Return a note for each joint whose centre is attracted by markers."""
    return tuple(
        Reason(
            "joint-markers",
            f"the centre of the {name} is attracted to the mean of {', '.join(about)} (λ_A = {settings.lambda_a:g}); "
            "its standard deviation includes 10 mm for the distance between this mean and the joint.",
            settings.lambda_a,
            level="ok",
        )
        for name, about in named.items()
    )


def _closely(fit: ChainFit, names: list[str], marked: Collection[str]) -> set[str]:
    """Return the joints whose centre must be known closely, since the weight on it is an error of the torque.

    They are ``marked`` joints and a first joint whose segment has few markers: both are in conventional marker sets.
    """
    few = count_positions(fit.local[fit.segment == 1]) < _FEW_PLACES
    return {*marked, *(names[:1] if few else ())}


def _weak_joints(
    fit: ChainFit, names: list[str], settings: FitJointsSettings, closely: Container[str]
) -> tuple[Reason, ...]:
    """Return a caution for every joint that turns too little or whose centre is uncertain."""
    reasons = []
    for name, arc, covariance in zip(names, np.degrees(fit.arcs), fit.covariance, strict=True):
        sd = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else None
        if arc < settings.small_arc_deg:
            reasons.append(
                Reason(
                    "small-arc",
                    f"the {name} turns by only {arc:.1f}°: skin motion of 2 mm then shifts its centre by "
                    f"{2 / np.radians(arc):.0f} mm unnoticed. Record a movement in which it turns more.",
                    float(arc),
                    settings.small_arc_deg,
                )
            )
        elif sd is not None and sd > (limit := min(settings.large_sd_m, _MARKED_SD if name in closely else np.inf)):
            reasons.append(
                Reason(
                    "joint-uncertain",
                    f"the centre of the {name} has a standard deviation of {1e3 * sd:.0f} mm.",
                    sd,
                    limit,
                )
            )
    return tuple(reasons)
