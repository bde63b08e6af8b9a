"""``mocap-id pneumatic``: a pneumatic cylinder, described in a file, as a spring."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from mocap_id.arrays import NORMAL_95
from mocap_id.config.device import load_device
from mocap_id.errors import ConfigError
from mocap_id.stages.device import Condition
from mocap_id.workflows.run_folder import describe_sources
from mocap_id_assist import pneumatic as workflow
from mocap_id_cli.console import AsJson, align, make_group, print_json

Device = Annotated[
    Path,
    typer.Argument(metavar="DEVICE.yaml", help="The device's description (docs/assist.md).", show_default=False),
]
_Pressure = Annotated[float | None, typer.Option(metavar="PA", help="Sealed absolute pressure.", show_default=False)]
_ROWS = 7


def commands() -> typer.Typer:
    """Return the commands of ``mocap-id pneumatic``."""
    text = "Describe a pneumatic spring, and choose its pressures."
    return make_group(text, curve=_curve, pressures=_pressures, identify=_identify, budget=_budget)


def _curve(
    device: Device,
    *,
    condition: Annotated[
        str | None, typer.Option(help="Name of a condition in the file; default: `sealed:`.", show_default=False)
    ] = None,
    flexion: _Pressure = None,
    extension: _Pressure = None,
    polytropic: Annotated[
        float | None, typer.Option(help="Polytropic exponent, 1 (slow) to 1.4 (fast).", show_default=False)
    ] = None,
    angles: Annotated[int, typer.Option(min=2, max=100_000, help="Number of angles.")] = 181,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for JSON and a figure.", show_default=False)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compute torque and stiffness over the stroke, and rest angle."""
    config = load_device(device)
    state = config.condition(condition)
    given = {"flexion_Pa": flexion, "extension_Pa": extension}
    changed = {name: pressure for name, pressure in given.items() if pressure is not None}
    if changed:
        if not all(0 < pressure < math.inf for pressure in changed.values()):
            raise ConfigError(f"--flexion and --extension: expected pressures above 0 Pa, not {changed}")
        state = Condition(**(state.model_dump() | changed | {"worn": True}))
    found = workflow.device_curve(config, state, polytropic, angles)
    if out is not None:
        found = replace(found, made_from=describe_sources(out, device))
    files = () if out is None else found.write(out)
    if as_json:
        print_json(found.document)
        return
    curve = found.content
    shown = range(0, angles, max(1, (angles - 1) // (_ROWS - 1)))
    rows = [["angle", "torque", "± 95 %", "stiffness"], *(_sample(curve, k) for k in shown)]
    typer.echo("\n".join(align(rows, numbers=True)))
    rest = curve["rest_angle_rad"]
    typer.echo(curve["why"] if rest is None else f"rest angle: {math.degrees(rest):.1f}°")
    if files:
        typer.echo(f"written to {out}: {', '.join(files)}")


def _sample(curve: Mapping[str, Any], k: int) -> list[str]:
    return [
        f"{math.degrees(curve['angle_rad'][k]):.1f}°",
        f"{curve['torque_Nm'][k]:.2f} N·m",
        f"{NORMAL_95 * curve['sd_torque_Nm'][k]:.2f} N·m",
        f"{curve['stiffness_Nm_rad'][k]:.2f} N·m/rad",
    ]


def _pressures(
    device: Device,
    *,
    stiffness: Annotated[float, typer.Option(metavar="N·m/rad", help="Desired stiffness.", show_default=False)],
    rest_angle: Annotated[float, typer.Option(metavar="RAD", help="Desired rest angle.", show_default=False)],
    span: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--range",
            metavar="LOW HIGH",
            help="Range in which the torques should agree, rad; default: only at the rest angle.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the two pressures that come nearest to a desired spring."""
    found = workflow.spring_pressures(load_device(device), stiffness, rest_angle, span)
    if as_json:
        print_json(found)
        return
    achieved = found["achieved"]
    typer.echo(f"flexion side {found['flexion_Pa']:.0f} Pa, extension side {found['extension_Pa']:.0f} Pa (absolute)")
    if achieved["rest_angle_rad"] is None:
        typer.echo("the torque is not zero at any angle of the stroke")
    else:
        rest = math.degrees(achieved["rest_angle_rad"])
        typer.echo(f"this gives {achieved['stiffness_Nm_rad']:.4g} N·m/rad at {rest:.1f}°")
    low, high = (math.degrees(end) for end in achieved["range_rad"])
    error = achieved["largest_torque_error_Nm"]
    difference = f"the torque differs from that of the linear spring by up to {error:.2f} N·m"
    typer.echo(f"from {low:.1f}° to {high:.1f}° {difference}")
    if found["why"]:
        typer.echo(f"the desired spring is not attainable, this is the nearest one: {found['why']}")


def _identify(
    device: Device,
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="CSV file of angle and torque, or a trial's YAML file or run folder.",
            show_default=False,
        ),
    ],
    *,
    joint: Annotated[int, typer.Option(min=1, help="Number of the joint, for a trial in the plane.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Estimate the parameters of a cylinder from angles and torques."""
    found = workflow.identify_device(load_device(device), log, joint)
    if as_json:
        print_json(found)
        return
    rows = [["parameter", "estimate", "95 % interval", "described"], *map(_row, found["parameters"])]
    typer.echo("\n".join(align(rows)))
    left_out = f", {found['left_out']} samples with empty cells are left out" if found["left_out"] else ""
    typer.echo(f"residual {found['residual_Nm']:.3f} N·m over {found['samples']} samples{left_out}")
    for caution in found["cautions"]:
        typer.echo(f"caution: {caution}")


def _row(parameter: dict[str, Any]) -> list[str]:
    described = f"{parameter['described']:.4g}"
    if parameter["value"] is None:
        return [parameter["name"], "–", parameter["why"], described]
    low, high = parameter["interval"]
    return [parameter["name"], f"{parameter['value']:.4g}", f"{low:.4g} to {high:.4g}", described]


def _budget(device: Device, *, as_json: AsJson = False) -> None:
    """Compute the gas for every change between two conditions."""
    found = workflow.gas_budget(load_device(device))
    if as_json:
        print_json(found)
        return
    rows = [["from", "to", "gas", "at 0 °C and 1 atm", "changes"]]
    for change in found["changes"]:
        times = "–" if change["changes_per_reservoir"] is None else str(change["changes_per_reservoir"])
        litres = f"{change['normal_litres']:.3f} l"
        rows.append([change["from"], change["to"], f"{change['gas_g']:.3f} g", litres, times])
    typer.echo("\n".join(align(rows)))
