"""The files of a workspace: a JSON document, the edge of the workspace as CSV, and figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.prescription.workspace import Overlay
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results.result import Result, make_text_file
from mocap_id.reporting.workspace_figures import draw_area, draw_change, draw_volume
from mocap_id.workflows.workspace.reach import Reach, first_joint


def workspace_result(reach: Reach, later: Reach | None = None, change: Overlay | None = None) -> Result:
    """Return ``workspace.json``, the edge as CSV and the figures, of one workspace or of two and their difference."""
    content: dict[str, Any] = {"product": __version__, **_one(reach)}
    if later is not None and change is not None:
        content["compared_with"] = _one(later)
        content["change"] = {
            "gained": change.gained,
            "lost": change.lost,
            "kept": change.kept,
            "counting_sd": change.sd,
            "aligned_at": "first joint",
        }
    return Result("workspace", "workspace.json", content, other_files=lambda: _files(reach, later, change), end="")


def _files(reach: Reach, later: Reach | None, change: Overlay | None) -> dict[str, bytes]:
    files = {"workspace.csv": make_text_file(_edge(reach)), **_figure("workspace", reach)}
    if later is None or change is None:
        return files
    names = (reach.subject.name, later.subject.name)
    return {
        **files,
        "compared_with.csv": make_text_file(_edge(later)),
        **_figure("compared_with", later),
        **render("change", "workspaces over each other", lambda: draw_change(change, names)),
    }


def _figure(name: str, reach: Reach) -> dict[str, bytes]:
    subject, workspace = reach.subject, reach.workspace
    title, joint = f"reachable workspace of {subject.name}", first_joint(subject.arm)
    if subject.arm.dimension == 2:
        seen = subject.arm.tips(subject.observed)
        return render(name, title, lambda: draw_area(workspace, seen, joint))
    return render(name, title, lambda: draw_volume(workspace, joint))


def _one(reach: Reach) -> dict[str, Any]:
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


def _edge(reach: Reach) -> Iterator[str]:
    """Return the lines of the edge: two points for each facet in the plane, three in space."""
    shape = reach.workspace.shape
    yield ",".join(["facet", "corner", *(f"{axis}_m" for axis in "xyz"[: shape.points.shape[1]])])
    for k, facet in enumerate(shape.boundary().tolist()):
        for corner, index in enumerate(facet):
            yield ",".join([str(k), str(corner), *(f"{value:.6f}" for value in shape.points[index])])
