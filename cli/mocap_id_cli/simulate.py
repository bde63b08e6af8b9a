"""``mocap-id simulate``: trials and whole cohorts whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from mocap_id import simulation
from mocap_id.simulation import Cohort, Kind, Options, RobotSet, Strategy
from mocap_id.simulation.people import read_people
from mocap_id.simulation.plate import Sense
from mocap_id.simulation.ur5 import JointName, Speed

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder.", show_default=False)]
Seed = Annotated[int, typer.Option(help="Of the body, its motion and every error.")]
Repetitions = Annotated[int, typer.Option(help="Sit-to-stands, or swings of the robot.")]
Rate = Annotated[float, typer.Option(help="Frames a second, Hz.")]
AnalogRate = Annotated[float, typer.Option(help="Analog samples a second, Hz.")]
MarkerNoise = Annotated[float, typer.Option(help="Standard deviation a coordinate, m.")]
SoftTissue = Annotated[float, typer.Option(help="Multiplies the skin's motion; 0 for none.")]
Occlusions = Annotated[float, typer.Option(help="Multiplies how often markers vanish.")]
Jumps = Annotated[int, typer.Option(help="How often a marker is mistaken for something near.")]
PlateSense = Annotated[Sense, typer.Option(help="Whose force the plate tells.")]
PlateMoved = Annotated[bool, typer.Option(help="Shift and turn the plate.")]
PlateOriginFlipped = Annotated[bool, typer.Option(help="Write ORIGIN with the wrong sign.")]
PlateNoise = Annotated[float, typer.Option(help="Multiplies the usual noise.")]
PlateBias = Annotated[float, typer.Option(help="Multiplies the usual channel bias.")]
ClockOffset = Annotated[float, typer.Option(help="Of the plate against the cameras, s.")]
SeatPlate = Annotated[bool, typer.Option(help="Put the chair on a plate of its own.")]
ChairMass = Annotated[float, typer.Option(help="Of the chair on its plate, kg.")]
Attempts = Annotated[int, typer.Option(help="Rises that are broken off before the last ones.")]
Hold = Annotated[float, typer.Option(help="Stop of the last rise half-way, s.")]
Rail = Annotated[float, typer.Option(help="Share of the weight on a rail while rising.")]

PeopleText = Annotated[
    str,
    typer.Option(
        metavar="NAME=VALUE,...",
        show_default=False,
        help="What sets the person apart from pinned rigid segments: "
        "hip_gap_mm, lumbar_deg, arm_swing_deg, heel_lift_mm, held_mass_kg.",
    ),
]


def simulating() -> typer.Typer:
    """The commands of ``mocap-id simulate``."""
    app = typer.Typer(
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        help="Make recordings whose exact truth is known.",
    )
    for kind in get_args(Kind):
        app.command(kind)(trial_command(kind))
    app.command("robot-set")(robot_set)
    app.command("cohort")(cohort)
    return app


def trial_command(kind: Kind) -> Callable[..., None]:
    """The command of one kind of trial."""

    def command(
        folder: Folder,
        *,
        seed: Seed = Options.seed,
        repetitions: Repetitions = Options.repetitions,
        strategy: Annotated[Strategy, typer.Option(help="How the person rises.")] = Options.strategy,
        rate: Rate = Options.rate,
        analog_rate: AnalogRate = Options.analog_rate,
        marker_noise: MarkerNoise = Options.marker_noise,
        soft_tissue: SoftTissue = Options.soft_tissue,
        occlusions: Occlusions = Options.occlusions,
        jumps: Jumps = Options.jumps,
        plate_sense: PlateSense = Options.plate_sense,
        plate_moved: PlateMoved = Options.plate_moved,
        plate_origin_flipped: PlateOriginFlipped = Options.plate_origin_flipped,
        plate_noise: PlateNoise = Options.plate_noise,
        plate_bias: PlateBias = Options.plate_bias,
        clock_offset: ClockOffset = Options.clock_offset,
        seat_plate: SeatPlate = Options.seat_plate,
        chair_mass: ChairMass = Options.chair_mass,
        attempts: Attempts = Options.attempts,
        hold: Hold = Options.hold,
        rail: Rail = Options.rail,
        people: PeopleText = "",
        joint: Annotated[JointName | None, typer.Option(help="Of the thesis's robot; any robot without.")] = None,
        speed: Annotated[Speed, typer.Option(help="Of that joint: 0.25 or 0.5 Hz.")] = Options.speed,
        orientation: Annotated[float, typer.Option(help="Yaw of that robot, degrees.")] = Options.orientation,
    ) -> None:
        """Make a recording with exact truth beside it and a trial.yaml that is ready to run."""
        options = Options(
            seed=seed,
            repetitions=repetitions,
            strategy=strategy,
            rate=rate,
            analog_rate=analog_rate,
            marker_noise=marker_noise,
            soft_tissue=soft_tissue,
            occlusions=occlusions,
            jumps=jumps,
            plate_sense=plate_sense,
            plate_moved=plate_moved,
            plate_origin_flipped=plate_origin_flipped,
            plate_noise=plate_noise,
            plate_bias=plate_bias,
            clock_offset=clock_offset,
            seat_plate=seat_plate,
            chair_mass=chair_mass,
            attempts=attempts,
            hold=hold,
            rail=rail,
            joint=joint,
            speed=speed,
            orientation=orientation,
        )
        typer.echo(simulation.simulate(kind, folder, replace(options, people=read_people(people))))

    return command


def robot_set(
    folder: Folder,
    *,
    repeats: Annotated[int, typer.Option(help="Trials of each joint, speed and orientation.")] = RobotSet.repeats,
    seed: Annotated[int, typer.Option(help="Of all markers and errors.")] = 1,
    repetitions: Annotated[int, typer.Option(help="Swings a trial.")] = Options.repetitions,
    rate: Rate = 480.0,
    analog_rate: AnalogRate = 2400.0,
    marker_noise: MarkerNoise = Options.marker_noise,
    occlusions: Occlusions = Options.occlusions,
    plate_noise: PlateNoise = Options.plate_noise,
    plate_bias: PlateBias = Options.plate_bias,
    clock_offset: ClockOffset = Options.clock_offset,
) -> None:
    """Make the thesis's robot study, each joint at two speeds in two orientations, with a robot-study.yaml."""
    options = Options(
        seed=seed,
        repetitions=repetitions,
        rate=rate,
        analog_rate=analog_rate,
        marker_noise=marker_noise,
        occlusions=occlusions,
        plate_noise=plate_noise,
        plate_bias=plate_bias,
        clock_offset=clock_offset,
    )
    typer.echo(simulation.simulate_set(folder, RobotSet(repeats, options=options)))


