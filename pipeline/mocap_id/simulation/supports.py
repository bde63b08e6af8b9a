"""Chair and rail: supports that carry a share of a person's weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.simulation.joint_motion import smoothstep
from mocap_id.simulation.schedule import Schedule

TRUNK = 3  # the link that the hand on the rail belongs to
POINT = (-0.30, 0.30)  # position of that hand in the trunk's frame, in front of the person, m


@dataclass(frozen=True)
class Chair:
    """A chair that pushes on a point of the thigh with 0 … ``share`` of the body's vertical load.

    Parameters
    ----------
    point : (x, y)
        Point on the underside of the thigh, near the hip, in the thigh's frame, m.
    share : float
        Share of the total vertical force while seated.
    friction : float
        Horizontal over vertical force.
    schedule : Schedule
    """

    point: tuple[float, float]
    share: float
    friction: float
    schedule: Schedule

    def load(self, time: FloatArray) -> FloatArray:
        """Return the chair's share of the total vertical force at times (T,)."""
        return self.share * self.schedule.chair_load(time)


@dataclass(frozen=True)
class Rail:
    """A rail that carries a share of the vertical load, unmeasured, while the person rises.

    Parameters
    ----------
    share : float
        Largest share of the total vertical force.
    schedule : Schedule
    """

    share: float
    schedule: Schedule

    def load(self, time: FloatArray) -> FloatArray:
        """Return the rail's share of the total vertical force at times (T,).

        The rail is loaded from the start of each rise until shortly before its end.
        """
        level = np.zeros_like(time)
        for each in self.schedule.repetitions:
            length = each.rise_end - each.rise_start
            level += smoothstep((time - each.rise_start) / (0.4 * length))
            level -= smoothstep((time - each.rise_start - 0.75 * length) / (0.25 * length))
        return self.share * level
