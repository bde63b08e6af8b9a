"""YAML files of simulated trials, cohorts and robot studies, ready to run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from mocap_id.simulation.body import SimulatedBody, Subject
from mocap_id.simulation.log_sensors import joint_position
from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.scene import Scene
from mocap_id.simulation.ur5 import REFERENCE, TOTAL, JointName

_TRIAL = """\
# {what}
# Made by `mocap-id simulate` with seed {seed}. The exact truth is in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
recording: {recording}
"""
_PLATE = "trial.c3d  # markers and force plate"
_BOARD = "{markers: trial.c3d, forces: {balance_board: board.csv}}"
_SIT_TO_STAND = """\
protocol: sit-to-stand  # {chair}
subject:  # for the reference model only
  height: {height:.3f}  # m
  mass: {mass:.2f}  # kg
"""
_FREE = """\
protocol: free  # a given movement that touches only the ground
subject:
  mass: {mass:.2f}  # kg
"""
_ROBOT = """\
protocol: robot-joint
encoder: encoder.csv  # the robot's own record of its joint, on its own clock
"""
_JOINT_SENSOR = """\
external:  # a wrench sensor in the joint, which carries the moving part
  - {{file: sensor.csv, name: joint, segment: {segment}, at: [{at}], measures: beyond}}
"""

_STUDY = """\
# {subjects} simulated persons, {trials} trials of {repetitions} sit-to-stands each.
# Made by `mocap-id simulate cohort` with seed {seed}. The exact truth of each trial is in truth/<trial>/.
# Paths are relative to this file.
study: simulated-cohort
out: runs
defaults: {{protocol: sit-to-stand}}  # {chair}
subjects:  # m, kg; the lengths between landmarks are the true ones
"""
_SIZE = "height: {height:.3f}, mass: {mass:.2f}, sex: {sex}"
_LANDMARKS = "landmarks_m: {{shank: {shank:.4f}, thigh: {thigh:.4f}}}"
_SUBJECT = f"  {{name}}: {{{{{_SIZE}, {_LANDMARKS}}}}}\n"
_STUDY_TRIAL = "  - {{trial: {}, subject: {}, strategy: {}, recording: {}}}\n"

_ROBOT_STUDY = """\
# {count} simulated trials of the thesis's robot, {periods} swings of one joint each (`mocap-id validate robot`).
# Made by `mocap-id simulate robot-set` with seed {seed}. The exact truth stands beside each trial.
# Paths are relative to this file.
study: simulated-ur5
reference:  # table 5.2's: m, kg, kg·m, kg·m²; `base` is the joint's distance from the plate's centre
"""
_REFERENCE = "  {name}: {{base: {l1}, mass: {mass}, mx1: 0.0, mx2: 0.0, my2: {my}, Izz2: {inertia}}}\n"
_ROBOT_TRIAL = "  - {{file: {}/trial.yaml, joint: {}, speed: {}, orientation: {:g}}}\n"


def trial_yaml(kind: Kind, name: str, options: Options, scene: Scene) -> str:
    """Return the text of ``trial.yaml``."""
    quoted = json.dumps(name, ensure_ascii=False)  # the folder's name may be 12 or yes
    if kind == "robot":
        what, rest = f"A robot's joint, {options.repetitions} swings.", _ROBOT
        if options.joint_sensor:
            at = ", ".join(f"{value:.6f}" for value in joint_position(scene))
            rest += _JOINT_SENSOR.format(segment=1, at=at)
    elif scene.chair is None:
        what, rest = "A person, a given movement.", _FREE.format(mass=scene.body.mass)
    else:
        what = f"A person, {options.repetitions} sit-to-stands, {options.strategy} strategy."
        chair = "samples with chair contact are excluded from the identification"
        if scene.seat_plate is not None:
            chair = "the chair stands on plate 2, whose force is included as measured"
        height = scene.body.description["subject"]["height_m"]
        mass = scene.body.mass - options.people.held_mass_kg
        rest = _SIT_TO_STAND.format(height=height, mass=mass, chair=chair)
    recording = _BOARD if options.board else _PLATE
    return _TRIAL.format(what=what, seed=options.seed, name=quoted, recording=recording) + rest


def study_yaml(
    options: Options, bodies: Mapping[Subject, SimulatedBody], trials: Sequence[tuple[str, str, str, str]]
) -> str:
    """Return the text of a cohort's ``study.yaml``.

    Each of ``trials`` is (name, subject, strategy, recording); ``bodies`` contains the body of each person.
    """
    chair = (
        "the force of the chair's own plate is included as measured"
        if options.seat_plate
        else "the chair stands on no plate"
    )
    counts = {"subjects": len(bodies), "trials": len(trials), "repetitions": options.repetitions}
    text = _STUDY.format(**counts, seed=options.seed, chair=chair)
    for subject, body in bodies.items():
        size = {"name": subject.name, "height": subject.height, "mass": subject.mass, "sex": subject.sex}
        text += _SUBJECT.format(**size, **body.scored_lengths)
    return text + "trials:\n" + "".join(_STUDY_TRIAL.format(*trial) for trial in trials)


def robot_study_yaml(
    seed: int, periods: int, joints: Sequence[JointName], trials: Sequence[tuple[str, Options]]
) -> str:
    """Return the text of ``robot-study.yaml`` for ``trials`` (name and options) with ``periods`` swings each."""
    text = _ROBOT_STUDY.format(count=len(trials), periods=periods, seed=seed)
    for joint in joints:
        known = REFERENCE[joint]
        text += _REFERENCE.format(name=joint, l1=known.distance, mass=TOTAL, my=known.my, inertia=known.inertia)
    text += "trials:\n"
    return text + "".join(_ROBOT_TRIAL.format(name, one.joint, one.speed, one.orientation) for name, one in trials)
