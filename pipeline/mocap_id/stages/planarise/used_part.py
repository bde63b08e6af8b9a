"""Selection of the frames and markers of a recording that are used, with their labels, coordinates and bursts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mocap_id import recording
from mocap_id.arrays import BoolArray, FloatArray, IntArray, chunks, find_runs
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.kinematics import find_bursts, find_swaps, propose_window, undo_swaps
from mocap_id.plates.choice import PlateChoice, choose_plates
from mocap_id.plates.clock import ClockSearch, find_clock_offset
from mocap_id.recording import Plate, Recording, ThinnedFrames
from mocap_id.recording.held_samples import describe_held
from mocap_id.stages.base import Findings
from mocap_id.stages.marker_names import find_markers
from mocap_id.stages.planarise import PlanariseSettings
from mocap_id.stages.trial_keys import BalanceBoard, Files
from mocap_id.verdict import Reason

_LISTED = 5  # largest number of swaps in the message; the facts contain all


@dataclass(frozen=True)
class UsedPart:
    """Frames and markers of a recording that are used."""

    source: Recording
    first: int  # index of the first frame
    stop: int  # index after the last frame
    labels: tuple[str, ...]
    positions: FloatArray  # (F, M, 3) in the lab, m
    proposed: bool  # whether the program chose the window

    @property
    def time(self) -> FloatArray:
        """(F,) times on the recording's clock, s."""
        return self.source.time[self.first : self.stop]

    @property
    def frames(self) -> IntArray:
        """(F,) frame numbers of the recording."""
        return self.source.frames[self.first : self.stop]

    @property
    def facts(self) -> dict[str, Any]:
        """Facts of planar.parquet about the recording and its window."""
        source = self.source
        return {
            "window_s": [float(self.time[0]), float(self.time[-1])],
            "window_proposed": self.proposed,
            "rate_hz": source.rate,
            "vertical": source.vertical,
            "units": source.units,
            "format": source.format,
            "files": [file.name for file in source.files],
        }

    def list_oddities(self, feet: Sequence[Plate]) -> list[Reason]:
        """Return reasons about the file, without assumptions about the feet's plates, which are cautions already."""
        doubted = {text for plate in feet for text in plate.assumptions}
        oddities = [oddity for oddity in self.source.oddities if oddity not in doubted]
        notes = [Reason("recording-oddity", f"{oddity}.", level="ok") for oddity in oddities]
        return [*notes, *describe_held(self.source.held, float(self.time[0]), float(self.time[-1]))]


def read_recording(files: Files, settings: PlanariseSettings) -> Recording:
    """Return the recording of a trial, read with the units and axes of its settings."""
    return recording.read(
        files.motion,
        None if isinstance(files.forces, BalanceBoard) else files.forces,
        units=settings.units,
        vertical=settings.vertical,
        force_unit=settings.force_unit,
        moment_unit=settings.moment_unit,
    )


def select_part(source: Recording, window: tuple[float, float] | None, ignore: Sequence[str]) -> UsedPart:
    """Return the frames of the window and the markers visible in it; if ``window`` is None, the program chooses it.

    ``window`` is the first and the last time, s. Raises RecordingError if no marker is visible, and ConfigError if the
    window has fewer than two frames.
    """
    file = source.files[0]
    out = find_markers((*source.labels, *source.left_out), ignore, f"{file}: planarise: ignore")
    keep = [i for i in range(len(source.labels)) if i not in out]
    people = [each for each in source.people if any(source.labels[i].startswith(each) for i in keep)]
    if len(people) > 1:
        others = ", ".join(f"'{each}*'" for each in people[1:])
        raise RecordingError(
            f"{file}: the recording shows {len(people)} people, whose labels begin with {', '.join(people)}; a trial "
            f"has one person: leave out the others, such as `planarise: {{ignore: [{others}]}}`"
        )
    visible = _find_visible(source.positions)[:, keep]
    if not visible.any():
        raise RecordingError(
            f"{file}: no marker is visible in any of its {len(source.frames)} frames ({len(source.labels)} labels); "
            "track and export the trial again"
        )
    if window is None:
        thinned = ThinnedFrames.of(source.positions, source.time, source.rate)
        first, stop = (thinned.step * k for k in propose_window(thinned.positions[:, keep], thinned.rate))
        stop = min(stop, len(source.frames))
    else:
        inside = np.flatnonzero((source.time >= window[0] - 1e-9) & (source.time <= window[1] + 1e-9))
        if inside.size < 2:
            raise ConfigError(
                f"{file}: window: [{window[0]:g}, {window[1]:g}] s has fewer than two frames; "
                f"the recording runs from {source.time[0]:g} to {source.time[-1]:g} s"
            )
        first, stop = int(inside[0]), int(inside[-1]) + 1
    kept = [keep[k] for k in np.flatnonzero(visible[first:stop].any(axis=0))]
    if not kept:
        span = f"{source.time[first]:g} to {source.time[stop - 1]:g} s"
        raise RecordingError(f"{file}: no marker is visible from {span}; choose another `window:`")
    labels = tuple(source.labels[marker] for marker in kept)
    proposed = window is None and (first, stop) != (0, len(source.frames))
    positions = source.positions[first:stop]
    return UsedPart(source, first, stop, labels, positions if labels == source.labels else positions[:, kept], proposed)


