"""``robot.html``, and the same tables in Markdown for pages such as docs/robot.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mocap_id.reporting.grids import Grid
from mocap_id.reporting.page import Page, Section
from mocap_id.reporting.results.study_page import count_passed
from mocap_id.reporting.robot_study.figures import draw_robot_figures
from mocap_id.reporting.robot_study.page_data import RobotStudyData
from mocap_id.reporting.robot_study.tables import list_thesis_rows, list_trials

LEGEND = (
    "Mean (standard deviation). Values: over the trials of a cell; errors: over all samples of these trials. P: states "
    "from the cameras; R: states from the robot's encoder; Ref.: the reference parameters on the same states. States "
    "are compared with the truth if it is known, else with the encoder. The rows of the thesis are below the rows of "
    "this program; ? is a number that is not readable in the thesis. Cells without a row of the thesis (the fast "
    "shoulder) were not measured there."
)
_FOOTER = (
    "The same numbers in SI units are in the CSV and Parquet files beside this page, which validation.json describes."
)


def render_robot_page(data: RobotStudyData) -> bytes:
    """Return the HTML page in UTF-8."""
    figures = draw_robot_figures(data)
    first, *tables = _list_grids(data)
    return Page(
        name=data.study,
        headline=count_passed(data.trials),
        lead=_describe_truth(data),
        command="validate robot",
        level="ok" if all(trial.passed for trial in data.trials) else "caution",
        sections=(
            Section("trials", "Trials", (first,)),
            Section("tables", "Tables", tuple(tables), text=(LEGEND,)),
            Section("figures", "Figures", figures=tuple(one.name for one in figures.all)),
        ),
        trials=data.trials,
        figures=figures,
        footer=_FOOTER,
    ).render()


def _list_grids(data: RobotStudyData) -> list[Grid]:
    return [list_trials(data.overview), *(list_thesis_rows(*table) for table in data.tables)]


def _describe_truth(data: RobotStudyData) -> str:
    against = set(data.overview["against"]) - {""}
    if "truth" in against:
        return "Simulated trials: the errors are differences from the exact truth."
    if "encoder" in against:
        return "The truth is not known. The states from the cameras are compared with the encoder; R has no comparison."
    return "Neither truth nor encoder is known, so the errors of the states are unknown."


def render_markdown(data: RobotStudyData, figures: Mapping[str, str]) -> str:
    """Return the tables and the ``figures`` (file by title) in Markdown."""
    parts = [LEGEND, *("\n".join(_render_table(grid)) for grid in _list_grids(data) if grid.rows)]
    parts += [f"![{name}]({file})" for name, file in figures.items()]
    return "\n\n".join(parts) + "\n"


def _render_table(grid: Grid) -> Iterator[str]:
    yield f"**{grid.caption}**"
    yield ""
    yield "| " + " | ".join(grid.head) + " |"
    yield "|" + "|".join("---" if k in grid.text else "--:" for k in range(len(grid.head))) + "|"
    for row in grid.rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
