"""Errors of the thesis's link-by-link recursion and of the whole chain's fit, on simulated sit-to-stands.

Every estimator gets the true plane and the true assignment of markers. About two minutes for 40 trials per row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import harness
import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics.bundle import fit_chain, fit_links
from mocap_id.kinematics.chain_fit import ChainFit, joint_angles, orient_frames
from mocap_id_simulation.options import Options
from mocap_id_simulation.scene import generate

FRAMES = 800  # as in fit-joints
ROWS: Mapping[str, Options] = {
    "clean": harness.CLEAN,
    "ordinary": harness.SHORT,
    "hard": replace(harness.SHORT, soft_tissue=2),
}


def fit_link_by_link(points: ComplexArray, segment: IntArray) -> ChainFit:
    """Fit centre, coordinates and angles of one link after another by equation 3.16, without covariance."""
    fit = fit_links(points, segment, "circle")
    centres, local, angles = fit.centres.copy(), fit.local.copy(), fit.angles.copy()
    ground: ComplexArray = np.tile([0j, 0.1 + 0j], (len(points), 1))
    seen_from, absolute = points, np.zeros(len(points))
    for joint in range(len(centres)):
        own = segment == joint + 1
        link = fit_chain(np.concatenate([ground, seen_from[:, own]], axis=1), np.repeat([0, 1], [2, own.sum()]))
        centres[joint], local[own] = link.centres[0], link.local[2:]
        absolute = absolute + link.angles[:, 0]
        angles[:, joint] = absolute
        seen_from = np.exp(-1j * link.angles) * (seen_from - link.centres[0])
    return replace(fit, centres=centres, local=local, angles=angles)


ESTIMATORS: dict[str, Callable[[ComplexArray, IntArray], ChainFit]] = {
    "circles": lambda points, segment: fit_links(points, segment, "circle"),
    "3.16, link by link": fit_link_by_link,
    "rigid-body": lambda points, segment: fit_links(points, segment, "rigid-body"),
    "bundle": fit_chain,
}


def measure(options: Options) -> list[FloatArray]:
    """Return the figures (13,) of every estimator in one trial.

    They are errors of the lengths of shank and thigh, %; of three joints, mm, and of three angles, degrees; whether the
    interval of each length includes the truth, NaN without intervals; and the arcs of the joints, degrees. Of the
    frames that ``fit-joints`` selects, those in which every angle is known are used.
    """
    made = generate("sit-to-stand", options)
    kept = np.unique(np.linspace(0, len(made.points) - 1, FRAMES).round().astype(np.int64))
    flat, segment = made.scene.plane.to_plane(made.points[kept]), made.scene.markers.link
    lengths = np.array([link.length for link in made.scene.body.links[1:3]])
    true_joints, true_angles = made.state.joint_xy[kept] @ [1, 1j], made.state.q[kept]
    found = []
    for estimate in ESTIMATORS.values():
        fit = orient_frames(estimate(flat[..., 0] + 1j * flat[..., 1], segment))
        used = np.isfinite(fit.angles).all(axis=1)
        turn = np.exp(1j * fit.angles[used])
        lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)
        joints = np.cumsum(lever * fit.centres, axis=1)
        off = np.angle(np.exp(1j * (joint_angles(fit.angles[used]) - true_angles[used])))
        off[:, -1] -= off[:, -1].mean()
        missed = np.abs(fit.lengths - lengths)
        inside = np.where(np.isfinite(fit.length_sd), missed <= harness.QUANTILE * fit.length_sd + 1e-9, np.nan)
        distance = 1e3 * harness.rms(np.abs(joints - true_joints[used]))
        angle = np.degrees(harness.rms(off))
        found.append(np.concatenate([100 * missed / lengths, distance, angle, inside, np.degrees(fit.arcs)]))
    return found


def main() -> None:
    arguments = harness.make_parser(__doc__, parallel=True, trials=40, first=50_000).parse_args()
    trials, first, rows = arguments.trials, arguments.first, []
    for row, options in ROWS.items():
        tasks = [replace(options, seed=first + k) for k in range(trials)]
        every = np.array(harness.run_all(measure, tasks, arguments.jobs))  # (trials, estimators, 13)
        for name, errors in zip(ESTIMATORS, np.moveaxis(every, 1, 0), strict=True):
            shares = [f"{100 * part:.0f} %" for part in errors[:, 8:10].mean(axis=0)]
            inside = " / ".join(shares) if np.isfinite(errors[:, 8:10]).all() else "none stated"
            rows.append([row, name, *harness.format_pairs(errors[:, :8]), inside])
        if row == "ordinary":
            arcs = np.median(every[:, -1, 10:], axis=0)
        harness.report_progress(f"{row}: {trials} trials")
    turned = ", ".join(f"{arc:.0f}° ({joint})" for arc, joint in zip(arcs, harness.JOINTS, strict=True))
    about = harness.describe_source(__file__, f"{trials} sit-to-stands per row, seeds from {first}")
    head = ["trials", "estimator", "shank, %", "thigh, %"]
    head += [f"{joint}, {unit}" for unit in ("mm", "°") for joint in harness.JOINTS]
    head.append("inside the 95 % interval, shank / thigh")
    sections = {
        "link-by-link": f"{about} Median arcs of the joints: {turned}.",
        "link-by-link-errors": harness.format_table(head, rows, numbers_from=2),
    }
    harness.publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
