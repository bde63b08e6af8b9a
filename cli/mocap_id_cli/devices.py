"""``mocap-id prescribe``, ``pneumatic`` and ``workspace``: devices for a measured person, and what an arm reaches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from mocap_id.arrays import NORMAL_95
from mocap_id.config.device import load_device
from mocap_id.errors import ConfigError, Refused
from mocap_id.stages.device import Condition
from mocap_id.workflows.run_folder import write_result
from mocap_id_assist import pneumatic as cylinders
from mocap_id_assist import workspaces
from mocap_id_assist.workspace import ReachableWorkspace
from mocap_id_cli.console import AsJson, Output, align, common_options, make_group


@common_options
def prescribe(
    config: Annotated[
        Path, Argument(metavar="CONFIG.yaml", help="The prescription's configuration (docs/prescribe.md).")
    ],
    *,
    out: Annotated[
        Path | None,
        Option(
            metavar="FOLDER",
            help="Folder for JSON, tables and figures; with the same folder, an interrupted search is continued.",
        ),
    ] = None,
    output: Output,
) -> None:
    """Find springs that let a weak person hold a wider range.

    The range is that of one joint or of a whole chain.
    """
    # these load numba, which the other commands of this module do not need
    from mocap_id_assist.files import load_prescription  # noqa: PLC0415
    from mocap_id_assist.prescription_output import prescription_lines, prescription_output  # noqa: PLC0415
    from mocap_id_assist.prescriptions import prescribe_from  # noqa: PLC0415

    found = prescribe_from(load_prescription(config), out, output.report_stage, output.say)
    result, written = write_result(prescription_output(found), out, config)
    output.print_result(result.document, chain(prescription_lines(found), written))
    if found.refused is not None:
        raise typer.Exit(Refused.exit_code)


Device = Annotated[Path, Argument(metavar="DEVICE.yaml", help="The device's description (docs/assist.md).")]
_Pressure = Annotated[float | None, Option(metavar="PA", help="Sealed absolute pressure.")]
_ROWS = 7  # of the printed curve
_COLUMNS = ("angle_rad", "torque_Nm", "sd_torque_Nm", "stiffness_Nm_rad")


def _curve(
    device: Device,
    *,
    condition: Annotated[str | None, Option(help="Name of a condition in the file; default: `sealed:`.")] = None,
    flexion: _Pressure = None,
    extension: _Pressure = None,
    polytropic: Annotated[float | None, Option(help="Polytropic exponent, 1 (slow) to 1.4 (fast).")] = None,
    angles: Annotated[int, Option(min=2, max=100_000, help="Number of angles.")] = 181,
    out: Annotated[Path | None, Option(metavar="FOLDER", help="Folder for JSON and a figure.")] = None,
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
    found, written = write_result(cylinders.device_curve(config, state, polytropic, angles), out, device)
    Output(as_json).print_result(found.document, chain(_describe_curve(found.content), written))


def _describe_curve(curve: Mapping[str, Any]) -> Iterator[str]:
    count = len(curve["angle_rad"])
    rows = [["angle", "torque", "± 95 %", "stiffness"]]
    for k in range(0, count, max(1, (count - 1) // (_ROWS - 1))):
        angle, torque, sd, stiffness = (curve[name][k] for name in _COLUMNS)
        torques = [f"{torque:.2f} N·m", f"{NORMAL_95 * sd:.2f} N·m"]
        rows.append([f"{math.degrees(angle):.1f}°", *torques, f"{stiffness:.2f} N·m/rad"])
    yield from align(rows, numbers=True)
    rest = curve["rest_angle_rad"]
    yield curve["why"] if rest is None else f"rest angle: {math.degrees(rest):.1f}°"


def _pressures(
    device: Device,
    *,
    stiffness: Annotated[float, Option(metavar="N·m/rad", help="Desired stiffness.")],
    rest_angle: Annotated[float, Option(metavar="RAD", help="Desired rest angle.")],
    span: Annotated[
        tuple[float, float] | None,
        Option(
            "--range",
            metavar="LOW HIGH",
            help="Range in which the torques should agree, rad; default: only at the rest angle.",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the two pressures that come nearest to a desired spring."""
    found = cylinders.spring_pressures(load_device(device), stiffness, rest_angle, span)
    Output(as_json).print_result(found, _describe_pressures(found))


def _describe_pressures(found: Mapping[str, Any]) -> Iterator[str]:
    achieved = found["achieved"]
    yield f"flexion side {found['flexion_Pa']:.0f} Pa, extension side {found['extension_Pa']:.0f} Pa (absolute)"
    if achieved["rest_angle_rad"] is None:
        yield "the torque is not zero at any angle of the stroke"
    else:
        rest = math.degrees(achieved["rest_angle_rad"])
        yield f"this gives {achieved['stiffness_Nm_rad']:.4g} N·m/rad at {rest:.1f}°"
    low, high = (math.degrees(end) for end in achieved["range_rad"])
    error = achieved["largest_torque_error_Nm"]
    difference = f"the torque differs from that of the linear spring by up to {error:.2f} N·m"
    yield f"from {low:.1f}° to {high:.1f}° {difference}"
    if found["why"]:
        yield f"the desired spring is not attainable, this is the nearest one: {found['why']}"


