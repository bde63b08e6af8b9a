"""The payload of a robot, identified from two trials in space: one with and one without the payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import runner
from mocap_id.dynamics.space import identification as dynamics
from mocap_id.errors import ConfigError
from mocap_id.reporting.results.columns import to_finite
from mocap_id.store.views import SpatialSkeleton
from mocap_id.workflows.run_folder import open_run

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
_SIGNIFICANT = 2.0  # number of standard deviations above which a negative mass is significant
_SAME = 0.02  # largest difference of two trials in the axes of a coordinate frame, or in the lever of a joint, m


@dataclass(frozen=True)
class FoundPayload:
    """The payload that was identified from two trials."""

    loaded: str  # name of the trial with the payload
    empty: str  # name of the trial without the payload
    segment: str  # name of the segment that carries the payload
    payload: dynamics.Payload  # in the coordinate frame of this segment in ``chain.h5`` of the loaded trial
    cautions: Mapping[str, tuple[str, ...]]  # codes of the cautions by trial

    @property
    def negative(self) -> bool:
        """Whether the mass is significantly negative; probably the trials were swapped, or something else changed."""
        return bool(self.payload.value[0] < -_SIGNIFICANT * self.payload.sd[0])

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values; None for a number that the trials do not determine."""
        centre, centre_sd = self.payload.centre()
        rows = zip(PARAMETERS, UNITS, self.payload.value, self.payload.sd, strict=True)
        return {
            "loaded": self.loaded,
            "empty": self.empty,
            "segment": self.segment,
            "cautions": {name: list(codes) for name, codes in self.cautions.items()},
            "parameters": {
                name: {"value": to_finite(value), "sd": to_finite(sd), "unit": unit} for name, unit, value, sd in rows
            },
            "centre_m": {"value": list(map(to_finite, centre)), "sd": list(map(to_finite, centre_sd))},
        }


def find_payload(
    loaded: Path, empty: Path, segment: str | None = None, progress: runner.Progress = lambda step: None
) -> FoundPayload:
    """Return the parameters of the payload of ``segment``, by default the last, from two trials with the same chain.

    Paths and ``progress`` are as for :func:`mocap_id.workflows.run_folder.open_run`. ConfigError is raised if a trial
    has no parameters in space, if the trials have different chains, or if there is no such segment.
    """
    runs = [open_run(path, progress) for path in (loaded, empty)]
    trees = []
    for run in runs:
        if not run.in_space:
            raise ConfigError(f"{run.source}: the trial is in the plane; a payload needs trials with `space: 3d`")
        tree = run.tree("dynamics.h5")
        if tree is None or "error_modes" not in tree.facts:
            raise ConfigError(f"{run.source}: the trial has no inertial parameters: {run.why_missing('dynamics.h5')}")
        if "unit_covariance" not in tree.facts:
            raise ConfigError(
                f"{run.source}: an earlier version of the program made this run: run the trial again from its YAML file"
            )
        trees.append(tree)
    # The mappings (b, 10K) from the full to the b base parameters, which must be the same.
    errors, other_errors = ([name for name, _ in tree.facts["error_modes"]] for tree in trees)
    mapping, other = (np.asarray(tree.array("base/regrouping"), dtype=np.float64) for tree in trees)
    frames, other_frames = (np.asarray(tree.facts["frames"]) for tree in trees)
    same = mapping.shape == other.shape and frames.shape == other_frames.shape and errors == other_errors
    if not same or max(np.abs(mapping - other).max(), np.abs(frames - other_frames).max()) > _SAME:
        raise ConfigError(
            f"{runs[0].source} and {runs[1].source} have different chains, so their parameters cannot be subtracted: "
            f"write `calibration:` with the YAML file of {runs[1].name} into the file of the trial with the payload"
        )
    chain = runs[0].tree("chain.h5")
    segments = SpatialSkeleton.from_tree(chain).segments if chain else ()
    carrier = segments[-1] if segment is None else segment
    if carrier not in segments:
        raise ConfigError(f"{loaded}: there is no segment {carrier!r}; the segments are {', '.join(segments)}")
    estimates = [
        dynamics.BaseEstimate(
            tree.numbers("base/value"),
            np.asarray(tree.facts["unit_covariance"], dtype=np.float64),
            np.asarray(tree.facts["residual_covariance"], dtype=np.float64),
            np.array([parameters for _, parameters in tree.facts["error_modes"]], dtype=np.float64),
        )
        for tree in trees
    ]
    found = dynamics.identify_payload(mapping, estimates[0], estimates[1], segments.index(carrier))
    cautions = {}
    for run in runs:
        reasons = run.summary.get("verdict", {}).get("reasons", ())
        cautions[run.name] = tuple(reason["code"] for reason in reasons if reason["level"] != "ok")
    return FoundPayload(runs[0].name, runs[1].name, carrier, found, cautions)
