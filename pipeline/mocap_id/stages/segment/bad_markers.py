"""Bad stretches, which are periods in which a marker is frozen, moved, mislabelled or not on the body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id.arrays import FloatArray, IntArray
from mocap_id.errors import Refused
from mocap_id.kinematics import Segmentation, frames_over_time
from mocap_id.kinematics.marker_faults import RecordedMarkers, find_bad_stretches, sample_rows
from mocap_id.kinematics.simple_faults import BadStretch, find_repeats
from mocap_id.store.views import Trajectories
from mocap_id.verdict import Reason

_ROUNDS = 3  # largest number of searches
_CLOSE = 0.1  # s: smaller differences of times are ignored
_UNSURE = 0.5  # confidence below which the segments are doubtful
_LISTED = 5  # largest number of stretches named in a note

_CAUSES = {
    "frozen": Reason(
        "marker-frozen",
        "does not move in the laboratory while its segment moves; its last position was repeated",
        level="ok",
    ),
    "moved": Reason(
        "marker-moved",
        "is at another position on its segment; it was probably pushed, or it fell off and was attached again",
        level="ok",
    ),
    "elsewhere": Reason(
        "marker-elsewhere",
        "is away from its position on its segment; it is probably mislabelled, or a reflection",
        level="ok",
    ),
    "ghost": Reason(
        "marker-ghost",
        "is on no segment, and its distance from every other moving marker changes; it is probably not on the body",
        level="ok",
    ),
}
"""Incomplete note by the kind of a bad stretch; its message is an observation with the probable cause."""


@dataclass(frozen=True)
class SegmentedMarkers:
    """Segments that were found without the samples in bad stretches."""

    found: Segmentation  # segments of the markers
    view: Trajectories  # markers without the bad stretches
    points: FloatArray  # (f, M, 3) markers in the frames used for the segmentation, m


def segment_without_bad_markers(
    recorded: Trajectories, frames: int, examined: IntArray, segment: Callable[[FloatArray], Segmentation]
) -> SegmentedMarkers:
    """Return the segments found without the bad stretches of the markers.

    The markers are segmented, then bad stretches are found; both are repeated until the stretches no longer change.

    Parameters
    ----------
    frames : int
        Number of frames used for the segmentation.
    examined : int array
        Indices of the markers in which bad stretches are searched.
    segment : callable
        Function that returns the segments for the positions (f, M, 3) of the markers, m.

    Raises
    ------
    Refused
        The markers as recorded do not form a chain.
    """
    swapped = _find_swapped_stretches(recorded)
    rows = sample_rows(len(recorded.frames), recorded.rate)
    markers = RecordedMarkers(recorded.read_positions(frames=rows), rows, recorded.read_track, recorded.rate)
    done = _segment(Trajectories(recorded.planar, swapped), frames, segment)
    bad: tuple[dict[str, Any], ...] = ()
    for _ in range(_ROUNDS):
        plane = done.points[..., 0] + 1j * done.points[..., 1]
        before = bad
        bad = tuple(
            _make_facts(recorded, stretch, swapped)
            for stretch in find_bad_stretches(markers, done.found, plane, examined)
        )
        bad_labels = {each["marker"] for each in bad}  # their times are more certain than those of swaps
        others = (each for each in swapped if each["marker"] not in bad_labels)
        view = Trajectories(recorded.planar, (*others, *bad))
        if _are_same(bad, before):
            return replace(done, view=view)
        try:
            other = _segment(view, frames, segment)
        except Refused:  # the other markers do not form a chain
            break
        if other.found.confidence.value < _UNSURE <= done.found.confidence.value:  # more certain with the bad samples
            return replace(done, view=view, points=other.points)
        done = other
    return done


def remove_repeats(recorded: Trajectories) -> Trajectories:
    """Return the markers of a trial in space without the stretches in which a marker has exactly the same position."""
    points = recorded.read_positions(np.arange(len(recorded.labels)))
    repeats = find_repeats(points, recorded.rate)
    return Trajectories(recorded.planar, [_make_facts(recorded, each, ()) for each in repeats])


def _segment(view: Trajectories, frames: int, segment: Callable[[FloatArray], Segmentation]) -> SegmentedMarkers:
    points = view.read_positions(frames=frames_over_time(view.read_plane(), frames))
    return SegmentedMarkers(segment(points), view, points)


def _make_facts(view: Trajectories, stretch: BadStretch, swapped: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return marker, times and kind of a stretch; "elsewhere" becomes "swapped" in one of the stretches ``swapped``."""
    marker, first, last = view.labels[stretch.marker], view.time[stretch.first], view.time[stretch.last]
    known = any(each["marker"] == marker and each["first_s"] < last and first < each["last_s"] for each in swapped)
    how = "swapped" if known and stretch.how == "elsewhere" else stretch.how
    return {"marker": marker, "first_s": float(first), "last_s": float(last), "how": how}


def _are_same(bad: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether two searches found the same stretches, with times that differ by less than 0.1 s."""
    return len(bad) == len(before) and all(
        one["marker"] == other["marker"]
        and abs(one["first_s"] - other["first_s"]) < _CLOSE
        and abs(one["last_s"] - other["last_s"]) < _CLOSE
        for one, other in zip(bad, before, strict=True)
    )


def _find_swapped_stretches(view: Trajectories) -> tuple[dict[str, Any], ...]:
    """Return the stretches in which two markers have exchanged labels that planarise has not repaired."""
    return tuple(
        {"marker": label, "first_s": swap["first_s"], "last_s": swap["last_s"], "how": "swapped"}
        for swap in view.planar.facts.get("swaps", ())
        if not swap["repaired"]
        for label in swap["labels"]
    )


def explain_bad_markers(bad: Sequence[Mapping[str, Any]]) -> Iterator[Reason]:
    """Yield a note for each kind of bad stretch that occurs, with the markers and times."""
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
        text = (
            f"a marker {cause.message}: {listed}{rest}. These samples were left out; all other samples are used. Check "
            "the marker in the camera software."
        )
        seconds = float(sum(each["last_s"] - each["first_s"] for each in stretches))
        yield replace(cause, message=text, value=seconds)


def describe_bad_stretches(label: str, bad: Sequence[Mapping[str, Any]]) -> str:
    """Return a text with the times and kinds of the bad stretches of a marker; an empty text if it has none."""
    own = [each for each in bad if each["marker"] == label]
    return "".join(f"; left out from {each['first_s']:.2f} to {each['last_s']:.2f} s: {each['how']}" for each in own)
