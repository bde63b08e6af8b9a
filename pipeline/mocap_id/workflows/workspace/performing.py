"""A subject's workspace, and two of them over each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.prescription.overlay import Overlay, overlay
from mocap_id.prescription.reach import PlanarArm, SpatialArm
from mocap_id.prescription.workspace import SAMPLES, Workspace, reachable
from mocap_id.workflows.workspace.sources import Subject


@dataclass(frozen=True)
class Reach:
    """A subject with its workspace."""

    subject: Subject
    workspace: Workspace
    seed: int


def measure(subject: Subject, samples: int = SAMPLES, seed: int = 0) -> Reach:
    """The workspace of a subject.

    Raises
    ------
    ConfigError
        Too few samples, or a tip that fills no area (volume): it sits on the last joint's axis.
    """
    try:
        return Reach(subject, reachable(subject.arm, subject.limits, samples, seed), seed)
    except ValueError as error:
        raise ConfigError(f"{subject.name}: {error}") from error


def compare(before: Reach, after: Reach) -> Overlay:
    """What was gained and lost from one session to another; both are laid over each other at the first joint.

    Raises
    ------
    ConfigError
        One workspace is an area and the other a volume.
    """
    if before.subject.arm.dimension != after.subject.arm.dimension:
        raise ConfigError(
            f"the workspace of {before.subject.name} has {before.subject.arm.dimension} dimensions and that of "
            f"{after.subject.name} {after.subject.arm.dimension}: only like can be compared"
        )
    shift = first_joint(before.subject.arm) - first_joint(after.subject.arm)
    return overlay(before.workspace.shape, after.workspace.shape, shift, before.seed)


def first_joint(arm: PlanarArm | SpatialArm) -> FloatArray:
    """Where an arm begins, (d,), m."""
    return arm.centres[0] if isinstance(arm, PlanarArm) else np.asarray(arm.chain.placements[0][:3, 3])
