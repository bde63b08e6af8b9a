"""The results of a trial for Python; each file is read when it is first used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mocap_id import __version__
from mocap_id.errors import MocapIdError, StoreError
from mocap_id.runner import Step
from mocap_id.verdict import Level, Reason
from mocap_id.workflows.run_folder import SUMMARY, RunFolder

if TYPE_CHECKING:
    import pandas as pd

    from mocap_id.interface.figures import Figure, PageFigures


@dataclass(frozen=True)
class Verdict:
    """The verdict on a trial."""

    level: Level  # ``ok``, ``caution`` or ``refused``
    reasons: tuple[Reason, ...]  # limits of the results; empty if the level is ``ok``
    notes: tuple[Reason, ...]  # other findings


def _make_table(file: str, text: str) -> cached_property[pd.DataFrame]:
    """Return a property of a run that reads the table ``file`` when it is first used; ``text`` is its docstring."""

    def read(run: Run) -> pd.DataFrame:
        return run._read_frame(file)

    read.__doc__ = text
    return cached_property(read)


class Run:
    """The results of a trial.

    Tables are data frames in SI units; ``frame.attrs["units"]`` gives the unit of each column. If the trial does not
    have a table, its property raises :class:`~mocap_id.errors.StoreError` with the reason.

    Parameters
    ----------
    files : RunFolder
        The run folder with its artefacts.
    steps : tuple of Step, optional
        The stages that were computed or reused; empty for a run that was only opened.
    """

    def __init__(self, files: RunFolder, steps: tuple[Step, ...] = ()) -> None:
        self._files = files
        self.steps = steps

    def __repr__(self) -> str:
        return f"<Run {self.name}: {self.verdict.level if self.summary else 'incomplete'}, {self.folder}>"

    def _repr_html_(self) -> str:
        """Return verdict, main numbers and player of the motion as HTML for a notebook."""
        from mocap_id.reporting.player import make_player  # noqa: PLC0415  needs the page's templates
        from mocap_id.reporting.report import render_notebook_view  # noqa: PLC0415  needs the page's templates
        from mocap_id.reporting.report_data import ReportData  # noqa: PLC0415  needs the page's templates

        if not self.summary:
            return f"<p>{escape(self.name)}: no {SUMMARY}</p>"
        settings = {"space": str(self.summary.get("space"))}
        data = ReportData(self.name, __version__, self._files.artefacts, settings=settings)
        try:
            player = make_player(data)
        except MocapIdError as error:  # the numbers do not need the tables
            return f"{render_notebook_view(self.summary)}<p>There is no player: {escape(str(error))}</p>"
        return render_notebook_view(self.summary, player)

    @property
    def name(self) -> str:
        """The trial's name."""
        return self._files.name

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self._files.path

    @property
    def report(self) -> Path:
        """Path of the page ``report.html``."""
        return self.folder / "report.html"

    def open_report(self) -> bool:
        """Open the report in the browser; return False if there is no browser."""
        import webbrowser  # noqa: PLC0415  takes 5 ms

        return webbrowser.open(self.report.resolve().as_uri())

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures of the report; give one of them to :meth:`figure`."""
        return self._page_figures.names

    def figure(self, name: str) -> Figure:
        """Return the figure of this name from the report; raise StoreError with the reason if it is missing."""
        return self._page_figures.find(name)

    @cached_property
    def _page_figures(self) -> PageFigures:
        from mocap_id.interface.figures import PageFigures  # noqa: PLC0415  a run that is only printed draws nothing

        return PageFigures(self.report)

    @property
    def summary(self) -> Mapping[str, Any]:
        """Content of ``summary.json``: verdict and numbers; empty if the run is not complete."""
        return self._files.summary

    @property
    def verdict(self) -> Verdict:
        """The verdict on the trial; raises StoreError if the run is not complete."""
        if not self.summary:
            raise StoreError(f"{self.folder} contains no {SUMMARY}: the run is not complete, run the trial again")
        verdict = self.summary["verdict"]
        reasons, notes = (tuple(map(Reason.from_dict, verdict[key])) for key in ("reasons", "notes"))
        return Verdict(verdict["level"], reasons, notes)

    @property
    def refused(self) -> bool:
        """Whether the trial was refused because the method is not applicable; raises StoreError as ``verdict``."""
        return self.verdict.level == "refused"

    planar = _make_table(
        "planar.parquet",
        "Measured markers in the axes of the plane of motion, or for a trial in space in the axes of the lab.",
    )
    wrench = _make_table("wrench.parquet", "Wrenches of the ground and of other contacts.")
    segments = _make_table("segments.parquet", "Segment of each marker.")
    states = _make_table("states.parquet", "Joint angles with their derivatives and standard deviations.")
    poses = _make_table("poses.parquet", "Measured poses of the bodies.")
    angles = _make_table(
        "angles.parquet",
        "Anatomical angles of a trial in space. In the plane this raises StoreError: the angles are in ``states``.",
    )
    markers = _make_table("markers.parquet", "Markers predicted from the states.")
    events = _make_table("events.parquet", "Repetitions, with the times of their events.")
    phases = _make_table("phases.parquet", "Mean curves over the repetitions.")
    encoder = _make_table("encoder.parquet", "Angles from the encoder of a robot's joint.")
    dynamics = _make_table(
        "dynamics.parquet",
        "Joint torques (NaN where unknown: see ``contact``), and measured and modelled wrenches of the ground.",
    )

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Identified base parameters with standard deviations; the column ``unit`` contains their units.

        Raises StoreError with the reason if there are none.
        """
        from mocap_id.workflows.export.tables import parameter_table  # noqa: PLC0415  needs pandas

        table = parameter_table(self._files)
        if table is None or table.empty:
            raise StoreError(self._files.why_missing("dynamics.h5"))
        return table

    def export(self, *formats: str, out: str | PathLike[str] | None = None, force: bool = False) -> tuple[Path, ...]:
        """Write the run in the formats of other programs, as ``mocap-id export`` does, and return the paths.

        Parameters
        ----------
        *formats : str
            ``"trc"``, ``"mot"``, ``"sto"`` and ``"osim"`` for OpenSim, ``"csv"`` for tables, ``"ktk"`` for Kinetics
            Toolkit.
        out : path, optional
            Output folder; by default ``export`` in the run folder.
        force : bool
            Overwrite existing files.

        Raises
        ------
        ConfigError
            A format is unknown.
        StoreError
            A file exists already, the folder cannot be written, or the run has no content for these formats.
        """
        from mocap_id.workflows.export import export_run  # noqa: PLC0415  only an export needs it

        return export_run(self.folder, formats, None if out is None else Path(out), force=force).files

    def _read_frame(self, file: str) -> pd.DataFrame:
        """Return an artefact, such as ``states.parquet``, as a data frame; raise StoreError if it is missing."""
        from mocap_id.store import LongTable, Table  # noqa: PLC0415  a run that is only printed reads no table
        from mocap_id.store.parquet import expand_columns  # noqa: PLC0415

        table = self._files.artefacts.get(file)
        if not isinstance(table, Table | LongTable) or not table.length or table.names == ["time"]:
            raise StoreError(f"{self.name}: {self._files.why_missing(file)}")
        frame = table.frame
        frame.attrs["units"] = {column.name: column.unit for column in expand_columns(table.schema, table.names)}
        return frame
