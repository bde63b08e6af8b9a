"""What a report is made from: a trial's artefacts, its refusal if there is one, and views of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from mocap_id.reporting.numbers import known
from mocap_id.reporting.residuals import Residual, by_marker
from mocap_id.reporting.views import Dynamics, Motion, Skeleton
from mocap_id.store import Artefact, Held
from mocap_id.verdict import Level, Reason, overall

_GRAVEST_FIRST: tuple[Level, ...] = ("refused", "caution", "ok")


@dataclass(frozen=True)
class Material(Held):
    """A trial as the report sees it.

    Parameters
    ----------
    trial : str
        The trial's name.
    product : str
        Version of the product.
    artefacts : mapping of str to Table or Tree
        By file name; those of stages that never ran are absent.
    refusal : Reason, optional
        Why the trial was refused; None for a trial that went through.
    seconds : mapping of str to float, optional
        Time that each stage took, s.
    settings : mapping of str to str
        What the user asked for, as it is shown.
    """

    trial: str
    product: str
    artefacts: Mapping[str, Artefact]
    refusal: Reason | None = None
    seconds: Mapping[str, float] | None = None
    settings: Mapping[str, str] = field(default_factory=dict)

    def why_missing(self, file: str) -> str:
        """One sentence for a quantity that the artefact ``file`` should have given and did not."""
        if file in self.artefacts:
            codes = dict.fromkeys(reason.code for reason in self.artefacts[file].reasons if reason.level != "ok")
            return f"see {', '.join(codes)} in the verdict" if codes else f"{file} does not say"
        if self.refusal is not None:
            return f"the trial was refused ({self.refusal.code}) before {file} was computed"
        return f"{file} was not computed"

    @cached_property
    def reasons(self) -> tuple[Reason, ...]:
        """Every reason, none twice, the gravest first and otherwise in the order of the artefacts."""
        own = () if self.refusal is None else (self.refusal,)
        found = (reason for artefact in self.artefacts.values() for reason in artefact.reasons)
        return tuple(sorted(dict.fromkeys((*own, *found)), key=lambda reason: _GRAVEST_FIRST.index(reason.level)))

    @property
    def level(self) -> Level:
        """The verdict's level."""
        return overall(self.reasons)

    @cached_property
    def skeleton(self) -> Skeleton | None:
        """The chain, None where it was not found."""
        tree = self.tree("chain.h5")
        return None if tree is None else Skeleton.from_tree(tree)

    @cached_property
    def motion(self) -> Motion | None:
        """The joint states, None where they were not estimated."""
        table = self.table("states.parquet")
        return None if table is None else Motion.from_table(table)

    @cached_property
    def dynamics(self) -> Dynamics | None:
        """The identified parameters, None where nothing was identified."""
        tree = self.tree("dynamics.h5")
        return None if tree is None else Dynamics.from_tree(tree)

    @property
    def measured_poses(self) -> bool:
        """The dynamics use the measured pose of every body, not the pinned chain."""
        return (self.facts("dynamics.h5").get("motion") or {}).get("source") == "segments"

    @property
    def low_pass(self) -> float | None:
        """Cut-off of the low-pass that model and measurement pass before they are compared, Hz; None without one."""
        return known(self.facts("dynamics.h5").get("cutoff_hz")) if self.measured_poses else None

    @property
    def bands(self) -> dict[str, float] | None:
        """Cut-offs of x, y and angle of the measured poses, Hz; None on the pinned chain."""
        bands = (self.facts("dynamics.h5").get("motion") or {}).get("bands_hz")
        return None if bands is None else {axis: float(bands[axis]) for axis in ("x", "y", "angle")}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies that the dynamics identify: on the pinned chain its segments."""
        if not self.measured_poses:
            return self.segment_names
        return tuple(str(name) for name in self.facts("dynamics.h5")["motion"].get("bodies") or ())

    @cached_property
    def residuals(self) -> dict[str, Residual]:
        """Residuals of each marker by its label; empty where unknown."""
        return by_marker(self.long("markers.parquet"), self.skeleton)

    @cached_property
    def segment_names(self) -> tuple[str, ...]:
        """Names of the segments, base first; empty where they are unknown."""
        if self.skeleton is not None:
            return self.skeleton.segments
        names = self.facts("segments.parquet").get("names")
        return tuple(str(name) for name in names or ())
