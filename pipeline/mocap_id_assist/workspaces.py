"""The workspace of the tip of a trial's chain, or of a chain in YAML (thesis 7.2), and its files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import __version__, runner
from mocap_id.arrays import FloatArray
from mocap_id.config.parsing import suggest_name
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import Chain, Revolute, se3
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results.result import Result, make_text_file
from mocap_id.store import Folder, Table, Tree
from mocap_id.store.views import Skeleton, joint_columns
from mocap_id.workflows.run_folder import check_provenance, open_run_to
from mocap_id_assist.figures import draw_area, draw_change, draw_volume
from mocap_id_assist.files import ChainFile, is_chain, load_chain
from mocap_id_assist.workspace import (
    SAMPLES,
    JointLimits,
    Overlay,
    PlanarArm,
    SpatialArm,
    Workspace,
    compute_workspace,
    find_limits,
    overlay_workspaces,
)

_LAST = "ukf-smooth"


@dataclass(frozen=True)
class SubjectArm:
    """An arm with its joint limits."""

    name: str
    joints: tuple[str, ...]
    arm: PlanarArm | SpatialArm
    limits: JointLimits
    tip: str  # a marker, or a point
    observed: FloatArray  # (T, n) recorded postures, rad; empty for a chain in YAML
    notes: tuple[str, ...]  # limitations of the result


def read_arm(
    path: Path, tip: str | None = None, quantile: float = 0.0, progress: runner.Progress = lambda step: None
) -> SubjectArm:
    """Return the arm from a trial's YAML file or run folder, or from a chain's YAML file.

    Parameters
    ----------
    path : Path
        A trial's YAML file is run up to the joint states, which needs no forces.
    tip : str, optional
        A marker of the last segment, or a point ``x,y`` in its frame, m; by default the marker farthest from the joint.
    quantile : float
        Fraction of the samples that is left out at each end of the range of an observed angle.
    progress : callable, optional
        Called with each step of the run if ``path`` is a trial's YAML file.

    Raises
    ------
    ConfigError
        The file, the tip or the quantile is wrong.
    RecordingError
        The motion does not determine the joint limits.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    if not path.is_dir() and is_chain(path):
        if tip is not None or quantile:
            raise ConfigError(
                f"{path}: a chain's YAML file contains `tip:` and limits; leave out `--tip` and `--quantile`"
            )
        return _read_chain(load_chain(path))
    folder, trial = open_run_to(path, _LAST, progress)
    return read_folder(folder, path.name if trial is None else trial.name, path, tip, quantile)


def read_folder(folder: Folder, name: str, source: Path, tip: str | None, quantile: float) -> SubjectArm:
    """Return the arm from the artefacts in a run folder; ``source`` is the path in messages.

    Raises
    ------
    StoreError
        An artefact is missing or damaged, or was not computed from the other artefacts in the folder.
    ConfigError, RecordingError
        As for :func:`read_arm`.
    """
    check_provenance(folder, ("chain.h5", "states.parquet"))
    chain, states = folder.read("chain.h5"), folder.read("states.parquet")
    assert isinstance(chain, Tree) and isinstance(states, Table)
    skeleton = Skeleton.from_tree(chain)
    centres, covariance = skeleton.centres, skeleton.covariance
    tip_name, local, error = _find_tip(skeleton, chain.numbers("markers/residual"), tip, source)
    notes = []
    if not np.isfinite(covariance).all():
        covariance = np.zeros_like(covariance)
        notes.append(
            "the joints have no standard deviations, so the interval includes only the uncertainty of the limits"
        )
    q, sd, observed = (joint_columns(states, name, len(centres)) for name in ("theta", "sd_theta", "observed"))
    seen = observed.astype(bool)
    if not np.isfinite(sd[seen & np.isfinite(q)]).all():
        notes.append("some angles have no standard deviation, so the interval is too narrow")
    try:
        limits = find_limits(q, np.nan_to_num(sd), seen, quantile)
    except ValueError as wrong:
        kind = ConfigError if "quantile" in str(wrong) else RecordingError
        raise kind(f"{source}: {wrong}") from wrong
    # The frame of the tip starts at the last joint, so the error of this joint also belongs to the tip.
    arm = PlanarArm(centres, local, covariance, covariance[-1] + error**2 * np.eye(2))
    complete = q[np.all(seen & np.isfinite(q), axis=1)]
    return SubjectArm(name, skeleton.joints, arm, limits, tip_name, complete, tuple(notes))


def _read_chain(chain: ChainFile) -> SubjectArm:
    """Return the arm of a chain's YAML file."""
    limits = JointLimits.given(chain.limits[:, 0], chain.limits[:, 1])
    arm: PlanarArm | SpatialArm
    if chain.planar:
        arm = PlanarArm.exact(chain.places[:, :2], chain.tip[:2])
    else:
        joints = tuple(Revolute((float(x), float(y), float(z))) for x, y, z in chain.axes)
        arm = SpatialArm(Chain(joints, se3.pose(np.eye(3), chain.places)), chain.tip)
    point = ", ".join(f"{x:g}" for x in chain.tip)
    return SubjectArm(chain.name, chain.joints, arm, limits, f"({point}) m", np.zeros((0, limits.dimension)), ())


def _find_tip(skeleton: Skeleton, residual: FloatArray, tip: str | None, source: Path) -> tuple[str, FloatArray, float]:
    """Return name and position (2,) of the tip in the last segment's frame, and the rms error of this position, m."""
    labels, segment, local, last = skeleton.markers, skeleton.marker_segment, skeleton.local, len(skeleton.centres)
    if tip is not None and "," in tip:
        return f"({tip}) m", _parse_point(tip), 0.0
    own = [k for k in range(len(labels)) if segment[k] == last]
    if not own:
        raise RecordingError(f"{source}: the last segment has no marker: give the tip as a point, `--tip x,y`")
    if tip is None:
        k = max(own, key=lambda k: float(np.linalg.norm(local[k])))
    elif tip in labels and labels.index(tip) in own:
        k = labels.index(tip)
    else:
        known = [labels[k] for k in own]
        about = "is not on the last segment" if tip in labels else "is not a marker of the chain"
        raise ConfigError(f"{source}: the tip `{tip}` {about}: {suggest_name(tip, known)}")
    return labels[k], local[k], float(np.nan_to_num(residual[k]))


def _parse_point(text: str) -> FloatArray:
    """Return the point (2,) in the text of `--tip`; raise ConfigError if it is not two numbers."""
    try:
        point = np.array([float(part) for part in text.split(",")])
    except ValueError:
        point = np.zeros(0)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise ConfigError(f"--tip {text}: expected a marker of the last segment, or a point `x,y` in its frame, m")
    return point


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
