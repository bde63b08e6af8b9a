"""``mocap-id transfer``: application of the body of one trial to other trials."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.dynamics.comparison import Agreement
from mocap_id.workflows import transfer as workflow
from mocap_id.workflows.run_folder import find_owner_of_files
from mocap_id_cli import progress
from mocap_id_cli.console import AsJson, Quiet, Verbose, align, log_to_stderr, print_result

_VERDICTS = {
    True: "verdict: the transfer is supported: the transferred body differs significantly from the allometric body and "
    "predicts the forces better",
    False: "verdict: these recordings do not support the transfer, for the reasons above: the allometric body is not "
    "worse",
    None: "verdict: nothing contradicts the transfer, but without forces or an allometric body it cannot be confirmed",
}
_UNITS = {"Fx": ("N", 1.0), "Fy": ("N", 1.0), "tauz": ("N·m", 1.0), "cop_x": ("mm", 1e3)}


def transfer(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="Trial that provides the body: YAML file or run folder.", show_default=False
        ),
    ],
    trials: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRIAL...",
            help="Trials of the same person to predict: YAML files or run folders.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table to this file, .csv or .parquet.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Apply the body identified from one trial to other trials.

    All trials must be of the same person. If a trial is given as a YAML file, missing or outdated results are computed
    first; a run folder is read unchanged.
    """
    log_to_stderr(quiet, verbose)
    if out is not None:
        workflow.check_format(out)
    result = workflow.transfer(model, trials, progress.report_stages(quiet))
    if out is not None:
        workflow.write(result, out, find_owner_of_files(model, *trials))
    print_result(as_json, workflow.as_json(result), _lines(result))


def _lines(result: workflow.Transfer) -> Iterator[str]:
    yield f"model of {result.model}; errors are model minus measurement: mean ± sd (rms)"
    for trial in result.trials:
        condition = "unknown" if trial.condition is None else f"{trial.condition:.0f}"
        yield f"\n{trial.trial}: {trial.samples} samples, condition number {condition}"
        yield from align([["", *(body.name for body in trial.bodies)], *_rows(trial)], numbers=True)
        yield from _intervals(trial)
        yield from (f"  {reason.code}: {reason.message}" for reason in trial.reasons)
        yield _VERDICTS[trial.supported]


def _intervals(trial: workflow.TrialTransfer) -> Iterator[str]:
    """Yield a line with predicted sd and fraction of samples in the 95 % intervals, if forces were measured."""
    known = {name: share for name, share in trial.inside.items() if math.isfinite(share)}
    if known:
        text = ", ".join(
            f"{name} ± {_UNITS[name][1] * trial.stated[name]:.1f} {_UNITS[name][0]}: {100 * share:.0f} %"
            for name, share in known.items()
        )
        yield f"transferred body, predicted sd and percentage of the samples in the 95 % interval: {text}"


def _rows(trial: workflow.TrialTransfer) -> Iterator[list[str]]:
    for name, (unit, factor) in _UNITS.items():
        yield [f"{name} ({unit})", *(_format_error(body.errors.get(name), factor) for body in trial.bodies)]
    for j in range(max(len(body.torques) for body in trial.bodies)):
        values = (_format_mean_sd(body.torques[j]) if body.torques else "" for body in trial.bodies)
        yield [f"tau_{j + 1} minus own (N·m)", *values]


def _format_error(error: Agreement | None, factor: float) -> str:
    return "–" if error is None else f"{_format_mean_sd(error, factor)} ({factor * workflow.rms_error(error):.1f})"


def _format_mean_sd(error: Agreement | None, factor: float = 1.0) -> str:
    return "–" if error is None else f"{factor * error.bias:.1f} ± {factor * error.sd:.1f}"
