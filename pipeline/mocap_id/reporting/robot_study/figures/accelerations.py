"""One trial's acceleration from the smoother and from finite differences (figure 5.6)."""

from __future__ import annotations

from mocap_id.reporting import style
from mocap_id.reporting.downsampling import envelope
from mocap_id.reporting.figure import Dash, Figure, Item, Line, Panel
from mocap_id.reporting.robot_study.page_data import StateTraces

CAPTION = (
    "Angular acceleration of a single trial: the smoother's (P, blue), and by a 20 Hz low-pass and differences of the "
    "frames' angles (red, dotted); the truth, if known, in black. Below, the error of each against the truth."
)
_LOOKS: tuple[tuple[str, str, Dash, float], ...] = (("Diff.", style.OTHER, ":", 0.7), ("P", style.BLUE, "-", 1.1))
_BINS = 200


def draw(traces: StateTraces) -> Figure:
    """Return the curves, and their errors if the truth is known."""
    curves: list[Item] = []
    errors: list[Item] = []
    for name, colour, dash, width in _LOOKS:
        if name in traces.curves:
            curve = traces.curves[name][:, 2]
            curves.append(Line(*envelope(traces.time, curve, _BINS), colour, name, dash, width))
            if traces.truth is not None:
                off = curve - traces.truth[:, 2]
                errors.append(Line(*envelope(traces.time, off, _BINS), colour, name, dash, width))
    title, time = f"acceleration (rad/s²): {style.printable(traces.trial)}", "time (s)"
    if traces.truth is None:
        return Figure(((Panel(tuple(curves), title, time, linked=True, height=2.2),),))
    curves.append(Line(*envelope(traces.time, traces.truth[:, 2], _BINS), style.INK, "truth", width=0.6))
    above = Panel(tuple(curves), title, linked=True, height=1.7)
    return Figure(((above,), (Panel(tuple(errors), "less the truth (rad/s²)", time, linked=True, height=1.9),)))
