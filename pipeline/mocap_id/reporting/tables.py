"""Tables of the report as rows of text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mocap_id.reporting import style
from mocap_id.reporting.dynamics_schema import ChannelEntry
from mocap_id.reporting.numbers import UNKNOWN, known, show, show_beside, show_fixed, show_interval, show_with_sd
from mocap_id.reporting.report_data import ReportData
from mocap_id.reporting.summary_schema import Summary

_SUFFIXES = {"s": "s", "m": "m", "hz": "Hz", "deg": "deg", "kg": "kg", "N": "N"}
"""Units in the suffixes of fact keys."""
_LABELS = {
    "arc_deg": "arcs of the joints in the fitted samples (deg)",
    "asked": "requested",
    "asymmetry_deg": "angle between left and right (deg)",
    "bridged_fraction": "share of bridged samples",
    "condition_number_scaled": "condition number with unit-norm columns",
    "count": "number of segments",
    "cutoff_hz": "low-pass cut-off (Hz)",
    "dual": "dual residual",
    "kkt": "KKT residual",
    "missing_fraction": "share of missing samples",
    "noise_floor_m": "movement of still markers (m)",
    "outlier_fraction": "share of outliers",
    "price_of_consistency": "relative cost of physical consistency",
    "primal": "primal residual",
    "proven": "optimality proven",
    "reference_pulls": "reference body used as a prior",
    "reprojection_rms_m": "reprojection error, rms (m)",
    "samples": "number of samples",
    "sd_holds": "standard deviations include",
    "static_gap": "movement of moving over still markers",
    "untold": "torques not determined",
    "window_proposed": "window chosen automatically",
}
"""Labels of fact keys that do not explain themselves."""
_WRENCH = ("Fx", "Fy", "tauz")


@dataclass(frozen=True)
class Grid:
    """A table of the page: caption, column headings and rows; ``text`` columns are left-aligned."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: frozenset[int] = frozenset({0})


def grid(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]], text: Iterable[int] = (0,)) -> Grid:
    """Make a table, with unprintable characters in its cells replaced."""
    clean = tuple(tuple(style.printable(cell) for cell in row) for row in rows)
    return Grid(caption, tuple(head), clean, frozenset(text))


def joints(summary: Summary) -> Grid:
    """Return the joint centres and arcs."""
    names = summary.segments.names or []
    rows = []
    for joint in summary.joints or ():
        parent = names[joint.parent] if 0 <= joint.parent < len(names) else str(joint.parent)
        x, y = joint.centre_m or (None, None)
        sx, sy = joint.sd_m or (None, None)
        rows.append((joint.name, parent, show_with_sd(x, sx), show_with_sd(y, sy), show_fixed(joint.arc_deg, 1)))
    head = ("joint", "fixed to", "x (m)", "y (m)", "arc (deg)")
    return grid("Joint centres in the frame of the previous segment, ± one standard deviation", head, rows, (0, 1))


def lengths(summary: Summary) -> Grid:
    """Return the segment lengths."""
    rows = [(name, show_with_sd(entry.value, entry.sd)) for name, entry in (summary.lengths_m or {}).items()]
    return grid("Segment lengths, joint to joint, ± one standard deviation", ("segment", "length (m)"), rows)


def in_band(data: ReportData) -> str:
    """Return the frequency band in which model and measurement are compared, in words."""
    return "unfiltered" if data.low_pass is None else f"below {data.low_pass:g} Hz"


def agreement(data: ReportData, summary: Summary) -> Grid:
    """Return the error of the modelled wrench."""
    units = {**dict.fromkeys(("Fx", "Fy", "Fz"), "N"), **dict.fromkeys(("taux", "tauy", "tauz"), "N·m")}
    rows = [
        (
            f"{name} ({units[name]})" if name in units else name,
            show(channel.bias),
            show(channel.sd),
            show_fixed(channel.r2, 4),
        )
        for name, channel in (summary.dynamics.wrench or {}).items()
    ]
    caption = f"Error of the model over the samples of the fit, {in_band(data)}"
    return grid(caption, ("component", "bias", "standard deviation", "r²"), rows)


def rivals(data: ReportData, summary: Summary) -> Grid:
    """Return the errors of the allometric bodies and of the model."""
    dynamics = summary.dynamics
    bodies = {"identified model": (dynamics.wrench or {}, dynamics.cop_rms_m)} if dynamics.rivals else {}
    bodies |= {name: (rival.wrench, rival.cop_rms_m) for name, rival in dynamics.rivals.items()}
    rows = [
        (
            name,
            *(_bias_and_sd(wrench.get(part)) for part in _WRENCH),
            millimetres(cop),
        )
        for name, (wrench, cop) in bodies.items()
    ]
    head = ("body", "Fx (N)", "Fy (N)", "tauz (N·m)", "centre of pressure, rms (mm)")
    caption = f"Errors of the model and of allometric bodies, {in_band(data)}: bias ± standard deviation"
    return grid(caption, head, rows)


