"""Marker names: subject prefixes, repeated labels, and trajectories that are no markers at all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

_OUTPUT = re.compile(
    r"(angles?|forces?|moments?|powers?|grf|centre_?of_?mass\w*|center_?of_?mass\w*)$",
    re.IGNORECASE,
)
"""What gait models write among the points: joint angles, forces, moments, powers, centres of mass."""

_JOINT_CENTRE = re.compile(r"(?:^|[LR_.\s-])(?:H|K|A|S|E|W)JC(?:[_.\s-].*)?$|joint_?cent(?:re|er)", re.IGNORECASE)
"""Computed joint centres: LHJC, R_KJC, L_HJC_reg …"""

_SEGMENT_AXES = ("O", "A", "L", "P")
"""A model's segment frame is written as four points: origin and one point along each axis."""


@dataclass(frozen=True)
class Naming:
    """Which trajectories are kept, under which names.

    Parameters
    ----------
    keep : tuple of int
        Columns of the file that are markers.
    labels : tuple of str
        Their unique names.
    oddities : tuple of str
        What was renamed or left out.
    """

    keep: tuple[int, ...]
    labels: tuple[str, ...]
    oddities: tuple[str, ...]


def name_markers(raw: Sequence[str], outputs: Iterable[str] = ()) -> Naming:
    """Choose the markers among a file's trajectories and give each a unique name.

    Parameters
    ----------
    raw : sequence of str
        Labels as in the file, one a trajectory, possibly empty.
    outputs : iterable of str
        Labels that the file itself declares as something else than markers (POINT:ANGLES …).
    """
    bare, oddities = _without_subject([text.strip().strip("\x00").strip() for text in raw])
    declared = {name.strip() for name in outputs} | {name.strip().split(":")[-1] for name in outputs}
    dropped = _not_markers(bare, declared)
    if dropped:
        names = ", ".join(bare[i] for i in dropped[:4]) + (" …" if len(dropped) > 4 else "")
        oddities.append(f"{len(dropped)} trajectories are computed, not measured, and were left out: {names}")
    unnamed = [i for i, name in enumerate(bare) if not name]
    if unnamed:
        oddities.append(f"{len(unnamed)} trajectories have no label and were named unlabelled-1 …")
        for number, i in enumerate(unnamed, start=1):
            bare[i] = f"unlabelled-{number}"
    keep = [i for i in range(len(bare)) if i not in set(dropped)]
    labels, repeated = _made_unique([bare[i] for i in keep])
    if repeated:
        oddities.append(f"labels that occur more than once were numbered (A, A#2 …): {', '.join(repeated)}")
    return Naming(tuple(keep), tuple(labels), tuple(oddities))


def _without_subject(names: list[str]) -> tuple[list[str], list[str]]:
    """Strip ``SUBJECT:`` prefixes, unless that makes two markers of two subjects one."""
    prefixes = sorted({name.split(":", 1)[0] for name in names if ":" in name})
    if not prefixes:
        return list(names), []
    stripped = [name.split(":", 1)[-1].strip() for name in names]
    if _repeats(stripped) - _repeats(names):
        return list(names), [f"subject prefixes kept, markers of {', '.join(prefixes)} share names"]
    return stripped, [f"subject prefix stripped from the labels: {', '.join(prefixes)}"]


def _repeats(names: Iterable[str]) -> set[str]:
    return {name for name, count in Counter(names).items() if count > 1 and name}


def _not_markers(names: Sequence[str], declared: set[str]) -> list[int]:
    stems = {name[:-1] for name in names if all(name[:-1] + axis in names for axis in _SEGMENT_AXES) and name[:-1]}
    return [
        i
        for i, name in enumerate(names)
        if name
        and (
            name in declared
            or _OUTPUT.search(name)
            or _JOINT_CENTRE.search(name)
            or (name[:-1] in stems and name[-1] in _SEGMENT_AXES)
        )
    ]


def _made_unique(names: Sequence[str]) -> tuple[list[str], list[str]]:
    seen: Counter[str] = Counter()
    taken = set(names)
    unique = []
    for name in names:
        seen[name] += 1
        candidate, number = name, seen[name]
        while number > 1 and (candidate := f"{name}#{number}") in taken:
            number += 1
        taken.add(candidate)
        seen[name] = number
        unique.append(candidate)
    return unique, sorted(_repeats(names))
