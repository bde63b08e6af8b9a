"""The payload of a robot: two trials in space, with and without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mocap_id import runner
from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space import payload as dynamics
from mocap_id.errors import ConfigError
from mocap_id.store import Tree
from mocap_id.store.spatial_views import SpatialSkeleton
from mocap_id.workflows.run_folder import RunFolder, open_run

PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
UNITS = ("kg", *["kg*m"] * 3, *["kg*m^2"] * 6)
_SURE = 2.0  # standard deviations
_SAME = 0.02  # largest difference of two trials in the axes of a frame, 1, or in the size of a joint's lever, m


@dataclass(frozen=True)
class FoundPayload:
    """The payload of one trial.

    Parameters
    ----------
    loaded, empty : str
        Names of the trials.
    segment : str
        The segment that carries it.
    payload : Payload
        In the frame of this segment in ``chain.h5`` of the loaded trial.
    cautions : mapping of str to tuple of str
        Codes of the cautions of each trial.
    """

    loaded: str
    empty: str
    segment: str
    payload: dynamics.Payload
    cautions: Mapping[str, tuple[str, ...]]

    @property
    def negative(self) -> bool:
        """Whether the mass is negative beyond its error: the trials are exchanged, or it is not a payload."""
        return bool(self.payload.value[0] < -_SURE * self.payload.sd[0])

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values; None for what the trials do not determine."""
        place, place_sd = self.payload.centre()
        found = zip(PARAMETERS, UNITS, self.payload.value, self.payload.sd, strict=True)
        return {
            "loaded": self.loaded,
            "empty": self.empty,
            "segment": self.segment,
            "cautions": {name: list(codes) for name, codes in self.cautions.items()},
            "parameters": {
                name: {"value": _number(value), "sd": _number(sd), "unit": unit} for name, unit, value, sd in found
            },
            "centre_m": {"value": list(map(_number, place)), "sd": list(map(_number, place_sd))},
        }


def find_payload(
    loaded: Path, empty: Path, segment: str | None = None, progress: runner.Progress = lambda step: None
) -> FoundPayload:
    """Return the parameters of a payload from two trials of one chain.

    Parameters
    ----------
    loaded, empty : Path
        YAML files or run folders of the trials with and without the payload.
    segment : str, optional
        The segment that carries it; default: the last one.
    progress : callable, optional
        Called with each step of a run.

    Raises
    ------
    ConfigError
        A trial has no parameters in space, the trials have different chains, or there is no such segment.
    StoreError, RecordingError, NumericalError
        As for :func:`mocap_id.workflows.run_folder.open_run`.
    """
    runs = [open_run(path, progress) for path in (loaded, empty)]
    trees = [_dynamics(run) for run in runs]
    mapping = _common_mapping(runs, trees)
    chain = runs[0].tree("chain.h5")
    segments = SpatialSkeleton.from_tree(chain).segments if chain else ()
    carrier = segments[-1] if segment is None else segment
    if carrier not in segments:
        raise ConfigError(f"{loaded}: there is no segment {carrier!r}; the segments are {', '.join(segments)}")
    with_payload, without = map(_estimate, trees)
    found = dynamics.identify_payload(mapping, with_payload, without, segments.index(carrier))
    return FoundPayload(runs[0].name, runs[1].name, carrier, found, {run.name: _cautions(run) for run in runs})


def _cautions(run: RunFolder) -> tuple[str, ...]:
    reasons = run.summary.get("verdict", {}).get("reasons", ())
    return tuple(reason["code"] for reason in reasons if reason["level"] != "ok")


def _dynamics(run: RunFolder) -> Tree:
    """Return dynamics.h5 with base parameters in space; ConfigError without."""
    if not run.in_space:
        raise ConfigError(f"{run.source}: the trial is in the plane; a payload needs trials with `space: 3d`")
    tree = run.tree("dynamics.h5")
    if tree is None or "propagate_errors" not in tree.facts:
        raise ConfigError(f"{run.source}: no inertial parameters: {run.why_missing('dynamics.h5')}")
    if "unit_covariance" not in tree.facts:
        raise ConfigError(f"{run.source}: the run is by an earlier version: run the trial again by its YAML file")
    return tree


def _common_mapping(runs: list[RunFolder], trees: list[Tree]) -> FloatArray:
    """Return the mapping (b, 10K) from full to base parameters; ConfigError if the chains differ."""
    errors, of_other = ([name for name, _ in tree.facts["propagate_errors"]] for tree in trees)
    one, other = (np.asarray(tree.array("base/regrouping"), dtype=np.float64) for tree in trees)
    frames, others = (np.asarray(tree.facts["frames"]) for tree in trees)
    same = one.shape == other.shape and frames.shape == others.shape and errors == of_other
    if not same or max(np.abs(one - other).max(), np.abs(frames - others).max()) > _SAME:
        raise ConfigError(
            f"{runs[0].source} and {runs[1].source} have different chains, so their parameters cannot be subtracted: "
            f"write `calibration:` with the YAML file of {runs[1].name} into the trial with the payload"
        )
    return one


def _estimate(tree: Tree) -> dynamics.BaseEstimate:
    facts = tree.facts
    return dynamics.BaseEstimate(
        tree.numbers("base/value"),
        np.asarray(facts["unit_covariance"], dtype=np.float64),
        np.asarray(facts["residual_covariance"], dtype=np.float64),
        np.array([parameters for _, parameters in facts["propagate_errors"]], dtype=np.float64),
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
