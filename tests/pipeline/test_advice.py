"""`mocap-id advise`: a small part of the check in docs/excitation.md, and the command line."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from mocap_id.config import load
from mocap_id.dynamics.cautions import classify
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.recording.writer import write_c3d
from mocap_id.runner import run_to
from mocap_id.workflows.advice import AdviceOptions, advise_movement, make_output, parse_angle_range, parse_support
from mocap_id_cli.commands import build
from mocap_id_simulation import Options, generate, simulate
from mocap_id_simulation.options import draw_subject

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SEED = 981_000


@pytest.fixture(scope="module")
def bodies():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        yield importlib.import_module("excitation")


@pytest.fixture(scope="module")
def weak(bodies, tmp_path_factory):
    """A robot's joint that hardly moves: case, options and the run trial."""
    case = bodies.Case("robot", SEED)
    marker, plate = bodies.NOISY["robot"]
    options = Options(seed=SEED, subject=draw_subject(SEED, 1), marker_noise=marker, plate_noise=plate)
    place = tmp_path_factory.mktemp("weak") / "before"
    before = bodies.record(place, case, options, bodies.make_first_motion(case))
    return case, options, place, before


@pytest.fixture(scope="module")
def advised(weak):
    return advise_movement(weak[2] / "trial.yaml")


def test_the_present_movement_is_what_was_identified(weak, advised) -> None:
    before, now = weak[3], advised.design.now
    np.testing.assert_allclose(now.sd, before.sd, rtol=1e-6)
    assert now.condition == pytest.approx(before.condition, rel=1e-6)


def test_an_advised_movement_makes_weak_parameters_known(bodies, weak, advised, tmp_path: Path) -> None:
    """SimulatedTrial, run through the pipeline: as was foreseen, and closer to the truth."""
    case, options, _, before = weak
    best = advised.design.best_standalone
    assert best is not None
    after = bodies.record(
        tmp_path / "after", case, options, bodies.make_movement(best.trajectory, advised.design.rest, before)
    )
    size = advised.design.size
    assert "weak" in {classify(float(sd)) for sd in before.sd / size}
    assert {classify(float(sd)) for sd in best.predicted.sd / size} == {"known"}
    assert {classify(float(sd)) for sd in after.sd / size} == {"known"}
    assert best.predicted.condition == pytest.approx(after.condition, rel=0.05)
    assert np.all(np.abs(np.log(best.predicted.sd / after.sd)) < np.log(5.0))
    off = [np.linalg.norm(((each.value - each.true) / size)[2:]) for each in (before, after)]
    assert off[1] < 0.2 * off[0]


def test_a_run_folder_is_advised_on_as_its_yaml(weak, advised) -> None:
    again = advise_movement(load(weak[2] / "trial.yaml").out)
    assert make_output(again).document == make_output(advised).document


def test_what_is_written(advised, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "advice"
    files = [folder / name for name in make_output(advised).write(folder)]
    assert [file.name for file in files] == ["advice.json", "movement.csv", "movement.svg", "movement.pdf"]
    told = json.loads(files[0].read_text())
    assert told["helps"] is True
    assert len(told["now"]["parameters"]) == len(told["designed"]["parameters"]) == 5
    with_sensor = zip(told["now"]["parameters"], told["sensor"]["parameters"], strict=True)
    assert all(now["name"] == then["name"] and then["sd"] <= now["sd"] for now, then in with_sensor)
    frame = pd.read_csv(files[1])
    assert list(frame.columns) == ["time_s", "joint_rad", "joint_rad_s", "joint_rad_s2"]
    limits = advised.limits
    assert frame["joint_rad"].between(limits.low[0] - 1e-6, limits.high[0] + 1e-6).all()
    assert frame["joint_rad_s"].abs().max() <= limits.speed[0] + 1e-6
    rate = np.gradient(frame["joint_rad"], frame["time_s"])
    np.testing.assert_allclose(rate[2:-2], frame["joint_rad_s"][2:-2], atol=0.02)
    assert b"<svg" in files[2].read_bytes()


def test_the_command_says_what_to_record(weak) -> None:
    said = CliRunner().invoke(build(), ["advise", "-q", str(weak[2] / "trial.yaml"), "--seconds", "12"])
    assert said.exit_code == 0, said.output
    assert "record this, 12 s: " in said.output
    assert "condition number" in said.output


def test_limits_are_asked_for(weak) -> None:
    options = AdviceOptions(angles={"joint": (-10.0, 10.0)}, speed=20.0, acceleration=100.0)
    found = advise_movement(weak[2] / "trial.yaml", options)
    np.testing.assert_allclose(np.degrees([found.limits.low[0], found.limits.high[0]]), [-10, 10])
    assert found.design.best_standalone is not None
    assert np.degrees(np.abs(found.design.best_standalone.trajectory.dq)).max() <= 20.0 + 1e-6


def test_a_joint_that_is_not_there(weak) -> None:
    with pytest.raises(ConfigError, match="no joint 'knee'; expected one of joint"):
        advise_movement(weak[2] / "trial.yaml", AdviceOptions(angles={"knee": (0.0, 10.0)}))


def test_without_a_plate_there_is_nothing_to_foresee(tmp_path: Path) -> None:
    """Without a force plate the run succeeds, and the advice states why there is none."""
    configuration = simulate("robot", tmp_path / "trial", Options(seed=3, repetitions=3))
    made = generate("robot", Options(seed=3, repetitions=3))
    (tmp_path / "trial" / "trial.c3d").unlink()
    write_c3d(tmp_path / "trial" / "trial.c3d", made.scene.markers.labels, made.points, 100.0)
    run_to(load(configuration), "identify-dim")
    with pytest.raises(RecordingError, match=r"no parameters were identified on trial trial.*the ground's wrench"):
        advise_movement(configuration)
    said = CliRunner().invoke(build(), ["advise", "-q", str(configuration)])
    assert said.exit_code != 0


@pytest.mark.parametrize(
    ("key", "value"),
    [("objective", "best"), ("seconds", 1.0), ("widen", -1.0), ("speed", 0.0), ("acceleration", 0.0), ("seed", -1)],
)
def test_what_cannot_be_asked(key: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"advise: {key} is .*; expected"):
        AdviceOptions(**{key: value})


@pytest.mark.parametrize("text", ["hip", "hip=10", "=1:2", "hip=a:b", "hip=20:10", "hip=nan:3"])
def test_a_range_that_does_not_read(text: str) -> None:
    with pytest.raises(ConfigError, match="JOINT=LOW:HIGH"):
        parse_angle_range(text)


def test_ranges() -> None:
    assert parse_angle_range("joint 2=-10:60.5") == ("joint 2", (-10.0, 60.5))
    assert parse_support("-8:3.5") == (-0.08, 0.035)
    assert parse_support("bolted") == "bolted"
    with pytest.raises(ConfigError, match="LOW:HIGH in cm"):
        parse_support("8")
