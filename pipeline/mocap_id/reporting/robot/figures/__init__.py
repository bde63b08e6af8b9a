"""The figures of a robot study (thesis figures 5.2 to 5.6): a figure, or a sentence that says why there is none."""

from __future__ import annotations

from collections.abc import Iterator

from mocap_id.reporting import style
from mocap_id.reporting.figure import Drawing, Drawings
from mocap_id.reporting.robot.figures import accelerations, recovery, wrench
from mocap_id.reporting.robot.material import RobotMaterial


def drawings(material: RobotMaterial) -> Drawings:
    """Every figure of the page."""
    return Drawings(style.printable(material.study), tuple(_drawings(material)))


def _drawings(material: RobotMaterial) -> Iterator[Drawing]:
    for k, one in enumerate(material.recoveries, start=1):
        title = style.printable(f"Kinematic recovery: {one.speed} swing of the {one.joint} ({one.trial})")
        yield Drawing(f"recovery-{k}", title, recovery.CAPTION, recovery.shown(one))
    averaged, missing = material.averaged, "No repetition is complete in any trial that went through."
    cell = "" if averaged is None else f": {averaged.cell}, {averaged.repetitions} swings"
    yield Drawing(
        "wrench",
        f"Measured and recovered contact wrench{cell}",
        wrench.CAPTION,
        missing if averaged is None else wrench.shown(averaged),
    )
    yield Drawing(
        "residuals",
        f"Errors of the recovered contact wrench{cell}",
        wrench.RESIDUALS,
        missing if averaged is None else wrench.errors(averaged),
    )
    traces = material.traces
    yield Drawing(
        "accelerations",
        "Acceleration by the smoother and by differences",
        accelerations.CAPTION,
        "No trial went through." if traces is None else accelerations.shown(traces),
    )
