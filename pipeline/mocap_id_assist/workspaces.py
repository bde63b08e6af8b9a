"""The workspace of the tip of a trial's chain, or of a chain in YAML (thesis 7.2), and its files."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from pydantic import Field

from mocap_id import __version__, runner
from mocap_id.arrays import FloatArray
from mocap_id.config.parsing import parse, raise_mistakes, read_source, suggest_name
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import Chain, Revolute, se3
from mocap_id.reporting import paper_figures, style
from mocap_id.reporting.paper_figures import render
from mocap_id.reporting.results import CommandResult, make_text_file
from mocap_id.stages.base import Settings
from mocap_id.store import Folder, Table, Tree
from mocap_id.store.artefacts import Skeleton, joint_columns
from mocap_id.workflows.run_folder import check_provenance, open_run_to
from mocap_id_assist.workspace import (
    POSTURES,
    JointLimits,
    Overlay,
    PlanarArm,
    ReachableWorkspace,
    SpatialArm,
    compute_reachable_workspace,
    find_limits,
    overlay_workspaces,
)

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class _ChainJoint(Settings):
    name: str = Field(min_length=1, max_length=60, description="name of the joint")
    axis: Literal["x", "y", "z"] | tuple[float, float, float] = Field(
        "z", description="axis of rotation in the frame of the previous link, with all joints at 0"
    )
    at: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="position in the frame of the previous joint, m"
    )
    limits_deg: tuple[float, float] = Field(description="smallest and largest angle, degrees")


class _ChainFile(Settings):
    chain: str = Field(pattern=r"^\w[\w .+-]*$", max_length=100, description="name of the chain")
    joints: tuple[_ChainJoint, ...] = Field(min_length=1, max_length=12, description="joints from the base to the tip")
    tip: tuple[float, float, float] = Field(description="end point in the frame of the last joint, m")


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

    A trial's YAML file is run up to the joint states, which needs no forces; ``progress`` is called with each step.
    ``tip`` is a marker of the last segment, or a point ``x,y`` in its frame, m; by default the marker farthest from the
    joint. ``quantile`` is the fraction of the samples that is left out at each end of the range of an observed angle.

    Raises
    ------
    ConfigError
        The file, the tip or the quantile is wrong.
    RecordingError
        The motion does not determine the joint limits.
    Refused, NumericalError, StoreError
        As for :func:`mocap_id.runner.run`.
    """
    data = None if path.is_dir() else read_source(path.absolute()).data
    if isinstance(data, dict) and "chain" in data and "recording" not in data:  # a chain, not a trial
        if tip is not None or quantile:
            raise ConfigError(
                f"{path}: a chain's YAML file contains `tip:` and limits; leave out `--tip` and `--quantile`"
            )
        return load_chain(path)
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
    skeleton = Skeleton(chain)
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


def load_chain(file: Path) -> SubjectArm:
    """Read and check a chain's YAML file, and return its arm, without uncertainty.

    The workspace is an area if all joints rotate about z. Raises ConfigError with one line for every mistake: file,
    line, key, what was found, what was expected.
    """
    source = read_source(file.absolute())
    parsed = parse(source, _ChainFile, "keys such as `chain:`, `joints:` and `tip:`")
    mistakes = []
    for index, joint in enumerate(parsed.joints):
        if joint.axis == (0.0, 0.0, 0.0):
            where = source.where(("joints", index, "axis"))
            mistakes.append(f"{where}: the axis of the joint `{joint.name}` is zero: expected a direction")
        low, high = joint.limits_deg
        if low >= high:
            where = source.where(("joints", index, "limits_deg"))
            mistakes.append(f"{where}: the first limit, {low:g}°, is not below the second, {high:g}°")
    raise_mistakes(mistakes)
    named = [np.array(_AXES[joint.axis] if isinstance(joint.axis, str) else joint.axis) for joint in parsed.joints]
    axes = np.array([axis / float(np.linalg.norm(axis)) for axis in named])
    places, tip = np.array([joint.at for joint in parsed.joints]), np.array(parsed.tip)
    ends = np.array([np.radians(joint.limits_deg) for joint in parsed.joints])
    limits = JointLimits.given(ends[:, 0], ends[:, 1])
    arm: PlanarArm | SpatialArm
    if np.all(axes == _AXES["z"]):
        arm = PlanarArm.exact(places[:, :2], tip[:2])
    else:
        hinges = tuple(Revolute((float(x), float(y), float(z))) for x, y, z in axes)
        arm = SpatialArm(Chain(hinges, se3.pose(np.eye(3), places)), tip)
    point = ", ".join(f"{x:g}" for x in tip)
    names = tuple(joint.name for joint in parsed.joints)
    return SubjectArm(parsed.chain, names, arm, limits, f"({point}) m", np.zeros((0, limits.dimension)), ())


