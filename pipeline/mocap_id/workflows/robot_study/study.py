"""``mocap-id validate robot``: run every trial with every method; write the thesis's tables and figures, and a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id import __version__
from mocap_id.config.robot_study import RobotStudy, load_robot_study
from mocap_id.errors import ConfigError
from mocap_id.reporting.results.columns import ResultTable
from mocap_id.reporting.results.result import Result
from mocap_id.reporting.robot_study.page_data import RobotStudyData
from mocap_id.store import Folder
from mocap_id.store.atomic import converting_errors, write_files
from mocap_id.store.ownership import check_owner, store_owner
from mocap_id.workflows.parallel import LocalBackend, TrialCallback, TrialRun, run_trials
from mocap_id.workflows.robot_study.figure_data import average_wrench, collect_recovery, collect_traces, select_cell
from mocap_id.workflows.robot_study.methods import CAMERAS, run_all_methods
from mocap_id.workflows.robot_study.tables import TABLES, make_tables
from mocap_id.workflows.robot_study.trial_results import RobotTrialResult, read_trial_result
from mocap_id.workflows.run_folder import find_owner_of_files

PAGE, DOCUMENT, MARKDOWN = "robot.html", "validation.json", "robot.md"
_BEGIN, _END = "<!-- tables: written by `mocap-id validate robot` -->", "<!-- end of tables -->"
_ABOUT = (
    "Each table is a CSV and a Parquet file (units and meanings in the field metadata). A missing value is empty in "
    "CSV and NaN in Parquet. Rows with the source `thesis` are from its tables."
)


@dataclass(frozen=True)
class RobotStudyResult:
    """The result of a robot study."""

    folder: Path  # folder of tables and page
    trials: tuple[RobotTrialResult, ...]
    frames: Mapping[str, pd.DataFrame]  # tables by name
    document: Mapping[str, Any]  # content of validation.json

    @property
    def failed(self) -> tuple[TrialRun, ...]:
        """Trials that failed or were refused."""
        return tuple(trial.run for trial in self.trials if trial.run.exit_code != 0)

    @property
    def page(self) -> Path:
        """Path of the page."""
        return self.folder / PAGE


def validate_robot(
    files: Sequence[Path] | Callable[[Path], Path],
    out: Path,
    *,
    jobs: int = 1,
    tell: TrialCallback = lambda run: None,
    page: Path | None = None,
) -> RobotStudyResult:
    """Run a robot study, write its tables and page, and return the result.

    Parameters
    ----------
    files : sequence of Path, or callable
        A study's file, or trials' files. A function is called with the folder ``out/trials``, where it simulates a
        study if it is missing, and returns the study's file.
    out : Path
        Folder of the tables and the page. The run folders of the trials are in its sub-folder ``runs``.
    jobs : int
        Number of trials that run at the same time.
    tell : callable, optional
        Called with the result of each finished trial.
    page : Path, optional
        A Markdown page whose tables are replaced. The figures are written to a folder beside this page.

    Raises
    ------
    ConfigError
        A file is wrong; no trial was run.
    StoreError
        The folder is in use or cannot be written. The failure of a trial raises nothing; it is reported in the tables.
    """
    out = out.absolute()
    text = None if page is None else _read_page(page)
    files = (files(out / "trials"),) if callable(files) else tuple(files)
    study = load_robot_study(files)
    owner = find_owner_of_files(*files)
    configs = [replace(one, trial=replace(one.trial, out=out / "runs" / one.trial.name)) for one in study.trials]
    with converting_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    with Folder(out).locked():
        check_owner(out, owner, DOCUMENT)
        runs = run_trials([one.trial for one in configs], LocalBackend(jobs), tell, run=run_all_methods)
        trials = tuple(read_trial_result(one, run, study.reference) for one, run in zip(configs, runs, strict=True))
        tables = make_tables(trials)
        data = _collect_page_data(study, trials, tables)
        content = _describe_study(study, trials, tables)
        result = Result("robot-study", DOCUMENT, content, tables, lambda: _make_pages(data))
        result.write(out)
        store_owner(out, owner, DOCUMENT)
    if page is not None and text is not None:
        _replace_tables(page, text, data)
    return RobotStudyResult(out, trials, {name: table.frame for name, table in tables.items()}, result.document)


def _make_pages(data: RobotStudyData) -> dict[str, bytes]:
    from mocap_id.reporting.robot_study.page import render_markdown, render_robot_page  # noqa: PLC0415  it loads the page's templates

    return {PAGE: render_robot_page(data), MARKDOWN: f"# {data.study}\n\n{render_markdown(data, {})}".encode()}


def _read_page(page: Path) -> str:
    try:
        text = page.read_text("utf-8")
    except OSError as error:
        raise ConfigError(f"{page}: the file cannot be read ({error.strerror})") from error
    if _BEGIN not in text or _END not in text:
        raise ConfigError(f"{page}: expected the lines `{_BEGIN}` and `{_END}`, which enclose the tables")
    return text


def _replace_tables(page: Path, text: str, data: RobotStudyData) -> None:
    """Write the tables between the marks in the page, and the figures into a folder with the page's name."""
    from mocap_id.reporting import paper_figures  # noqa: PLC0415  it loads matplotlib
    from mocap_id.reporting.robot_study.figures import draw_robot_figures  # noqa: PLC0415
    from mocap_id.reporting.robot_study.page import render_markdown  # noqa: PLC0415

    drawings = draw_robot_figures(data)
    drawn = [one for one in drawings.all if not one.missing]
    links = {one.title: f"{page.stem}/{one.name}.svg" for one in drawn}
    files = paper_figures.make_figure_files(drawings)
    figures = {links[one.title]: files[f"figures/{one.name}.svg"] for one in drawn}
    head, rest = text.split(_BEGIN, 1)
    tail = rest.split(_END, 1)[1]
    content = f"{head}{_BEGIN}\n\n{render_markdown(data, links)}\n{_END}{tail}"
    write_files(page.parent, {**figures, page.name: content.encode()})


