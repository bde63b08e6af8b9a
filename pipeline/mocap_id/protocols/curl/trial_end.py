"""End of a trial of curls by the three rules of the thesis: stopped, out of tempo, out of the plane (8.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import FloatArray, find_runs
from mocap_id.protocols.curl.repetitions import Curl, CurlRules


@dataclass(frozen=True)
class TrialEnd:
    """End of a trial of curls."""

    time: float  # time of the end, s
    # rule that ends the trial: ``stopped``, ``tempo``, ``plane``, or ``recording`` if the recording ends first
    rule: str
    why: str  # observation to which the rule was applied, for the report


def find_trial_end(time: FloatArray, axis: FloatArray, curls: tuple[Curl, ...], rules: CurlRules) -> TrialEnd:
    """Find the end of a trial: the earliest time at which one of the three rules ends it.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    axis : (T, 3) array
        Unit vector of the elbow's axis in the trial's axes, towards the right; NaN where unknown.
    """
    done = [curl for curl in curls if curl.complete]
    ends = (
        _end_by_failure(curls),
        _end_by_pause(curls, rules),
        _end_by_tempo(done, rules),
        _end_by_plane(time, axis, done, rules),
    )
    ends_known = [curl.end for curl in done if np.isfinite(curl.end)]
    last = ends_known[-1] if ends_known else float(time[-1])
    default = TrialEnd(last, "recording", "no rule ends the trial earlier")
    return min((end for end in ends if end is not None), key=lambda end: end.time, default=default)


def _end_by_failure(curls: tuple[Curl, ...]) -> TrialEnd | None:
    """Return the end at the first failed attempt after the last complete curl; None without a failed attempt."""
    complete = [k for k, curl in enumerate(curls) if curl.complete]
    rest = [curl for curl in (curls[complete[-1] + 1 :] if complete else curls) if not curl.unknown]
    return TrialEnd(rest[0].start, "stopped", f"the next attempt fails: {rest[0].why}") if rest else None


def _end_by_pause(curls: tuple[Curl, ...], rules: CurlRules) -> TrialEnd | None:
    """Return the end at the first pause between curls that is too long; None without such a pause."""
    durations = np.array([curl.end - curl.start for curl in curls if curl.complete])
    if not np.isfinite(durations).any():
        return None
    longest = rules.pause * (1 / rules.metronome if rules.metronome else float(np.nanmedian(durations)))
    for curl, following in pairwise(curls):
        pause = following.start - curl.end
        if pause > longest:
            return TrialEnd(curl.end, "stopped", f"a pause of {pause:.1f} s follows, expected at most {longest:.1f} s")
    return None


def _end_by_tempo(done: list[Curl], rules: CurlRules) -> TrialEnd | None:
    """Return the end before the first complete curl that is out of the metronome's tempo; None without such a curl."""
    if rules.metronome is None:
        return None
    period = 1 / rules.metronome
    for curl in done:
        duration = curl.end - curl.start
        if abs(duration - period) > rules.tempo * period:
            why = f"the next curl takes {duration:.2f} s, expected {period:.2f} s ± {100 * rules.tempo:.0f} %"
            return TrialEnd(curl.start, "tempo", why)
    return None


def _end_by_plane(time: FloatArray, axis: FloatArray, done: list[Curl], rules: CurlRules) -> TrialEnd | None:
    """Return the end at the first sustained rotation of the elbow's axis from its first direction; None without it."""
    done = [curl for curl in done if np.isfinite(curl.end - curl.start)]
    if not done:
        return None
    first = (time >= done[0].start) & (time <= done[0].end)
    if not np.isfinite(axis[first]).any():
        return None
    reference = np.nanmean(axis[first], axis=0)
    with np.errstate(invalid="ignore"):
        turned = np.arccos(np.clip(axis @ reference / np.linalg.norm(reference), -1, 1))
        away = (turned > rules.plane) & (time >= done[0].start) & (time <= done[-1].end)
    for run in find_runs(away):
        if time[run.stop - 1] - time[run.start] >= rules.sustained:
            degrees = np.degrees(np.nanmax(turned[run]))
            why = f"the elbow's axis rotates by {degrees:.0f}°, expected at most {np.degrees(rules.plane):.0f}°"
            return TrialEnd(float(time[run.start]), "plane", why)
    return None
