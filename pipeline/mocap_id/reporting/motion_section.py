"""Page section on the motion of the masses: pinned chain or measured poses, and the effect of pinned joints."""

from __future__ import annotations

import math

from mocap_id.reporting.dynamics_schema import ChannelEntry, GapEntry, MotionEntry
from mocap_id.reporting.numbers import show, show_fixed
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import Summary
from mocap_id.reporting.tables import Grid, facts, grid, in_band, millimetres

_COMPONENTS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}
_CONFIGURED = "it is configured"


def text(data: ReportData, summary: Summary) -> tuple[str, ...]:
    """Describe which motion was chosen and why, and the result of the comparison."""
    motion = summary.dynamics.motion
    if motion is None:
        return ()
    if motion.source == "chain":
        return (_of_chain(motion),)
    chosen = (
        f"In the dynamics, every body moves as its own markers were measured, because {motion.why}. Pinned joints "
        "would hide this movement. Skeleton, lengths and angles are still those of the pinned chain."
    )
    return chosen, _compared(data, summary)


def cost(data: ReportData, summary: Summary) -> Grid:
    """Return the errors on left-out repetitions and the clock offset, for the pinned chain and measured poses."""
    found = summary.dynamics.pins
    sides = (
        ("pinned chain", found.chain, found.clock_offset_s),
        ("measured poses", found.segments, summary.dynamics.clock_offset_s),
    )
    rows = [
        (
            name,
            *(show(_rms(of.wrench.get(part))) for part in _COMPONENTS),
            millimetres(of.cop_rms_m),
            show_fixed(None if clock is None else 1e3 * clock, 2),
        )
        for name, of, clock in sides
        if of is not None
    ]
    head = ("motion", *(f"{part} ({unit})" for part, unit in _COMPONENTS.items()), "centre of pressure (mm)")
    caption = f"Pinned chain and measured poses: rms error on left-out repetitions, {in_band(data)}"
    return grid(caption, (*head, "clock offset (ms)"), rows)


def joints(data: ReportData, summary: Summary) -> Grid:
    """Return the gap of each joint and whether it is pinned in the dynamics; empty for the pinned chain."""
    motion = summary.dynamics.motion
    if motion is None or motion.source == "chain":
        return grid("", (), ())
    rigid = _within_a_body(data)
    rows = [
        (name, millimetres(gap.gap_m), show(gap.acceleration_m_s2), _treatment(gap, rigid.get(name)))
        for name, gap in (motion.joints or {}).items()
    ]
    head = ("joint", "gap (mm)", "acceleration below 3 Hz (m/s²)", "in the dynamics")
    caption = "Gap between the two sides of each joint (rms). Up to 0.03 m/s² counts as noise; the joint is pinned"
    return grid(caption, head, rows, (0, 3))


def poses(summary: Summary) -> Grid:
    """Return bodies, cut-off frequencies and prior of a fit to measured poses; empty for the pinned chain."""
    motion = summary.dynamics.motion
    if motion is None or motion.source == "chain":
        return grid("", (), ())
    cutoffs = {f"cut-off frequency for {axis} (Hz)": f"{cutoff:g}" for axis, cutoff in (motion.bands_hz or {}).items()}
    values = {
        "bodies": motion.bodies,
        **cutoffs,
        "reason for these cut-off frequencies": motion.bands_why,
        "source of the loose prior of the body parameters": motion.prior,
    }
    return facts("Measured poses", values)


def _of_chain(motion: MotionEntry) -> str:
    """Return one sentence with the gaps, if known."""
    why = _CONFIGURED if motion.why == "asked for" else motion.why
    gaps = ", ".join(
        f"{name} {millimetres(gap.gap_m)} mm and {show(gap.acceleration_m_s2, 2)} m/s²"
        for name, gap in (motion.joints or {}).items()
    )
    return f"The masses move with the pinned chain, because {why}" + (f" (rms gaps: {gaps})." if gaps else ".")


def _compared(data: ReportData, summary: Summary) -> str:
    """Compare the errors of the pinned chain with those of the measured poses."""
    found, own = summary.dynamics.pins, summary.dynamics.clock_offset_s
    if found.chain is None or found.segments is None:
        return f"The effect of pinned joints is unknown: {found.why}."
    pairs = {
        **{part: (_rms(found.chain.wrench.get(part)), _rms(found.segments.wrench.get(part))) for part in _COMPONENTS},
        "the centre of pressure": (found.chain.cop_rms_m, found.segments.cop_rms_m),
    }
    ratios = ", ".join(
        f"{show_fixed(pinned / free, 1)} times as large for {name}"
        for name, (pinned, free) in pairs.items()
        if pinned and free
    )
    clock = (
        f" The two clock offsets differ by {show_fixed(1e3 * abs(found.clock_offset_s - own), 1)} ms."
        if found.clock_offset_s is not None and own is not None
        else ""
    )
    motion = summary.dynamics.motion
    others = ", and no body for the other markers (arms, head)" if motion and "others" in (motion.bodies or ()) else ""
    return (
        f"Both motions were used to predict left-out repetitions, on the same {found.samples} samples, "
        f"{in_band(data)}. With the pinned chain the error is {ratios}. Not all of this is due to the pins, because "
        f"the chain has its own smoothing and fit{others}.{clock}"
    )


def _rms(channel: ChannelEntry | None) -> float | None:
    if channel is None or channel.bias is None or channel.sd is None:
        return None
    return math.hypot(channel.bias, channel.sd)


def _treatment(gap: GapEntry, body: str | None) -> str:
    if body is not None:
        return f"inside one body ({body})"
    return "pinned" if gap.pinned else "free"


def _within_a_body(data: ReportData) -> dict[str, str]:
    """Return the joints whose two segments belong to one body of the dynamics, with the name of that body."""
    bodies = data.facts("poses.parquet").get("bodies") or ()
    used = (data.facts("dynamics.h5").get("motion") or {}).get("used") or ()
    own = [bodies[k] for k in used if k < len(bodies)]
    names = data.skeleton.joints if data.skeleton is not None else ()
    return {
        name: str(body["name"]) for j, name in enumerate(names) for body in own if {j, j + 1} <= set(body["segments"])
    }
