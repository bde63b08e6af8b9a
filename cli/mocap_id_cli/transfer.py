"""``mocap-id transfer``: the model of one trial on others, as a table."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from mocap_id.dynamics.predict import Agreement
from mocap_id.workflows import transfer as workflow
from mocap_id.workflows import transfer_table
from mocap_id_cli.run import Quiet, Verbose, log_to_stderr, progress

_VERDICTS = {
    True: "verdict: supported; the carried body was told from the table's beforehand and is closer to the forces",
    False: "verdict: not supported by these recordings, for the reasons above; a table's body serves as well",
    None: "verdict: nothing speaks against it, but there are no forces or no table's body here to show it by",
}
_SHOWN = {"Fx": ("N", 1.0), "Fy": ("N", 1.0), "tauz": ("N·m", 1.0), "cop_x": ("mm", 1e3)}


def transfer(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="Trial whose body is carried over: YAML or run folder.", show_default=False
        ),
    ],
    trials: Annotated[
        list[Path],
        typer.Argument(metavar="TRIAL...", help="Trials of the same person to predict, likewise.", show_default=False),
    ],
    *,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the table, .csv or .parquet.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Apply the body identified on one trial to other trials of the same person.

    What a YAML file asks for and is not there yet is computed first; a run folder is taken as it is.
    """
    log_to_stderr(quiet, verbose)
    if out is not None:
        transfer_table.check_format(out)
    found = workflow.transfer(model, trials, progress(quiet))
    if out is not None:
        transfer_table.write(found, out)
    if as_json:
        typer.echo(json.dumps(transfer_table.as_json(found), indent=2, ensure_ascii=False, allow_nan=False))
        return
    typer.echo("\n".join(_lines(found)))


def _lines(found: workflow.Transfer) -> Iterator[str]:
    yield f"model of {found.model}; errors are model less measurement: mean ± sd (rms)"
    for trial in found.trials:
        condition = "unknown" if trial.condition is None else f"{trial.condition:.0f}"
        yield f"\n{trial.trial}: {trial.samples} samples, condition number {condition}"
        yield from _aligned([["", *(body.name for body in trial.bodies)], *_rows(trial)])
        yield from _intervals(trial)
        yield from (f"  {reason.code}: {reason.message}" for reason in trial.reasons)
        yield _VERDICTS[trial.supported]


def _intervals(trial: workflow.Applied) -> Iterator[str]:
    """Stated standard deviations of the transferred body, and the shares of samples inside their intervals."""
    known = {name: share for name, share in trial.inside.items() if math.isfinite(share)}
    if known:
        told = ", ".join(
            f"{name} ± {_SHOWN[name][1] * trial.stated[name]:.1f} {_SHOWN[name][0]}: {100 * share:.0f} %"
            for name, share in known.items()
        )
        yield f"transferred, stated sd and share of the samples in its 95 % interval: {told}"


def _rows(trial: workflow.Applied) -> Iterator[list[str]]:
    for name, (unit, factor) in _SHOWN.items():
        yield [f"{name} ({unit})", *(_error(body.errors.get(name), factor) for body in trial.bodies)]
    for j in range(max(len(body.torques) for body in trial.bodies)):
        yield [
            f"tau_{j + 1} less own (N·m)",
            *(_spread(body.torques[j]) if body.torques else "" for body in trial.bodies),
        ]


def _error(error: Agreement | None, factor: float) -> str:
    return "–" if error is None else f"{_spread(error, factor)} ({factor * workflow.rms(error):.1f})"


def _spread(error: Agreement | None, factor: float = 1.0) -> str:
    return "–" if error is None else f"{factor * error.bias:.1f} ± {factor * error.sd:.1f}"


def _aligned(rows: list[list[str]]) -> Iterator[str]:
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for first, *rest in rows:
        cells = (cell.rjust(width) for cell, width in zip(rest, widths[1:], strict=True))
        yield "  ".join([first.ljust(widths[0]), *cells])