def _collect_page_data(
    study: RobotStudy, trials: Sequence[RobotTrialResult], tables: Mapping[str, ResultTable]
) -> RobotStudyData:
    slow, fast = select_cell(trials, "shoulder", "slow"), select_cell(trials, "elbow", "fast")
    chosen = {cell[0].name for cell in (slow, fast) if cell}
    return RobotStudyData(
        study=study.name,
        trials=tuple(trial.entry(trial.name, _describe(trial), f"runs/{trial.name}/report.html") for trial in trials),
        overview=tables["trials"].frame,
        tables=tuple((one.title, tables[one.name].frame, one.quantities) for one in TABLES),
        recoveries=tuple(collect_recovery(trial) for trial in trials if trial.name in chosen),
        averaged=average_wrench(fast) if fast else None,
        traces=collect_traces(fast[0]) if fast else None,
    )


def _describe(trial: RobotTrialResult) -> str:
    orientation = "" if trial.labels.orientation is None else f"{trial.labels.orientation:g}°"
    movement = " ".join(filter(None, (trial.labels.speed, orientation))) or "unlabelled"
    return f"{trial.labels.joint or 'joint'}, {movement}"


def _describe_study(
    study: RobotStudy, trials: Sequence[RobotTrialResult], tables: Mapping[str, ResultTable]
) -> dict[str, Any]:
    return {
        "study": study.name,
        "product": __version__,
        "about": _ABOUT,
        "page": PAGE,
        "trials": [
            {
                "trial": trial.name,
                "joint": trial.labels.joint,
                "speed": trial.labels.speed,
                "orientation": trial.labels.orientation,
                "exit_code": trial.run.exit_code,
                "message": trial.run.published,
                "truth": trial.truth is not None,
                "against": trial.by_method[CAMERAS.name].against if trial.by_method else "",
            }
            for trial in trials
        ],
        "tables": {name: table.description for name, table in tables.items()},
    }
