"""Reasons about the markers' noise: repeated frames, low-pass filters and oscillating skin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.estimation.residual_spectrum import Oscillation
from mocap_id.verdict import Reason

FILTERED_HZ = 12.0
"""Cut-off below which a recording counts as filtered."""
LOST_HZ = 5.0
"""Cut-off below which movement is lost too, so that the intervals of the states are not known."""

_SAME = 1e-9  # m
_MOVED = 2e-5  # m; median step after a repeated frame. A recording without noise repeats frames at rest.
_SHORT = 0.1  # s; within it the smoother bridges without loss
_MANY = 0.01  # share of repeated frames for a caution


def find_repeated_frames(observed: FloatArray) -> BoolArray:
    """Return the frames (F,) in which all markers (F, M, 2) are exactly where they were in the frame before."""
    rows, equal = np.arange(1, len(observed)), np.zeros(len(observed) - 1, dtype=np.int64)
    for k in range(observed.shape[1]):  # few frames remain after the first markers
        step = np.abs(observed[rows, k] - observed[rows - 1, k]).max(axis=1)
        kept = ~(step > _SAME)  # NaN where unseen
        rows, equal = rows[kept], (equal + (step <= _SAME))[kept]
    repeated = np.zeros(len(observed), dtype=np.bool_)
    repeated[rows[equal > 1]] = True
    for run in find_runs(repeated):
        after = observed[run.stop : run.stop + 1] - observed[run.stop - 1]
        if not np.any(np.isfinite(after)) or np.nanmedian(np.abs(after)) < _MOVED:
            repeated[run] = False
    return repeated


def bridge_repeated(observed: BoolArray, repeated: BoolArray, rate: float) -> BoolArray:
    """Return which angles (F, n) are observed if short runs of repeated frames (F,) count as the frames beside them."""
    found = observed.copy()
    for run in find_runs(repeated):
        if run.stop - run.start <= _SHORT * rate and run.start > 0 and run.stop < len(found):
            found[run] = found[run.start - 1] & found[run.stop]
    return found


def repeated_reason(repeated: BoolArray) -> tuple[Reason, ...]:
    """Return a reason if frames repeat the one before."""
    share = float(np.mean(repeated))
    if share == 0:
        return ()
    message = (
        f"{np.count_nonzero(repeated)} of {len(repeated)} frames ({100 * share:.1f} %) repeat the frame before: the "
        "recording was resampled, or frames were lost. They are left out of the states, which are bridged there. "
        "Export again at the rate of the cameras."
    )
    return (Reason("repeated-frames", message, share, _MANY, "caution" if share >= _MANY else "ok"),)


def filter_reason(cut_off: float | None) -> tuple[Reason, ...]:
    """Return a caution if the markers were filtered below :data:`FILTERED_HZ`."""
    if cut_off is None or cut_off >= FILTERED_HZ:
        return ()
    held = "The intervals of the states include the noise that is left."
    if cut_off < LOST_HZ:
        held = "Movement is lost too, by an unknown amount: intervals of the states are not given."
    message = (
        f"the residuals of the markers end at {cut_off:.1f} Hz: the recording was filtered or resampled before the "
        f"export. {held} Export the unfiltered markers."
    )
    return (Reason("prefiltered", message, cut_off, FILTERED_HZ),)


def oscillation_reason(found: Sequence[Oscillation], segments: Sequence[str]) -> tuple[Reason, ...]:
    """Return a caution if the markers of segments oscillate together; ``segments`` are the names, base first."""
    if not found:
        return ()
    parts = ", ".join(f"{segments[each.segment]} {1e3 * each.size:.1f} mm at {each.frequency:.1f} Hz" for each in found)
    message = (
        f"all markers of a segment oscillate together against the chain ({parts}, rms left in the residuals): soft "
        "tissue wobbles, or a marker plate is loose. Accelerations contain the oscillation, and their intervals "
        "include it. Fix the markers to bony places, or tape the plates on firmly."
    )
    return (Reason("markers-oscillate", message, max(each.size for each in found)),)
