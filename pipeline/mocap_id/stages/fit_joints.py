"""fit-joints: centres, marker coordinates and lengths of the whole chain."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from mocap_id.arrays import ComplexArray, FloatArray
from mocap_id.kinematics import ChainFit, fit_chain, fix_gauge
from mocap_id.stages.base import Context, Outputs, Settings, Stage
from mocap_id.stages.trajectories import Trajectories
from mocap_id.store import Tree
from mocap_id.store.schemas import CHAIN
from mocap_id.verdict import Reason


class FitJointsSettings(Settings):
    """How much is looked at, and when a joint is called weak."""

    frames: int = Field(800, ge=50, description="frames fitted, evenly over the trial")
    small_arc_deg: float = Field(10.0, ge=0, description="a joint that turns less is reported as weak, degrees")
    large_sd_m: float = Field(0.02, gt=0, description="a centre less certain than this is reported, m")


def fit_joints(context: Context) -> Outputs:
    """Fit the chain to the markers of its segments."""
    settings: FitJointsSettings = context.settings
    trajectories = Trajectories.of(context.table("planar.parquet")).without_bursts().thinned(settings.frames)
    segments = context.table("segments.parquet")
    assigned = segments.frame.dropna(subset="segment")
    labels = [str(label) for label in assigned["marker"]]
    segment = assigned["segment"].to_numpy(dtype=np.int64)
    kept = [trajectories.labels.index(label) for label in labels]
    fit = fix_gauge(fit_chain(trajectories.plane[:, kept], segment))
    joint_names = segments.facts["joint_names"]
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
        "iterations": fit.iterations,
        "reprojection_rms_m": float(np.sqrt(np.mean(fit.residual[segment > 0] ** 2))),
    }
    return (Tree(CHAIN, data, facts, _weak_joints(fit, joint_names, settings)),)


def _xy(points: ComplexArray) -> FloatArray:
    """(K, 2) real coordinates."""
    return np.stack([points.real, points.imag], axis=1)


def _weak_joints(fit: ChainFit, names: list[str], settings: FitJointsSettings) -> tuple[Reason, ...]:
    """A caution for every joint that turned too little, or whose centre is uncertain."""
    reasons = []
    for name, arc, covariance in zip(names, np.degrees(fit.arcs), fit.covariance, strict=True):
        sd = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
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
        elif sd > settings.large_sd_m:
            reasons.append(
                Reason(
                    "joint-uncertain",
                    f"the centre of the {name} is known to {1e3 * sd:.0f} mm only (standard deviation).",
                    sd,
                    settings.large_sd_m,
                )
            )
    return tuple(reasons)


STAGE = Stage(
    name="fit-joints",
    version=1,
    inputs=("planar.parquet", "segments.parquet"),
    outputs=("chain.h5",),
    uses=(),
    settings=FitJointsSettings,
    function=fit_joints,
    help="Fit joint centres, marker coordinates and segment lengths together.",
)
