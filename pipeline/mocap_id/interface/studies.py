"""Studies for Python: the runs of all trials, and the tables of the study as data frames."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id.interface.figures import Figure, PageFigures
from mocap_id.interface.run_result import Run
from mocap_id.interface.running import open as open_folder
from mocap_id.workflows.study import StudyResult, run_study

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd


class Study:
    """The results of a study."""

    def __init__(self, result: StudyResult) -> None:
        self._result = result

    @property
    def folder(self) -> Path:
        """Folder of the tables and the page."""
        return self._result.study.folder

    @property
    def page(self) -> Path:
        """Path of the page about all trials."""
        return self._result.page

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures of the page; give one of them to :meth:`figure`."""
        return self._page_figures.names

    def figure(self, name: str) -> Figure:
        """Return the figure of this name from the page; raise StoreError with the reason if it is missing."""
        return self._page_figures.find(name)

    @cached_property
    def _page_figures(self) -> PageFigures:
        return PageFigures(self.page)

    @property
    def document(self) -> Mapping[str, Any]:
        """Content of ``study.json``."""
        return self._result.document

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables by name; ``frame.attrs["units"]`` gives the unit of each column."""
        import pandas as pd  # noqa: PLC0415  only the tables need it

        tables = {}
        for name, about in self.document["tables"].items():
            tables[name] = pd.read_parquet(self.folder / f"{name}.parquet")
            tables[name].attrs["units"] = {column["name"]: column["unit"] for column in about["columns"]}
        return tables

    @cached_property
    def runs(self) -> Mapping[str, Run]:
        """The runs by name of the trial, without the trials that have no results."""
        trials = zip(self._result.study.trials, self.document["trials"], strict=True)
        return {one.name: open_folder(one.trial.out) for one, about in trials if about["report"] is not None}

    @property
    def failures(self) -> Mapping[str, str]:
        """Messages of the trials that failed or were refused, by name of the trial; empty if all succeeded."""
        return {run.trial: run.message or "" for run in self._result.failed}


def study(file: str | PathLike[str], *, jobs: int = 1) -> Study:
    """Run all trials of a study, write its tables and page, and return the results.

    Results that are up to date are reused.

    Parameters
    ----------
    file : path
        The study's YAML file.
    jobs : int
        Number of trials that run at the same time.

    Raises
    ------
    ConfigError
        The file is invalid; nothing was run.
    StoreError
        The study's folder is in use or cannot be written. If a trial fails, nothing is raised: see ``failures``.
    """
    return Study(run_study(Path(file), jobs))
