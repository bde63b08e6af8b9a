"""The figures of a robot study (thesis figures 5.2 to 5.6): a drawing, or a sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from matplotlib.figure import Figure

from mocap_id.reporting.contents import FigureEntry
from mocap_id.reporting.figures import Drawing, drawing
from mocap_id.reporting.robot.figures import accelerations, recovery, wrench
from mocap_id.reporting.robot.material import RobotMaterial

NAMES = ("recovery-1", "recovery-2", "wrench", "residuals", "accelerations")


def render(material: RobotMaterial) -> dict[str, Drawing]:
    """Every figure of the page, by name."""
    return {entry.name: drawing(entry, material.study, draw) for entry, draw in _drawn(material)}


def _drawn(material: RobotMaterial) -> Iterator[tuple[FigureEntry, Callable[[], Figure | str]]]:
    for k, one in enumerate(material.recoveries, start=1):
        title = f"Kinematic recovery: {one.speed} swing of the {one.joint} ({one.trial})"
        yield FigureEntry(f"recovery-{k}", title, recovery.CAPTION), partial(recovery.draw, one)
    cell = "" if material.averaged is None else f": {material.averaged.cell}, {material.averaged.repetitions} swings"
    missing = "No repetition is complete in any trial that went through."
    averaged = material.averaged
    yield (
        FigureEntry("wrench", f"Measured and recovered contact wrench{cell}", wrench.CAPTION),
        lambda: missing if averaged is None else wrench.draw(averaged),
    )
    yield (
        FigureEntry("residuals", f"Errors of the recovered contact wrench{cell}", wrench.RESIDUALS),
        lambda: missing if averaged is None else wrench.draw_residuals(averaged),
    )
    traces = material.traces
    yield (
        FigureEntry("accelerations", "Acceleration by the smoother and by differences", accelerations.CAPTION),
        lambda: "No trial went through." if traces is None else accelerations.draw(traces),
    )
