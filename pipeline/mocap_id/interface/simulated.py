"""Simulated trials, cohorts and studies for Python."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias

import mocap_id_simulation as simulation
from mocap_id.config.parsing import suggest_name
from mocap_id.errors import ConfigError

Kind: TypeAlias = Literal[
    "sit-to-stand", "robot", "arm", "chain", "robot-in-space", "robot-set", "cohort", "reach-cohort", "curl-study"
]

_TRIALS: dict[str, tuple[Callable[..., Path], Any]] = {
    "sit-to-stand": (partial(simulation.simulate, "sit-to-stand"), simulation.Options),
    "robot": (partial(simulation.simulate, "robot"), simulation.Options),
    "arm": (simulation.write_arm, simulation.ArmOptions),
    "chain": (simulation.write_chain, simulation.ChainOptions),
    "robot-in-space": (simulation.simulate_space_robot, simulation.SpaceRobotOptions),
}
_SETS: dict[str, tuple[Callable[..., Path], Any]] = {
    "robot-set": (simulation.simulate_robot_set, simulation.RobotSet),
    "cohort": (simulation.simulate_cohort, simulation.Cohort),
    "reach-cohort": (simulation.simulate_reach_cohort, simulation.ReachCohort),
    "curl-study": (simulation.simulate_curl_study, simulation.CurlStudy),
}


def simulate(kind: Kind, folder: str | PathLike[str], **options: Any) -> Path:
    """Simulate recordings with their exact truth, and return the path of the YAML file of the trial or study.

    Parameters
    ----------
    kind : str
        Name of a command of ``mocap-id simulate``.
    folder : path
        A new folder, to which all files are written.
    **options
        Options of this command, such as ``seed=1``.

    Raises
    ------
    ConfigError
        There is no such kind or option, or a value is out of range.
    StoreError
        The folder already contains a trial, or cannot be written.
    """
    if kind not in {**_TRIALS, **_SETS}:
        raise ConfigError(f"simulate: there is no kind {kind!r}: {suggest_name(kind, (*_TRIALS, *_SETS))}")
    write, model = {**_TRIALS, **_SETS}[kind]
    chosen = model()
    own = [each.name for each in fields(model) if each.name != "options"]
    common = [each.name for each in fields(chosen.options)] if kind in _SETS else []
    for name in options:
        if name not in (*own, *common):
            raise ConfigError(f"simulate {kind}: there is no option {name!r}: {suggest_name(name, (*own, *common))}")
    if common:
        shared = replace(chosen.options, **{name: options.pop(name) for name in common if name in options})
        options["options"] = shared
    return write(Path(folder), replace(chosen, **options))
