"""fit-joints: centres, marker coordinates and lengths of the whole chain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mocap_id.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from mocap_id.errors import ConfigError
from mocap_id.kinematics import ChainFit, fit_chain, fit_links, fix_gauge, frames_along_motion
from mocap_id.stages.base import Context, Outputs
from mocap_id.stages.fit_joints import FitJointsSettings
from mocap_id.stages.trajectories import PlanarView
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.verdict import Reason


def fit_joints(context: Context) -> Outputs:
    """Fit the chain to the markers of its segments."""
    settings: FitJointsSettings = context.settings
    view, segments = PlanarView(context.long("planar.parquet")), context.table("segments.parquet")
    assigned = np.flatnonzero(segments["segment"] >= 0)
    labels, segment = [str(label) for label in segments["marker"][assigned]], segments["segment"][assigned]
    points, own = view.plane(), _columns(view, labels)
    useful = np.flatnonzero(_shown(points, own, segment))
    if len(useful) > settings.frames:
        points = points[frames_along_motion(points, settings.frames, useful)]
    joint_names = segments.facts["joint_names"]
    named: Mapping[str, list[str]] = segments.facts["joint_markers"]
    auxiliary = {
        joint_names.index(name) + 1: points[:, _columns(view, about)].mean(axis=1) for name, about in named.items()
    }
    fit = fix_gauge(_estimate(points[:, own], segment, auxiliary, settings))
    data = {
        "joints": {
            "name": np.array(joint_names, dtype=object),
            "parent": np.arange(len(fit.centres)),
            "centre": _xy(fit.centres),
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
            "local": _xy(fit.local),
            "residual": fit.residual,
        },
    }
    facts = {
        "estimator": settings.estimator,
        "iterations": fit.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(fit.residual[segment > 0] ** 2))),
    }
    reasons = _for_comparison(settings) + _pulled(named, settings) + _weak_joints(fit, joint_names, settings)
    return (Tree(CHAIN, data, facts, reasons),)


def _columns(view: PlanarView, labels: list[str]) -> IntArray:
    return np.array([view.labels.index(label) for label in labels], dtype=np.int64)


def _shown(points: ComplexArray, own: IntArray, segment: IntArray) -> BoolArray:
    """(F,) frames that show two markers or more, by their columns, of every moving segment."""
    seen = np.isfinite(points)
    moving = [own[segment == k] for k in range(1, segment.max() + 1)]
    return np.asarray(np.all([seen[:, markers].sum(axis=1) >= 2 for markers in moving], axis=0))


def _estimate(
    points: ComplexArray, segment: IntArray, auxiliary: Mapping[int, ComplexArray], settings: FitJointsSettings
) -> ChainFit:
    if settings.estimator == "bundle":
        return fit_chain(points, segment, auxiliary, settings.lambda_a)
    if auxiliary:
        raise ConfigError(f"segment: joint_markers: `fit-joints: {{estimator: {settings.estimator}}}` uses none")
    return fit_links(points, segment, settings.estimator)


def _for_comparison(settings: FitJointsSettings) -> tuple[Reason, ...]:
    """A caution where the chain is not the one that the program would give by itself."""
    if settings.estimator == "bundle":
        return ()
    spread = "; its joints and lengths have no standard deviations" if settings.estimator == "circle" else ""
    return (
        Reason(
            "estimator",
            f"the joints are fitted by `{settings.estimator}`, which is there to be compared with{spread}. Leave "
            "`fit-joints: {estimator: …}` away for the fit of the whole chain.",
        ),
    )


def _pulled(named: Mapping[str, list[str]], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """A note of each joint that markers pull."""
    return tuple(
        Reason(
            "joint-markers",
            f"the centre of the {name} is pulled towards the middle of {', '.join(about)} (λ_A = "
            f"{settings.lambda_a:g}); its standard deviation does not say how far that is from the joint.",
            settings.lambda_a,
            level="ok",
        )
        for name, about in named.items()
    )


def _xy(points: ComplexArray) -> FloatArray:
    """(K, 2) real coordinates."""
    return np.stack([points.real, points.imag], axis=1)


def _weak_joints(fit: ChainFit, names: list[str], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """A caution for every joint that turned too little, or whose centre is uncertain."""
    reasons = []
    for name, arc, covariance in zip(names, np.degrees(fit.arcs), fit.covariance, strict=True):
        sd = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if np.isfinite(covariance).all() else None
        if arc < settings.small_arc_deg:
            reasons.append(
                Reason(
                    "small-arc",
                    f"the {name} turned by {arc:.1f}° only: skin that slips by 2 mm shifts its centre by "
                    f"{2 / np.radians(arc):.0f} mm unseen. A movement with more of it would place it better.",
                    float(arc),
                    settings.small_arc_deg,
                )
            )
        elif sd is not None and sd > settings.large_sd_m:
            reasons.append(
                Reason(
                    "joint-uncertain",
                    f"the centre of the {name} is known to {1e3 * sd:.0f} mm only (standard deviation).",
                    sd,
                    settings.large_sd_m,
                )
            )
    return tuple(reasons)
