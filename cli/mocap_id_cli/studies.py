"""Commands on studies: ``init``, ``study`` and ``sensitivity``."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from mocap_id import workflows
from mocap_id_cli import progress
from mocap_id_cli.console import Jobs, Output, TrialPath, align, common_options, describe_verdict, shorten

if TYPE_CHECKING:
    from mocap_id.workflows.sensitivity.study import PerturbationRun
    from mocap_id.workflows.study.discovery import Discovery


_PLURALS = {"strategy": "strategies", "session": "sessions", "side": "sides"}


def init(
    folder: Annotated[Path, Argument(metavar="FOLDER", help="Folder of the recordings.")],
    *,
    pattern: Annotated[
        str | None,
        Option(
            help="Pattern that says where a recording's path contains person and strategy, such as "
            "'{subject}/{strategy}*.c3d'; default: determined from the paths."
        ),
    ] = None,
    out: Annotated[Path, Option(metavar="STUDY.yaml", help="File to write.")] = Path("study.yaml"),
    dry_run: Annotated[bool, Option("--dry-run", help="Show what was found, and write nothing.")] = False,
    force: Annotated[bool, Option("--force", help="Overwrite an existing file.")] = False,
    keep_names: Annotated[
        bool, Option("--keep-names", help="Use the names in the recordings' paths as ids, instead of s01, s02 …")
    ] = False,
) -> None:
    """Write a study file for a folder of recordings.

    The recordings are C3D files, TRC files with their MOT files, exports of QTM, Motive or Nexus, or skeletons of a
    depth camera or markerless software. For markers of an arm without a force plate, and for skeletons, the file is of
    a study of reaches. People get ids. Keep subjects.csv, which is written beside the file: it lists names and ids.
    """
    from mocap_id.workflows.study import discovery  # noqa: PLC0415  no other command has to wait for it

    known = {} if keep_names else discovery.read_known_ids(out)
    found = discovery.discover(folder, pattern, keep_names=keep_names, known=known)
    typer.echo("\n".join(_describe_findings(found, folder)))
    if dry_run:
        typer.echo("nothing written: --dry-run")
        return
    written = discovery.write_draft(found, out, keep_names=keep_names, force=force)
    typer.echo("\n".join(f"wrote {path}" for path in written))


def _describe_findings(found: Discovery, folder: Path) -> Iterator[str]:
    yield f"pattern: {found.pattern}"
    if found.tried and ("{subject}" not in found.pattern or any("pattern" in why for why in found.left_out.values())):
        yield f"tried: {', '.join(found.tried)}; give another pattern with --pattern"
    labels = ("session", "side") if found.reach else ("strategy",)
    rows = [["trial", "subject", "called", *labels, "recording"]]
    for trial in found.trials:
        files = [path.relative_to(folder).as_posix() for path in (trial.markers, trial.forces) if path is not None]
        values = [getattr(trial, name) or "–" for name in labels]
        rows.append([trial.trial, trial.subject, trial.name, *values, " + ".join(files)])
    yield from align(rows)
    counts = ", ".join(f"{len({getattr(trial, name) for trial in found.trials})} {_PLURALS[name]}" for name in labels)
    named = [trial for trial in found.trials if trial.name.casefold() in trial.markers.stem.casefold()]
    if named and named[0].name != named[0].subject:
        yield (
            f"note: {named[0].markers.name} contains the name of {named[0].subject}, and the report of a trial shows "
            "the name of its file: rename such files before you give reports to others"
        )
    yield from (f"note: {doubt}" for doubt in found.doubts)
    yield f"{len(found.trials)} trials of {len(found.names)} people, {counts}"
    for path, why in found.left_out.items():
        yield f"left out: {path.relative_to(folder).as_posix()}: {why}"


@common_options
def study(
    file: Annotated[Path, Argument(metavar="STUDY.yaml", help="The study's file.")],
    *,
    jobs: Jobs = 1,
    output: Output,
) -> None:
    """Run all trials of a study and write its tables and page.

    Results that are up to date are reused. If a trial fails or is refused, the other trials still run, and the exit
    code is 1.
    """
    result = workflows.study.run_study(file, jobs, begin=output.show_trial_count, tell=output.report_trial)
    progress.stop()
    output.print_result(result.document, _describe_study(result))
    if result.failed:
        raise typer.Exit(1)


def _describe_study(result: workflows.study.StudyResult) -> Iterator[str]:
    trials = result.document["trials"]
    width = max(len(trial["trial"]) for trial in trials)
    for trial, run in zip(trials, result.runs, strict=True):
        yield f"{trial['trial']:<{width}}  {describe_verdict(trial)}"
        if run.message is not None:  # unlike the document, it names the files, which the user has to find
            yield from (f"{'':<{width}}    {line}" for line in run.message.splitlines())
    yield from (f"note: {remark}" for remark in result.document["remarks"])
    yield f"{len(trials) - len(result.failed)} of {len(trials)} trials have results"
    yield f"tables: {shorten(result.study.folder)}"
    yield f"page: {shorten(result.page)}"


@common_options
def sensitivity(
    trial: TrialPath,
    *,
    settings: Annotated[
        Path | None, Option(metavar="FILE", help="YAML file of the perturbations; default: all perturbations.")
    ] = None,
    only: Annotated[
        list[str] | None,
        Option(metavar="KIND", help="Apply only this kind, such as clock-offset (repeatable; docs/sensitivity.md)."),
    ] = None,
    jobs: Annotated[int, Option("--jobs", "-j", min=1, help="Number of perturbations that run at the same time.")] = 2,
    out: Annotated[
        Path | None, Option(metavar="FOLDER", help="Output folder; default: <run folder>-sensitivity.")
    ] = None,
    output: Output,
) -> None:
    """Perturb a trial and report which errors it tolerates.

    The perturbations are typical laboratory errors (thesis 5.5.2). If TRIAL is a YAML file, missing or outdated
    results are computed first. A given run folder is not changed.
    """
    from mocap_id.workflows.sensitivity import perturbations, study  # noqa: PLC0415  no other command waits for them

    def report(run: PerturbationRun, number: int, count: int) -> None:
        outcome = "" if run.estimates is not None else "  refused" if run.refused else "  failed"
        output.say(f"{number:>4}/{count}  {run.perturbation.name:<36}{run.seconds:6.2f} s{outcome}")

    options = perturbations.SensitivityOptions() if settings is None else perturbations.read_options(settings)
    options = options.only(only or ())
    start = time.perf_counter()
    folder, runs, document = study.study_sensitivity(
        trial, options, jobs=jobs, out=out, progress=output.report_stage, tell=report
    )
    wall = time.perf_counter() - start
    spent = sum(run.seconds for run in runs)
    output.say(f"perturbations: {len(runs)}, {spent:.1f} s of processor time, {wall:.1f} s in all")
    output.print_result(document, _describe_sensitivity(document, folder, options.tolerance))


def _describe_sensitivity(document: Mapping[str, Any], folder: Path, share: float) -> Iterator[str]:
    from mocap_id.reporting.sensitivity import describe_criterion  # noqa: PLC0415  as above

    yield f"{document['trial']}: what this trial tolerates. {describe_criterion(share)}"
    if document["note"]:
        yield f"note: {document['note']}"
    yield from (f"  {row['sentence']}" for row in document["tolerates"])
    yield f"written: {shorten(folder.absolute())}"