def held_out(data: ReportData, summary: Summary) -> Grid:
    """Return the prediction errors on left-out repetitions, of the fit and of the reference body."""
    found, low_pass = summary.dynamics.held_out, data.low_pass
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
        rows.append(("samples within the 95 % interval (%)", *shares))
    caption = (
        f"Prediction errors on left-out repetitions, {in_band(data)}: bias ± standard deviation over "
        f"{found.samples} samples, {found.folds} fits for {found.repetitions} repetitions"
        if rows
        else ""
    )
    return grid(caption, ("predicted by", "Fx (N)", "Fy (N)", "tauz (N·m)", "centre of pressure (mm)"), rows)


def _bias_and_sd(channel: ChannelEntry | None, factor: float = 1.0) -> str:
    if channel is None or channel.bias is None or channel.sd is None:
        return UNKNOWN
    return f"{show(factor * channel.bias)} ± {show(factor * channel.sd)}"


def base_parameters(data: ReportData, summary: Summary) -> Grid:
    """Return the identified parameters with intervals and reference values."""
    dynamics = data.dynamics
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
                    *([percent(entry.prior_share)] if data.measured_poses else []),
                )
            )
    head = ("parameter", "value ± sd", "95 % interval", "reference", "unit", "verdict")
    if not data.measured_poses:
        return grid("Base parameters", head, rows, (0, 4, 5))
    caption = "Base parameters; the last column is the share of the loose prior in the precision"
    return grid(caption, (*head, "share of prior (%)"), rows, (0, 4, 5))


def excitation(summary: Summary) -> Grid:
    """Return how well the movement determines each base parameter, and which movement would improve it."""
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
        "Excitation of each base parameter: standard deviation relative to its size; norm of the part of its regressor "
        "column that is independent of the others, in residual standard deviations per SI unit; share of that part"
    )
    head = (
        "parameter",
        "verdict",
        "sd (%)",
        "excitation",
        "own share (%)",
        "movement that would help",
        "factor on the sd",
    )
    return grid(caption, head, rows, (0, 1, 5))


def plates(data: ReportData) -> Grid:
    """Return the detected use of each force plate."""
    rows = [
        (
            str(plate.get("index", "")),
            str(plate.get("kind", "")),
            str(plate.get("use", "")),
            show_fixed(plate.get("mean_vertical_N"), 1),
            str(plate.get("why", "")),
        )
        for plate in data.facts("wrench.parquet").get("plates") or ()
    ]
    head = ("plate", "type", "use", "mean vertical force (N)", "reason")
    return grid("Force plates and their detected use", head, rows, (0, 1, 2, 4))


def markers(data: ReportData) -> Grid:
    """Return segment, reason and prediction error of each marker."""
    segments = data.table("segments.parquet")
    if segments is None:
        return grid("Markers", (), ())
    names = dict(enumerate(data.segment_names))
    rows = []
    for label, segment, rigid, reason in zip(
        *(segments[name].tolist() for name in ("marker", "segment", "residual", "reason")), strict=True
    ):
        found = data.residuals.get(label)
        chain = (None, None, None) if found is None else (found.rms, found.q95, found.seen)
        own = "none" if segment < 0 else names.get(segment, str(segment))
        rows.append((label, own, *map(millimetres, (rigid, *chain[:2])), percent(chain[2]), reason))
    head = ("marker", "segment", "rigid (mm)", "chain (mm)", "95 % (mm)", "visible (%)", "reason")
    caption = "Markers: rms distance from the rigid segment; rms and 95 % quantile of the distance from the chain"
    return grid(caption, head, rows, (0, 1, 6))


def facts(caption: str, values: Mapping[str, Any]) -> Grid:
    """Return a table of the known values; nested keys are joined by colons, and matrices are left out."""
    return grid(caption, ("quantity", "value"), _flat(values, ""), (0, 1))


def _flat(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{_readable(key)}: ")
        elif value not in (None, "", UNKNOWN, [], ()) and not _is_matrix(value):
            yield above + _readable(key), _cell(value)


def _is_matrix(value: object) -> bool:
    rows = value if isinstance(value, list) else []
    return any(isinstance(row, list) and any(isinstance(item, float) for item in row) for row in rows)


def _readable(key: str) -> str:
    """Return the key of a fact as readable text: ``window_s`` as window (s)."""
    if key in _LABELS or not key.isidentifier():
        return _LABELS.get(key, key)
    stem, _, suffix = key.rpartition("_")
    return f"{stem.replace('_', ' ')} ({_SUFFIXES[suffix]})" if suffix in _SUFFIXES and stem else key.replace("_", " ")


def _cell(value: object) -> str:
    """Format any JSON value as short text."""
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
    """Format a length in millimetres with one decimal."""
    number = known(metres)
    return UNKNOWN if number is None else show_fixed(1e3 * number, 1)


def percent(share: object) -> str:
    """Format a share in per cent with one decimal."""
    number = known(share)
    return UNKNOWN if number is None else show_fixed(100 * number, 1)
