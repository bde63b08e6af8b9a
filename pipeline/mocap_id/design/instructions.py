"""Instructions: a wave movement in words that a laboratory can follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mocap_id.design.wave_movement import WaveMovement

_LEAST = np.radians(0.5)  # smaller swings are not mentioned
_LEAST_SWAY = 0.0025  # m


def describe_waves(waves: WaveMovement, joints: Sequence[str]) -> str:
    """Describe what every joint does, one phrase for each; ``joints`` are their names."""
    phrases = [_joint(waves, j, joints[j]) for j in range(int(waves.balanced), len(joints))]
    text = "; ".join(phrase for phrase in phrases if phrase)
    if not waves.balanced:
        return text
    sway = float(waves.amplitude[0, 0])
    keeping = f"let {with_article(joints[0])} keep the balance"
    if abs(sway) < _LEAST_SWAY:
        return f"{text}; {keeping}"
    swaying = f"sway to and fro by {100 * abs(sway):.1f} cm at {waves.frequency[0]:.2f} Hz"
    return "; ".join(part for part in (text, f"{swaying} and {keeping}") if part)


def _joint(waves: WaveMovement, joint: int, name: str) -> str:
    size = float(np.hypot(*waves.amplitude[joint]))
    if size < _LEAST:
        if abs(waves.centre[joint]) < _LEAST:
            return ""
        return f"hold {with_article(name)} at {_degrees(waves.rest[joint] + waves.centre[joint])}"
    middle, first = waves.rest[joint] + waves.centre[joint], abs(float(waves.amplitude[joint, 0]))
    overtone = abs(float(waves.amplitude[joint, 1]))
    ends = f"from {_degrees(middle - first)} to {_degrees(middle + first)}"
    second = f", and {_degrees(overtone)} at twice that" if overtone >= _LEAST else ""
    return f"swing {with_article(name)} by ±{_degrees(first)} ({ends}) at {waves.frequency[joint]:.2f} Hz{second}"


def with_article(name: str) -> str:
    """Return a joint's name as used within a sentence: ``the hip``, but ``joint 2``."""
    return name if name[-1:].isdigit() else f"the {name}"


def _degrees(angle: float) -> str:
    return f"{round(float(np.degrees(angle))):d}°"