def _find_tip(skeleton: Skeleton, residual: FloatArray, tip: str | None, source: Path) -> tuple[str, FloatArray, float]:
    """Return name and position (2,) of the tip in the last segment's frame, and the rms error of this position, m."""
    labels, segment, local, last = skeleton.markers, skeleton.marker_segment, skeleton.local, len(skeleton.centres)
    if tip is not None and "," in tip:
        try:
            point = np.array([float(part) for part in tip.split(",")])
        except ValueError:
            point = np.zeros(0)
        if point.shape != (2,) or not np.isfinite(point).all():
            raise ConfigError(f"--tip {tip}: expected a marker of the last segment, or a point `x,y` in its frame, m")
        return f"({tip}) m", point, 0.0
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


def measure_workspace(subject: SubjectArm, samples: int = POSTURES, seed: int = 0) -> ReachableWorkspace:
    """Compute the workspace of a subject.

    ConfigError is raised if there are too few samples, or if the tip covers no area or volume because it is on the axis
    of the last joint.
    """
    try:
        return compute_reachable_workspace(subject.arm, subject.limits, samples, seed)
    except ValueError as error:
        raise ConfigError(f"{subject.name}: {error}") from error


def compare_workspaces(
    before: SubjectArm, workspace: ReachableWorkspace, after: SubjectArm, later: ReachableWorkspace
) -> Overlay:
    """Return the gain and loss of workspace from ``before`` to ``after``, with the first joints at the same position.

    ConfigError is raised if one workspace is an area and the other a volume.
    """
    if before.arm.dimension != after.arm.dimension:
        raise ConfigError(
            f"the workspace of {before.name} has {before.arm.dimension} dimensions, but the workspace of {after.name} "
            f"has {after.arm.dimension}: only equal dimensions can be compared"
        )
    return overlay_workspaces(workspace.shape, later.shape, before.arm.base - after.arm.base, workspace.seed)


_LENGTH_LIMIT = 0.03  # m, chosen: above the usual error of a joint centre, and not measured on sessions of one person


def find_other_lengths(before: SubjectArm, after: SubjectArm) -> tuple[str, ...]:
    """Return why a comparison may show another chain instead of another range; () if the chains agree.

    The later chain is that of another person, or has other joints or another tip. A length is compared if it is known
    in both chains: it must differ by more than 30 mm and by more than two standard deviations.
    """
    if before.joints != after.joints:
        joints = " and ".join(f"{', '.join(each.joints)} ({each.name})" for each in (before, after))
        return (f"the chains have different joints: {joints}. The difference of the workspaces is not one of range",)
    arms = [each.arm for each in (before, after) if isinstance(each.arm, PlanarArm)]
    if len(arms) < 2:
        return ()
    segments = [f"from {low} to {high}" for low, high in pairwise(before.joints)]
    segments.append(f"from {before.joints[-1]} to the tip ({' and '.join(dict.fromkeys((before.tip, after.tip)))})")
    lengths, variances = np.array([_measure_lengths(arm) for arm in arms]).swapaxes(0, 1)
    off, limit = lengths[1] - lengths[0], np.maximum(_LENGTH_LIMIT, 2 * np.sqrt(variances.sum(axis=0)))
    changed = [f"{segments[k]} by {1e3 * off[k]:+.0f} mm" for k in np.flatnonzero(np.abs(off) > limit)]
    if not changed:
        return ()
    return (
        f"the lengths of the segments changed: {', '.join(changed)}. This is another person, the markers were placed "
        "again, or a joint moved too little in one of the trials: part of the difference is not one of range",
    )


