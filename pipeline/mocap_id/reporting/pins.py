"""The page's part on the motion of the masses: pinned chain or measured poses, and what pins cost on this trial."""

from __future__ import annotations

import math

from mocap_id.reporting.dynamics_shape import ChannelEntry, GapEntry, MotionEntry
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import show, show_fixed
from mocap_id.reporting.shape import Summary
from mocap_id.reporting.tables import Grid, facts, grid, in_band, millimetres

_COMPONENTS = {"Fx": "N", "Fy": "N", "tauz": "N·m"}
_ASKED = "the settings ask for it"


def text(material: Material, summary: Summary) -> tuple[str, ...]:
    """In plain words: which motion was chosen and why, and what the comparison says."""
    motion = summary.dynamics.motion
    if motion is None:
        return ()
    if motion.source == "chain":
        return (_of_chain(motion),)
    chosen = (
        f"Every body moves as its own markers were measured, because {motion.why}. Pins would hide this movement from "
        "the dynamics. Skeleton, lengths and angles are still those of the pinned chain."
    )
    return chosen, _compared(material, summary)


def cost(material: Material, summary: Summary) -> Grid:
    """Errors on left-out repetitions with pins and on measured poses, and the clock offset that each finds."""
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
    caption = f"Pinned chain and measured poses: rms error on left-out repetitions, {in_band(material)}"
    return grid(caption, (*head, "clock offset (ms)"), rows)


def joints(material: Material, summary: Summary) -> Grid:
    """How far the two sides of each joint part, and which joints the dynamics pin; nothing for the pinned chain."""
    motion = summary.dynamics.motion
    if motion is None or motion.source == "chain":
        return grid("", (), ())
    rigid = _within_a_body(material)
    rows = [
        (name, millimetres(gap.gap_m), show(gap.acceleration_m_s2), _treated(gap, rigid.get(name)))
        for name, gap in (motion.joints or {}).items()
    ]
    head = ("joint", "gap (mm)", "acceleration below 3 Hz (m/s²)", "in the dynamics")
    caption = "Gap between the two sides of each joint, rms; up to 0.03 m/s² it counts as noise and the joint is pinned"
    return grid(caption, head, rows, (0, 3))


def poses(summary: Summary) -> Grid:
    """Bodies, bands and prior of the fit on measured poses; nothing for the pinned chain."""
    motion = summary.dynamics.motion
    if motion is None or motion.source == "chain":
        return grid("", (), ())
    cutoffs = {f"cut-off of {axis} (Hz)": f"{cutoff:g}" for axis, cutoff in (motion.bands_hz or {}).items()}
    values = {
        "bodies": motion.bodies,
        **cutoffs,
        "these cut-offs, because": motion.bands_why,
        "mean of the loose prior of the bodies' parameters": motion.prior,
    }
    return facts("Measured poses", values)


def _of_chain(motion: MotionEntry) -> str:
    """One sentence with the gaps, where they are known."""
    why = _ASKED if motion.why == "asked for" else motion.why
    gaps = ", ".join(
        f"{name} {millimetres(gap.gap_m)} mm and {show(gap.acceleration_m_s2, 2)} m/s²"
        for name, gap in (motion.joints or {}).items()
    )
    return f"The masses move as the pinned chain, because {why}" + (f" (rms: {gaps})." if gaps else ".")


def _compared(material: Material, summary: Summary) -> str:
    """The pinned chain's errors as multiples of those of the measured poses."""
    found, own = summary.dynamics.pins, summary.dynamics.clock_offset_s
    if found.chain is None or found.segments is None:
        return f"What pins would cost is not known: {found.why}."
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
    others = ", and no body of the other markers (arms, head)" if motion and "others" in (motion.bodies or ()) else ""
    return (
        f"Each motion predicts repetitions that its fit did not see, on the same {found.samples} samples, "
        f"{in_band(material)}. On the pinned chain the error is {ratios}. Not all of this is due to the pins: that "
        f"chain has its own smoothing and fit{others}.{clock}"
    )


def _rms(channel: ChannelEntry | None) -> float | None:
    if channel is None or channel.bias is None or channel.sd is None:
        return None
    return math.hypot(channel.bias, channel.sd)


def _treated(gap: GapEntry, body: str | None) -> str:
    if body is not None:
        return f"inside one body ({body})"
    return "pinned" if gap.pinned else "free"


def _within_a_body(material: Material) -> dict[str, str]:
    """Joints whose two segments are one body of the dynamics, with its name."""
    bodies = material.facts("poses.parquet").get("bodies") or ()
    used = (material.facts("dynamics.h5").get("motion") or {}).get("used") or ()
    own = [bodies[k] for k in used if k < len(bodies)]
    names = material.skeleton.joints if material.skeleton is not None else ()
    return {
        name: str(body["name"]) for j, name in enumerate(names) for body in own if {j, j + 1} <= set(body["segments"])
    }
