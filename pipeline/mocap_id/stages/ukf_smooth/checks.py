"""Checks of the recording and of the states, also of an arm's: time stamps, gaps, repeated frames, filters, skin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.anatomy.angles import ELBOW, JointAngles
from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import RecordingError
from mocap_id.estimation import BRIDGE_LIMIT, FRAMEWISE
from mocap_id.estimation.lasting_errors import ResidualSpectrum
from mocap_id.estimation.smoothing import find_stretches
from mocap_id.stages.base import Findings
from mocap_id.stages.ukf_smooth import UkfSmoothSettings
from mocap_id.store.artefacts import Trajectories

UNKNOWN_SD_HZ = 5.0
"""Cut-off, Hz: a filter with a lower cut-off also removes movement, so that the standard deviations are unknown."""

_FILTERED_HZ = 12.0  # cut-off below which a recording counts as filtered
_JITTER = 0.25  # largest error of a time stamp, in frames; rounding to milliseconds causes this at 500 Hz
_SAME = 1e-9  # m, largest change of a marker in a repeated frame
_MOVED = 2e-5  # m, least median change after a repeated frame, because noise-free recordings repeat frames at rest
_SHORT = 0.1  # s; the smoother bridges shorter gaps without loss
_LISTED = 3  # stretches of a segment that a message lists
_MANY = 0.01  # fraction of repeated frames for a caution


def check_uniform_times(view: Trajectories, trial: str) -> None:
    """Raise RecordingError if the times of the frames are not uniform, because the process model has a fixed step."""
    time, period = view.time, 1.0 / view.rate
    off = np.abs(time - time[0] - period * np.arange(len(time))) / period
    if not np.all(off <= _JITTER):
        k = int(np.argmax(~(off <= _JITTER)))
        raise RecordingError(
            f"trial {trial}: ukf-smooth: time stamps are not uniform: frame {view.frames[k]} is at "
            f"{time[k]:.4f} s, expected {time[0] + period * k:.4f} s at {view.rate:g} frames per second; "
            "export the trial at a constant rate with a row for every frame, or use a `window:` with uniform times"
        )


def report_gaps(
    out: Findings,
    missing: BoolArray,
    time: FloatArray,
    names: Sequence[str],
    *,
    quantity: str,
    settings: UkfSmoothSettings,
) -> None:
    """Add a caution for every joint whose angle has gaps, or for every segment whose pose has gaps.

    ``names`` are the K joints or segments. ``missing`` (F, K) is true in the frames without the angle or pose, ``time``
    (F,) is in s, and ``quantity`` is "angle" or "pose".
    """
    limit = f"its standard deviation would exceed {settings.angle_sd_limit:g} rad"
    if settings.method in FRAMEWISE:
        limit = f"`{settings.method}`, which bridges up to {BRIDGE_LIMIT:g} s, leaves a gap"
    why = (
        f"its markers are missing, or do not fit the chain, for so long that {limit}. Fill or relabel them, or leave "
        "this time out with `window:`"
    )
    if settings.method == "encoder":
        why = "the encoder's record does not cover this time. Record longer, or leave this time out with `window:`"
    for name, is_missing in zip(names, missing.T, strict=True):
        if not is_missing.any():
            continue
        gaps = find_runs(is_missing)
        longest = max(gaps, key=lambda gap: gap.stop - gap.start)
        seconds = np.count_nonzero(is_missing) * (time[-1] - time[0]) / max(len(time) - 1, 1)
        where = "throughout" if is_missing.all() else f"{len(gaps)} times, longest from {time[longest.start]:.2f} s"
        out.say(
            "gap", f"the {quantity} of the {name} is missing for {seconds:.2f} s ({where}): {why}.", float(seconds), 0.0
        )


def list_rejected(rejected: BoolArray, time: FloatArray, names: Sequence[str]) -> list[tuple[str, float, float]]:
    """Return segment, first and last time, s, of the stretches in which most visible markers of a segment are not used.

    ``rejected`` (F, K) marks these frames for the K segments called ``names``; ``time`` (F,) is in s. A few frames are
    no stretch.
    """
    return [
        (name, float(time[run.start]), float(time[run.stop - 1]))
        for name, each in zip(names, rejected.T, strict=True)
        for run in find_stretches(each)
    ]


def report_rejected(out: Findings, stretches: Sequence[tuple[str, float, float]], time: FloatArray) -> None:
    """Add a caution about the ``stretches`` of :func:`list_rejected`; ``time`` (F,) is in s."""
    frames = np.zeros(len(time), dtype=np.bool_)
    spans: dict[str, list[str]] = {}
    for name, first, last in stretches:
        frames |= (time >= first) & (time <= last)
        spans.setdefault(name.replace("_", " "), []).append(f"{first:.2f}–{last:.2f} s")
    if not spans:
        return
    parts = []
    for name, own in spans.items():
        more = f" and {len(own) - _LISTED} times more" if len(own) > _LISTED else ""
        parts.append(f"{name} at {', '.join(own[:_LISTED])}{more}")
    out.say(
        "markers-rejected",
        f"over half of the visible markers of a segment do not fit the chain and the movement ({'; '.join(parts)}), so "
        "they are not used. The pose there is bridged and counts as not observed: no range, volume, average or "
        "event contains it. Check the labels and the markers of these segments at these times, or leave the times out "
        "with `window:`",
        float(np.count_nonzero(frames) * (time[-1] - time[0]) / max(len(time) - 1, 1)),
        0.0,
    )


def find_repeated_frames(observed: FloatArray) -> BoolArray:
    """Return whether each frame (F,) repeats the frame before: all markers (F, M, 2 or 3) have the same positions.

    ``observed`` is in m, NaN where missing. Frames at rest in a recording without noise do not count.
    """
    rows, equal = np.arange(1, len(observed)), np.zeros(len(observed) - 1, dtype=np.int64)
    for k in range(observed.shape[1]):  # few frames remain after the first markers
        step = np.abs(observed[rows, k] - observed[rows - 1, k]).max(axis=1)
        kept = ~(step > _SAME)  # NaN where missing
        rows, equal = rows[kept], (equal + (step <= _SAME))[kept]
    repeated = np.zeros(len(observed), dtype=np.bool_)
    repeated[rows[equal > 1]] = True
    for run in find_runs(repeated):
        after = observed[run.stop : run.stop + 1] - observed[run.stop - 1]
        if not np.any(np.isfinite(after)) or np.nanmedian(np.abs(after)) < _MOVED:
            repeated[run] = False
    return repeated


def bridge_repeated(observed: BoolArray, repeated: BoolArray, rate: float) -> BoolArray:
    """Return ``observed`` (F, n), set to true in short runs of ``repeated`` frames (F,) between two observed frames.

    It is false in a run with an unobserved frame beside it. ``rate`` is in frames per second.
    """
    bridged = observed.copy()
    for run in find_runs(repeated):
        if run.stop - run.start <= _SHORT * rate and run.start > 0 and run.stop < len(bridged):
            bridged[run] = bridged[run.start - 1] & bridged[run.stop]
    return bridged


def report_repeated_frames(out: Findings, repeated: BoolArray) -> None:
    """Add a reason if frames repeat the frame before: a caution if there are many, otherwise a note."""
    share = float(np.mean(repeated))
    if share > 0:
        out.say(
            "repeated-frames",
            f"{np.count_nonzero(repeated)} of {len(repeated)} frames ({100 * share:.1f} %) repeat the frame before: "
            "the recording was resampled, or frames were lost. The states are estimated without these frames and "
            "bridged there. Export again at the rate of the cameras.",
            share,
            _MANY,
            "caution" if share >= _MANY else "ok",
        )


def report_residuals(
    out: Findings, spectrum: ResidualSpectrum, segments: Sequence[str], *, from_markers: bool = True
) -> None:
    """Add cautions about filtered markers and about oscillating ones; ``segments`` are the names, base first.

    ``from_markers`` says whether the states come from the markers, not from an encoder.
    """
    cut_off, oscillations = spectrum.cut_off, spectrum.oscillations
    if cut_off is not None and cut_off < _FILTERED_HZ:
        effect = "The intervals of the states include the remaining noise."
        if not from_markers:
            effect = "The states come from the encoder."
        elif cut_off < UNKNOWN_SD_HZ:
            effect = (
                "The filter also removed an unknown part of the movement, so intervals of the states are not given."
            )
        out.say(
            "prefiltered",
            f"the residuals of the markers contain almost nothing above {cut_off:.1f} Hz: the recording was filtered "
            f"or resampled before the export. {effect} Export the unfiltered markers.",
            cut_off,
            _FILTERED_HZ,
        )
    if oscillations:
        parts = [f"{segments[k]} {1e3 * size:.1f} mm at {frequency:.1f} Hz" for k, frequency, size in oscillations]
        out.say(
            "markers-oscillate",
            f"all markers of a segment oscillate together relative to the chain ({', '.join(parts)}, rms of the "
            "residuals): soft tissue wobbles, or a marker plate is loose. The accelerations contain this oscillation "
            "as an error, and their intervals include it. Attach the markers where the bone is close to the skin, or "
            "tape the plates on firmly.",
            max(size for _, _, size in oscillations),
        )


_HYPEREXTENDED = 20.0  # degrees: elbows extend by up to 15° beyond straight
_MOSTLY = 0.98  # quantile of the flexion
_LEANING = 45.0  # degrees, of the thorax from the vertical
_ROTATED = (-150.0, -40.0)  # degrees, mean pronation that no forearm has


def check_arm_motion(out: Findings, angles: Sequence[JointAngles], thorax: FloatArray) -> None:
    """Add cautions if the motion is impossible for an arm.

    ``angles`` are the angles of all joints. ``thorax`` (F, 3) is the long axis of the thorax in the trial's axes, y up;
    it has no rows if it is unknown.
    """
    elbow = next((each.angle for each in angles if each.names == ELBOW), np.zeros((0, 3)))
    # the elbow bends backwards if `side` is wrong
    flexion = np.degrees(elbow[np.isfinite(elbow[:, 0]), 0])
    low, high = np.quantile(flexion, [1 - _MOSTLY, _MOSTLY]).tolist() if len(flexion) else (0.0, 0.0)
    if low <= -_HYPEREXTENDED and low + high <= 0:
        out.say(
            "elbow-backwards",
            f"the elbow bends backwards: its flexion is {low:.0f}° to {high:.0f}°. Probably the recording is of the "
            "other arm: correct `side:`, or check the names of the landmarks",
            low,
            -_HYPEREXTENDED,
        )
    texts = []
    up = thorax[np.isfinite(thorax[:, 1]), 1]
    lean = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0)))) if len(up) else 0.0
    if lean > _LEANING:
        texts.append(
            f"the thorax leans {lean:.0f}° from the vertical for most of the trial: unless the person lies down, its "
            "landmarks are exchanged, or the vertical axis of the recording is wrong"
        )
    pronation = elbow[np.isfinite(elbow[:, 2]), 2]
    mean = float(np.degrees(np.angle(np.mean(np.exp(1j * pronation))))) if len(pronation) else 0.0
    if _ROTATED[0] < mean < _ROTATED[1]:
        texts.append(f"the mean pronation is {mean:.0f}°, which no forearm has: RS and US are probably exchanged")
    if texts:
        message = f"{'; '.join(texts)}. The joint angles have errors of a similar size"
        out.say("motion-implausible", message, float(len(texts)), 0.0)
