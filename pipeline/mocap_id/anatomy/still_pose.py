"""The still pose of a recording, and the places of landmarks in the frames of marker clusters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mocap_id.anatomy.frames import PALPATION
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import RecordingError
from mocap_id.verdict import Reason

_SPAN = 0.2  # s, over which a velocity is measured
_QUIET = 0.02  # m/s, postural sway stays below it
_SHORTEST = 0.3  # s
_SHARE = 0.9  # of the visible markers that must be quiet: a lone shaking marker does not count
_HOLES = 0.1  # s, runs of quiet frames closer than this are one
_BENT = 0.01  # m, rms at which a landmark does not follow its cluster


@dataclass(frozen=True)
class StillPose:
    """Frames in which the body stands still.

    Parameters
    ----------
    frames : slice
    speed : float
        90th percentile of the markers' speeds in these frames, m/s.
    reasons : tuple of Reason
        Empty if the pose is still.
    """

    frames: slice
    speed: float
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class LandmarkPosition:
    """Place of a landmark in the frame of a cluster.

    Parameters
    ----------
    local : (3,) array
        Mean over the frames, m.
    sd : float
        Standard deviation along each axis, palpation included, m.
    spread : float
        rms distance from the mean while the place was measured, m.
    """

    local: FloatArray
    sd: float
    spread: float


def find_still_pose(points: FloatArray, rate: float, given: tuple[float, float] | None = None) -> StillPose:
    """Return the longest interval in which the markers hardly move.

    A marker's speed is its displacement over 0.2 s. Frames are quiet if 90 % of the visible markers move at most at
    20 mm/s, which is the sway of a standing person.

    Parameters
    ----------
    points : (F, M, 3) array
        Markers, m; NaN where unseen.
    rate : float
        Hz.
    given : (float, float), optional
        Start and end of the pose in s from the first frame, instead of a search.

    Returns
    -------
    StillPose
        With a caution, ``no-still-pose``, if no interval of 0.3 s is quiet, or the given one is not. In the first case
        the frames are the quietest 0.3 s.

    Raises
    ------
    RecordingError
        The given interval has no frames in the recording, or the recording is shorter than 0.5 s.
    """
    speed = _measure_speeds(points, rate)
    shortest = max(round(_SHORTEST * rate), 2)
    if given is not None:
        frames = slice(max(round(given[0] * rate), 0), min(round(given[1] * rate) + 1, len(points)))
        if frames.stop - frames.start < 2:
            end = (len(points) - 1) / rate
            raise RecordingError(f"static: {given[0]:g} to {given[1]:g} s is outside the recording, 0 to {end:.2f} s")
        return _judge_pose(frames, speed)
    if len(points) < shortest + 2 or not np.isfinite(speed).any():
        raise RecordingError(f"the recording has {len(points)} frames; a still pose needs at least 0.5 s")
    quiet = _close_holes(np.nan_to_num(speed, nan=np.inf) <= _QUIET, int(_HOLES * rate))
    runs = [run for run in find_runs(quiet) if run.stop - run.start >= shortest]
    if runs:
        return _judge_pose(max(runs, key=lambda run: run.stop - run.start), speed)
    filled = np.where(np.isfinite(speed), speed, np.nanmax(speed))
    window = np.convolve(filled, np.ones(shortest) / shortest, mode="valid")
    start = int(np.argmin(window))
    return _judge_pose(slice(start, start + shortest), speed)


def _judge_pose(frames: slice, speed: FloatArray) -> StillPose:
    inside = speed[frames]
    value = float(np.nanpercentile(inside, 90)) if np.isfinite(inside).any() else np.inf
    if value <= 1.5 * _QUIET:
        return StillPose(frames, value, ())
    message = (
        f"no pose is still: the markers move at {1000 * value:.0f} mm/s, expected at most {1000 * _QUIET:.0f} mm/s. "
        "Landmarks are tied to moving skin; record a second of rest, or name a still moment under `static:`"
    )
    return StillPose(frames, value, (Reason("no-still-pose", message, value, _QUIET),))


def _measure_speeds(points: FloatArray, rate: float) -> FloatArray:
    """Return the speed (F,) below which 90 % of the visible markers move, m/s; NaN where none is seen."""
    half = max(round(_SPAN * rate / 2), 1)
    count = len(points)
    late, early = np.minimum(np.arange(count) + half, count - 1), np.maximum(np.arange(count) - half, 0)
    steps = np.linalg.norm(points[late] - points[early], axis=-1) * rate / np.maximum(late - early, 1)[:, None]
    seen = np.isfinite(steps).sum(axis=1)
    rank = np.maximum(np.ceil(_SHARE * seen).astype(np.int64) - 1, 0)
    return np.asarray(np.take_along_axis(np.sort(steps, axis=1), rank[:, None], axis=1)[:, 0])


def _close_holes(flags: BoolArray, longest: int) -> BoolArray:
    closed = flags.copy()
    for hole in find_runs(~flags):
        inside = hole.start > 0 and hole.stop < len(flags)
        if inside and hole.stop - hole.start <= longest:
            closed[hole] = True
    return closed


def locate_landmarks(
    points: Mapping[str, FloatArray],
    segment: Mapping[str, int],
    rotations: FloatArray,
    origins: FloatArray,
    *,
    frames: slice,
    palpation: float = PALPATION,
) -> tuple[dict[str, LandmarkPosition], tuple[Reason, ...]]:
    """Return the places of landmarks in the frames of their segments, the means over a still pose.

    A landmark that the still pose hides is averaged over the whole recording, where the skin has moved; its larger
    spread is part of its standard deviation.

    Parameters
    ----------
    points : mapping
        Landmark to its trajectory (F, 3), m; NaN where unseen.
    segment : mapping
        Landmark to the number of its segment.
    rotations : (F, S, 3, 3) array
        Frame of each segment's cluster to the trial; NaN where unknown.
    origins : (F, S, 3) array
        m.
    frames : slice
        The still pose.
    palpation : float
        Standard deviation of each landmark along each axis, m.

    Returns
    -------
    places : dict
        Landmark to :class:`LandmarkPosition`. Landmarks that are never seen together with their cluster are left out.
    reasons : tuple of Reason
        Landmarks left out, or hidden in the still pose.
    """
    places: dict[str, LandmarkPosition] = {}
    reasons: list[Reason] = []
    for name, track in points.items():
        k = segment[name]
        local = np.einsum("fji,fj->fi", rotations[:, k], track - origins[:, k])
        still = _average_positions(local[frames], palpation, 0.0)
        place = still or _average_positions(local, palpation, 1.0)
        if place is None:
            message = f"{name} is never seen together with its segment and was left out"
            reasons.append(Reason("landmark-hidden", message))
            continue
        if still is None:
            message = f"{name} is hidden in the still pose; its mean over the recording was used"
            reasons.append(Reason("landmark-hidden", message, place.spread, level="ok"))
        elif place.spread > _BENT:
            message = (
                f"{name} moves by {1000 * place.spread:.0f} mm against its segment in the still pose, expected below "
                f"{1000 * _BENT:.0f} mm; check the name of the marker and `static:`"
            )
            reasons.append(Reason("landmark-loose", message, place.spread, _BENT))
        places[name] = place
    return places, tuple(reasons)


def _average_positions(local: FloatArray, palpation: float, skin: float) -> LandmarkPosition | None:
    """Return the mean of places (K, 3); ``skin`` is the share of their spread that does not average out."""
    seen = np.isfinite(local).all(axis=1)
    count = int(seen.sum())
    if count == 0:
        return None
    mean = local[seen].mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((local[seen] - mean) ** 2, axis=1))))
    lasting = (skin * spread) ** 2 / 3
    return LandmarkPosition(mean, float(np.sqrt(palpation**2 + lasting + spread**2 / 3 / count)), spread)
