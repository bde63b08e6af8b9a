"""Place of joints that give way: what a joint fit takes for a place, against joint fits of simulated bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import least_squares

from mocap_id.dynamics.measured_motion import BodyPoses, close_gaps
from mocap_id.geometry import planar
from mocap_id.stages.identify_dim.segment_fit import estimate_hidden_gaps

TIME = np.arange(60) / 10
CENTRES = np.array([[0.0, 0.1], [0.0, 0.4]])
LOCAL = np.array([[0.0, 0.0], [0.05, 0.2], [0.0, 0.3]])  # centroid of each body's markers
INFORMATION = np.array([[4.0, 0.04], [4.0, 0.05], [4.0, 0.1]]) / 0.001**2
ANGLE = np.column_stack([np.zeros(60), -0.2 + 0.3 * np.cos(2 * TIME), 0.9 + 0.8 * np.sin(1.7 * TIME)])


def poses(gap: np.ndarray) -> BodyPoses:
    """Three bodies, the last of which is off its joint by a gap (T, 2) in the frame of the one before."""
    angle = np.cumsum(ANGLE, axis=1)
    origin = [np.zeros((60, 2))]
    for body, centre in enumerate(CENTRES):
        place = centre + (gap if body == 1 else 0.0)
        origin.append(origin[-1] + planar.rotate(angle[:, body], np.broadcast_to(place, (60, 2))))
    return BodyPoses(
        time=TIME,
        position=np.stack(origin, axis=1) + planar.rotate(angle, LOCAL),
        angle=angle,
        centroid=LOCAL,
        information=INFORMATION,
        body=np.arange(3),
        centres=CENTRES,
    )


def with_errors(true: BodyPoses, errors: np.ndarray) -> BodyPoses:
    """The same bodies with errors (2, 2, 2) of the centres before and after each joint."""
    after = np.vstack([np.zeros(2), errors[:, 1]])  # a frame's origin is its joint
    between = errors[:, 0] - after[:2]
    return replace(true, centroid=LOCAL - after, centres=CENTRES + between)


def joint_fit(true: BodyPoses) -> np.ndarray:
    """Errors of the centres for which closing all gaps changes the poses least."""
    scale = np.sqrt(np.concatenate([np.repeat(INFORMATION[:, :1], 2, axis=1), INFORMATION[:, 1:]], axis=1))

    def change(errors: np.ndarray) -> np.ndarray:
        open_ = with_errors(true, errors.reshape(2, 2, 2))
        closed = close_gaps(open_, [0, 1])
        moved = np.concatenate([closed.position - open_.position, (closed.angle - open_.angle)[..., None]], axis=-1)
        return np.asarray((moved * scale).ravel())

    return np.asarray(least_squares(change, np.zeros(8)).x.reshape(2, 2, 2))


def test_the_error_of_a_joint_fit_follows_from_the_gap_that_it_leaves() -> None:
    """Gaps of the model's first two orders; the rms over persons of the places that their joint fits find."""
    rng = np.random.default_rng(3)
    x = ANGLE[:, 2]
    orders = chebyshev.chebvander(2 * (x - x.min()) / np.ptp(x) - 1, 2)[:, 1:] * [1.0, 0.5]
    said, seen = [], []
    for _ in range(12):
        true = poses(orders @ rng.normal(size=(2, 2)) * 0.002)
        errors = joint_fit(true)
        found = with_errors(true, errors)
        angle = true.angle
        wrong = np.stack(
            [planar.rotate(angle[:, j], errors[j, 0]) + planar.rotate(angle[:, j + 1], errors[j, 1]) for j in (0, 1)],
            axis=1,
        )
        seen.append(np.mean(np.sum((wrong / 2) ** 2, axis=-1), axis=0) / 2)
        said.append(estimate_hidden_gaps(found, [1]))
    np.testing.assert_allclose(np.sqrt(np.mean(said, axis=0)), np.sqrt(np.mean(seen, axis=0)), rtol=0.35)


def test_joints_without_a_gap_have_no_such_error() -> None:
    exact = poses(np.zeros((60, 2)))
    assert (estimate_hidden_gaps(exact, []) == 0.0).all()
    assert (estimate_hidden_gaps(exact, [1]) < 1e-12).all()
    assert (estimate_hidden_gaps(replace(exact, angle=np.full((60, 3), np.nan)), [1]) == 0.0).all()


def test_a_gap_that_the_joint_fit_hides_is_limited() -> None:
    """Of a gap in step with a joint that hardly turns, a joint fit leaves nearly nothing."""
    x = ANGLE[:, 2] - ANGLE[:, 2].mean()
    still = replace(poses(0.05 * np.column_stack([x**2, x])), angle=np.cumsum(ANGLE * [1, 1, 0.01], axis=1))
    assert (np.sqrt(estimate_hidden_gaps(still, [1])) < 0.02).all()
