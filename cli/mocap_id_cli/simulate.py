"""``mocap-id simulate``: trials, robot studies and cohorts whose truth is known.

The options of the commands, with their defaults and help texts, are the fields of :class:`mocap_id.simulation.Options`,
and for trials in space those of :class:`~mocap_id.simulation.arm.ArmOptions`,
:class:`~mocap_id.simulation.arm.ChainOptions` and :class:`~mocap_id.simulation.space_robot.SpaceRobotOptions`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast, get_args, get_type_hints

import typer

from mocap_id import simulation
from mocap_id.simulation import Cohort, Kind, Options, PersonOptions, RobotSet, Strategy
from mocap_id.simulation.arm import (
    ArmOptions,
    ChainOptions,
    CurlStudy,
    ReachCohort,
    simulate_curl_study,
    simulate_reach_cohort,
    write_arm,
    write_chain,
)
from mocap_id.simulation.arm.pneumatic_device import CurlCondition
from mocap_id.simulation.options import FaultOptions, read_faults, read_people
from mocap_id.simulation.space_robot import SpaceRobotOptions, simulate_space_robot

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder.", show_default=False)]
_AnyOptions: TypeAlias = Options | ArmOptions | ChainOptions | SpaceRobotOptions
_TEXTS = {"people": read_people, "faults": read_faults}
_HELP = {
    "people": "Differences between the person and rigid segments on pins: "
    + ", ".join(each.name for each in fields(PersonOptions))
    + ".",
    "faults": "Faults of the recording: " + ", ".join(each.name for each in fields(FaultOptions)) + ".",
}
_TRIALS: dict[Kind, str] = {
    "sit-to-stand": "Simulate a person who stands up and sits down.",
    "robot": "Simulate a robot that turns one joint in a vertical plane.",
}
_READY = "FOLDER then has the recording, its exact truth and a trial.yaml that is ready to run."
_ROBOT_SET = (
    *("seed", "repetitions", "rate", "analog_rate", "marker_noise", "occlusions", "plate_noise", "plate_bias"),
    "clock_offset",
)
_REACH_COHORT = ("seed", "preset", "cycles", "glide_mm", "rate", "soft_tissue", "anonymous")
_CURL_STUDY = ("seed", "preset", "rate", "soft_tissue", "anonymous")
_COHORT = (*_ROBOT_SET, "soft_tissue", "jumps", "seat_plate", "people")


def commands() -> typer.Typer:
    """Return the commands of ``mocap-id simulate``."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        help="Simulate recordings whose exact truth is known.",
    )
    every = tuple(name for name in _names(Options()) if name != "subject")
    for kind in get_args(Kind):
        app.command(kind)(_with_options(partial(_trial, kind), f"{_TRIALS[kind]}\n\n{_READY}", Options(), every))
    in_space: tuple[tuple[str, Callable[..., Path], _AnyOptions], ...] = (
        ("arm", _arm, ArmOptions()),
        ("chain", _chain, ChainOptions()),
        ("robot-in-space", _space_robot, SpaceRobotOptions()),
    )
    for name, write, defaults in in_space:
        app.command(name)(_with_options(write, write.__doc__, defaults, _names(defaults)))
    app.command("robot-set")(_with_options(_robot_set, _robot_set.__doc__, RobotSet().options, _ROBOT_SET))
    app.command("cohort")(_with_options(_cohort, _cohort.__doc__, Cohort().options, _COHORT))
    reach = _with_options(_reach_cohort, _reach_cohort.__doc__, ReachCohort().options, _REACH_COHORT)
    app.command("reach-cohort")(reach)
    curls = _with_options(_curl_study, _curl_study.__doc__, CurlStudy().options, _CURL_STUDY)
    app.command("curl-study")(curls)
    return app


def _names(options: _AnyOptions) -> tuple[str, ...]:
    return tuple(each.name for each in fields(options))


def _with_options(
    simulate: Callable[..., Path], doc: str | None, defaults: _AnyOptions, names: tuple[str, ...]
) -> Callable[..., None]:
    """Return a command with the parameters of ``simulate`` and, in place of ``options``, the options named."""

    def command(**values: Any) -> None:
        chosen = {name: values.pop(name) for name in names}
        for name, read in _TEXTS.items():
            if name in chosen:
                chosen[name] = read(chosen[name])
        typer.echo(simulate(options=replace(defaults, **chosen), **values))

    own = [each for each in inspect.signature(simulate, eval_str=True).parameters.values() if each.name != "options"]
    signature = inspect.Signature([*own, *_parameters(defaults, names)])
    command.__signature__ = signature  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in signature.parameters.values()}
    command.__doc__ = doc
    return command


