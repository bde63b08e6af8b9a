"""Thresholds of the analysis of curls."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CurlRules:
    """Rules for curls, compensation and the end of the trial.

    Parameters
    ----------
    metronome : float or None
        Curls per second that the metronome asks for; None: no tempo is checked.
    attempt : float
        Least rise of the elbow's flexion that counts as an attempt, rad.
    complete : float
        Least rise of a complete curl, as a share of the trial's large curls.
    tempo : float
        Largest deviation of a curl's period from the metronome's, as a share of it.
    pause : float
        Longest time between two curls before the person has stopped, in periods.
    plane : float
        Largest turn of the elbow's axis away from its direction at the first curl, rad.
    compensation : float
        Change of a shoulder angle or of the thorax that counts as compensation, rad.
    sustained : float
        Least duration of a compensation and of motion out of the plane, s.
    """

    metronome: float | None = None
    attempt: float = 0.26
    complete: float = 0.6
    tempo: float = 0.5
    pause: float = 2.0
    plane: float = 0.35
    compensation: float = 0.17
    sustained: float = 0.25