def _measure_lengths(arm: PlanarArm) -> tuple[FloatArray, FloatArray]:
    """Return the distances (n,) from each joint to the next and to the tip, m, and their variances, m²."""
    ends = np.vstack([arm.centres[1:], arm.tip])
    length = np.linalg.norm(ends, axis=1)
    along = ends / np.maximum(length, 1e-9)[:, None]
    covariance = np.concatenate([arm.centre_covariance[1:], arm.tip_covariance[None]])
    return length, np.einsum("ki,kij,kj->k", along, covariance, along)


def workspace_result(
    subject: SubjectArm,
    workspace: ReachableWorkspace,
    later: tuple[SubjectArm, ReachableWorkspace, Overlay] | None = None,
) -> CommandResult:
    """Return ``workspace.json``, the edge as CSV, and figures: of one workspace, or of two and their difference."""
    content: dict[str, Any] = {"product": __version__, **_document(subject, workspace)}
    if later is not None:
        change = later[2]
        content["compared_with"] = _document(*later[:2])
        content["change"] = {
            "gained": change.gained,
            "lost": change.lost,
            "kept": change.kept,
            "counting_sd": change.sd,
            "aligned_at": "first joint",
            "notes": list(find_other_lengths(subject, later[0])),
        }

    def make(name: str, one: SubjectArm, reach: ReachableWorkspace) -> dict[str, bytes]:
        arm, title, shape = one.arm, f"reachable workspace of {one.name}", reach.shape
        # the edge: two points for each facet in the plane, three points in space
        lines = [",".join(["facet", "corner", *(f"{axis}_m" for axis in "xyz"[: shape.points.shape[1]])])]
        for k, facet in enumerate(shape.boundary().tolist()):
            for corner, index in enumerate(facet):
                lines.append(",".join([str(k), str(corner), *(f"{value:.6f}" for value in shape.points[index])]))
        files = {f"{name}.csv": make_text_file(lines)}
        if arm.dimension == 2:
            seen = arm.tips(one.observed)
            return files | render(name, title, lambda: draw_area(reach, seen, arm.base))
        return files | render(name, title, lambda: draw_volume(reach, arm.base))

    def make_files() -> dict[str, bytes]:
        files = make("workspace", subject, workspace)
        if later is not None:
            other, reach, change = later
            files |= make("compared_with", other, reach)
            names = subject.name, other.name
            files |= render("change", "workspaces over each other", lambda: draw_change(change, names))
        return files

    return CommandResult("workspace", "workspace.json", content, other_files=make_files, end="")


def _document(subject: SubjectArm, workspace: ReachableWorkspace) -> dict[str, Any]:
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
        "seed": workspace.seed,
        "convergence": [
            {"samples": count, "radius_m": radius, "value": value} for count, radius, value in workspace.convergence
        ],
        "notes": list(subject.notes),
    }


_TIPS, _CHANGES = 1500, 6000  # maximum number of points that are drawn
_VIEWS = (("front", 2, 1), ("side", 0, 1), ("top", 2, 0))