def _identify(
    device: Device,
    log: Annotated[
        Path, Argument(metavar="LOG", help="CSV file of angle and torque, or a trial's YAML file or run folder.")
    ],
    *,
    joint: Annotated[int, Option(min=1, help="Number of the joint, for a trial in the plane.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Estimate the parameters of a cylinder from angles and torques."""
    found = cylinders.identify_device(load_device(device), log, joint)
    Output(as_json).print_result(found, _describe_parameters(found))


def _describe_parameters(found: Mapping[str, Any]) -> Iterator[str]:
    rows = [["parameter", "estimate", "95 % interval", "described"]]
    for parameter in found["parameters"]:
        estimate = ["–", parameter["why"]]
        if parameter["value"] is not None:
            low, high = parameter["interval"]
            estimate = [f"{parameter['value']:.4g}", f"{low:.4g} to {high:.4g}"]
        rows.append([parameter["name"], *estimate, f"{parameter['described']:.4g}"])
    yield from align(rows)
    left_out = f", {found['left_out']} samples with empty cells are left out" if found["left_out"] else ""
    yield f"residual {found['residual_Nm']:.3f} N·m over {found['samples']} samples{left_out}"
    yield from (f"caution: {caution}" for caution in found["cautions"])


def _budget(device: Device, *, as_json: AsJson = False) -> None:
    """Compute the gas for every change between two conditions."""
    found = cylinders.gas_budget(load_device(device))
    rows = [["from", "to", "gas", "at 0 °C and 1 atm", "changes"]]
    for change in found["changes"]:
        times = "–" if change["changes_per_reservoir"] is None else str(change["changes_per_reservoir"])
        litres = f"{change['normal_litres']:.3f} l"
        rows.append([change["from"], change["to"], f"{change['gas_g']:.3f} g", litres, times])
    Output(as_json).print_result(found, align(rows))


pneumatic = make_group(
    "Describe a pneumatic spring, and choose its pressures.",
    curve=_curve,
    pressures=_pressures,
    identify=_identify,
    budget=_budget,
)


@common_options
def workspace(
    trial: Annotated[
        Path, Argument(metavar="TRIAL", help="A trial's YAML file or run folder, or a chain's YAML file.")
    ],
    *,
    compare: Annotated[Path | None, Option(metavar="TRIAL", help="A later session to compare with the first.")] = None,
    tip: Annotated[
        str | None,
        Option(
            metavar="MARKER", help="Marker of the last segment, or x,y in its frame, m.", show_default="farthest marker"
        ),
    ] = None,
    quantile: Annotated[
        float, Option(help="Fraction of samples that is excluded at each end of an angle's range.")
    ] = 0.0,
    samples: Annotated[int, Option(help="Number of postures to sample.")] = 10_000,
    seed: Annotated[int, Option(help="Seed of the samples.")] = 0,
    out: Annotated[Path | None, Option(metavar="FOLDER", help="Folder for JSON, CSV and figures.")] = None,
    output: Output,
) -> None:
    """Compute what the tip of a chain reaches within its limits.

    The result is an area (in space a volume) for the observed limits of the joints. Forces are not needed. If TRIAL is
    a trial's YAML file, missing or outdated stages up to the joint states are computed first; a run folder is read
    unchanged.
    """
    paths = [trial] if compare is None else [trial, compare]
    subjects = [workspaces.read_arm(path, tip, quantile, output.report_stage) for path in paths]
    reaches = [workspaces.measure_workspace(subject, samples, seed) for subject in subjects]
    later = None
    if compare is not None:
        change = workspaces.compare_workspaces(subjects[0], reaches[0], subjects[1], reaches[1])
        later = subjects[1], reaches[1], change
    result, written = write_result(workspaces.workspace_result(subjects[0], reaches[0], later), out, *paths)
    lines = [line for each in zip(subjects, reaches, strict=True) for line in _lines(*each)]
    if compare is not None:
        unit = "m²" if change.points.shape[1] == 2 else "m³"
        lines.append(
            f"from the first to the second: gained {change.gained:.5f} {unit}, lost {change.lost:.5f}, kept "
            f"{change.kept:.5f}; both are aligned at the first joint"
        )
        lines += [f"  note: {each}" for each in result.content["change"]["notes"]]
    output.print_result(result.document, [*lines, *written])


def _lines(subject: workspaces.SubjectArm, found: ReachableWorkspace) -> Iterator[str]:
    kind, unit = ("area", "m²") if subject.arm.dimension == 2 else ("volume", "m³")
    low, high = found.interval
    yield f"{subject.name}: {kind} {found.measure:.5f} {unit}, 95 % interval {low:.5f} to {high:.5f}; tip {subject.tip}"
    bounds = zip(subject.joints, *np.degrees([subject.limits.lower, subject.limits.upper]), strict=True)
    yield from (f"  {name}: {lower:.1f}° to {upper:.1f}°" for name, lower, upper in bounds)
    steps = ", ".join(f"{value:.5f} with {count}" for count, _, value in found.convergence)
    yield f"  samples: {steps}"
    yield from (f"  note: {note}" for note in subject.notes)
