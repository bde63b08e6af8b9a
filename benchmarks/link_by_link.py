"""Errors of the thesis's link-by-link recursion and of the whole chain's fit, on simulated sit-to-stands.

Every estimator gets the true plane and the true assignment of markers. About two minutes for 40 trials per row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import harness
import numpy as np

from mocap_id.arrays import ComplexArray, FloatArray, IntArray
from mocap_id.kinematics import ChainFit, fit_chain, fit_links, joint_angles, orient_frames
from mocap_id_simulation import Options, SimulatedTrial, generate

FRAMES = 800  # as in fit-joints
ROWS: Mapping[str, Options] = {
    "clean": harness.CLEAN,
    "ordinary": harness.SHORT,
    "hard": replace(harness.SHORT, soft_tissue=2),
}


@dataclass(frozen=True)
class Trial:
    """Markers of one trial and its true chain; T frames, lengths in m, angles in rad."""

    points: ComplexArray  # (T, M)
    segment: IntArray  # (M,)
    lengths: FloatArray  # (2,) shank, thigh
    joints: ComplexArray  # (T, 3)
    angles: FloatArray  # (T, 3)


@dataclass(frozen=True)
class Errors:
    """Errors of one estimator in one trial."""

    length: FloatArray  # (2,) %
    joint: FloatArray  # (3,) mm
    angle: FloatArray  # (3,) degrees
    covered: FloatArray  # (2,) 1 if the interval of the length includes the truth, NaN without intervals
    arc: FloatArray  # (3,) degrees


def draw(options: Options) -> Trial:
    """Simulate a trial and select frames as ``fit-joints`` does."""
    made: SimulatedTrial = generate("sit-to-stand", options)
    kept = np.unique(np.linspace(0, len(made.points) - 1, FRAMES).round().astype(np.int64))
    flat = made.scene.plane.to_plane(made.points[kept])
    joints = made.state.joint_xy[kept]
    return Trial(
        flat[..., 0] + 1j * flat[..., 1],
        made.scene.markers.link,
        np.array([link.length for link in made.scene.body.links[1:3]]),
        joints[..., 0] + 1j * joints[..., 1],
        made.state.q[kept],
    )


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


def compare(trial: Trial, fit: ChainFit) -> Errors:
    """Return the errors of a chain over the frames in which all angles have values."""
    fit = orient_frames(fit)
    used = np.isfinite(fit.angles).all(axis=1)
    turn = np.exp(1j * fit.angles[used])
    lever = np.concatenate([np.ones((len(turn), 1)), turn[:, :-1]], axis=1)
    joints = np.cumsum(lever * fit.centres, axis=1)
    off = np.angle(np.exp(1j * (joint_angles(fit.angles[used]) - trial.angles[used])))
    off[:, -1] -= off[:, -1].mean()
    missed = fit.lengths - trial.lengths
    return Errors(
        100 * np.abs(missed) / trial.lengths,
        1e3 * harness.rms(np.abs(joints - trial.joints[used])),
        np.degrees(harness.rms(off)),
        np.where(np.isfinite(fit.length_sd), np.abs(missed) <= harness.QUANTILE * fit.length_sd + 1e-9, np.nan),
        np.degrees(fit.arcs),
    )


def measure(options: Options) -> list[Errors]:
    """Return the errors of every estimator in one trial."""
    trial = draw(options)
    return [compare(trial, estimate(trial.points, trial.segment)) for estimate in ESTIMATORS.values()]


def format_errors(errors: list[Errors]) -> list[str]:
    """Return median / 90th percentile of each error, and the share inside the intervals."""
    covered = np.mean([each.covered for each in errors], axis=0)
    share = " / ".join(f"{100 * part:.0f} %" for part in covered) if np.isfinite(covered).all() else "none stated"
    return [
        *harness.format_pairs(np.array([np.concatenate([each.length, each.joint, each.angle]) for each in errors])),
        share,
    ]


def main() -> None:
    """Measure all rows and publish the sections."""
    arguments = harness.make_parser(__doc__, parallel=True, trials=40, first=50_000).parse_args()
    trials, first, rows = arguments.trials, arguments.first, []
    for row, options in ROWS.items():
        every = harness.run_all(measure, [replace(options, seed=first + k) for k in range(trials)], arguments.jobs)
        rows += [
            [row, name, *format_errors(list(errors))]
            for name, errors in zip(ESTIMATORS, zip(*every, strict=True), strict=True)
        ]
        if row == "ordinary":
            arcs = np.median([errors[-1].arc for errors in every], axis=0)
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
