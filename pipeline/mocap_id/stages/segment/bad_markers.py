"""Bad stretches of markers: search, facts and notes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics import Segmentation, frames_over_time
from mocap_id.kinematics.marker_faults import BadStretch, RecordedMarkers, find_bad_stretches, sample_rows
from mocap_id.kinematics.repeated_positions import find_repeats
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_ROUNDS = 3
_CLOSE = 0.1  # s
_UNSURE = 0.5
_LISTED = 5


@dataclass(frozen=True)
class _Cause:
    """Code and words of a cause: what is seen, and what has probably happened."""

    code: str
    seen: str
    reading: str


_CAUSES = {
    "frozen": _Cause(
        "marker-frozen",
        "stands still in the laboratory while its segment moves",
        "its last position was repeated",
    ),
    "moved": _Cause(
        "marker-moved", "is at another place on its segment", "it was probably taped on again, or it was pushed"
    ),
    "elsewhere": _Cause(
        "marker-elsewhere", "is away from its place on its segment", "it is probably mislabelled, or a reflection"
    ),
    "ghost": _Cause(
        "marker-ghost",
        "is on no segment and keeps its distance from no other moving marker",
        "it is probably no marker of the body",
    ),
}


@dataclass(frozen=True)
class SegmentedMarkers:
    """The segments, found without the bad stretches.

    Parameters
    ----------
    found : Segmentation
    view : Trajectories
        The markers without the bad stretches.
    points : (f, M, 3) array
        The frames that were segmented, m.
    """

    found: Segmentation
    view: Trajectories
    points: FloatArray


def segment_without_bad(
    recorded: Trajectories, frames: int, examined: IntArray, segmented: Callable[[FloatArray], Segmentation]
) -> SegmentedMarkers:
    """Segment the markers, find their bad stretches, and segment again without them until no more are found.

    Parameters
    ----------
    recorded : Trajectories
    frames : int
        Number of frames to segment.
    examined : int array
        Columns of the markers that may be bad.
    segmented : callable
        Return the segments of points (f, M, 3), m.

    Raises
    ------
    Refused
        The markers as recorded make no chain.
    """
    swapped = _swapped(recorded)
    rows = sample_rows(len(recorded.frames), recorded.rate)
    markers = RecordedMarkers(recorded.read_positions(frames=rows), rows, recorded.read_track, recorded.rate)
    done = _segmented(Trajectories(recorded.planar, swapped), frames, segmented)
    bad: tuple[dict[str, Any], ...] = ()
    for _ in range(_ROUNDS):
        plane = done.points[..., 0] + 1j * done.points[..., 1]
        found = tuple(
            _fact(recorded, stretch, swapped) for stretch in find_bad_stretches(markers, done.found, plane, examined)
        )
        again, bad = _same(found, bad), found
        named = {each["marker"] for each in bad}  # with times that are surer than those of the swaps
        others = (each for each in swapped if each["marker"] not in named)
        view = Trajectories(recorded.planar, (*others, *bad))
        if again:
            return replace(done, view=view)
        try:
            other = _segmented(view, frames, segmented)
        except Refused:  # the rest of the markers shows no chain
            break
        if other.found.confidence.value < _UNSURE <= done.found.confidence.value:  # the bad samples did less harm
            return replace(done, view=view, points=other.points)
        done = other
    return done


def without_repeats(recorded: Trajectories) -> Trajectories:
    """Return the markers of a trial in space without stretches in which an exact position is repeated."""
    points = recorded.read_positions(np.arange(len(recorded.labels)))
    repeats = find_repeats(points, recorded.rate)
    return Trajectories(recorded.planar, [_fact(recorded, each, ()) for each in repeats])


def _segmented(view: Trajectories, frames: int, segmented: Callable[[FloatArray], Segmentation]) -> SegmentedMarkers:
    points = view.read_positions(frames=frames_over_time(view.read_plane(), frames))
    return SegmentedMarkers(segmented(points), view, points)


def _fact(view: Trajectories, stretch: BadStretch, swapped: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the facts of a stretch; a marker that is elsewhere during a known swap counts as swapped, once."""
    marker, first, last = view.labels[stretch.marker], view.time[stretch.first], view.time[stretch.last]
    known = any(each["marker"] == marker and each["first_s"] < last and first < each["last_s"] for each in swapped)
    how = "swapped" if known and stretch.how == "elsewhere" else stretch.how
    return {"marker": marker, "first_s": float(first), "last_s": float(last), "how": how}


def _same(found: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether two searches found the same stretches, to a tenth of a second."""
    return len(found) == len(before) and all(
        one["marker"] == other["marker"]
        and abs(one["first_s"] - other["first_s"]) < _CLOSE
        and abs(one["last_s"] - other["last_s"]) < _CLOSE
        for one, other in zip(found, before, strict=True)
    )


def _swapped(view: Trajectories) -> tuple[dict[str, Any], ...]:
    """Return the stretches in which markers have each other's labels, unless planarise has exchanged them."""
    return tuple(
        {"marker": label, "first_s": swap["first_s"], "last_s": swap["last_s"], "how": "swapped"}
        for swap in view.planar.facts.get("swaps", ())
        if not swap["repaired"]
        for label in swap["labels"]
    )


def bad_marker_notes(bad: Sequence[Mapping[str, Any]]) -> Iterator[Reason]:
    """Yield a note for every cause, with the markers and times."""
    for how, cause in _CAUSES.items():
        stretches = [each for each in bad if each["how"] == how]
        if not stretches:
            continue
        listed = "; ".join(
            each["marker"]
            if how == "ghost"
            else f"{each['marker']} from {each['first_s']:.2f} to {each['last_s']:.2f} s"
            for each in stretches[:_LISTED]
        )
        rest = f"; and {len(stretches) - _LISTED} more" if len(stretches) > _LISTED else ""
        yield Reason(
            cause.code,
            f"a marker {cause.seen}; {cause.reading}: {listed}{rest}. These samples were left out; all others are "
            "used. Check the marker in the camera software.",
            float(sum(each["last_s"] - each["first_s"] for each in stretches)),
            level="ok",
        )


def left_out_words(label: str, bad: Sequence[Mapping[str, Any]]) -> str:
    """Return when and why samples of a marker are left out, in words; empty if none are."""
    own = [each for each in bad if each["marker"] == label]
    return "".join(f"; left out from {each['first_s']:.2f} to {each['last_s']:.2f} s: {each['how']}" for each in own)
