"""Workspaces as files: JSON for programs, the edge as CSV for spreadsheets, figures for people."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import __version__
from mocap_id.prescription.overlay import Overlay
from mocap_id.reporting.paper import drawn
from mocap_id.reporting.reach import area, gains, volume
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.workspace.performing import Reach, first_joint


def as_json(reach: Reach, later: Reach | None = None, change: Overlay | None = None) -> dict[str, Any]:
    """What was found; SI units, angles in degrees where the key says so."""
    found: dict[str, Any] = {"schema": "mocap-id/workspace", "version": 1, "product": __version__, **_one(reach)}
    if later is not None and change is not None:
        found["compared_with"] = _one(later)
        found["change"] = {
            "gained": change.gained,
            "lost": change.lost,
            "kept": change.kept,
            "counting_sd": change.sd,
            "aligned_at": "first joint",
        }
    return found


def write(folder: Path, reach: Reach, later: Reach | None = None, change: Overlay | None = None) -> tuple[str, ...]:
    """Write ``workspace.json``, ``workspace.csv`` and the figures; the names of the files.

    Raises
    ------
    StoreError
        The folder cannot be written.
    """
    contents = {
        "workspace.json": json.dumps(as_json(reach, later, change), indent=1, ensure_ascii=False).encode(),
        "workspace.csv": "\n".join([*_edge(reach), ""]).encode(),
        **_figure("workspace", reach),
    }
    if later is not None and change is not None:
        contents["compared_with.csv"] = "\n".join([*_edge(later), ""]).encode()
        contents |= _figure("compared_with", later)
        names = (reach.subject.name, later.subject.name)
        contents |= drawn("change", "workspaces over each other", lambda: gains.draw(change, names))
    with explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_together(folder, contents)
    return tuple(contents)


def _figure(name: str, reach: Reach) -> dict[str, bytes]:
    subject, workspace = reach.subject, reach.workspace
    title, joint = f"reachable workspace of {subject.name}", first_joint(subject.arm)
    if subject.arm.dimension == 2:
        seen = subject.arm.tips(subject.observed)
        return drawn(name, title, lambda: area.draw(workspace, seen, joint))
    return drawn(name, title, lambda: volume.draw(workspace, joint))


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
    """The edge of the workspace: two points a facet in the plane, three in space."""
    shape = reach.workspace.shape
    yield ",".join(["facet", "corner", *(f"{axis}_m" for axis in "xyz"[: shape.points.shape[1]])])
    for k, facet in enumerate(shape.boundary().tolist()):
        for corner, index in enumerate(facet):
            yield ",".join([str(k), str(corner), *(f"{value:.6f}" for value in shape.points[index])])
