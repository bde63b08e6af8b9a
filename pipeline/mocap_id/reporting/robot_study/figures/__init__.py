"""The figures of a robot study (thesis figures 5.2 to 5.6); where there is no figure, a sentence says why."""

from __future__ import annotations

from collections.abc import Iterator

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.robot_study.figures import accelerations, recovery, wrench
from mocap_id.reporting.robot_study.page_data import RobotStudyData


def robot_figures(data: RobotStudyData) -> Drawings:
    """Return every figure of the page."""
    return Drawings(style.printable(data.study), tuple(_drawings(data)))


def _drawings(data: RobotStudyData) -> Iterator[Drawing]:
    for k, one in enumerate(data.recoveries, start=1):
        title = style.printable(f"Kinematic recovery: {one.speed} swing of the {one.joint} ({one.trial})")
        yield Drawing(f"recovery-{k}", title, recovery.CAPTION, recovery.draw(one))
    averaged, missing = data.averaged, "No repetition is complete in any trial that went through."
    cell = "" if averaged is None else f": {averaged.cell}, {averaged.repetitions} swings"
    yield Drawing(
        "wrench",
        f"Measured and recovered contact wrench{cell}",
        wrench.CAPTION,
        missing if averaged is None else wrench.draw(averaged),
    )
    yield Drawing(
        "residuals",
        f"Errors of the recovered contact wrench{cell}",
        wrench.RESIDUALS,
        missing if averaged is None else wrench.draw_errors(averaged),
    )
    traces = data.traces
    yield Drawing(
        "accelerations",
        "Acceleration by the smoother and by differences",
        accelerations.CAPTION,
        "No trial went through." if traces is None else accelerations.draw(traces),
    )
