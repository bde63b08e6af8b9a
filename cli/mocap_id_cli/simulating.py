"""``mocap-id simulate``: a trial whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mocap_id.workflows import simulate as simulation
from mocap_id.workflows.simulate import Kind, Options, Strategy
from mocap_id.workflows.simulate.plate import Sense


def simulate(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help="sit-to-stand or robot.", show_default=False)],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A new folder.", show_default=False)],
    *,
    seed: Annotated[int, typer.Option(help="Of the body, its motion and every error.")] = Options.seed,
    repetitions: Annotated[int, typer.Option(help="Sit-to-stands, or swings of the robot.")] = Options.repetitions,
    strategy: Annotated[Strategy, typer.Option(help="How the person rises.")] = Options.strategy,
    rate: Annotated[float, typer.Option(help="Frames a second, Hz.")] = Options.rate,
    analog_rate: Annotated[float, typer.Option(help="Analog samples a second, Hz.")] = Options.analog_rate,
    marker_noise: Annotated[float, typer.Option(help="Standard deviation a coordinate, m.")] = Options.marker_noise,
    soft_tissue: Annotated[float, typer.Option(help="Multiplies the skin's motion; 0 for none.")] = Options.soft_tissue,
    occlusions: Annotated[float, typer.Option(help="Multiplies how often markers vanish.")] = Options.occlusions,
    jumps: Annotated[int, typer.Option(help="How often a marker is mistaken for something near.")] = Options.jumps,
    plate_sense: Annotated[Sense, typer.Option(help="Whose force the plate tells.")] = Options.plate_sense,
    plate_moved: Annotated[bool, typer.Option(help="Shift and turn the plate.")] = Options.plate_moved,
    plate_origin_flipped: Annotated[
        bool, typer.Option(help="Write ORIGIN with the wrong sign.")
    ] = Options.plate_origin_flipped,
    plate_noise: Annotated[float, typer.Option(help="Multiplies the usual noise.")] = Options.plate_noise,
    plate_bias: Annotated[float, typer.Option(help="Multiplies the usual channel bias.")] = Options.plate_bias,
    clock_offset: Annotated[float, typer.Option(help="Of the plate against the cameras, s.")] = Options.clock_offset,
    seat_plate: Annotated[bool, typer.Option(help="Put the chair on a plate of its own.")] = Options.seat_plate,
    chair_mass: Annotated[float, typer.Option(help="Of the chair on its plate, kg.")] = Options.chair_mass,
    attempts: Annotated[int, typer.Option(help="Rises that are broken off before the last ones.")] = Options.attempts,
    hold: Annotated[float, typer.Option(help="Stop of the last rise half-way, s.")] = Options.hold,
    rail: Annotated[float, typer.Option(help="Share of the weight on a rail while rising.")] = Options.rail,
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
    )
    typer.echo(simulation.simulate(kind, folder, options))
