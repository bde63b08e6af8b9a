"""Workspace of an arm, comparison of two workspaces, and the output files: JSON, the edge as CSV, and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError
from mocap_id.prescription.arms import PlanarArm, SpatialArm
from mocap_id.prescription.workspace import SAMPLES, Overlay, Workspace, compute_workspace, overlay_workspaces
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results.result import Result, make_text_file
from mocap_id.reporting.workspace_figures import draw_area, draw_change, draw_volume
from mocap_id.workflows.workspace.arm_source import SubjectArm


@dataclass(frozen=True)
class Reach:
    """A subject's arm with its workspace."""

    subject: SubjectArm
    workspace: Workspace
    seed: int


def measure(subject: SubjectArm, samples: int = SAMPLES, seed: int = 0) -> Reach:
    """Compute the workspace of a subject.

    ConfigError is raised if there are too few samples, or if the tip covers no area or volume because it is on the axis
    of the last joint.
    """
    try:
        return Reach(subject, compute_workspace(subject.arm, subject.limits, samples, seed), seed)
    except ValueError as error:
        raise ConfigError(f"{subject.name}: {error}") from error


def compare(before: Reach, after: Reach) -> Overlay:
    """Return the gain and loss of workspace from ``before`` to ``after``, with the first joints at the same position.

    ConfigError is raised if one workspace is an area and the other a volume.
    """
    if before.subject.arm.dimension != after.subject.arm.dimension:
        raise ConfigError(
            f"the workspace of {before.subject.name} has {before.subject.arm.dimension} dimensions, but the workspace "
            f"of {after.subject.name} has {after.subject.arm.dimension}: only equal dimensions can be compared"
        )
    shift = first_joint(before.subject.arm) - first_joint(after.subject.arm)
    return overlay_workspaces(before.workspace.shape, after.workspace.shape, shift, before.seed)


def first_joint(arm: PlanarArm | SpatialArm) -> FloatArray:
    """Return the position (d,) of the first joint of an arm, m."""
    return arm.centres[0] if isinstance(arm, PlanarArm) else np.asarray(arm.chain.placements[0][:3, 3])


def workspace_result(reach: Reach, later: Reach | None = None, change: Overlay | None = None) -> Result:
    """Return ``workspace.json``, the edge as CSV, and figures: of one workspace, or of two and their difference."""
    content: dict[str, Any] = {"product": __version__, **_document(reach)}
    if later is not None and change is not None:
        content["compared_with"] = _document(later)
        content["change"] = {
            "gained": change.gained,
            "lost": change.lost,
            "kept": change.kept,
            "counting_sd": change.sd,
            "aligned_at": "first joint",
        }
    return Result("workspace", "workspace.json", content, other_files=lambda: _files(reach, later, change), end="")


def _files(reach: Reach, later: Reach | None, change: Overlay | None) -> dict[str, bytes]:
    files = {"workspace.csv": make_text_file(_edge_rows(reach)), **_draw("workspace", reach)}
    if later is None or change is None:
        return files
    names = (reach.subject.name, later.subject.name)
    return {
        **files,
        "compared_with.csv": make_text_file(_edge_rows(later)),
        **_draw("compared_with", later),
        **render("change", "workspaces over each other", lambda: draw_change(change, names)),
    }


def _draw(name: str, reach: Reach) -> dict[str, bytes]:
    subject, workspace = reach.subject, reach.workspace
    title, joint = f"reachable workspace of {subject.name}", first_joint(subject.arm)
    if subject.arm.dimension == 2:
        seen = subject.arm.tips(subject.observed)
        return render(name, title, lambda: draw_area(workspace, seen, joint))
    return render(name, title, lambda: draw_volume(workspace, joint))


def _document(reach: Reach) -> dict[str, Any]:
    subject, workspace = reach.subject, reach.workspace
    limits = subject.limits
    return {
        "name": subject.name,
        "tip": subject.tip,
        "dimension": subject.arm.dimension,
        "joints": [
            {
                "name": name,
                "lower_deg": float(np.degrees(limits.lower[j])),
                "upper_deg": float(np.degrees(limits.upper[j])),
                "lower_sd_deg": float(np.degrees(limits.lower_sd[j])),
                "upper_sd_deg": float(np.degrees(limits.upper_sd[j])),
            }
            for j, name in enumerate(subject.joints)
        ],
        "workspace": {
            "kind": "area" if subject.arm.dimension == 2 else "volume",
            "unit": "m^2" if subject.arm.dimension == 2 else "m^3",
            "value": workspace.measure,
            "low": workspace.interval[0],
            "high": workspace.interval[1],
            "sd_of_limits_and_dimensions": workspace.sd,
            "discretisation": workspace.discretisation,
        },
        "samples": len(workspace.postures),
        "seed": reach.seed,
        "convergence": [
            {"samples": count, "radius_m": radius, "value": value} for count, radius, value in workspace.convergence
        ],
        "notes": list(subject.notes),
    }


def _edge_rows(reach: Reach) -> Iterator[str]:
    """Yield the lines of a CSV file with the edge: two points for each facet in the plane, three points in space."""
    shape = reach.workspace.shape
    yield ",".join(["facet", "corner", *(f"{axis}_m" for axis in "xyz"[: shape.points.shape[1]])])
    for k, facet in enumerate(shape.boundary().tolist()):
        for corner, index in enumerate(facet):
            yield ",".join([str(k), str(corner), *(f"{value:.6f}" for value in shape.points[index])])
