"""Names of markers: subject prefixes, repeated labels, and trajectories that are not markers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mocap_id.recording.units import strip_padding

_OUTPUT = re.compile(r"(angles?|forces?|moments?|powers?|grf|cent(re|er)_?of_?mass\w*)$", re.IGNORECASE)
"""Outputs of gait models among the points: joint angles, forces, moments, powers, centres of mass."""

_JOINT_CENTRE = re.compile(r"(?:^|[LR_.\s-])(?:H|K|A|S|E|W)JC(?:[_.\s-].*)?$|joint_?cent(?:re|er)", re.IGNORECASE)
"""Computed joint centres, such as LHJC, R_KJC or L_HJC_reg."""

_SEPARATORS = ":_-. "  # characters between the name of a subject and the name of a marker
_SEGMENT_AXES = ("O", "A", "L", "P")
"""Last letters of the four points of a model's segment frame: the origin and a point on each axis."""


@dataclass(frozen=True)
class MarkerNames:
    """Trajectories to keep, and their names."""

    keep: tuple[int, ...]  # numbers of the trajectories that are markers, counted from 0
    labels: tuple[str, ...]  # unique names of these trajectories
    oddities: tuple[str, ...]  # notes on renamed and omitted trajectories


def name_markers(raw: Sequence[str], outputs: Iterable[str] = (), subjects: Iterable[str] = ()) -> MarkerNames:
    """Select the markers among the trajectories and give each a unique name without the name of a person.

    ``raw`` are the labels of all trajectories in the file, possibly empty. ``outputs`` are labels of trajectories that
    the file declares not to be markers (POINT:ANGLES …). ``subjects`` are names of subjects and label prefixes that the
    file declares. These names are removed from the start of labels, as is everything up to a colon; no message contains
    them.
    """
    known = sorted({name.strip() for name in subjects if name.strip()}, key=len, reverse=True)
    split = [_split_prefix(strip_padding(text), known) for text in raw]
    bare, oddities = _remove_subjects(split)
    declared = {part for name in outputs for part in (name.strip(), _split_prefix(name.strip(), known)[1])}
    computed = _find_computed(bare, declared)
    if computed:
        names = ", ".join(bare[i] for i in computed[:4]) + (" …" if len(computed) > 4 else "")
        oddities.append(f"{len(computed)} trajectories are computed, not measured, and were omitted: {names}")
    unnamed = [i for i, name in enumerate(bare) if not name]
    if unnamed:
        oddities.append(f"{len(unnamed)} trajectories have no label and were named unlabelled-1, …")
        for number, i in enumerate(unnamed, start=1):
            bare[i] = f"unlabelled-{number}"
    keep = [i for i in range(len(bare)) if i not in set(computed)]
    labels, repeated = _make_unique([bare[i] for i in keep])
    if repeated:
        oddities.append(f"labels that occur more than once were numbered (A, A#2, …): {', '.join(repeated)}")
    return MarkerNames(tuple(keep), tuple(labels), tuple(oddities))


def _split_prefix(label: str, subjects: Sequence[str]) -> tuple[str, str]:
    """Split a label into the name of a subject, possibly empty, and the name of the marker."""
    if ":" in label:
        prefix, name = label.split(":", 1)
        return prefix, name.strip()
    for subject in subjects:
        rest = label.removeprefix(subject)
        if rest != label and rest and (rest[0] in _SEPARATORS or subject[-1] in _SEPARATORS):
            return subject, rest.lstrip(_SEPARATORS)
    return "", label


def _remove_subjects(split: Sequence[tuple[str, str]]) -> tuple[list[str], list[str]]:
    """Return the names without prefixes, and notes.

    If two markers would then have the same name, the prefixes are replaced by numbered subjects.
    """
    names = [name for _, name in split]
    prefixes = list(dict.fromkeys(prefix for prefix, _ in split if prefix))
    if not prefixes:
        return names, []
    markers = {(prefix, name) for prefix, name in split if name}
    if len({name for _, name in markers}) == len(markers):
        several = f" of {len(prefixes)} subjects" if len(prefixes) > 1 else ""
        return names, [f"the labels contain subject names{several}, which were removed"]
    number = {prefix: f"subject-{k}:" for k, prefix in enumerate(prefixes, start=1)} | {"": ""}
    oddity = (
        f"markers of {len(prefixes)} subjects share names: the subjects were named subject-1 to "
        f"subject-{len(prefixes)}, in the order of the file. A trial must have one person: omit the others with "
        "`planarise: {ignore: ['subject-2:*']}`"
    )
    return [number[prefix] + name for prefix, name in split], [oddity]


def _find_computed(names: Sequence[str], declared: set[str]) -> list[int]:
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


def _make_unique(names: Sequence[str]) -> tuple[list[str], list[str]]:
    counts: Counter[str] = Counter()
    taken = set(names)
    unique = []
    for name in names:
        counts[name] += 1
        candidate, number = name, counts[name]
        while number > 1 and (candidate := f"{name}#{number}") in taken:
            number += 1
        taken.add(candidate)
        counts[name] = number
        unique.append(candidate)
    return unique, sorted(name for name, count in counts.items() if count > 1 and name)
