"""Names for OpenSim, whose components have no blanks or slashes in their names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from mocap_id.store.views import Skeleton

_UNFIT = re.compile(r"[^A-Za-z0-9_.\-]+")
BASE = "base"
"""Name of the joint that fixes the base segment to the ground."""


def legal(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """Return unique names that consist of letters, digits, ``_``, ``.`` and ``-``.

    Examples
    --------
    >>> legal(["joint 1", "joint/1", "hip"])
    {'joint 1': 'joint_1', 'joint/1': 'joint_1_2', 'hip': 'hip'}
    """
    given: dict[str, str] = {}
    used = set(taken)
    for name in names:
        plain = _UNFIT.sub("_", name).strip("_") or "unnamed"
        chosen, number = plain, 2
        while chosen in used:
            chosen, number = f"{plain}_{number}", number + 1
        given[name] = chosen
        used.add(chosen)
    return given


def body_names(skeleton: Skeleton) -> tuple[str, ...]:
    """Return OpenSim's names of the segments, base first."""
    return tuple(legal(skeleton.segments, taken=("ground",)).values())


def joint_names(skeleton: Skeleton) -> tuple[str, ...]:
    """Return OpenSim's names of the joints."""
    return tuple(legal(skeleton.joints, taken=(BASE,)).values())


def coordinate_names(skeleton: Skeleton) -> tuple[str, ...]:
    """Return OpenSim's names of the joint angles, such as ``ankle_angle``."""
    return tuple(f"{joint}_angle" for joint in joint_names(skeleton))


def renamed(names: Mapping[str, str]) -> tuple[str, ...]:
    """Return a note on the names that were changed, if any."""
    changed = [f"{old} → {new}" for old, new in names.items() if old != new]
    return (f"names that OpenSim does not accept were changed: {', '.join(changed)}",) if changed else ()
