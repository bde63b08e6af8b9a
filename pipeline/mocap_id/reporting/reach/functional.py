"""What the tip of several joints can be held at, with springs and without."""

from __future__ import annotations

from matplotlib.figure import Figure

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.reporting import paper, style


def draw(tips: FloatArray, without: BoolArray, held: BoolArray, joint: FloatArray) -> Figure:
    """Two panels of sampled postures.

    Parameters
    ----------
    tips : (N, 2) array
        Where each posture has the tip, m.
    without, held : (N,) bool arrays
        Which of them can be held without springs, and with them.
    joint : (2,) array
        The first joint, m.
    """
    figure = paper.blank(3.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    kinds = (("without springs", without, style.VERMILLION), ("with springs", held, style.GREEN))
    for axes, (title, which, colour) in zip(panels, kinds, strict=True):
        axes.plot(*tips[~which].T, ".", ms=1.2, color=style.FAINT, rasterized=True)
        axes.plot(*tips[which].T, ".", ms=2.2, color=colour, rasterized=True)
        axes.plot(*joint, "o", ms=5, mfc="none", mec=style.INK)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(title=title, xlabel="x (m)")
    panels[0].set_ylabel("y, up (m)")
    return figure
