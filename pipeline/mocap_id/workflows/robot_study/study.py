"""``mocap-id validate robot``: every trial by every method, the thesis's tables and figures, and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from mocap_id import __version__
from mocap_id.config.robot_study import RobotStudy, load_robot_study
from mocap_id.errors import ConfigError
from mocap_id.reporting.cohort.material import TrialEntry
from mocap_id.reporting.robot.material import RobotMaterial, Shown
from mocap_id.reporting.shape import ReasonEntry
from mocap_id.simulation import RobotSet, simulate_set
from mocap_id.simulation.robot_set import FILE, set_file
from mocap_id.store import Folder
from mocap_id.store.atomic import explained, replace_together
from mocap_id.workflows.performing import Here, Performed, Tell, perform_all
from mocap_id.workflows.robot_study import series
from mocap_id.workflows.robot_study.columns import TABLES, TRIALS
from mocap_id.workflows.robot_study.rows import Case, case
from mocap_id.workflows.robot_study.tables import tables
from mocap_id.workflows.robot_study.variants import CAMERAS, perform_variants
from mocap_id.workflows.study.writing import as_bytes, table_document, table_files

PAGE, DOCUMENT, MARKDOWN = "robot.html", "validation.json", "robot.md"
_SCHEMAS = {"trials": TRIALS} | {spec.name: spec.schema for spec in TABLES}
_BEGIN, _END = "<!-- tables: written by `mocap-id validate robot` -->", "<!-- end of tables -->"


@dataclass(frozen=True)
class Outcome:
    """How a study went.

    Parameters
    ----------
    folder : Path
        Where tables and page are.
    cases : tuple of Case
    frames : mapping of str to DataFrame
        Every table.
    document : mapping
        What validation.json holds.
    """

    folder: Path
    cases: tuple[Case, ...]
    frames: Mapping[str, pd.DataFrame]
    document: Mapping[str, Any]

    @property
    def failed(self) -> tuple[Performed, ...]:
        """Trials that failed or were refused."""
        return tuple(one.performed for one in self.cases if one.performed.exit_code != 0)

    @property
    def page(self) -> Path:
        """For people."""
        return self.folder / PAGE


def validate_robot(
    files: Sequence[Path],
    out: Path,
    *,
    generated: RobotSet | None = None,
    jobs: int = 1,
    tell: Tell = lambda done: None,
    page: Path | None = None,
) -> Outcome:
    """Run a robot study.

    Parameters
    ----------
    files : sequence of Path
        A study's file, or trials' files; with none, a set is simulated in ``out/trials`` unless one stands there.
    out : Path
        Gets a run folder for each trial in ``runs``, the tables, and the page.
    generated : RobotSet, optional
        Which set is simulated.
    jobs : int
        Trials at a time.
    tell : callable, optional
        Told of every trial once it is done.
    page : Path, optional
        A page in Markdown whose tables are to be replaced; its figures go to a folder beside it.

    Raises
    ------
    ConfigError
        A file is wrong; nothing was run.
    StoreError
        The folder is in use or cannot be written. What goes wrong with one trial is told in its row.
    """
    out = out.absolute()
    before = None if page is None else _readable(page)
    study = load_robot_study(tuple(files) or (_generated(out, generated or RobotSet()),))
    trials = [replace(one, trial=replace(one.trial, out=out / "runs" / one.trial.name)) for one in study.trials]
    with explained(out):
        out.mkdir(parents=True, exist_ok=True)
    with Folder(out).locked():
        performed = perform_all([one.trial for one in trials], Here(jobs), tell, how=perform_variants)
        cases = tuple(case(one, done, study.reference) for one, done in zip(trials, performed, strict=True))
        frames = tables(cases)
        document = _document(study, cases, frames)
        _write(out, study, cases, frames, document)
    if page is not None and before is not None:
        _replace_tables(page, before, study, cases, frames)
    return Outcome(out, cases, frames, document)


def _generated(out: Path, wanted: RobotSet) -> Path:
    """The simulated set in the study's folder, made if it is not there; ConfigError where another one is."""
    folder = out / "trials"
    if not (folder / FILE).exists():
        return simulate_set(folder, wanted)
    if (folder / FILE).read_text("utf-8") != set_file(wanted):
        raise ConfigError(
            f"{folder} holds a set of another seed or number of trials: ask for that one, or choose another `--out`"
        )
    return folder / FILE


