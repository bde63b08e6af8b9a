"""The report's tables as text, row by row; how they look is the page's business."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.dynamics_shape import ChannelEntry
from mocap_id.reporting.material import Material
from mocap_id.reporting.numbers import UNKNOWN, known, show, show_beside, show_fixed, show_interval, show_with_sd
from mocap_id.reporting.shape import Summary

_SUFFIXES = {"s": "s", "m": "m", "hz": "Hz", "deg": "deg", "kg": "kg", "N": "N"}
"""Units at the end of the facts' keys."""
_WRENCH = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class Grid:
    """A table: its caption, the column heads and the rows; ``text`` columns are set left, the others right."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})


def grid(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]], text: Iterable[int] = (0,)) -> Grid:
    """A table whose cells hold nothing that does not print."""
    clean = tuple(tuple(style.printable(cell) for cell in row) for row in rows)
    return Grid(caption, tuple(head), clean, frozenset(text))


def joints(summary: Summary) -> Grid:
    """Where the joints are and how far they turn."""
    names = summary.segments.names or []
    rows = []
    for joint in summary.joints or ():
        parent = names[joint.parent] if 0 <= joint.parent < len(names) else str(joint.parent)
        x, y = joint.centre_m or (None, None)
        sx, sy = joint.sd_m or (None, None)
        rows.append((joint.name, parent, show_with_sd(x, sx), show_with_sd(y, sy), show_fixed(joint.arc_deg, 1)))
    head = ("joint", "fixed to", "x (m)", "y (m)", "arc (deg)")
    return grid("Joint centres in the frame of the segment before, ± one standard deviation", head, rows, (0, 1))


def lengths(summary: Summary) -> Grid:
    """Distances between joints."""
    rows = [(name, show_with_sd(entry.value, entry.sd)) for name, entry in (summary.lengths_m or {}).items()]
    return grid("Segment lengths, joint to joint, ± one standard deviation", ("segment", "length (m)"), rows)


def in_band(material: Material) -> str:
    """In which band model and measurement are compared."""
    return "unfiltered" if material.low_pass is None else f"below {material.low_pass:g} Hz"


def agreement(material: Material, summary: Summary) -> Grid:
    """How far the model's wrench is from the measured one."""
    units = {"Fx": "N", "Fy": "N", "tauz": "N·m"}
    rows = [
        (
            f"{name} ({units[name]})" if name in units else name,
            show(channel.bias),
            show(channel.sd),
            show_fixed(channel.r2, 4),
        )
        for name, channel in (summary.dynamics.wrench or {}).items()
    ]
    caption = f"Model against measurement over the samples of the fit, {in_band(material)}"
    return grid(caption, ("component", "bias", "standard deviation", "r²"), rows)


def rivals(material: Material, summary: Summary) -> Grid:
    """How far the bodies of the tables of people are from the measured wrench, beside the model."""
    dynamics = summary.dynamics
    bodies = {"identified model": (dynamics.wrench or {}, dynamics.cop_rms_m)} if dynamics.rivals else {}
    bodies |= {name: (rival.wrench, rival.cop_rms_m) for name, rival in dynamics.rivals.items()}
    rows = [
        (
            name,
            *(
                f"{show(wrench[part].bias)} ± {show(wrench[part].sd)}" if part in wrench else UNKNOWN
                for part in _WRENCH
            ),
            millimetres(cop),
        )
        for name, (wrench, cop) in bodies.items()
    ]
    head = ("body", "Fx (N)", "Fy (N)", "tauz (N·m)", "centre of pressure, rms (mm)")
    caption = f"Model and allometric bodies against measurement, {in_band(material)}: bias ± standard deviation"
    return grid(caption, head, rows)


def held_out(material: Material, summary: Summary) -> Grid:
    """How far repetitions are off that the model was not fitted to, beside the fit's own error and the reference's."""
    found, low_pass = summary.dynamics.held_out, material.low_pass
    errors = {
        "models fitted without the repetition": found.model,
        "the same, unfiltered": None if low_pass is None else found.unfiltered,
        "model of the whole trial": found.in_sample,
        "allometric body": found.reference,
    }
    rows = [
        (
            name,
            *(_bias_and_sd(channels.get(part)) for part in _WRENCH),
            _bias_and_sd(channels.get("cop_x"), 1e3),
        )
        for name, channels in errors.items()
        if channels
    ]
    if found.inside is not None:
        shares = (percent(found.inside.get(part)) for part in (*_WRENCH, "cop_x"))
        rows.append(("samples inside the 95 % interval (%)", *shares))
    caption = (
        f"Repetitions left out of the fit and predicted, {in_band(material)}: bias ± standard deviation over "
        f"{found.samples} samples, {found.folds} fits for {found.repetitions} repetitions"
        if rows
        else ""
    )
    return grid(caption, ("predicted by", "Fx (N)", "Fy (N)", "tauz (N·m)", "centre of pressure (mm)"), rows)


def _bias_and_sd(channel: ChannelEntry | None, factor: float = 1.0) -> str:
    if channel is None or channel.bias is None or channel.sd is None:
        return UNKNOWN
    return f"{show(factor * channel.bias)} ± {show(factor * channel.sd)}"


