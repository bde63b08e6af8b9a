"""``mocap-id inspect``: the content of a recording, as text or JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.table import Table
from typer import Argument, Option

from mocap_id.recording.c3d_package import compare_with_package
from mocap_id.workflows.recording_trial import describe_recording, read_content
from mocap_id_cli.console import AsJson, print_json


def inspect(
    file: Annotated[
        Path, Argument(metavar="FILE", help="C3D or TRC file, a QTM, Motive or Nexus export, or a skeleton.")
    ],
    *,
    forces: Annotated[
        Path | None,
        Option(
            metavar="MOT", help="MOT file with the ground forces; default: the MOT file of the same name beside it."
        ),
    ] = None,
    units: Annotated[str | None, Option(help="Length unit, if the file does not declare it.")] = None,
    vertical: Annotated[str | None, Option(help="Axis that points up, such as Z or -Y; detected if omitted.")] = None,
    force_unit: Annotated[str | None, Option(help="Unit of the plates' forces, such as N or lbf.")] = None,
    moment_unit: Annotated[str | None, Option(help="Unit of the plates' moments, such as Nmm.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print what a recording contains.

    These are markers, rates, gaps, force plates and irregularities of the file.
    """
    found = describe_recording(
        read_content(file, forces, units=units, vertical=vertical, force_unit=force_unit, moment_unit=moment_unit)
    )
    if found["format"].startswith("C3D"):
        found["oddities"] += compare_with_package(file)
    if as_json:
        print_json(found)
        return
    console = Console(highlight=False, soft_wrap=True)
    overview = Table.grid(padding=(0, 2))
    for name, value in _rows(found):
        overview.add_row(name, value)
    console.print(overview)
    if found["plates"]:
        table = Table("plate", "type", "mean upward force", "as a mass", "problem")
        for plate in found["plates"]:
            force, mass = plate["mean_fz_N"], plate["mass_kg"]
            newtons, kilograms = "–" if force is None else f"{force:.1f} N", "–" if mass is None else f"{mass:.1f} kg"
            table.add_row(str(plate["index"]), str(plate["type"]), newtons, kilograms, plate["problem"] or "")
        console.print(table)
    console.print("markers: " + ", ".join(found["markers"]), markup=False)
    for oddity in found["oddities"]:
        console.print(f"note: {oddity}", markup=False)


def _rows(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    yield "file", str(found["file"])
    yield "format", str(found["format"])
    yield "frames", f"{found['frames']} from number {found['first_frame']}, {found['duration_s']:.2f} s"
    yield "rate", f"{found['rate_hz']:g} Hz"
    yield "markers", f"{len(found['markers'])}, {100 * found['missing_fraction']:.1f} % of the samples missing"
    yield "units", f"{found['units'] or 'not declared'}, {found['vertical']} up"
    analog = found["analog_rate_hz"]
    yield "analog", "none" if analog is None else f"{analog:g} Hz"
    mass = found["mass_kg"]
    yield "mass", "no plate" if mass is None else f"{mass:.1f} kg, mean load of the plates"