def draw_area(workspace: ReachableWorkspace, recorded: FloatArray, joint: FloatArray) -> Figure:
    """Return the figure of a planar workspace: recorded tips, sampled postures, area, and convergence (figure 7.1).

    ``recorded`` (T, 2) are tips in the recording, m; empty for a chain in YAML. ``joint`` (2,) is the first joint, m.
    """
    figure = paper_figures.make_figure(2.6)
    track, cloud, area, converged = figure.subplots(1, 4)
    every = max(1, len(recorded) // _TIPS)
    track.plot(*recorded[::every].T, ".", ms=1.5, color=style.VERMILLION)
    cloud.plot(*workspace.shape.points[:_TIPS].T, ".", ms=1.2, color=style.VERMILLION)
    edge = workspace.shape.points[workspace.shape.boundary()]
    for axes in (cloud, area):
        axes.add_collection(LineCollection(list(edge), colors=style.BLUE, linewidths=0.9, rasterized=True))
        axes.autoscale_view()
    simplices = workspace.shape.triangulation.simplices[workspace.shape.kept]
    filled = PolyCollection(list(workspace.shape.points[simplices]), facecolors=style.SKY, rasterized=True)
    area.add_collection(filled)
    half = 0.5 * (workspace.interval[1] - workspace.interval[0])
    titles = ("recorded tip", "sampled postures", f"{workspace.measure:.4f} ± {half:.4f} m²")
    for axes, title in zip((track, cloud, area), titles, strict=True):
        _draw_joint(axes, joint)
        axes.set(title=title, xlabel="x (m)")
    track.set_ylabel("y, up (m)")
    _draw_convergence(converged, workspace, "m²")
    return figure


def draw_volume(workspace: ReachableWorkspace, joint: FloatArray) -> Figure:
    """Return the figure of a spatial workspace: surface, convergence, and three projections (figures 7.3 and 7.4).

    ``joint`` (3,) is the position of the first joint, m.
    """
    figure = paper_figures.make_figure(5.0)
    grid = figure.add_gridspec(2, 3)
    points, facets = workspace.shape.points, workspace.shape.boundary()
    solid: Any = figure.add_subplot(grid[0, :2], projection="3d")
    solid.plot_trisurf(points[:, 2], points[:, 0], points[:, 1], triangles=facets, color=style.SKY, rasterized=True)
    solid.scatter(joint[2], joint[0], joint[1], color=style.INK)
    solid.set(xlabel="z (m)", ylabel="x (m)", zlabel="y (m)", title=f"{workspace.measure:.4f} m³")
    _draw_convergence(figure.add_subplot(grid[0, 2]), workspace, "m³")
    for k, (name, across, up) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[1, k])
        shadow = list(points[facets][:, :, [across, up]])
        axes.add_collection(PolyCollection(shadow, facecolors=style.SKY, edgecolors=style.SKY, rasterized=True))
        axes.autoscale_view()
        _draw_joint(axes, joint[[across, up]])
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    return figure


def draw_change(change: Overlay, names: tuple[str, str]) -> Figure:
    """Return the figure of two sessions' workspaces: parts in both, gained and lost; three views in space.

    ``names`` are those of the earlier and the later session.
    """
    views = (("in the plane", 0, 1),) if change.points.shape[1] == 2 else _VIEWS
    figure = paper_figures.make_figure(3.4)
    kinds = (
        (change.before & change.after, style.FAINT, f"both, {change.kept:.4f}"),
        (change.after & ~change.before, style.GREEN, f"gained: {style.clean(names[1], 24)}, {change.gained:.4f}"),
        (change.before & ~change.after, style.VERMILLION, f"lost: {style.clean(names[0], 24)}, {change.lost:.4f}"),
    )
    panels = figure.subplots(1, len(views), squeeze=False)[0]
    every = max(1, len(change.points) // _CHANGES)
    for axes, (name, across, up) in zip(panels, views, strict=True):
        for which, colour, label in kinds:
            points = change.points[which][::every]
            axes.plot(points[:, across], points[:, up], ".", ms=1.4, color=colour, label=label)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=name, xlabel=f"{'xyz'[across]} (m)", ylabel=f"{'xyz'[up]} (m)")
    paper_figures.add_legend(figure, panels)
    return figure


def _draw_joint(axes: Axes, joint: FloatArray) -> None:
    axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_convergence(axes: Axes, workspace: ReachableWorkspace, unit: str) -> None:
    """Draw area or volume against the number of samples, with the interval of the last value."""
    counts, _, values = zip(*workspace.convergence, strict=True)
    axes.axhspan(*workspace.interval, color=style.BLUE, alpha=0.15, lw=0)
    axes.plot(counts, values, "o-", ms=3, color=style.BLUE)
    axes.set_xscale("log")
    axes.set_xticks(counts, [f"{count:d}" for count in counts], rotation=45)
    axes.minorticks_off()
    axes.set(title=f"convergence ({unit})", xlabel="samples")