def base_parameters(material: Material, summary: Summary) -> Grid:
    """The identified parameters with their intervals, beside the reference's."""
    dynamics = material.dynamics
    rows = []
    if dynamics is not None:
        for entry, reference in zip(summary.dynamics.base or (), dynamics.base_reference, strict=False):
            rows.append(
                (
                    entry.name,
                    show_with_sd(entry.value, entry.sd),
                    show_interval(entry.value, entry.sd),
                    show_beside(reference, entry.sd),
                    style.unit(entry.unit),
                    entry.verdict or UNKNOWN,
                    *([percent(entry.prior_share)] if material.measured_poses else []),
                )
            )
    head = ("parameter", "value ± sd", "95 % interval", "reference", "unit", "verdict")
    if not material.measured_poses:
        return grid("Base parameters", head, rows, (0, 4, 5))
    caption = "Base parameters; the last column is the share of the precision that comes from the loose prior"
    return grid(caption, (*head, "of which prior (%)"), rows, (0, 4, 5))


def excitation(summary: Summary) -> Grid:
    """How much the movement tells of each base parameter, and which one would tell more."""
    rows = [
        (
            entry.name,
            entry.verdict or UNKNOWN,
            percent(entry.relative_sd),
            show(entry.excitation, 3),
            percent(entry.own_share),
            entry.helps or UNKNOWN,
            UNKNOWN if entry.sd_ratio is None else f"× {show(entry.sd_ratio, 2)}",
        )
        for entry in summary.dynamics.base or ()
        if entry.excitation is not None
    ]
    caption = (
        "How much the movement tells of each base parameter: standard deviation by size; norm of the part of its "
        "column that no other column can imitate, in residual standard deviations for one SI unit, and its share"
    )
    head = ("parameter", "verdict", "sd (%)", "excitation", "own share (%)", "what would tell more", "its sd then")
    return grid(caption, head, rows, (0, 1, 5))


def plates(material: Material) -> Grid:
    """What each force plate was taken for."""
    rows = [
        (
            str(plate.get("index", "")),
            str(plate.get("kind", "")),
            str(plate.get("use", "")),
            show_fixed(plate.get("mean_vertical_N"), 1),
            str(plate.get("why", "")),
        )
        for plate in material.facts("wrench.parquet").get("plates") or ()
    ]
    head = ("plate", "kind", "taken for", "mean vertical force (N)", "why")
    return grid("Force plates and what they were taken for", head, rows, (0, 1, 2, 4))


def markers(material: Material) -> Grid:
    """Every marker: its segment, why, and how well the chain predicts it."""
    segments = material.table("segments.parquet")
    if segments is None:
        return grid("Markers", (), ())
    names = dict(enumerate(material.segment_names))
    rows = []
    for label, segment, rigid, reason in zip(
        *(segments[name].tolist() for name in ("marker", "segment", "residual", "reason")), strict=True
    ):
        found = material.residuals.get(label)
        chain = (None, None, None) if found is None else (found.rms, found.q95, found.seen)
        own = "none" if segment < 0 else names.get(segment, str(segment))
        rows.append((label, own, *map(millimetres, (rigid, *chain[:2])), percent(chain[2]), reason))
    head = ("marker", "segment", "rigid (mm)", "chain (mm)", "95 % (mm)", "seen (%)", "why")
    caption = "Markers: rms distance from the rigid segment, rms and 95 % distance from the chain's prediction"
    return grid(caption, head, rows, (0, 1, 6))


def facts(caption: str, values: Mapping[str, Any]) -> Grid:
    """Names and values, those that are known; nested ones with a dotted name."""
    return grid(caption, ("what", "value"), _flat(values, ""), (0, 1))


def _flat(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{_words(key)}: ")
        elif value not in (None, "", UNKNOWN, [], ()):
            yield above + _words(key), _cell(value)


def _words(key: str) -> str:
    """A fact's key for people: ``window_s`` as window (s)."""
    if not key.isidentifier():
        return key
    stem, _, suffix = key.rpartition("_")
    return f"{stem.replace('_', ' ')} ({_SUFFIXES[suffix]})" if suffix in _SUFFIXES and stem else key.replace("_", " ")


def _cell(value: object) -> str:
    """Any JSON value as a short text."""
    match value:
        case None:
            return UNKNOWN
        case bool():
            return "yes" if value else "no"
        case int():
            return str(value)
        case float():
            return show(value, 4)
        case Mapping():
            return ", ".join(f"{key}: {_cell(item)}" for key, item in value.items())
        case list() | tuple():
            nested = any(isinstance(item, (list, tuple)) for item in value)
            return (" | " if nested else ", ").join(_cell(item) for item in value)
    return str(value)


def millimetres(metres: object) -> str:
    """A length as millimetres with one decimal."""
    number = known(metres)
    return UNKNOWN if number is None else show_fixed(1e3 * number, 1)


def percent(share: object) -> str:
    """A share as per cent with one decimal."""
    number = known(share)
    return UNKNOWN if number is None else show_fixed(100 * number, 1)