def _write(
    out: Path,
    study: RobotStudy,
    cases: Sequence[Case],
    frames: Mapping[str, pd.DataFrame],
    document: Mapping[str, Any],
) -> None:
    from mocap_id.reporting.robot.figures import drawings  # noqa: PLC0415  whoever writes a page loads templates
    from mocap_id.reporting.robot.page import markdown, page  # noqa: PLC0415

    material = _material(study, cases, frames)
    files = {**table_files(frames, _SCHEMAS, "robot-study"), PAGE: page(material, drawings(material))}
    files |= {MARKDOWN: f"# {study.name}\n\n{markdown(material, {})}".encode(), DOCUMENT: as_bytes(document)}
    replace_together(out, files)


def _readable(page: Path) -> str:
    try:
        text = page.read_text("utf-8")
    except OSError as error:
        raise ConfigError(f"{page}: cannot be read ({error.strerror})") from error
    if _BEGIN not in text or _END not in text:
        raise ConfigError(f"{page}: has no lines `{_BEGIN}` and `{_END}`, between which the tables would go")
    return text


def _replace_tables(
    page: Path, before: str, study: RobotStudy, cases: Sequence[Case], frames: Mapping[str, pd.DataFrame]
) -> None:
    """Tables between the page's marks, figures in a folder of the page's name."""
    from mocap_id.reporting import paper  # noqa: PLC0415  matplotlib is imported by whoever draws with it
    from mocap_id.reporting.robot.figures import drawings  # noqa: PLC0415
    from mocap_id.reporting.robot.page import markdown  # noqa: PLC0415

    material = _material(study, cases, frames)
    found = drawings(material)
    shown = {one.title: f"{page.stem}/{one.name}.svg" for one in found.all if not one.missing}
    head, rest = before.split(_BEGIN, 1)
    tail = rest.split(_END, 1)[1]
    with explained(page):
        (page.parent / page.stem).mkdir(exist_ok=True)
    text = f"{head}{_BEGIN}\n\n{markdown(material, shown)}\n{_END}{tail}"
    drawn = paper.files(found)
    figures = {f"{page.stem}/{one.name}.svg": drawn[f"figures/{one.name}.svg"] for one in found.all if not one.missing}
    replace_together(page.parent, {**figures, page.name: text.encode()})


def _material(study: RobotStudy, cases: Sequence[Case], frames: Mapping[str, pd.DataFrame]) -> RobotMaterial:
    slow, fast = series.choose(cases, "shoulder", "slow"), series.choose(cases, "elbow", "fast")
    chosen = list(dict.fromkeys(one[0].name for one in (slow, fast) if one))
    return RobotMaterial(
        study=study.name,
        product=__version__,
        trials=tuple(map(_entry, cases)),
        overview=frames["trials"],
        tables=tuple(
            Shown(spec.name, spec.title, frames[spec.name], [(one.name, one.unit) for one in spec.quantities])
            for spec in TABLES
        ),
        recoveries=tuple(series.recovery(one) for one in cases if one.name in chosen),
        averaged=series.averaged(fast) if fast else None,
        traces=series.traces(fast[0]) if fast else None,
    )


def _entry(one: Case) -> TrialEntry:
    verdict = (one.summary or {}).get("verdict")
    orientation = "" if one.labels.orientation is None else f"{one.labels.orientation:g}°"
    return TrialEntry(
        name=one.name,
        subject=one.labels.joint or "joint",
        strategy=" ".join(filter(None, (one.labels.speed, orientation))) or "unlabelled",
        fate="failed" if verdict is None or one.performed.exit_code not in (0, 4) else verdict["level"],
        reasons=[] if verdict is None else [ReasonEntry(**reason) for reason in verdict["reasons"]],
        message=one.performed.published,
        report=None if verdict is None else f"runs/{one.name}/report.html",
    )


def _document(study: RobotStudy, cases: Sequence[Case], frames: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    return {
        "schema": "mocap-id/robot-study",
        "version": 1,
        "study": study.name,
        "product": __version__,
        "about": "Each table stands as CSV and as Parquet (units and meanings in the field metadata). Missing is empty "
        "in CSV and NaN in Parquet. Rows whose source is `thesis` are what its table has there.",
        "page": PAGE,
        "trials": [
            {
                "trial": one.name,
                "joint": one.labels.joint,
                "speed": one.labels.speed,
                "orientation": one.labels.orientation,
                "exit_code": one.performed.exit_code,
                "message": one.performed.published,
                "truth": one.truth is not None,
                "against": one.by_method[CAMERAS.name].against if one.by_method else "",
            }
            for one in cases
        ],
        "tables": {name: table_document(_SCHEMAS[name], frame) for name, frame in frames.items()},
    }
