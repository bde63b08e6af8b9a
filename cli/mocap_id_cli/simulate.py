"""``mocap-id simulate``: simulated trials, robot studies and cohorts, whose exact truth is known.

The options of the commands, with their defaults and help texts, are the fields of the option classes in
:mod:`mocap_id_simulation`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast, get_type_hints

import typer
from typer import Argument, Option

from mocap_id_cli.console import make_group, set_parameters
from mocap_id_simulation import simulate as simulate_plane
from mocap_id_simulation.arm_files import write_arm, write_chain
from mocap_id_simulation.options import (
    ArmOptions,
    ChainOptions,
    CurlCondition,
    FaultOptions,
    Options,
    PersonOptions,
    Strategy,
    read_faults,
    read_people,
)
from mocap_id_simulation.space_robot import RobotSet, SpaceRobotOptions, simulate_robot_set, simulate_space_robot
from mocap_id_simulation.studies import (
    Cohort,
    CurlStudy,
    ReachCohort,
    simulate_cohort,
    simulate_curl_study,
    simulate_reach_cohort,
)

_Folder = Annotated[Path, Argument(metavar="FOLDER", help="A new folder.")]
_AnyOptions: TypeAlias = Options | ArmOptions | ChainOptions | SpaceRobotOptions
_PARSERS = {"people": read_people, "faults": read_faults}
_HELP = {
    "people": "Deviations of the person from rigid segments with pin joints: "
    + ", ".join(each.name for each in fields(PersonOptions))
    + ".",
    "faults": "Faults of the recording: " + ", ".join(each.name for each in fields(FaultOptions)) + ".",
}
_TRIAL = "FOLDER then contains the recording, its exact truth and a trial.yaml that is ready to run."
_STUDY = "FOLDER then contains their recordings, the exact truth and a study.yaml that is ready to run."
_ROBOT_SET = (
    *("seed", "repetitions", "rate", "analog_rate", "marker_noise", "occlusions", "plate_noise", "plate_bias"),
    "clock_offset",
)
_COHORT = (*_ROBOT_SET, "soft_tissue", "jumps", "seat_plate", "people")
_CURL_STUDY = ("seed", "preset", "rate", "soft_tissue", "anonymous")
_REACH_COHORT = (*_CURL_STUDY, "cycles", "glide_mm")


def _make_command(
    write: Callable[..., Path], text: str, defaults: _AnyOptions, names: Sequence[str]
) -> Callable[..., None]:
    """Return a command that calls ``write``, with the help ``text``.

    Its parameters are those of ``write`` and, instead of ``options``, the fields ``names`` of ``defaults``.
    """

    def command(**values: Any) -> None:
        chosen = {name: values.pop(name) for name in names}
        chosen |= {name: parse(chosen[name]) for name, parse in _PARSERS.items() if name in chosen}
        typer.echo(write(options=replace(defaults, **chosen), **values))

    own = [each for each in inspect.signature(write, eval_str=True).parameters.values() if each.name != "options"]
    set_parameters(command, [*own, *_make_parameters(defaults, names)])
    command.__doc__ = text
    return command


def _make_parameters(defaults: _AnyOptions, names: Sequence[str]) -> Iterator[inspect.Parameter]:
    types = get_type_hints(type(defaults))
    for each in fields(defaults):
        if each.name not in names:
            continue
        kind, option = types[each.name], Option(getattr(defaults, each.name), help=each.metadata.get("help"))
        if each.name in _PARSERS:
            kind, option = str, Option("", metavar="NAME=VALUE,...", show_default=False, help=_HELP[each.name])
        yield inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=option, annotation=kind)


def _take_folder(write: Callable[[Path, Any], Path]) -> Callable[..., Path]:
    """Return a function that simulates a trial by ``write``, with FOLDER as a parameter of the command line."""

    def simulate_trial(folder: _Folder, *, options: _AnyOptions) -> Path:
        return write(folder, options)

    return simulate_trial


def _robot_set(
    folder: _Folder,
    *,
    repeats: Annotated[int, Option(help="Trials of each joint, speed and orientation.")] = RobotSet.repeats,
    options: Options,
) -> Path:
    return simulate_robot_set(folder, RobotSet(repeats, options=options))


def _cohort(
    folder: _Folder,
    *,
    subjects: Annotated[int, Option(help="Number of people, alternately female and male.")] = Cohort.subjects,
    strategies: Annotated[str, Option(help="Strategies of rising, separated by commas.")] = ",".join(Cohort.strategies),
    trials: Annotated[int, Option(help="Trials of each person and strategy.")] = Cohort.trials,
    options: Options,
) -> Path:
    names = tuple(cast(Strategy, name.strip()) for name in strategies.split(","))
    return simulate_cohort(folder, Cohort(subjects, names, trials, options))


def _reach_cohort(
    folder: _Folder,
    *,
    subjects: Annotated[int, Option(help="Number of people, from healthy to severely limited.")] = (
        ReachCohort.subjects
    ),
    sessions: Annotated[
        int, Option(help="Sessions of each person; each session is for both arms.")
    ] = ReachCohort.sessions,
    skeletons: Annotated[
        bool, Option("--skeletons", help="Write skeletons of a depth camera instead of markers.")
    ] = ReachCohort.skeletons,
    options: ArmOptions,
) -> Path:
    return simulate_reach_cohort(folder, ReachCohort(subjects, sessions, skeletons, options))


def _curl_study(
    folder: _Folder,
    *,
    subjects: Annotated[int, Option(help="Number of people.")] = CurlStudy.subjects,
    trials: Annotated[int, Option(help="Trials of each person and condition.")] = CurlStudy.trials,
    conditions: Annotated[str, Option(help="Conditions of the device, separated by commas.")] = ",".join(
        CurlStudy.conditions
    ),
    options: ArmOptions,
) -> Path:
    names = tuple(cast(CurlCondition, name.strip()) for name in conditions.split(","))
    return simulate_curl_study(folder, CurlStudy(subjects, trials, names, options))


def _make_commands() -> dict[str, Callable[..., None]]:
    plane = [each.name for each in fields(Options) if each.name != "subject"]
    trials: tuple[tuple[str, Callable[..., Path], str, _AnyOptions], ...] = (
        ("sit-to-stand", partial(simulate_plane, "sit-to-stand"), "a person who stands up and sits down", Options()),
        ("robot", partial(simulate_plane, "robot"), "a robot that moves one joint in a vertical plane", Options()),
        ("arm", write_arm, "an arm that reaches or curls, in space", ArmOptions()),
        ("chain", write_chain, "a chain of bodies without names, in space", ChainOptions()),
        ("robot-in-space", simulate_space_robot, "a robot on a force plate that moves in space", SpaceRobotOptions()),
    )
    made = {}
    for name, write, text, options in trials:
        names = plane if isinstance(options, Options) else [each.name for each in fields(options)]
        made[name] = _make_command(_take_folder(write), f"Simulate {text}.\n\n{_TRIAL}", options, names)
    robot_set = (
        "Simulate the thesis's robot study.\n\nEach joint moves at two speeds in two orientations. FOLDER then "
        "contains the recordings, their exact truth and a robot-study.yaml."
    )
    cohort = f"Simulate several people who stand up and sit down.\n\n{_STUDY}"
    curls = f"Simulate people who curl with a pneumatic device.\n\n{_STUDY}"
    made["robot-set"] = _make_command(_robot_set, robot_set, RobotSet().options, _ROBOT_SET)
    made["cohort"] = _make_command(_cohort, cohort, Cohort().options, _COHORT)
    reaches = f"Simulate people who reach.\n\n{_STUDY}"
    made["reach-cohort"] = _make_command(_reach_cohort, reaches, ReachCohort().options, _REACH_COHORT)
    made["curl-study"] = _make_command(_curl_study, curls, CurlStudy().options, _CURL_STUDY)
    return made


simulate = make_group("Simulate recordings whose exact truth is known.", **_make_commands())
