"""One trial's acceleration by the smoother and by differences (figure 5.6)."""

from __future__ import annotations

from matplotlib.figure import Figure

from mocap_id.reporting import style
from mocap_id.reporting.decimation import envelope
from mocap_id.reporting.robot.material import Traces

CAPTION = (
    "Angular acceleration of a single trial: the smoother's (P, blue), and by a 20 Hz low-pass and differences of the "
    "frames' angles (red, dotted); the truth in black where it is known. Below, what is left of each against the truth."
)


def draw(traces: Traces) -> Figure:
    """The curves, and their errors where the truth is known."""
    known = traces.truth is not None
    drawing = style.figure(3.6 if known else 2.2)
    panels = list(drawing.subplots(2 if known else 1, 1, sharex=True, squeeze=False)[:, 0])
    looks = {"Diff.": (style.OTHER, ":", 0.7), "P": (style.BLUE, "-", 1.1)}
    for name, (colour, line, width) in looks.items():
        if name not in traces.curves:
            continue
        curve = traces.curves[name][:, 2]
        panels[0].plot(*envelope(traces.time, curve, 200), line, color=colour, lw=width, label=name)
        if traces.truth is not None:
            off = curve - traces.truth[:, 2]
            panels[1].plot(*envelope(traces.time, off, 200), line, color=colour, lw=width)
    if traces.truth is not None:
        panels[0].plot(*envelope(traces.time, traces.truth[:, 2], 200), color=style.INK, lw=0.6, label="truth")
        panels[1].set_title("less the truth (rad/s²)")
    panels[0].set_title(f"acceleration (rad/s²): {style.printable(traces.trial)}")
    panels[-1].set_xlabel("time (s)")
    style.legend_above(drawing, panels[:1])
    return drawing
