"""Robots that move in space on a plate, with and without a payload: parameters compared with the exact truth.

It takes about ten seconds per seed and core, for two trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space.pseudo_inertia import change_of_frame
from mocap_id.geometry import se3
from mocap_id.kinematics.space.rigid_body import rigid_poses
from mocap_id.store.spatial_views import SpatialSkeleton
from mocap_id.workflows.payload import find_payload
from mocap_id.workflows.run_folder import RunFolder, open_run
from mocap_id_simulation import SpaceRobotOptions, simulate_space_robot

PAYLOAD = 2.0  # kg


@dataclass(frozen=True)
class Outcome:
    """Errors of one robot, and shares inside the 95 % intervals."""

    kinds: bool  # all joints were found as hinges
    base: float  # of all base parameters, relative to their norm
    base_inside: float
    mass: float  # of the payload, relative
    centre: float  # of mass of the payload, m
    payload: float  # of the ten parameters of the payload, relative to their norm
    payload_inside: float


def measure(task: tuple[Any, int, int]) -> Outcome:
    """Simulate a robot with and without its payload, run both trials and compare."""
    preset, first, k = task
    with harness.temporary_folder() as folder:
        empty, loaded = (
            simulate_space_robot(folder / name, SpaceRobotOptions(seed=first + k, preset=preset, payload=payload))
            for name, payload in (("empty", 0.0), ("loaded", PAYLOAD))
        )
        loaded.write_text(loaded.read_text("utf-8") + "calibration: ../empty/trial.yaml\n", encoding="utf-8")
        found = find_payload(loaded, empty).payload
        runs, truths = zip(*((open_run(file), harness.read_truth(file)) for file in (empty, loaded)), strict=True)
    tree: Any = runs[0].tree("dynamics.h5")
    value, sd = tree.numbers("base/value"), tree.numbers("base/sd")
    frames = _find_frames(runs[0], truths[0])
    parameters = np.array(list(truths[0]["parameters"].values())).reshape(-1, 10)
    own = [move @ part for move, part in zip(frames, parameters, strict=True)]
    base = np.asarray(tree.array("base/regrouping")) @ np.concatenate(own)
    carried = _find_frames(runs[1], truths[1])[-1] @ np.array(truths[1]["payload"]["parameters"])
    return Outcome(
        all(joint.kind == "hinge" for joint in _read_skeleton(runs[0]).chain.joints),
        float(np.linalg.norm(value - base) / np.linalg.norm(base)),
        float(np.mean(np.abs(value - base) <= harness.QUANTILE * sd)),
        float(abs(found.value[0] / carried[0] - 1)),
        float(np.linalg.norm(found.centre()[0] - carried[1:4] / carried[0])),
        float(np.linalg.norm(found.value - carried) / np.linalg.norm(carried)),
        float(np.mean(np.abs(found.value - carried) <= harness.QUANTILE * found.sd)),
    )


def _read_skeleton(run: RunFolder) -> SpatialSkeleton:
    tree = run.tree("chain.h5")
    assert tree is not None
    return SpatialSkeleton.from_tree(tree)


def _find_frames(run: RunFolder, truth: Mapping[str, Any]) -> list[FloatArray]:
    """Return matrices (10, 10) from the true frame of each segment to the estimated frame, by their common markers."""
    skeleton = _read_skeleton(run)
    true = np.array([truth["local_xyz_m"][label] for label in skeleton.markers])
    moves = []
    for k in range(len(skeleton.segments)):
        here = skeleton.chain.segment == k
        rotation, origin, _ = rigid_poses(skeleton.chain.local[None, here], true[here])
        moves.append(change_of_frame(se3.pose(rotation[0], origin[0])))
    return moves


def make_table(preset: str, outcomes: Sequence[Outcome], first: int) -> str:
    """Return the table of a preset."""
    rows = []
    for quantity, name, factor in (
        ("base parameters, % of their norm", "base", 100),
        ("payload: mass, %", "mass", 100),
        ("payload: centre of mass, mm", "centre", 1e3),
        ("payload: all ten parameters, % of their norm", "payload", 100),
    ):
        values = factor * np.array([getattr(each, name) for each in outcomes])
        rows.append([quantity, *harness.format_numbers(np.quantile(values, (0.5, 0.8, 1.0), method="higher"), ".2g")])
    for quantity, name in (("base parameters", "base_inside"), ("payload", "payload_inside")):
        share = np.array([getattr(each, name) for each in outcomes])
        rows.append([f"inside 95 %: {quantity}", f"{100 * share.mean():.0f} %", "", f"{100 * share.min():.0f} %"])
    kinds = sum(each.kinds for each in outcomes)
    title = f"**{preset}**, {len(outcomes)} robots, seeds from {first}: all joints found as hinges in {kinds}."
    head = ["error", "median (share: mean)", "80 % quantile", "largest (share: least)"]
    return title + "\n\n" + harness.format_table(head, rows, numbers_from=1)


def main() -> None:
    """Measure both presets, or the presets in ``--only``."""
    only = ("clean", "default")
    given = harness.make_parser(__doc__, parallel=True, only=only, trials=20, first=285_000).parse_args()
    sections = {"robots-in-space": harness.measure_rows("robots-in-space", only, given, measure, make_table)}
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