def _find_visible(positions: FloatArray) -> BoolArray:
    """Return whether each marker is visible in each frame, (F, M)."""
    return np.isfinite(positions[..., 0] + positions[..., 1] + positions[..., 2])


def express_trajectories(part: UsedPart, frame: PlaneFrame) -> dict[str, FloatArray]:
    """Return the coordinates x, y and z in the axes of the plane, by name, each (F, M), m; NaN if not visible."""
    x, y, z = (np.empty(part.positions.shape[:2]) for _ in range(3))
    for some in chunks(len(part.time)):
        local = frame.to_plane(part.positions[some])
        local[~_find_visible(local)] = np.nan
        x[some], y[some], z[some] = np.moveaxis(local, 2, 0)
    return {"x": x, "y": y, "z": z}


def list_bursts(part: UsedPart, points: Mapping[str, FloatArray]) -> dict[str, list[list[float]]]:
    """Return first and last time of every burst (a jump away and back), s, by the label of each marker that has one."""
    found = {}
    for marker, label in enumerate(part.labels):
        track = np.stack([values[:, marker] for values in points.values()], axis=1)
        out = find_bursts(track[:, None], part.source.rate)[:, 0]
        if out.any():
            found[label] = [part.time[[run.start, run.stop - 1]].tolist() for run in find_runs(out)]
    return found


def choose_on_one_clock(
    source: Recording, part: UsedPart, *, feet: Collection[int], seat: Collection[int] = ()
) -> tuple[Recording, ThinnedFrames, PlateChoice, ClockSearch]:
    """Return the use of every plate after the plates' clock is corrected, which everything later uses.

    ``feet`` and ``seat`` are as in :func:`mocap_id.plates.choice.choose_plates`.
    """

    def choose(plates: tuple[Plate, ...]) -> tuple[ThinnedFrames, PlateChoice]:
        thinned = ThinnedFrames.of(part.positions, part.time, source.rate, plates)
        return thinned, choose_plates(plates, thinned.samples, thinned.positions, feet=feet, seat=seat)

    thinned, choice = choose(source.plates)
    loaded = [source.plates[index] for index in (*choice.indices("feet"), *choice.indices("seat"))]
    clock = find_clock_offset(loaded, thinned.positions, thinned.time, thinned.rate, frame_s=1.0 / source.rate)
    if clock.offset_s:
        source = replace(source, plates=clock.correct(source.plates))
        thinned, choice = choose(source.plates)
    return source, thinned, choice, clock


def check_swaps(out: Findings, part: UsedPart, *, repair: bool) -> tuple[FloatArray, list[dict[str, Any]]]:
    """Find swapped labels, add a reason and, if ``repair``, correct them; return the positions and the swaps' facts."""
    swaps = find_swaps(part.positions, part.source.rate)
    if not swaps:
        return part.positions, []
    facts = [
        {
            "labels": [part.labels[swap.first], part.labels[swap.second]],
            "first_frame": int(part.frames[swap.start]),
            "last_frame": int(part.frames[swap.stop - 1]),
            "first_s": float(part.time[swap.start]),
            "last_s": float(part.time[swap.stop - 1]),
            "repaired": repair,
        }
        for swap in swaps
    ]
    listed = "; ".join(
        f"{part.labels[swap.first]} and {part.labels[swap.second]} in frames {part.frames[swap.start]} to "
        f"{part.frames[swap.stop - 1]} ({part.time[swap.start]:.2f} to {part.time[swap.stop - 1]:.2f} s)"
        for swap in swaps[:_LISTED]
    )
    rest = f"; and {len(swaps) - _LISTED} more" if len(swaps) > _LISTED else ""
    times = "once" if len(swaps) == 1 else f"{len(swaps)} times"
    outcome = (
        "These frames were corrected in the results; the file was not changed."
        if repair
        else "Both markers are left out of the skeleton in these frames. To use them there, set "
        "`planarise: {repair_swaps: true}`, or relabel them and export the trial again."
    )
    message = f"two markers have each other's label {times}: {listed}{rest}. {outcome}"
    out.say("marker-swap", message, float(len(swaps)), level="ok" if repair else "caution")
    return undo_swaps(part.positions, swaps) if repair else part.positions, facts
