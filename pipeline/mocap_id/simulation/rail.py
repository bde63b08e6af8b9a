"""A hand on a rail: it carries a share of the body's vertical load while the person rises, and no plate knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.motion import smoothstep
from mocap_id.simulation.schedule import Schedule

TRUNK = 3  # the link that the arm belongs to
POINT = (-0.30, 0.30)  # of the hand in the trunk's frame, in front of the person, m


@dataclass(frozen=True)
class Rail:
    """What the rail does.

    Parameters
    ----------
    share : float
        Of the total vertical force, at most.
    schedule : Schedule
    """

    share: float
    schedule: Schedule

    def load(self, time: FloatArray) -> FloatArray:
        """Share of the total vertical force at times (T,): from the start of each rise until shortly before its end."""
        level = np.zeros_like(time)
        for each in self.schedule.repetitions:
            length = each.rise_end - each.rise_start
            level += smoothstep((time - each.rise_start) / (0.4 * length))
            level -= smoothstep((time - each.rise_start - 0.75 * length) / (0.25 * length))
        return self.share * level
