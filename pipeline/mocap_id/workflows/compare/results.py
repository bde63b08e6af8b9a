"""Differences between two summaries: verdict, segments, joints, noise, parameters, fit, events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mocap_id.workflows.compare.difference import Difference, choices, quantity

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


def results(a: Summary, b: Summary) -> Iterator[Difference]:
    """Compare two summaries."""
    yield from _verdict(a["verdict"], b["verdict"])
    yield from _segments(a["segments"], b["segments"])
    yield from _joints(a["joints"] or (), b["joints"] or ())
    yield from _lengths(a["lengths_m"] or {}, b["lengths_m"] or {})
    yield from _angles(a.get("angles") or {}, b.get("angles") or {})
    for group, key, unit in _PLAIN:
        yield quantity("noise", key, a[group][key], b[group][key], unit)
    yield from _base(a["dynamics"]["base"] or (), b["dynamics"]["base"] or ())
    yield from _fit(a["dynamics"], b["dynamics"])
    yield from _events(a["repetitions"] or (), b["repetitions"] or ())


def _verdict(a: Summary, b: Summary) -> Iterator[Difference]:
    yield Difference("verdict", "level", a["level"], b["level"])
    before, after = _reasons(a), _reasons(b)
    for key in dict.fromkeys((*before, *after)):
        one, other = before.get(key), after.get(key)
        if one is None or other is None:
            yield Difference("verdict", f"{key} {'gained' if one is None else 'lost'}", _message(one), _message(other))
        elif one["value"] is None and other["value"] is None:
            yield Difference("verdict", key, one["message"], other["message"])
        else:
            yield quantity("verdict", key, one["value"], other["value"])


def _reasons(verdict: Summary) -> dict[str, Summary]:
    """Return reasons by code; repeated codes are numbered."""
    found: dict[str, Summary] = {}
    for reason in (*verdict["reasons"], *verdict.get("notes", ())):
        key, number = reason["code"], 2
        while key in found:
            key, number = f"{reason['code']} {number}", number + 1
        found[key] = reason
    return found


def _message(reason: Summary | None) -> str | None:
    return None if reason is None else str(reason["message"])


def _segments(a: Summary, b: Summary) -> Iterator[Difference]:
    yield quantity("segments", "count", a["count"], b["count"])
    yield quantity("segments", "confidence", a["confidence"], b["confidence"])
    yield Difference("segments", "names", ", ".join(a["names"] or ()), ", ".join(b["names"] or ()))
    yield from choices("markers", dict(a["assignment"] or {}), dict(b["assignment"] or {}))


def _joints(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    for name, one, other in _paired(a, b):
        sizes = (len(entry.get("centre_m") or ()) for entry in (one, other))
        for k, axis in enumerate("xyz"[: max(*sizes, 2)]):
            yield quantity(
                "joints",
                f"{name} {axis}",
                _at(one, "centre_m", k),
                _at(other, "centre_m", k),
                "m",
                sds=(_at(one, "sd_m", k), _at(other, "sd_m", k)),
            )
        yield quantity("joints", f"{name} arc", one.get("arc_deg"), other.get("arc_deg"), "deg")
        if one.get("kind") != other.get("kind"):
            yield Difference("joints", f"{name} kind", one.get("kind"), other.get("kind"))


def _paired(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[tuple[str, Summary, Summary]]:
    """Yield entries with the same name, with an empty one where a run has none."""
    before, after = ({entry["name"]: entry for entry in entries} for entries in (a, b))
    for name in dict.fromkeys((*before, *after)):
        yield name, before.get(name, {}), after.get(name, {})


def _at(entry: Summary, key: str, k: int) -> float | None:
    values = entry.get(key)
    return None if values is None or k >= len(values) else values[k]


def _lengths(a: Summary, b: Summary) -> Iterator[Difference]:
    for name in dict.fromkeys((*a, *b)):
        one, other = a.get(name, {}), b.get(name, {})
        sds = (one.get("sd"), other.get("sd"))
        yield quantity("lengths", name, one.get("value"), other.get("value"), "m", sds=sds)


def _angles(a: Summary, b: Summary) -> Iterator[Difference]:
    for name in dict.fromkeys((*a, *b)):
        one, other = (entry.get(name, {}).get("range_deg") for entry in (a, b))
        yield quantity("angles", f"{name} range", one, other, "deg")


def _base(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    for name, one, other in _paired(a, b):
        unit = str(one.get("unit") or other.get("unit"))
        sds = (one.get("sd"), other.get("sd"))
        yield quantity("base parameters", name, one.get("value"), other.get("value"), unit, sds=sds)
        yield Difference("base parameters", f"{name} verdict", one.get("verdict"), other.get("verdict"))


def _fit(a: Summary, b: Summary) -> Iterator[Difference]:
    for key, unit in _FIT:
        yield quantity("fit", key, a[key], b[key], unit)
    sds = (a["clock_offset_sd_s"], b["clock_offset_sd_s"])
    yield quantity("fit", "clock_offset_s", a["clock_offset_s"], b["clock_offset_s"], "s", sds=sds)
    before, after = a["wrench"] or {}, b["wrench"] or {}
    for name in dict.fromkeys((*before, *after)):
        one, other = before.get(name, {}), after.get(name, {})
        for key, unit in (("bias", _UNITS[name]), ("sd", _UNITS[name]), ("r2", "")):
            yield quantity("fit", f"{name} {key}", one.get(key), other.get(key), unit)


def _events(a: Sequence[Summary], b: Sequence[Summary]) -> Iterator[Difference]:
    yield quantity("events", "repetitions", len(a), len(b))
    for k, (one, other) in enumerate(zip(a, b, strict=False), start=1):
        for key in ("start_s", "seat_off_s", "stand_s", "seat_on_s", "end_s"):
            yield quantity("events", f"repetition {k} {key.removesuffix('_s')}", one[key], other[key], "s")