def _parameters(defaults: _AnyOptions, names: tuple[str, ...]) -> Iterator[inspect.Parameter]:
    types = get_type_hints(type(defaults))
    for each in fields(defaults):
        if each.name not in names:
            continue
        kind, option = types[each.name], typer.Option(getattr(defaults, each.name), help=each.metadata.get("help"))
        if each.name in _TEXTS:
            kind, option = str, typer.Option("", metavar="NAME=VALUE,...", show_default=False, help=_HELP[each.name])
        yield inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY, default=option, annotation=kind)


def _trial(kind: Kind, folder: Folder, *, options: Options) -> Path:
    return simulation.simulate(kind, folder, options)


def _arm(folder: Folder, *, options: ArmOptions) -> Path:
    """Simulate an arm that reaches or curls, in space.

    FOLDER then has the recording, its exact truth and a trial.yaml that is ready to run.
    """
    return write_arm(folder, options)


def _chain(folder: Folder, *, options: ChainOptions) -> Path:
    """Simulate a chain of bodies without names, in space.

    FOLDER then has the recording, its exact truth and a trial.yaml that is ready to run.
    """
    return write_chain(folder, options)


def _space_robot(folder: Folder, *, options: SpaceRobotOptions) -> Path:
    """Simulate a robot on a force plate that moves in space.

    Its joints move together. FOLDER then has the recording, its exact truth and a trial.yaml that is ready to run.
    """
    return simulate_space_robot(folder, options)


def _robot_set(
    folder: Folder,
    *,
    repeats: Annotated[int, typer.Option(help="Trials of each joint, speed and orientation.")] = RobotSet.repeats,
    options: Options,
) -> Path:
    """Simulate the thesis's robot study.

    Each joint moves at two speeds in two orientations. FOLDER then has the recordings, their exact truth and a
    robot-study.yaml.
    """
    return simulation.simulate_robot_set(folder, RobotSet(repeats, options=options))


def _cohort(
    folder: Folder,
    *,
    subjects: Annotated[int, typer.Option(help="Number of persons, alternately female and male.")] = Cohort.subjects,
    strategies: Annotated[str, typer.Option(help="Strategies of rising, separated by commas.")] = ",".join(
        Cohort.strategies
    ),
    trials: Annotated[int, typer.Option(help="Trials of each person and strategy.")] = Cohort.trials,
    options: Options,
) -> Path:
    """Simulate several people who stand up and sit down.

    FOLDER then has their recordings, the exact truth and a study.yaml that is ready to run.
    """
    names = tuple(cast(Strategy, name.strip()) for name in strategies.split(","))
    return simulation.simulate_cohort(folder, Cohort(subjects, names, trials, options))


def _reach_cohort(
    folder: Folder,
    *,
    subjects: Annotated[int, typer.Option(help="Number of people, from healthy to severely limited.")] = (
        ReachCohort.subjects
    ),
    sessions: Annotated[int, typer.Option(help="Sessions of each person, both arms in each.")] = ReachCohort.sessions,
    skeletons: Annotated[
        bool, typer.Option("--skeletons", help="Skeletons of a depth camera instead of markers.")
    ] = ReachCohort.skeletons,
    options: ArmOptions,
) -> Path:
    """Simulate people who reach.

    FOLDER then has their recordings, the exact truth and a study.yaml that is ready to run.
    """
    return simulate_reach_cohort(folder, ReachCohort(subjects, sessions, skeletons, options))


def _curl_study(
    folder: Folder,
    *,
    subjects: Annotated[int, typer.Option(help="Number of people.")] = CurlStudy.subjects,
    trials: Annotated[int, typer.Option(help="Trials of each person and condition.")] = CurlStudy.trials,
    conditions: Annotated[str, typer.Option(help="Conditions of the device, separated by commas.")] = ",".join(
        CurlStudy.conditions
    ),
    options: ArmOptions,
) -> Path:
    """Simulate people who curl with a pneumatic device.

    FOLDER then has their recordings, the exact truth and a study.yaml that is ready to run.
    """
    names = tuple(cast(CurlCondition, name.strip()) for name in conditions.split(","))
    return simulate_curl_study(folder, CurlStudy(subjects, trials, names, options))
