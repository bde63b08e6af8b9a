"""End of a trial of curls by the three rules of the thesis: stopped, tempo broken, out of the plane (8.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mocap_id.arrays import FloatArray, find_runs
from mocap_id.protocols.curl.repetitions import Curl
from mocap_id.protocols.curl.rules import CurlRules


@dataclass(frozen=True)
class TrialEnd:
    """When the trial ends, and by which rule.

    Parameters
    ----------
    time : float
        s.
    rule : str
        ``stopped``, ``tempo``, ``plane``, or ``recording`` if the recording ends first.
    why : str
        One sentence.
    """

    time: float
    rule: str
    why: str


def find_end(time: FloatArray, axis: FloatArray, curls: tuple[Curl, ...], rules: CurlRules) -> TrialEnd:
    """Find the end of the trial: the first of the three rules that applies.

    Parameters
    ----------
    time : (T,) array
        s.
    axis : (T, 3) array
        Unit axis of the elbow in the trial's frame, towards the right; NaN where unknown.
    curls : tuple of Curl
        In order of time.
    rules : CurlRules
    """
    ends = [end for end in (_failed(curls), _paused(curls, rules), _out_of_tempo(curls, rules)) if end is not None]
    done = [curl for curl in curls if curl.complete]
    if done and (left := _out_of_plane(time, axis, done, rules)) is not None:
        ends.append(left)
    last = done[-1].end if done else float(time[-1])
    return min(ends, key=lambda end: end.time, default=TrialEnd(last, "recording", "no rule ends the trial earlier"))


def _failed(curls: tuple[Curl, ...]) -> TrialEnd | None:
    """Return the end at the first failed attempt after which no complete curl follows."""
    complete = [k for k, curl in enumerate(curls) if curl.complete]
    rest = curls[complete[-1] + 1 :] if complete else curls
    return TrialEnd(rest[0].start, "stopped", f"the next attempt fails: {rest[0].why}") if rest else None


def _paused(curls: tuple[Curl, ...], rules: CurlRules) -> TrialEnd | None:
    """Return the end at the first pause of several periods between curls."""
    durations = [curl.end - curl.start for curl in curls if curl.complete]
    if not durations:
        return None
    longest = rules.pause * (1 / rules.metronome if rules.metronome else float(np.median(durations)))
    for curl, following in pairwise(curls):
        pause = following.start - curl.end
        if pause > longest:
            why = f"a pause of {pause:.1f} s follows, expected at most {longest:.1f} s"
            return TrialEnd(curl.end, "stopped", why)
    return None


def _out_of_tempo(curls: tuple[Curl, ...], rules: CurlRules) -> TrialEnd | None:
    """Return the end before the first curl whose duration is too far from the metronome's period."""
    if rules.metronome is None:
        return None
    period = 1 / rules.metronome
    for curl in curls:
        duration = curl.end - curl.start
        if curl.complete and abs(duration - period) > rules.tempo * period:
            why = f"the next curl takes {duration:.2f} s, expected {period:.2f} s ± {100 * rules.tempo:.0f} %"
            return TrialEnd(curl.start, "tempo", why)
    return None


def _out_of_plane(time: FloatArray, axis: FloatArray, done: list[Curl], rules: CurlRules) -> TrialEnd | None:
    """Return the end at the first sustained turn of the elbow's axis away from its direction in the first curl."""
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
            why = f"the elbow's axis turns by {degrees:.0f}°, expected at most {np.degrees(rules.plane):.0f}°"
            return TrialEnd(float(time[run.start]), "plane", why)
    return None
