"""Differences between two summaries: verdict, segments, joints, noise, parameters, fit, events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.workflows.compare.difference import Difference, compare_entries, compare_numbers

Summary = Mapping[str, Any]
_NOISE = (
    ("markers", "reprojection_rms_mm", "mm"),
    ("markers", "missing_fraction", ""),
    ("noise", "marker_sd_m", "m"),
    ("noise", "sigma_v", "rad/s^4"),
)
_FIT = {"condition_number": "", "condition_number_scaled": "", "mass_kg": "kg", "cop_rms_m": "m", "samples": ""}
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N*m", "tauy": "N*m", "tauz": "N*m"}


def compare_results(a: Summary, b: Summary) -> Iterator[Difference]:
    """Yield the differences between two summaries."""
    yield from _compare_verdicts(a["verdict"], b["verdict"])
    yield from _compare_segments(a["segments"], b["segments"])
    yield from _compare_joints(_by_name(a["joints"]), _by_name(b["joints"]))
    for name, one, other in _pair(a["lengths_m"] or {}, b["lengths_m"] or {}):
        yield _compare_key("lengths", name, one, other, "value", unit="m", sd="sd")
    for name, one, other in _pair(a.get("angles") or {}, b.get("angles") or {}):
        yield _compare_key("angles", f"{name} range", one, other, "range_deg", unit="deg")
    for group, key, unit in _NOISE:
        yield _compare_key("noise", key, a[group], b[group], key, unit=unit)
    for name, one, other in _pair(_by_name(a["dynamics"]["base"]), _by_name(b["dynamics"]["base"])):
        unit = str(one.get("unit") or other.get("unit"))
        yield _compare_key("base parameters", name, one, other, "value", unit=unit, sd="sd")
        yield Difference("base parameters", f"{name} verdict", one.get("verdict"), other.get("verdict"))
    yield from _compare_fit(a["dynamics"], b["dynamics"])
    yield from _compare_events(a["repetitions"] or (), b["repetitions"] or ())


def _by_name(entries: Sequence[Summary] | None) -> dict[str, Summary]:
    return {entry["name"]: entry for entry in entries or ()}


def _pair(a: Summary, b: Summary) -> Iterator[tuple[str, Summary, Summary]]:
    """Yield each name with its entries in ``a`` and ``b``; an entry is empty if the mapping does not have the name."""
    for name in dict.fromkeys((*a, *b)):
        yield name, a.get(name, {}), b.get(name, {})


def _compare_key(
    section: str, name: str, a: Summary, b: Summary, key: str, *, unit: str = "", sd: str = ""
) -> Difference:
    """Return the difference of the numbers at ``key`` in two entries; ``sd`` is the key of the standard deviation."""
    return compare_numbers(section, name, a.get(key), b.get(key), unit, sds=(a.get(sd), b.get(sd)))


def _compare_verdicts(a: Summary, b: Summary) -> Iterator[Difference]:
    yield Difference("verdict", "level", a["level"], b["level"])
    for key, one, other in _pair(_number_reasons(a), _number_reasons(b)):
        if not one or not other:
            name = f"{key} {'lost' if one else 'gained'}"
            yield Difference("verdict", name, one.get("message"), other.get("message"))
        elif one["value"] is None and other["value"] is None:
            yield Difference("verdict", key, one["message"], other["message"])
        else:
            yield _compare_key("verdict", key, one, other, "value")


def _number_reasons(verdict: Summary) -> dict[str, Summary]:
    """Return the reasons for a verdict by code; a repeated code gets a number."""
    reasons: dict[str, Summary] = {}
    for reason in (*verdict["reasons"], *verdict.get("notes", ())):
        key, number = reason["code"], 2
        while key in reasons:
            key, number = f"{reason['code']} {number}", number + 1
        reasons[key] = reason
    return reasons


def _compare_segments(a: Summary, b: Summary) -> Iterator[Difference]:
    yield _compare_key("segments", "count", a, b, "count")
    yield _compare_key("segments", "confidence", a, b, "confidence")
    yield Difference("segments", "names", ", ".join(a["names"] or ()), ", ".join(b["names"] or ()))
    yield from compare_entries("markers", dict(a["assignment"] or {}), dict(b["assignment"] or {}))


def _compare_joints(a: Summary, b: Summary) -> Iterator[Difference]:
    for name, one, other in _pair(a, b):
        before, after = (_list_components(entry) for entry in (one, other))
        for axis in "xyz"[: max(len(before), len(after), 2)]:
            pair = before.get(axis, {}), after.get(axis, {})
            yield _compare_key("joints", f"{name} {axis}", *pair, "value", unit="m", sd="sd")
        yield _compare_key("joints", f"{name} arc", one, other, "arc_deg", unit="deg")
        if one.get("kind") != other.get("kind"):
            yield Difference("joints", f"{name} kind", one.get("kind"), other.get("kind"))


def _list_components(joint: Summary) -> dict[str, Summary]:
    """Return the coordinates of a joint centre by axis, m, with their standard deviations if known."""
    centre, sd = joint.get("centre_m") or (), joint.get("sd_m") or ()
    return {
        axis: {"value": value, "sd": sd[k] if k < len(sd) else None}
        for k, (axis, value) in enumerate(zip("xyz", centre, strict=False))
    }


def _compare_fit(a: Summary, b: Summary) -> Iterator[Difference]:
    for key, unit in _FIT.items():
        yield _compare_key("fit", key, a, b, key, unit=unit)
    yield _compare_key("fit", "clock_offset_s", a, b, "clock_offset_s", unit="s", sd="clock_offset_sd_s")
    for name, one, other in _pair(a["wrench"] or {}, b["wrench"] or {}):
        for key, unit in (("bias", _UNITS[name]), ("sd", _UNITS[name]), ("r2", "")):
            yield _compare_key("fit", f"{name} {key}", one, other, key, unit=unit)


def _compare_events(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    yield compare_numbers("events", "repetitions", len(a), len(b))
    for k, (one, other) in enumerate(zip(a, b, strict=False), start=1):
        for key in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield _compare_key("events", f"repetition {k} {key.removesuffix('_s')}", one, other, key, unit="s")