def cohort(
    folder: Folder,
    *,
    subjects: Annotated[int, typer.Option(help="Persons, women and men in turn.")] = Cohort.subjects,
    strategies: Annotated[str, typer.Option(help="How they rise, with commas.")] = ",".join(Cohort.strategies),
    trials: Annotated[int, typer.Option(help="Of each person and strategy.")] = Cohort.trials,
    repetitions: Annotated[int, typer.Option(help="Sit-to-stands a trial.")] = Options.repetitions,
    seed: Annotated[int, typer.Option(help="Of all bodies, motions and errors.")] = 1,
    rate: Rate = Options.rate,
    analog_rate: AnalogRate = Options.analog_rate,
    marker_noise: MarkerNoise = Options.marker_noise,
    soft_tissue: SoftTissue = Options.soft_tissue,
    occlusions: Occlusions = Options.occlusions,
    jumps: Jumps = Options.jumps,
    plate_noise: PlateNoise = Options.plate_noise,
    plate_bias: PlateBias = Options.plate_bias,
    clock_offset: ClockOffset = Options.clock_offset,
    seat_plate: SeatPlate = Options.seat_plate,
    people: PeopleText = "",
) -> None:
    """Make the recordings of several persons with their exact truth and a study.yaml that is ready to run."""
    options = Options(
        seed=seed,
        repetitions=repetitions,
        rate=rate,
        analog_rate=analog_rate,
        marker_noise=marker_noise,
        soft_tissue=soft_tissue,
        occlusions=occlusions,
        jumps=jumps,
        plate_noise=plate_noise,
        plate_bias=plate_bias,
        clock_offset=clock_offset,
        seat_plate=seat_plate,
        people=read_people(people),
    )
    names = tuple(cast(Strategy, name.strip()) for name in strategies.split(","))
    typer.echo(simulation.simulate_cohort(folder, Cohort(subjects, names, trials, options)))
