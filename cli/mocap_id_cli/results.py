"""Commands on finished runs: ``compare``, ``transfer``, ``payload``, ``export`` and ``figures``.

If a trial is given as a YAML file, missing or outdated results are computed first; a run folder is read unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from mocap_id import workflows
from mocap_id.reporting import PdfFonts
from mocap_id_cli.console import Output, Quiet, TrialPath, Verbose, align, common_options, log_to_stderr, shorten

if TYPE_CHECKING:
    from mocap_id.dynamics.prediction import Agreement

_LONGEST = 40  # characters of a text in the table of `compare`
_VERDICTS = {
    True: "verdict: the transfer is supported: the transferred body differs significantly from the allometric body and "
    "predicts the forces better",
    False: "verdict: these recordings do not support the transfer, for the reasons above: the allometric body is not "
    "worse",
    None: "verdict: nothing contradicts the transfer, but without forces or an allometric body it cannot be confirmed",
}
_UNITS = {"Fx": ("N", 1.0), "Fy": ("N", 1.0), "tauz": ("N·m", 1.0), "cop_x": ("mm", 1e3)}


@common_options
def compare(
    a: Annotated[Path, Argument(metavar="A", help="A trial's YAML file or run folder.")],
    b: Annotated[Path, Argument(metavar="B", help="The other run: YAML file or run folder.")],
    *,
    out: Annotated[Path | None, Option(metavar="FILE", help="Write the table to this file, .csv.")] = None,
    everything: Annotated[bool, Option("--all", help="Also show equal values.")] = False,
    output: Output,
) -> None:
    """Compare two runs: show what changed, and by how much.

    If A or B is a YAML file, missing or outdated results are computed first; a run folder is read unchanged.
    """
    if out is not None:
        workflows.run_folder.check_ending(out, ".csv")
    comparison = workflows.regress.compare_runs(a, b, output.report_stage)
    rows = comparison.rows if everything else comparison.changed
    if out is not None:
        content = workflows.regress.format_rows(rows)
        workflows.run_folder.write_owned(out.parent, {out.name: content}, out.name, a, b)
    output.print_result(comparison.as_json(rows), _describe_comparison(comparison, rows))


def _describe_comparison(
    comparison: workflows.regress.RunComparison, rows: tuple[workflows.regress.Difference, ...]
) -> Iterator[str]:
    for letter, run in (("A", comparison.a), ("B", comparison.b)):
        yield f"{letter}: {run.name} ({run.source})"
    if comparison.identical:
        yield "identical: all artefacts have the same content"
    for section, group in groupby(rows, key=lambda row: row.section):
        members = list(group)
        unit = "rms in A, in B, and of B - A" if section == "series" else "A, B, B - A, of A, in combined sd"
        yield f"\n{section}" + (f" ({unit})" if any(row.difference is not None for row in members) else "")
        sign = "" if section == "series" else "+"
        cells = [
            [
                f"  {row.name} ({row.unit})" if row.unit else f"  {row.name}",
                _format_value(row.a),
                _format_value(row.b),
                "" if row.difference is None else f"{row.difference:{sign}.4g}",
                "" if row.percent is None else f"{row.percent:+.2f} %",
                "" if row.in_sd is None else f"{row.in_sd:+.1f} sd",
            ]
            for row in members
        ]
        yield from align(cells, numbers=True)


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


@common_options
def transfer(
    model: Annotated[Path, Argument(metavar="MODEL", help="Trial that provides the body: YAML file or run folder.")],
    trials: Annotated[
        list[Path],
        Argument(metavar="TRIAL...", help="Trials of the same person to predict: YAML files or run folders."),
    ],
    *,
    out: Annotated[Path | None, Option(metavar="FILE", help="Write the table to this file, .csv or .parquet.")] = None,
    output: Output,
) -> None:
    """Apply the body identified from one trial to other trials.

    All trials must be of the same person. If a trial is given as a YAML file, missing or outdated results are computed
    first; a run folder is read unchanged.
    """
    if out is not None:
        workflows.run_folder.check_ending(out, ".csv", ".parquet")
    result = workflows.transfer.transfer_model(model, trials, output.report_stage)
    if out is not None:
        content = result.format_table(out.suffix.lower())
        workflows.run_folder.write_owned(out.parent, {out.name: content}, out.name, model, *trials)
    output.print_result(result.as_json(), _describe_transfer(result))


def _describe_transfer(result: workflows.transfer.Transfer) -> Iterator[str]:
    yield f"model of {result.model}; errors are model minus measurement: mean ± sd (rms)"
    for trial in result.trials:
        condition = "unknown" if trial.condition is None else f"{trial.condition:.0f}"
        yield f"\n{trial.trial}: {trial.samples} samples, condition number {condition}"
        rows = [["", *(body.name for body in trial.bodies)]]
        for name, (unit, factor) in _UNITS.items():
            rows.append([f"{name} ({unit})", *(_format_error(body.errors.get(name), factor) for body in trial.bodies)])
        for j in range(max(len(body.torques) for body in trial.bodies)):
            values = (_format_mean_sd(body.torques[j]) if body.torques else "" for body in trial.bodies)
            rows.append([f"tau_{j + 1} minus own (N·m)", *values])
        yield from align(rows, numbers=True)
        if text := ", ".join(  # only if forces were measured
            f"{name} ± {_UNITS[name][1] * trial.stated[name]:.1f} {_UNITS[name][0]}: {100 * share:.0f} %"
            for name, share in trial.inside.items()
            if math.isfinite(share)
        ):
            yield f"transferred body, predicted sd and percentage of the samples in the 95 % interval: {text}"
        yield from (f"  {reason.code}: {reason.message}" for reason in trial.reasons)
        yield _VERDICTS[trial.supported]


def _format_error(error: Agreement | None, factor: float) -> str:
    if error is None:
        return "–"
    return f"{_format_mean_sd(error, factor)} ({factor * workflows.transfer.rms_error(error):.1f})"


def _format_mean_sd(error: Agreement | None, factor: float = 1.0) -> str:
    return "–" if error is None else f"{factor * error.bias:.1f} ± {factor * error.sd:.1f}"


@common_options
def payload(
    loaded: Annotated[Path, Argument(metavar="LOADED", help="Trial with the payload: YAML file or run folder.")],
    empty: Annotated[Path, Argument(metavar="EMPTY", help="Trial without the payload: YAML file or run folder.")],
    *,
    segment: Annotated[
        str | None, Option(metavar="NAME", help="Segment that carries the payload; default: the last.")
    ] = None,
    output: Output,
) -> None:
    """Identify what a robot carries from two trials in space.

    The trial with the payload must take its chain from the other trial (`calibration:`), and plate and robot must not
    be moved between the trials. If a trial is given as a YAML file, missing or outdated results are computed first; a
    run folder is read unchanged.
    """
    found = workflows.transfer.find_payload(loaded, empty, segment, output.report_stage)
    output.print_result(found.as_json(), _describe_payload(found))


def _describe_payload(found: workflows.transfer.FoundPayload) -> Iterator[str]:
    yield f"payload of {found.segment}: {found.loaded} minus {found.empty}; value ± standard deviation"
    yield "values are in the frame of the segment; moments of inertia are about its origin (the joint)"
    names, units = workflows.transfer.PARAMETERS, workflows.transfer.UNITS
    rows = zip(names, found.payload.value, found.payload.sd, units, strict=True)
    yield from align([[name, _format_with_sd(value, sd), unit] for name, value, sd, unit in rows])
    place, sd = found.payload.centre()
    shown = ", ".join(_format_with_sd(1e3 * a, 1e3 * b) for a, b in zip(place, sd, strict=True))
    yield f"centre of mass: {shown} mm"
    if found.negative:
        yield "caution: the mass is negative: probably the trials are exchanged, give the trial with the payload first"
    yield from (f"cautions of {trial}: {', '.join(codes)}" for trial, codes in found.cautions.items() if codes)


def _format_with_sd(value: float, sd: float) -> str:
    """Return a value with its standard deviation, both rounded to the second digit of the standard deviation."""
    if not math.isfinite(value):
        return "not determined"
    digits = max(0, 1 - math.floor(math.log10(max(sd, 1e-9))))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def export(
    trial: TrialPath,
    *,
    to: Annotated[list[str], Option("--to", metavar="FORMAT", help="trc, mot, sto, csv, osim, ktk (repeatable).")],
    out: Annotated[
        Path | None, Option(metavar="FOLDER", help="Output folder; default: `export` in the run folder.")
    ] = None,
    force: Annotated[bool, Option("--force", help="Overwrite existing files.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Write a run as OpenSim files or as tables.

    The formats trc, mot, sto and osim are for OpenSim, csv for tables, ktk for Kinetics Toolkit. If TRIAL is a YAML
    file, missing or outdated results are computed first; a run folder is read unchanged.
    """
    log_to_stderr(quiet, verbose)
    output = Output(quiet=quiet)
    formats = [name.strip() for each in to for name in each.split(",")]
    result = workflows.export.export_run(trial, formats, out, force=force, progress=output.report_stage)
    for file in result.files:
        typer.echo(shorten(file))
    for note in result.notes:
        output.say(f"note: {note}")


def figures(
    run: Annotated[Path, Argument(metavar="RUN", help="Folder of a trial or study, or its page.")],
    *,
    out: Annotated[
        Path | None,
        Option(
            metavar="FOLDER", help="Folder in which the folder `figures` is created; default: the folder of the page."
        ),
    ] = None,
    pdf_fonts: Annotated[
        PdfFonts, Option(help="Fonts in the PDF: type-3, or truetype, which some journals require.")
    ] = "type-3",
) -> None:
    """Draw the figures of a page as SVG and PDF files.

    The figures, captions and data are read from the page; nothing is computed again.
    """
    for file in workflows.figures.write_figures(run, out, pdf_fonts):
        typer.echo(shorten(file))
