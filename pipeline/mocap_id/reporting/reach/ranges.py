"""One joint with and without its spring: the range on a dial, and the torque that holds it (figures 7.6 to 7.8)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mocap_id.prescription.one_joint import OneJoint
from mocap_id.prescription.one_spring import Prescription
from mocap_id.reporting import paper, style


def draw(joint: OneJoint, found: Prescription) -> Figure:
    """Dial (0 hangs down where gravity pulls with the sine) and torques over the angle."""
    figure = paper.blank(3.0)
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 2))
    dial: Any = figure.add_subplot(grid[0, 0], projection="polar")
    dial.set_theta_zero_location("S")
    bands = [("joint limits", (joint.lower, joint.upper), style.BLUE, 1.0), ("with", found.range, style.GREEN, 0.6)]
    if found.without is not None:
        bands.insert(1, ("without a spring", found.without, style.VERMILLION, 0.8))
    for label, (low, high), colour, radius in bands:
        angle = np.linspace(low, high, 181)
        dial.plot(angle, np.full_like(angle, radius), color=colour, lw=5, label=label, solid_capstyle="butt")
    dial.set_rticks([])
    dial.set_ylim(0, 1.1)
    axes = figure.add_subplot(grid[0, 1])
    angle = np.linspace(joint.lower, joint.upper, 361)
    axes.plot(np.degrees(angle), joint.gravity(angle), color=style.VERMILLION, label="without a spring")
    if found.helps:
        torque = joint.torque(angle, found.stiffness, found.rest)
        axes.plot(np.degrees(angle), torque, color=style.GREEN, label="with")
        axes.axvspan(*np.degrees(found.range), color=style.GREEN, alpha=0.12, lw=0)
    for limit in (joint.torque_low, joint.torque_high):
        axes.axhline(limit, color=style.INK, ls="--", lw=0.8)
    spring = f"{found.stiffness:.3g} N·m/rad, rest {np.degrees(found.rest):.1f}°" if found.helps else "no spring helps"
    axes.set(title=spring, xlabel="angle (°)", ylabel="torque that holds it (N·m)")
    paper.legend_above(figure, [dial])
    return figure
