"""The ``trial.yaml`` of a simulated trial."""

from __future__ import annotations

import json

from mocap_id.simulation.options import Kind, Options
from mocap_id.simulation.scene import Scene

_TOP = """\
# {what}
# Made by `mocap-id simulate` with seed {seed}. The exact truth stands beside it, in truth.json and truth.npz.
# Paths are relative to this file.
trial: {name}
recording: trial.c3d  # markers and force plate
"""

_SIT_TO_STAND = """\
protocol: sit-to-stand  # {chair}
subject:  # for the reference model only
  height: {height:.3f}  # m
  mass: {mass:.2f}  # kg
"""

_FREE = """\
protocol: free  # a given movement, nothing but the ground touched
subject:
  mass: {mass:.2f}  # kg
"""

_ROBOT = """\
protocol: robot-joint
encoder: encoder.csv  # the robot's own record of its joint, on its own clock
"""


def configuration(kind: Kind, name: str, options: Options, scene: Scene) -> str:
    """YAML text, ready to run."""
    quoted = json.dumps(name, ensure_ascii=False)  # a folder may be called 12 or yes
    if kind == "robot":
        what = f"A robot's joint, {options.repetitions} swings."
        return _TOP.format(what=what, seed=options.seed, name=quoted) + _ROBOT
    what = f"A person, {options.repetitions} sit-to-stands, {options.strategy} strategy."
    if scene.chair is None:
        free = _FREE.format(mass=scene.body.mass)
        return _TOP.format(what="A person, a given movement.", seed=options.seed, name=quoted) + free
    size = {
        "height": scene.body.description["subject"]["height_m"],
        "mass": scene.body.mass - options.people.held_mass_kg,
    }
    chair = "samples with chair contact stay out of the identification"
    if scene.seat_plate is not None:
        chair = "the chair stands on plate 2, and what that reads counts as measured"
    return _TOP.format(what=what, seed=options.seed, name=quoted) + _SIT_TO_STAND.format(**size, chair=chair)
