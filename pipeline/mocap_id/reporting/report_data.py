"""Input of a report: the artefacts of a trial, its refusal if it was refused, and quantities derived from both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting.grids import to_number
from mocap_id.store import Artefact, ArtefactSet, LongTable
from mocap_id.store.artefacts import (
    IdentifiedDynamics,
    JointStates,
    MeasuredPoses,
    Skeleton,
    SpatialAngles,
    SpatialSkeleton,
)
from mocap_id.verdict import Level, Reason, overall

_MOST_SEVERE_FIRST: tuple[Level, ...] = ("refused", "caution", "ok")


@dataclass(frozen=True)
class ReportData(ArtefactSet):
    """Artefacts and metadata of a trial for its report."""

    trial: str  # name of the trial
    product: str  # version of mocap-id
    artefacts: Mapping[str, Artefact]  # by file name; without those of stages that did not run
    refusal: Reason | None = None  # why the trial was refused; None if it was not refused
    seconds: Mapping[str, float] | None = None  # run time of each stage, s
    settings: Mapping[str, str] = field(default_factory=dict)  # settings of the user, as texts

    def why_missing(self, file: str) -> str:
        """Return a clause that says why a quantity of the artefact ``file`` is missing."""
        if file in self.artefacts:
            codes = dict.fromkeys(reason.code for reason in self.artefacts[file].reasons if reason.level != "ok")
            return f"see {', '.join(codes)} in the verdict" if codes else f"{file} does not contain it"
        if self.refusal is not None:
            return f"the trial was refused ({self.refusal.code}) before {file} was computed"
        return f"{file} was not computed"

    def explain(self, file: str) -> str:
        """Return why a quantity of the artefact ``file`` is unknown: as the artefact says, else why it is missing."""
        return self.facts(file).get("why") or self.why_missing(file)

    def rows(self, file: str) -> list[dict[str, Any]]:
        """Return the rows of a table, each with its values by column name; empty if the table is missing."""
        table = self.table(file)
        if table is None:
            return []
        columns = (values.tolist() for values in table.columns.values())
        return [dict(zip(table.names, row, strict=True)) for row in zip(*columns, strict=True)]

    @cached_property
    def reasons(self) -> tuple[Reason, ...]:
        """All distinct reasons, most severe first and otherwise in the order of the artefacts."""
        own = () if self.refusal is None else (self.refusal,)
        found = (reason for artefact in self.artefacts.values() for reason in artefact.reasons)
        return tuple(sorted(dict.fromkeys((*own, *found)), key=lambda reason: _MOST_SEVERE_FIRST.index(reason.level)))

    @property
    def level(self) -> Level:
        """Level of the verdict."""
        return overall(self.reasons)

    @property
    def in_space(self) -> bool:
        """Whether the trial has `space: 3d`."""
        return super().in_space or self.settings.get("space") == "3d"

    @cached_property
    def skeleton(self) -> Skeleton | None:
        """Chain in the plane; None if it was not found or the trial is in space."""
        tree = self.tree("chain.h5")
        return None if tree is None or self.in_space else Skeleton(tree)

    @cached_property
    def spatial_skeleton(self) -> SpatialSkeleton | None:
        """Chain in space; None if it was not found or the trial is in the plane."""
        tree = self.tree("chain.h5")
        return SpatialSkeleton(tree) if tree is not None and self.in_space else None

    @cached_property
    def segment_poses(self) -> MeasuredPoses | None:
        """Poses of the segments in space; None if they were not estimated or the trial is in the plane."""
        table = self.table("poses.parquet")
        return MeasuredPoses(table) if table is not None and self.in_space else None

    @cached_property
    def angles(self) -> SpatialAngles | None:
        """Angles in space; None if they were not estimated or the trial is in the plane."""
        table = self.table("angles.parquet")
        return SpatialAngles(table) if table is not None and self.in_space else None

    @cached_property
    def motion(self) -> JointStates | None:
        """Joint states in the plane; None if they were not estimated or the trial is in space."""
        table = self.table("states.parquet")
        return None if table is None or self.in_space else JointStates.from_table(table)

    @cached_property
    def zeros(self) -> tuple[tuple[Literal["static", "standing", "segment line"], float, float | None], ...]:
        """What defines the zero of each joint angle in the plane, and value and sd of ``theta_j`` there, rad.

        The zero is on the segment lines if no pose was found; the sd is None if the states have none. Empty in space.
        """
        joints = 0 if self.motion is None else self.motion.mean.shape[1]
        if self.skeleton is not None:
            joints = max(joints, len(self.skeleton.centres))
        found = self.facts("phases.parquet").get("zeros")
        if not found:
            return (("segment line", 0.0, 0.0),) * joints
        return tuple((each["source"], float(each["zero"]), to_number(each["sd"])) for each in found)

    @cached_property
    def shown_motion(self) -> JointStates | None:
        """Joint states in the plane, with angles that begin at their zeros; None as for :attr:`motion`."""
        if self.motion is None:
            return None
        shift = np.zeros(self.motion.mean.shape[1:])
        shift[:, 0] = [value for _, value, _ in self.zeros[: len(shift)]]
        return replace(self.motion, mean=self.motion.mean - shift)

    @cached_property
    def dynamics(self) -> IdentifiedDynamics | None:
        """Identified parameters; None if nothing was identified."""
        tree = self.tree("dynamics.h5")
        return None if tree is None else IdentifiedDynamics(tree)

    @property
    def contact(self) -> BoolArray:
        """Samples (T,) of dynamics.parquet in which an unmeasured support may carry the body; none if not searched."""
        table = self.table("dynamics.parquet")
        if table is None or "contact" not in table.names:
            return np.zeros(0 if table is None else table.length, dtype=np.bool_)
        found: BoolArray = table["contact"]
        return found

    @property
    def measured_poses(self) -> bool:
        """Whether the dynamics use the measured pose of every body instead of the pinned chain."""
        return (self.facts("dynamics.h5").get("motion") or {}).get("source") == "segments"

    @property
    def low_pass(self) -> float | None:
        """Cut-off, Hz, of the low-pass on model and measurement before their comparison; None if unfiltered."""
        return to_number(self.facts("dynamics.h5").get("cutoff_hz")) if self.measured_poses else None

    @property
    def bands(self) -> dict[str, float] | None:
        """Cut-off frequencies for x, y and angle of the measured poses, Hz; None for the pinned chain."""
        bands = (self.facts("dynamics.h5").get("motion") or {}).get("bands_hz")
        return None if bands is None else {axis: float(bands[axis]) for axis in ("x", "y", "angle")}

    @cached_property
    def segment_of(self) -> dict[str, int]:
        """Number of the segment of each marker of the chain, by label."""
        found = self.skeleton or self.spatial_skeleton
        return {} if found is None else dict(zip(found.markers, found.marker_segment.tolist(), strict=True))

    @cached_property
    def residuals(self) -> dict[str, dict[str, float]]:
        """Distance of each marker from its prediction by the chain, by label; empty if it is unknown.

        ``rms`` and ``q95`` are root mean square and 95 % quantile, m, NaN if the marker is never visible; ``seen`` is
        the fraction of frames in which it is visible.
        """
        markers, found = self.long("markers.parquet"), {}
        if markers is None or not markers.length:
            return {}
        for label, column in zip(markers.labels, markers.values["residual"].T, strict=True):
            seen = column[np.isfinite(column)]
            rms, q95 = (np.sqrt(np.mean(seen**2)), np.quantile(seen, 0.95)) if seen.size else (np.nan, np.nan)
            found[label] = {"rms": float(rms), "q95": float(q95), "seen": seen.size / column.size}
        return found

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the plane; empty without a chain in the plane."""
        return () if self.skeleton is None else tuple(self.skeleton.joints)

    @cached_property
    def segment_names(self) -> tuple[str, ...]:
        """Names of the segments, base first; empty if unknown."""
        skeleton = self.skeleton or self.spatial_skeleton
        if skeleton is not None:
            return skeleton.segments
        names = self.facts("segments.parquet").get("names")
        return tuple(str(name) for name in names or ())


def read_positions(planar: LongTable, time: FloatArray, labels: Sequence[str], axes: str = "xy") -> FloatArray:
    """Return the measured marker positions at some instants, (K, M, 2) in the plane of motion or (K, M, 3) in space, m.

    ``planar`` is ``planar.parquet``; ``time`` (K,) are the instants, s; ``labels`` are the M markers, and ``axes`` is
    ``xy`` or ``xyz``. A position is NaN if no frame has exactly this time, or if the marker was not visible.
    """
    found = np.full((len(time), len(labels), len(axes)), np.nan)
    row = np.searchsorted(planar.time, time).clip(0, len(planar.time) - 1)
    own = np.flatnonzero(planar.time[row] == time)
    place = {label: k for k, label in enumerate(planar.labels)}
    known = [(k, place[label]) for k, label in enumerate(labels) if label in place]
    for to, column in known:
        for axis, name in enumerate(axes):
            found[own, to, axis] = planar.values[name][row[own], column]
    return found
