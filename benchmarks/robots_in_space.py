"""Robots that move in space on a plate, with and without a payload: parameters compared with the exact truth.

It takes about ten seconds per seed and core, for two trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.space.consistency import change_of_frame
from mocap_id.geometry import se3
from mocap_id.kinematics.space.bodies import rigid_poses
from mocap_id.store.artefacts import SpatialSkeleton
from mocap_id.workflows.run_folder import open_run
from mocap_id.workflows.transfer import find_payload
from mocap_id_simulation.space_robot import SpaceRobotOptions, simulate_space_robot

PAYLOAD = 2.0  # kg


ERRORS = (
    "base parameters, % of their norm",
    "payload: mass, %",
    "payload: centre of mass, mm",
    "payload: all ten parameters, % of their norm",
)
INSIDE = ("base parameters", "payload")


def measure(task: tuple[Any, int, int]) -> tuple[bool, harness.Comparison]:
    """Simulate a robot with and without its payload, run both trials and compare.

    Return whether all joints were found as hinges, and the errors with the shares inside the 95 % intervals.
    """
    preset, first, k = task
    with harness.temporary_folder() as folder:
        empty, loaded = (
            simulate_space_robot(folder / name, SpaceRobotOptions(seed=first + k, preset=preset, payload=payload))
            for name, payload in (("empty", 0.0), ("loaded", PAYLOAD))
        )
        loaded.write_text(loaded.read_text("utf-8") + "calibration: ../empty/trial.yaml\n", encoding="utf-8")
        found = find_payload(loaded, empty).payload
        truths, skeletons = ([read(file) for file in (empty, loaded)] for read in (harness.read_truth, _read_skeleton))
        tree: Any = open_run(empty).tree("dynamics.h5")
    value, sd = tree.numbers("base/value"), tree.numbers("base/sd")
    frames, turned = map(_find_frames, skeletons, truths)
    parameters = np.array(list(truths[0]["parameters"].values())).reshape(-1, 10)
    own = [move @ part for move, part in zip(frames, parameters, strict=True)]
    base = np.asarray(tree.array("base/regrouping")) @ np.concatenate(own)
    carried = turned[-1] @ np.array(truths[1]["payload"]["parameters"])
    errors = (
        100 * np.linalg.norm(value - base) / np.linalg.norm(base),
        100 * abs(found.value[0] / carried[0] - 1),
        1e3 * np.linalg.norm(found.centre()[0] - carried[1:4] / carried[0]),
        100 * np.linalg.norm(found.value - carried) / np.linalg.norm(carried),
    )
    pairs = ((value - base, sd), (found.value - carried, found.sd))
    inside = [float(np.mean(np.abs(off) <= harness.QUANTILE * each)) for off, each in pairs]
    hinges = all(joint.kind == "hinge" for joint in skeletons[0].chain.joints)
    compared = harness.Comparison((), dict(zip(ERRORS, errors, strict=True)), dict(zip(INSIDE, inside, strict=True)))
    return hinges, compared


def _read_skeleton(file: Path) -> SpatialSkeleton:
    tree = open_run(file).tree("chain.h5")
    assert tree is not None
    return SpatialSkeleton(tree)


def _find_frames(skeleton: SpatialSkeleton, truth: Mapping[str, Any]) -> list[FloatArray]:
    """Return matrices (10, 10) from the true frame of each segment to the estimated frame, by their common markers."""
    true = np.array([truth["local_xyz_m"][label] for label in skeleton.markers])
    moves = []
    for k in range(len(skeleton.segments)):
        here = skeleton.chain.segment == k
        rotation, origin, _ = rigid_poses(skeleton.chain.local[None, here], true[here])
        moves.append(change_of_frame(se3.pose(rotation[0], origin[0])))
    return moves


def make_table(preset: str, outcomes: Sequence[tuple[bool, harness.Comparison]], first: int) -> str:
    rows = []
    for name in ERRORS:
        values = [each.errors[name] for _, each in outcomes]
        rows.append([name, *harness.format_numbers(np.quantile(values, (0.5, 0.8, 1.0), method="higher"), ".2g")])
    for name in INSIDE:
        share = 100 * np.array([each.inside[name] for _, each in outcomes])
        rows.append([f"inside 95 %: {name}", f"{share.mean():.0f} %", "", f"{share.min():.0f} %"])
    kinds = sum(hinges for hinges, _ in outcomes)
    title = f"**{preset}**, {len(outcomes)} robots, seeds from {first}: all joints found as hinges in {kinds}."
    head = ["error", "median (share: mean)", "80 % quantile", "largest (share: least)"]
    return title + "\n\n" + harness.format_table(head, rows, numbers_from=1)


def main() -> None:
    only = ("clean", "default")
    given = harness.make_parser(__doc__, parallel=True, only=only, trials=20, first=285_000).parse_args()
    sections = {"robots-in-space": harness.measure_rows("robots-in-space", only, given, measure, make_table)}
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
