"""``robot.html`` for people, and the same tables in Markdown for pages such as docs/robot.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mocap_id.reporting import style
from mocap_id.reporting.cohort.page import told
from mocap_id.reporting.embedding import embedded
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.page import environment
from mocap_id.reporting.robot import tables
from mocap_id.reporting.robot.material import RobotMaterial
from mocap_id.reporting.tables import Grid

LEGEND = (
    "Mean (standard deviation): of values over the trials of a cell, of errors over all their samples. P: states from "
    "the cameras; R: states from the robot's encoder; Ref.: the reference parameters on the same states. States are "
    "held against the truth where it is known, else against the encoder. The thesis's rows stand below ours; ? is what "
    "cannot be read in it. A cell without a row of the thesis (the fast shoulder) is beyond what it measured."
)


def page(material: RobotMaterial, figures: Drawings) -> bytes:
    """The page as UTF-8."""
    through = sum(trial.fate in ("ok", "caution") for trial in material.trials)
    html = (
        environment()
        .get_template("robot.html.j2")
        .render(
            study=style.printable(material.study),
            product=material.product,
            level="ok" if through == len(material.trials) else "caution",
            headline=f"{through} of {len(material.trials)} trials went through",
            lead=_lead(material),
            legend=LEGEND,
            overview=tables.overview(material),
            grids=[tables.table(shown) for shown in material.tables],
            figures=figures,
            embedded=embedded(figures),
            trials=[told(trial) for trial in material.trials],
        )
    )
    return html.encode("utf-8")


def _lead(material: RobotMaterial) -> str:
    against = set(material.overview["against"]) - {""}
    if "truth" in against:
        return "Simulated trials: the exact truth is known, and errors are against it."
    if "encoder" in against:
        return "No truth is known: the cameras' states are held against the encoder's, and R has nothing to be held to."
    return "Neither a truth nor an encoder is known: nothing tells how far off the states are."


def markdown(material: RobotMaterial, figures: Mapping[str, str]) -> str:
    """Tables, and links to figures (title to file), for a page in Markdown."""
    grids = [tables.overview(material), *(tables.table(shown) for shown in material.tables)]
    parts = [LEGEND, *("\n".join(_table(grid)) for grid in grids if grid.rows)]
    parts += [f"![{name}]({file})" for name, file in figures.items()]
    return "\n\n".join(parts) + "\n"


def _table(grid: Grid) -> Iterator[str]:
    yield f"**{grid.caption}**"
    yield ""
    yield "| " + " | ".join(grid.head) + " |"
    yield "|" + "|".join("---" if k in grid.text else "--:" for k in range(len(grid.head))) + "|"
    for row in grid.rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
