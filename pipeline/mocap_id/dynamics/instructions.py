"""A movement in words that a laboratory can follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.dynamics.waves import Waves

_LEAST = np.radians(0.5)  # less is no movement
_LEAST_SWAY = 0.0025  # m


def swung(waves: Waves, joints: Sequence[str]) -> str:
    """What every joint does, one phrase each.

    Parameters
    ----------
    waves : Waves
    joints : sequence of str
        Their names.
    """
    phrases = [_joint(waves, j, joints[j]) for j in range(int(waves.balanced), len(joints))]
    said = "; ".join(phrase for phrase in phrases if phrase)
    if not waves.balanced:
        return said
    sway = float(waves.amplitude[0, 0])
    keeping = f"let {the(joints[0])} keep the balance"
    if abs(sway) < _LEAST_SWAY:
        return f"{said}; {keeping}"
    swaying = f"sway to and fro by {100 * abs(sway):.1f} cm at {waves.frequency[0]:.2f} Hz"
    return "; ".join(part for part in (said, f"{swaying} and {keeping}") if part)


def _joint(waves: Waves, joint: int, name: str) -> str:
    size = float(np.hypot(*waves.amplitude[joint]))
    if size < _LEAST:
        if abs(waves.centre[joint]) < _LEAST:
            return ""
        return f"hold {the(name)} at {_degrees(waves.rest[joint] + waves.centre[joint])}"
    middle, first = waves.rest[joint] + waves.centre[joint], abs(float(waves.amplitude[joint, 0]))
    overtone = abs(float(waves.amplitude[joint, 1]))
    ends = f"from {_degrees(middle - first)} to {_degrees(middle + first)}"
    beside = f", and {_degrees(overtone)} at twice that" if overtone >= _LEAST else ""
    return f"swing {the(name)} by ±{_degrees(first)} ({ends}) at {waves.frequency[joint]:.2f} Hz{beside}"


def the(name: str) -> str:
    """A joint's name within a sentence: ``joint 2`` has no article."""
    return name if name[-1:].isdigit() else f"the {name}"


def _degrees(angle: float) -> str:
    return f"{round(float(np.degrees(angle))):d}°"
