"""Computing a workspace, and comparing two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.prescription.arms import PlanarArm, SpatialArm
from mocap_id.prescription.workspace import SAMPLES, Overlay, Workspace, compute_workspace, overlay_workspaces
from mocap_id.workflows.workspace.arm_source import SubjectArm


@dataclass(frozen=True)
class Reach:
    """A subject's arm with its workspace."""

    subject: SubjectArm
    workspace: Workspace
    seed: int


def measure(subject: SubjectArm, samples: int = SAMPLES, seed: int = 0) -> Reach:
    """Compute the workspace of a subject.

    Raises
    ------
    ConfigError
        There are too few samples, or the tip covers no area (volume) because it is on the last joint's axis.
    """
    try:
        return Reach(subject, compute_workspace(subject.arm, subject.limits, samples, seed), seed)
    except ValueError as error:
        raise ConfigError(f"{subject.name}: {error}") from error


def compare(before: Reach, after: Reach) -> Overlay:
    """Return what was gained and lost from one session to another, with the first joints in the same place.

    Raises
    ------
    ConfigError
        One workspace is an area and the other a volume.
    """
    if before.subject.arm.dimension != after.subject.arm.dimension:
        raise ConfigError(
            f"the workspace of {before.subject.name} has {before.subject.arm.dimension} dimensions and that of "
            f"{after.subject.name} {after.subject.arm.dimension}: only workspaces of the same dimension can be compared"
        )
    shift = first_joint(before.subject.arm) - first_joint(after.subject.arm)
    return overlay_workspaces(before.workspace.shape, after.workspace.shape, shift, before.seed)


def first_joint(arm: PlanarArm | SpatialArm) -> FloatArray:
    """Return the first joint of an arm, (d,), m."""
    return arm.centres[0] if isinstance(arm, PlanarArm) else np.asarray(arm.chain.placements[0][:3, 3])
