"""What a perturbation does where physics or arithmetic says what it must do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mocap_id.workflows.sensitivity import perturbations
from mocap_id.workflows.sensitivity.perturbations import KINDS, Perturbation, RerunInputs
from mocap_id.workflows.sensitivity.study import Estimates, compare_series, perturb, read_estimates, run_perturbation

GRAVITY = 9.81
JOINT = "joint"
NOTHING = [
    ("angle-bias", JOINT, 0.0),
    ("angle-noise", JOINT, 0.0),
    ("clock-offset", "", 0.0),
    ("wrench-bias", "Fy", 0.0),
    ("wrench-noise", "tauz", 0.0),
    ("camera-noise", "", 0.0),
    ("marker-count", "", 99),
    ("drop-outs", "", 0.0),
    ("soft-tissue", "", 0.0),
    ("frame-rate", "", 1),
]


def change(own: Estimates, now: Estimates, name: str) -> float:
    return now.parameters[name].value - own.parameters[name].value


def others(own: Estimates, now: Estimates, but: str) -> float:
    """Largest change of the other base parameters, as a share of their size."""
    left = [one for one in own.parameters.values() if one.verdict and one.name != but]
    return max(abs(change(own, now, one.name)) / one.size for one in left)


def tracks(trial: RerunInputs) -> np.ndarray:
    values = trial.long("planar.parquet").values
    return np.stack([values["x"], values["y"]], axis=-1)


def test_every_kind_has_its_change_and_no_other_has() -> None:
    assert all((kind.change is None) != (kind.change_log is None) for kind in KINDS.values())


@pytest.mark.parametrize(("kind", "target", "level"), NOTHING)
def test_no_perturbation_changes_nothing_to_the_bit(robot: RerunInputs, own: Estimates, kind, target, level) -> None:
    now = perturb(robot, Perturbation(kind, target, level))
    assert read_estimates(now) == own
    for file in ("states.parquet", "dynamics.parquet"):
        before, after = robot.table(file).frame, now.table(file).frame
        assert before.equals(after[before.columns])
    off = compare_series(robot, now)
    assert np.all(off.state_r2 == 1.0)
    assert np.all(off.torque_rms == 0.0)


@pytest.mark.parametrize("bias", [0.01, -0.05])
def test_an_angle_bias_turns_the_first_moments_the_other_way(robot: RerunInputs, own: Estimates, bias: float) -> None:
    now = read_estimates(perturb(robot, Perturbation("angle-bias", JOINT, bias)))
    before = complex(own.parameters["mx2"].value, own.parameters["my2"].value)
    after = complex(now.parameters["mx2"].value, now.parameters["my2"].value)
    assert abs(after - before * np.exp(-1j * bias)) < 1e-6 * abs(before)
    for name in ("m1+m2", "I2"):
        assert abs(change(own, now, name)) < 1e-6 * own.parameters[name].size


@pytest.mark.parametrize(("component", "into"), [("Fy", "m1+m2"), ("tauz", "mx1+p2x*m2")])
def test_a_constant_of_the_plate_goes_into_one_parameter(robot: RerunInputs, own: Estimates, component, into) -> None:
    now = read_estimates(perturb(robot, Perturbation("wrench-bias", component, 4.0)))
    assert change(own, now, into) == pytest.approx(4.0 / GRAVITY, rel=1e-6)
    assert others(own, now, but=into) < 1e-6
    assert now.codes == own.codes


def test_a_constant_of_fx_goes_nowhere(robot: RerunInputs, own: Estimates) -> None:
    now = read_estimates(perturb(robot, Perturbation("wrench-bias", "Fx", 10.0)))
    assert others(own, now, but="") < 1e-9


@pytest.mark.parametrize("delay", [0.02, -0.0437])
def test_an_offset_of_the_clock_is_found_where_it_is_looked_for(
    robot: RerunInputs, own: Estimates, delay: float
) -> None:
    estimated = read_estimates(perturb(robot, Perturbation("clock-offset", "", delay)))
    assert estimated.offset - own.offset == pytest.approx(delay, abs=1e-4)
    assert others(own, estimated, but="") < 2e-3
    ignored = read_estimates(perturb(robot, Perturbation("clock-offset-ignored", "", delay)))
    assert ignored.offset == pytest.approx(delay, abs=1e-4)  # found, and not taken out
    assert others(own, ignored, but="") > 10 * others(own, estimated, but="")


def test_an_offset_that_is_ignored_counts_from_the_true_one(robot: RerunInputs, own: Estimates) -> None:
    now = read_estimates(perturb(robot, Perturbation("clock-offset-ignored", "", 0.0)))
    assert others(own, now, but="") < 1e-3


def test_a_higher_level_is_the_same_draw_larger(robot: RerunInputs) -> None:
    before = tracks(robot)
    for kind in ("camera-noise", "soft-tissue"):
        once, twice = (
            tracks(KINDS[kind].change(robot, Perturbation(kind, "", level))) - before for level in (0.001, 0.002)
        )
        known = np.isfinite(before)
        assert np.allclose(2 * once[known], twice[known], atol=1e-12)
        assert not np.allclose(once[known], 0)


def test_angle_noise_turns_a_frames_markers_by_that_noise(robot: RerunInputs) -> None:
    chain = robot.tree("chain.h5").data
    centre = np.asarray(chain["joints"]["centre"])[0]
    moving = perturbations._find_moving(robot)
    before, after = tracks(robot), tracks(KINDS["angle-noise"].change(robot, Perturbation("angle-noise", JOINT, 0.01)))
    theta = robot.states("theta")[:, 0]
    ideal = np.angle([complex(*v) for v in (before - centre)[:, moving[0]]])
    turned = np.angle([complex(*v) for v in (after - centre)[:, moving[0]]]) - ideal
    known = np.isfinite(turned) & np.isfinite(theta)
    assert np.std(turned[known]) == pytest.approx(0.01, rel=0.15)
    still = np.setdiff1d(np.arange(before.shape[1]), moving)
    assert np.array_equal(before[:, still], after[:, still], equal_nan=True)


def test_drop_outs_take_their_share_and_more_takes_the_same_too(robot: RerunInputs) -> None:
    moving = perturbations._find_moving(robot)
    before = np.isfinite(tracks(robot)[:, moving, 0])
    few, many = (
        np.isfinite(tracks(KINDS["drop-outs"].change(robot, Perturbation("drop-outs", "", share)))[:, moving, 0])
        for share in (0.1, 0.4)
    )
    assert 0.1 <= 1 - few.mean() <= 0.1 + (1 - before.mean()) + 0.01
    assert 0.4 <= 1 - many.mean() <= 0.4 + (1 - before.mean()) + 0.01
    assert not np.any(many & ~few)


def test_so_many_markers_are_left_on_every_moving_segment(robot: RerunInputs) -> None:
    now = KINDS["marker-count"].change(robot, Perturbation("marker-count", "", 3))
    left = now.table("segments.parquet").frame["segment"].value_counts()
    own = robot.table("segments.parquet").frame["segment"].value_counts()
    assert left[1] == 3 < own[1]
    assert left[0] == own[0]


def test_a_frame_of_the_last_segment_that_lies_otherwise_counts_for_nothing(robot: RerunInputs, own: Estimates) -> None:
    """Fewer markers move its centroid, so the gauge; the mass and its moments are where they were."""
    now = read_estimates(perturb(robot, Perturbation("marker-count", "", 3)))
    size = own.parameters["my2"].size
    assert math.hypot(change(own, now, "mx2"), change(own, now, "my2")) < 0.02 * size


def test_a_frame_rate_divided_averages_as_reading_would(robot: RerunInputs) -> None:
    """A straight line stays; a sine of period P loses sinc(W / P), W the longer interval."""
    now = KINDS["frame-rate"].change(robot, Perturbation("frame-rate", "", 4))
    rate = robot.long("planar.parquet").facts["rate_hz"]
    assert now.long("planar.parquet").facts["rate_hz"] == rate / 4
    wrench = robot.table("wrench.parquet")
    made = wrench.with_columns(Fx=3 * wrench["time"] - 1, Fy=np.sin(2 * np.pi * 2.0 * wrench["time"]))
    for every in (3, 4):
        averaged = perturbations._average(made, every)
        seen = {name: averaged[name][2:-2] for name in ("time", "Fx", "Fy")}
        assert np.allclose(seen["Fx"], 3 * seen["time"] - 1)
        kept = np.sinc(2.0 * every / rate)
        assert np.allclose(seen["Fy"], kept * np.sin(2 * np.pi * 2.0 * seen["time"]), atol=2e-3)
        assert averaged.names == wrench.names


def test_a_perturbation_knows_nothing_of_those_before_it(robot: RerunInputs) -> None:
    first, second = Perturbation("camera-noise", "", 0.002), Perturbation("wrench-noise", "Fx", 1.0)
    alone = run_perturbation(robot, first).estimates
    run_perturbation(robot, second)
    assert run_perturbation(robot, first).estimates == alone


def test_other_seeds_draw_other_noise(robot: RerunInputs) -> None:
    changes = (Perturbation("camera-noise", "", 0.001, seed) for seed in (1, 2))
    one, two = (tracks(KINDS["camera-noise"].change(robot, change)) for change in changes)
    assert not np.array_equal(one, two, equal_nan=True)


def test_what_cannot_be_computed_is_an_answer(robot: RerunInputs) -> None:
    """Three frames of a whole recording are no movement."""
    every = len(robot.table("wrench.parquet").frame) // 3
    tried = run_perturbation(robot, Perturbation("frame-rate", "", every))
    assert tried.estimates is None
    assert tried.why
    assert tried.changes.state_r2.shape == (3, 0)
