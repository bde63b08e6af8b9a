"""A robot of which two joints move: both are found, and one joint stays one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.recording import write_c3d
from mocap_id.runner import run_stage
from mocap_id.store import Folder
from mocap_id.store.artefacts import Skeleton
from mocap_id_simulation import Options, SimulatedTrial, motion_through
from mocap_id_simulation.bodies import Link, add_plate_markers
from mocap_id_simulation.scene import draw_scene, measure_scene, random_streams
from mocap_id_simulation.sit_to_stand import Swing

UPPER, HEIGHT = 0.4, 0.16  # m: distance of the joints, and of the forearm's centre of mass from the second one
MASS, INERTIA = 3.0, 0.03


def two_joints(seed: int, amplitude: float) -> SimulatedTrial:
    """Simulate a robot whose second joint swings with an amplitude, rad."""
    options = Options(seed=seed, repetitions=4, analog_rate=100, occlusions=0.0)
    rng = random_streams(seed)
    scene, places = draw_scene("robot", options, rng), np.random.default_rng(seed)
    base, arm = scene.body.links
    links = (
        base,
        replace(arm, length=UPPER, com=(0.005, 0.2)),
        Link("forearm", "elbow", (0.0, UPPER), 0.35, MASS, (0.0, HEIGHT), INERTIA),
    )
    swings = Swing(0.42, 0.7, 0.2, 4, 1.0), Swing(0.56, amplitude, 0.5, 5, 1.0)
    duration = min(swing.duration for swing in swings)
    time = np.arange(-1.0, duration + 1.0, 0.005)
    angles = np.column_stack([swing.motion().at(time)[0][:, 0] for swing in swings])
    link = np.repeat([0, 1, 2], 4)
    along = [(0.1 + 0.15 * k % 0.6) * links[segment].length for k, segment in enumerate(link)]
    local = np.column_stack([places.uniform(-0.05, 0.05, 12), along, places.uniform(-0.05, 0.1, 12)])
    markers = add_plate_markers(
        places,
        tuple(f"S{segment}M{k}" for k, segment in enumerate(link)),
        link,
        local,
        softness=np.zeros(12),
        hidden=np.zeros(12, dtype=np.bool_),
        at_joint=(None,) * 12,
    )
    body = replace(scene.body, links=links)
    return measure_scene(
        replace(scene, body=body, motion=motion_through(time, angles, duration), markers=markers), options, rng
    )


@pytest.mark.parametrize(("seed", "amplitude"), [(5, 0.6), (6, 0.15)])
def test_both_joints_are_identified(tmp_path: Path, seed: int, amplitude: float) -> None:
    made = two_joints(seed, amplitude)
    write_c3d(tmp_path / "trial.c3d", made.labels, made.points, 100.0, plates=[made.signals])
    file = tmp_path / "trial.yaml"
    file.write_text("trial: two\nrecording: trial.c3d\nprotocol: robot-joint\n", encoding="utf-8")
    trial = load(file)
    for stage in ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim"):
        assert run_stage(trial, stage).refused is None
    folder = Folder(trial.out)
    skeleton = Skeleton(folder.read("chain.h5"))
    assert len(skeleton.centres) == 2
    assert np.hypot(*skeleton.centres[1]) == pytest.approx(UPPER, abs=0.002)
    states, base = folder.read("states.parquet"), folder.read("dynamics.h5").data["base"]
    for joint, angle in enumerate(made.state.q.T, start=1):
        found = np.asarray(states[f"theta_{joint}"])
        off = [np.nanstd(sign * found - angle) for sign in (1, -1)]
        assert np.degrees(min(off)) < 0.2
    own = {str(name): (value, sd) for name, value, sd in zip(base["name"], base["value"], base["sd"], strict=True)}
    first_moment = np.hypot(own["mx3"][0], own["my3"][0])
    assert first_moment == pytest.approx(MASS * HEIGHT, abs=3 * np.hypot(own["mx3"][1], own["my3"][1]))
    assert own["I3"][0] == pytest.approx(INERTIA + MASS * HEIGHT**2, abs=4 * own["I3"][1])
