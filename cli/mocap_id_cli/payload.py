"""``mocap-id payload``: the inertial parameters of what a robot carries."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.workflows.payload import PARAMETERS, UNITS, FoundPayload, find_payload
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, align, log_to_stderr, print_result


def payload(
    loaded: Annotated[
        Path,
        typer.Argument(metavar="LOADED", help="Trial with the payload: YAML file or run folder.", show_default=False),
    ],
    empty: Annotated[
        Path,
        typer.Argument(metavar="EMPTY", help="Trial without the payload: YAML file or run folder.", show_default=False),
    ],
    *,
    segment: Annotated[
        str | None, typer.Option(metavar="NAME", help="Segment that carries the payload; default: the last.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Identify what a robot carries from two trials in space.

    The trial with the payload must take its chain from the other trial (`calibration:`), and plate and robot must not
    be moved between the trials. If a trial is given as a YAML file, missing or outdated results are computed first; a
    run folder is read unchanged.
    """
    log_to_stderr(quiet, verbose)
    found = find_payload(loaded, empty, segment, progress.report_stages(quiet))
    print_result(as_json, found.as_json(), _lines(found))


def _lines(found: FoundPayload) -> Iterator[str]:
    yield f"payload of {found.segment}: {found.loaded} minus {found.empty}; value ± standard deviation"
    yield "values are in the frame of the segment; moments of inertia are about its origin (the joint)"
    rows = zip(PARAMETERS, found.payload.value, found.payload.sd, UNITS, strict=True)
    yield from align([[name, _format_value(value, sd), unit] for name, value, sd, unit in rows])
    place, sd = found.payload.centre()
    shown = ", ".join(_format_value(1e3 * a, 1e3 * b) for a, b in zip(place, sd, strict=True))
    yield f"centre of mass: {shown} mm"
    if found.negative:
        yield "caution: the mass is negative: probably the trials are exchanged, give the trial with the payload first"
    yield from (f"cautions of {trial}: {', '.join(codes)}" for trial, codes in found.cautions.items() if codes)


def _format_value(value: float, sd: float) -> str:
    """Return a value with its standard deviation, both rounded to the second digit of the standard deviation."""
    if not math.isfinite(value):
        return "not determined"
    digits = max(0, 1 - math.floor(math.log10(max(sd, 1e-9))))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"
