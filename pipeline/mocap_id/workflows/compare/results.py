"""Differences between two summaries: verdict, segments, joints, noise, parameters, fit, events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.workflows.compare.difference import Difference, compare_entries, compare_numbers

Summary = Mapping[str, Any]
_PLAIN = (
    ("markers", "reprojection_rms_mm", "mm"),
    ("markers", "missing_fraction", ""),
    ("noise", "marker_sd_m", "m"),
    ("noise", "sigma_v", "rad/s^4"),
)
_FIT = (
    ("condition_number", ""),
    ("condition_number_scaled", ""),
    ("mass_kg", "kg"),
    ("cop_rms_m", "m"),
    ("samples", ""),
)
_UNITS = {"Fx": "N", "Fy": "N", "Fz": "N", "taux": "N*m", "tauy": "N*m", "tauz": "N*m"}


def compare_results(a: Summary, b: Summary) -> Iterator[Difference]:
    """Yield the differences between two summaries."""
    yield from _compare_verdicts(a["verdict"], b["verdict"])
    yield from _compare_segments(a["segments"], b["segments"])
    yield from _compare_joints(a["joints"] or (), b["joints"] or ())
    yield from _compare_lengths(a["lengths_m"] or {}, b["lengths_m"] or {})
    yield from _compare_angles(a.get("angles") or {}, b.get("angles") or {})
    for group, key, unit in _PLAIN:
        yield compare_numbers("noise", key, a[group][key], b[group][key], unit)
    yield from _compare_base(a["dynamics"]["base"] or (), b["dynamics"]["base"] or ())
    yield from _compare_fit(a["dynamics"], b["dynamics"])
    yield from _compare_events(a["repetitions"] or (), b["repetitions"] or ())


def _compare_verdicts(a: Summary, b: Summary) -> Iterator[Difference]:
    yield Difference("verdict", "level", a["level"], b["level"])
    before, after = _number_reasons(a), _number_reasons(b)
    for key in dict.fromkeys((*before, *after)):
        one, other = before.get(key), after.get(key)
        if one is None or other is None:
            yield Difference(
                "verdict", f"{key} {'gained' if one is None else 'lost'}", _read_message(one), _read_message(other)
            )
        elif one["value"] is None and other["value"] is None:
            yield Difference("verdict", key, one["message"], other["message"])
        else:
            yield compare_numbers("verdict", key, one["value"], other["value"])


def _number_reasons(verdict: Summary) -> dict[str, Summary]:
    """Return the reasons of a verdict by code; repeated codes are numbered."""
    found: dict[str, Summary] = {}
    for reason in (*verdict["reasons"], *verdict.get("notes", ())):
        key, number = reason["code"], 2
        while key in found:
            key, number = f"{reason['code']} {number}", number + 1
        found[key] = reason
    return found


def _read_message(reason: Summary | None) -> str | None:
    return None if reason is None else str(reason["message"])


def _compare_segments(a: Summary, b: Summary) -> Iterator[Difference]:
    yield compare_numbers("segments", "count", a["count"], b["count"])
    yield compare_numbers("segments", "confidence", a["confidence"], b["confidence"])
    yield Difference("segments", "names", ", ".join(a["names"] or ()), ", ".join(b["names"] or ()))
    yield from compare_entries("markers", dict(a["assignment"] or {}), dict(b["assignment"] or {}))


def _compare_joints(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    for name, one, other in _pair(a, b):
        sizes = (len(entry.get("centre_m") or ()) for entry in (one, other))
        for k, axis in enumerate("xyz"[: max(*sizes, 2)]):
            yield compare_numbers(
                "joints",
                f"{name} {axis}",
                _read_component(one, "centre_m", k),
                _read_component(other, "centre_m", k),
                "m",
                sds=(_read_component(one, "sd_m", k), _read_component(other, "sd_m", k)),
            )
        yield compare_numbers("joints", f"{name} arc", one.get("arc_deg"), other.get("arc_deg"), "deg")
        if one.get("kind") != other.get("kind"):
            yield Difference("joints", f"{name} kind", one.get("kind"), other.get("kind"))


def _pair(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[tuple[str, Summary, Summary]]:
    """Yield the entries with the same name in both lists; an empty entry if a list has none of this name."""
    before, after = ({entry["name"]: entry for entry in entries} for entries in (a, b))
    for name in dict.fromkeys((*before, *after)):
        yield name, before.get(name, {}), after.get(name, {})


def _read_component(entry: Summary, key: str, k: int) -> float | None:
    values = entry.get(key)
    return None if values is None or k >= len(values) else values[k]


def _compare_lengths(a: Summary, b: Summary) -> Iterator[Difference]:
    for name in dict.fromkeys((*a, *b)):
        one, other = a.get(name, {}), b.get(name, {})
        sds = (one.get("sd"), other.get("sd"))
        yield compare_numbers("lengths", name, one.get("value"), other.get("value"), "m", sds=sds)


def _compare_angles(a: Summary, b: Summary) -> Iterator[Difference]:
    for name in dict.fromkeys((*a, *b)):
        one, other = (entry.get(name, {}).get("range_deg") for entry in (a, b))
        yield compare_numbers("angles", f"{name} range", one, other, "deg")


def _compare_base(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    for name, one, other in _pair(a, b):
        unit = str(one.get("unit") or other.get("unit"))
        sds = (one.get("sd"), other.get("sd"))
        yield compare_numbers("base parameters", name, one.get("value"), other.get("value"), unit, sds=sds)
        yield Difference("base parameters", f"{name} verdict", one.get("verdict"), other.get("verdict"))


def _compare_fit(a: Summary, b: Summary) -> Iterator[Difference]:
    for key, unit in _FIT:
        yield compare_numbers("fit", key, a[key], b[key], unit)
    sds = (a["clock_offset_sd_s"], b["clock_offset_sd_s"])
    yield compare_numbers("fit", "clock_offset_s", a["clock_offset_s"], b["clock_offset_s"], "s", sds=sds)
    before, after = a["wrench"] or {}, b["wrench"] or {}
    for name in dict.fromkeys((*before, *after)):
        one, other = before.get(name, {}), after.get(name, {})
        for key, unit in (("bias", _UNITS[name]), ("sd", _UNITS[name]), ("r2", "")):
            yield compare_numbers("fit", f"{name} {key}", one.get(key), other.get(key), unit)


def _compare_events(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    yield compare_numbers("events", "repetitions", len(a), len(b))
    for k, (one, other) in enumerate(zip(a, b, strict=False), start=1):
        for key in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield compare_numbers("events", f"repetition {k} {key.removesuffix('_s')}", one[key], other[key], "s")
