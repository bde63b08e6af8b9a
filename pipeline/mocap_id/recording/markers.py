"""Markers: names without the names of people, positions in metres and lab axes, without impossible samples."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.recording.marker_tables import MarkerTable
from mocap_id.recording.model import (
    LENGTHS,
    ReadingOptions,
    Recording,
    check_length_unit,
    find_length_scale,
    nearest_axis,
    strip_padding,
    to_z_up,
)

_OUTPUT = re.compile(r"(angles?|forces?|moments?|powers?|grf|cent(re|er)_?of_?mass\w*)$", re.IGNORECASE)
"""Outputs of gait models among the points: joint angles, forces, moments, powers, centres of mass."""

_JOINT_CENTRE = re.compile(r"(?:^|[LR_.\s-])(?:H|K|A|S|E|W)JC(?:[_.\s-].*)?$|joint_?cent(?:re|er)", re.IGNORECASE)
"""Computed joint centres, such as LHJC, R_KJC or L_HJC_reg."""

_UNLABELLED = re.compile(r"$|\*\d*$|un-?labell?ed", re.IGNORECASE)
"""Names that camera software gives to trajectories that nobody labelled."""

_LABELLED = 6  # least number of labelled markers with which unlabelled pieces are left out
_BODY_MARKERS = 5  # least number of markers of a person
_RIGID_M, _BENT_M = 0.010, 0.020  # change of the distance of two markers on an object at most, on a person at least
_BENT_PAIRS = 0.1  # least fraction of the pairs of a person's markers that change their distance
_PEOPLE_APART_M = 0.5  # least distance of the markers of two people whose markers have different names
_COMPARED_FRAMES = 200  # number of frames in which distances are compared

_MAX_DISTANCE_M = 1000.0  # larger than any laboratory: such coordinates are invalid
_MIN_SPREAD_M, _MAX_SPREAD_M = 0.02, 100.0  # accepted spread of the markers of a trial, to check the unit
_MILLIMETRE = 1e-3
_APART_M = 1.0  # least distance of a code for missing samples from all real samples
_REPEATED = 10  # least number of samples at a code that is near real samples
_BLOCK = 1000  # number of frames to process at a time, which limits the memory needed

_SEPARATORS = ":_-. "  # characters between the name of a subject and the name of a marker
_SEGMENT_AXES = ("O", "A", "L", "P")
"""Last letters of the four points of a model's segment frame: the origin and a point on each axis."""


@dataclass(frozen=True)
class MarkerNames:
    """Trajectories to keep, and their names."""

    keep: tuple[int, ...]  # numbers of the trajectories that are markers, counted from 0
    labels: tuple[str, ...]  # unique names of these trajectories
    oddities: tuple[str, ...]  # notes on renamed and omitted trajectories
    # names of the subject or object and of the marker of each of these, as in the file; either may be empty
    parts: tuple[tuple[str, str], ...] = ()
    left_out: tuple[str, ...] = ()  # labels of trajectories that `leave_out_objects` left out
    people: tuple[str, ...] = ()  # beginnings of the labels of each person, if there are several people


def name_markers(
    raw: Sequence[str], outputs: Iterable[str] = (), subjects: Iterable[str] = (), *, apart: bool = False
) -> MarkerNames:
    """Select the markers among the trajectories and give each a unique name without the name of a person.

    ``raw`` are the labels of all trajectories; a label may be empty. ``outputs`` are the labels that the file declares
    as other data than markers (POINT:ANGLES …). The names of ``subjects`` that the file declares are removed from the
    start of labels, as is everything up to a colon; no message contains them. With ``apart``, every label says the
    number of its subject.
    """
    known = sorted({name.strip() for name in subjects if name.strip()}, key=len, reverse=True)
    split = [_split_prefix(strip_padding(text), known) for text in raw]
    bare, oddities = [name for _, name in split], list[str]()
    prefixes = list(dict.fromkeys(prefix for prefix, _ in split if prefix))
    markers = {(prefix, name) for prefix, name in split if name}
    if prefixes and len({name for _, name in markers}) == len(markers) and not apart:
        several = f" of {len(prefixes)} subjects" if len(prefixes) > 1 else ""
        oddities.append(f"the labels contain subject names{several}, which were removed")
    elif prefixes:  # two markers would have the same name: numbered subjects replace the prefixes
        numbered = {prefix: f"subject-{k}:" for k, prefix in enumerate(prefixes, start=1)} | {"": ""}
        bare = [numbered[prefix] + name for prefix, name in split]
        oddities.append(
            f"markers of {len(prefixes)} subjects {'move apart' if apart else 'share names'}: the subjects were named "
            f"subject-1 to subject-{len(prefixes)}, in the order of the file. A trial must have one person: omit the "
            "others with `planarise: {ignore: ['subject-2:*']}`"
        )
    declared = {part for name in outputs for part in (name.strip(), _split_prefix(name.strip(), known)[1])}
    stems = {name[:-1] for name in bare if all(name[:-1] + axis in bare for axis in _SEGMENT_AXES) and name[:-1]}
    computed = [
        i
        for i, name in enumerate(bare)
        if name
        and (
            name in declared
            or _OUTPUT.search(name)
            or _JOINT_CENTRE.search(name)
            or (name[:-1] in stems and name[-1] in _SEGMENT_AXES)
        )
    ]
    if computed:
        names = ", ".join(bare[i] for i in computed[:4]) + (" …" if len(computed) > 4 else "")
        oddities.append(f"{len(computed)} trajectories are computed, not measured, and were omitted: {names}")
    unnamed = [i for i, name in enumerate(bare) if not name]
    if unnamed:
        oddities.append(f"{len(unnamed)} trajectories have no label and were named unlabelled-1, …")
        for number, i in enumerate(unnamed, start=1):
            bare[i] = f"unlabelled-{number}"
    keep = [i for i in range(len(bare)) if i not in set(computed)]
    labels, counts, taken = list[str](), Counter[str](), {bare[i] for i in keep}
    for name in (bare[i] for i in keep):
        counts[name] += 1
        label, number = name, counts[name]
        while number > 1 and (label := f"{name}#{number}") in taken:
            number += 1
        taken.add(label)
        counts[name] = number
        labels.append(label)
    repeated = sorted(name for name, count in counts.items() if count > 1 and name)
    if repeated:
        oddities.append(f"labels that occur more than once were numbered (A, A#2, …): {', '.join(repeated)}")
    return MarkerNames(tuple(keep), tuple(labels), tuple(oddities), tuple(split[i] for i in keep))


def leave_out_objects(naming: MarkerNames, positions: FloatArray) -> tuple[MarkerNames, FloatArray]:
    """Return the markers of the person, and their positions (F, M, 3); positions are NaN where a marker was not seen.

    A prefix whose markers keep their distances, such as ``BOX:``, is an object if another prefix carries a body. Where
    the person has labels, trajectories without a label are left out if they are pieces, seen in less than half of the
    frames, if they are far from the person, or if the file calls them unlabelled. A trajectory that is equal to another
    of the same label is left out; if only the labels differ, there is a note.
    """
    frames = positions[:: max(1, len(positions) // _COMPARED_FRAMES)]
    naming = _separate_repeated_labels(naming, frames)
    prefixes = [prefix for prefix, _ in naming.parts]
    unlabelled = np.array([bool(prefix) and bool(_UNLABELLED.match(prefix)) for prefix in prefixes], dtype=bool)
    named = np.array([not _UNLABELLED.match(name) for _, name in naming.parts], dtype=bool)
    notes, out = [], np.zeros(len(prefixes), dtype=bool)
    if (np.isfinite(frames).all(axis=2).any(axis=0) & named & ~unlabelled).sum() >= _LABELLED:
        called = [_UNLABELLED.match(name) is not None and name[:1] not in ("", "*") for _, name in naming.parts]
        out = unlabelled | np.array(called, dtype=bool)
        rest = np.flatnonzero(~named & ~out)
        out[rest] = np.isfinite(positions[:, rest]).all(axis=2).mean(axis=0) < 0.5
        person = frames[:, named & ~unlabelled]
        for k in rest:
            distance = np.linalg.norm(person - frames[:, k, None], axis=2)
            nearest = np.min(distance, axis=1, where=np.isfinite(distance), initial=np.inf)
            out[k] |= bool(np.median(nearest) > _PEOPLE_APART_M)
        if out.any():
            notes.append(
                f"{int(out.sum())} trajectories without a label, such as pieces and reflections, were left out: "
                "label those that belong to the person"
            )
    copies: dict[bytes, list[int]] = {}
    for k in np.flatnonzero(~out & np.isfinite(positions).any(axis=(0, 2))):
        copies.setdefault(hashlib.sha256(np.nan_to_num(positions[:, k]).tobytes()).digest(), []).append(int(k))
    for same in copies.values():
        out[[k for k in same[1:] if naming.parts[k] == naming.parts[same[0]]]] = True
        if len(same) > 1:
            notes.append(
                f"the trajectories {', '.join(naming.labels[k] for k in same[:4])} are exactly equal: those with the "
                "same label were left out, and those with another label are used like separate measurements, although "
                "they are none. Export each marker once, or leave one out with `planarise: {ignore: […]}`"
            )
    groups = {prefix: np.array([each == prefix for each in prefixes]) & ~out for prefix in dict.fromkeys(prefixes)}
    if len(groups) == 1:
        groups = {}
    changes = {prefix: _measure_distance_changes(frames[:, group]) for prefix, group in groups.items() if group.any()}
    bodies = [
        prefix
        for prefix, change in changes.items()
        if groups[prefix].sum() >= _BODY_MARKERS and (change > _BENT_M).sum() > _BENT_PAIRS * len(change)
    ]
    objects = [
        prefix
        for prefix, change in changes.items()
        if bodies and prefix and prefix not in bodies and len(change) and (change <= _RIGID_M).all()
    ]
    for number, prefix in enumerate(objects, start=1):
        labels = [naming.parts[i][1] for i in np.flatnonzero(groups[prefix])]
        names = ", ".join(labels[:4]) + (" …" if len(labels) > 4 else "")
        notes.append(
            f"the markers of object {number} ({len(labels)}: {names}) were left out: they have a prefix of their own "
            "and keep their distances from each other, unlike those of the person"
        )
        out |= groups[prefix]
    people = [prefix for prefix in bodies if prefix] if len(bodies) > 1 else []
    shared = Counter(name for prefix, name in naming.parts if prefix in people)
    if people and max(shared.values()) == 1:  # the prefixes may be parts of one person
        middle = [np.nanmedian(frames[:, groups[prefix]], axis=0) for prefix in people]
        nearest = [np.linalg.norm(a[:, None] - b, axis=2).min() for a, b in itertools.combinations(middle, 2)]
        people = people if min(nearest) > _PEOPLE_APART_M else []
    if not out.any() and not people:
        return replace(naming, oddities=(*naming.oddities, *notes)), positions
    kept = np.flatnonzero(~out).tolist()
    parts = [naming.parts[i] for i in kept]
    again = name_markers([f"{prefix}:{name}" if prefix else name for prefix, name in parts], apart=bool(people))
    computed = [note for note in naming.oddities if "computed" in note]
    numbers = {prefix: k for k, prefix in enumerate(dict.fromkeys(prefix for prefix, _ in parts if prefix), start=1)}
    left = MarkerNames(
        tuple(naming.keep[i] for i in kept),
        again.labels,
        (*computed, *again.oddities, *notes),
        again.parts,
        tuple(naming.labels[i] for i in np.flatnonzero(out)),
        tuple(f"subject-{numbers[prefix]}:" for prefix in people),
    )
    return left, positions[:, kept] if out.any() else positions


def _separate_repeated_labels(naming: MarkerNames, frames: FloatArray) -> MarkerNames:
    """Return the names with a prefix for each person, if two or more people have the same labels without a colon.

    Either labels occur several times, or they begin with several words and a separator. They are those of several
    people if at least five labels occur so, all usually far apart, and if every person bends.
    """
    if any(prefix for prefix, _ in naming.parts):
        return naming
    names = [name for _, name in naming.parts]
    ways = [[(str(names[:k].count(name)), name) for k, name in enumerate(names)]]
    for mark in "_-. ":
        for first in (True, False):
            cuts = [name.find(mark) if first else name.rfind(mark) for name in names]
            ways.append([(name[: max(cut, 0)], name[cut + 1 :]) for name, cut in zip(names, cuts, strict=True)])
    for parts in ways:
        places: dict[str, list[int]] = {}
        for k, (prefix, name) in enumerate(parts):
            if prefix and name:
                places.setdefault(name, []).append(k)
        pairs = [pair for same in places.values() for pair in itertools.pairwise(same)]
        distances = [np.linalg.norm(frames[:, a] - frames[:, b], axis=1) for a, b in pairs]
        apart = [np.median(each[np.isfinite(each)]) > _PEOPLE_APART_M for each in distances if np.isfinite(each).any()]
        if len(apart) < _BODY_MARKERS or not all(apart):
            continue
        people = {parts[k][0] for pair in pairs for k in pair}
        groups = [[k for k, (prefix, _) in enumerate(parts) if prefix == each] for each in people]
        changes = [_measure_distance_changes(frames[:, group]) for group in groups]
        if all((change > _BENT_M).sum() > _BENT_PAIRS * len(change) for change in changes):
            return replace(naming, parts=tuple(parts))
    return naming


def _measure_distance_changes(positions: FloatArray) -> FloatArray:
    """Return by how much the distance of each pair of markers (F, M, 3) changes between 12 and 88 % quantiles, m."""
    first, second = np.triu_indices(positions.shape[1], 1)
    distance = np.linalg.norm(positions[:, first] - positions[:, second], axis=2)
    distance = distance[:, np.isfinite(distance).any(axis=0)]
    if not distance.shape[1]:
        return np.zeros(0)
    return np.asarray(np.ptp(np.nanquantile(distance, [0.12, 0.88], axis=0), axis=0))


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


def resolve_length_unit(
    path: Path, declared: str, override: str | None, oddities: list[str], *, required: bool = True
) -> tuple[str, float]:
    """Return the length unit to use and its size in metres; contradictions are noted in ``oddities``.

    ``declared`` is the unit in the file, possibly empty; ``override`` in the configuration has priority. If neither is
    known, RecordingError is raised, or unless ``required`` the unit is empty and lengths are read as millimetres.
    """
    name = strip_padding(declared)
    if override is not None:
        scale = check_length_unit(override)
        if find_length_scale(name) not in (None, scale):
            oddities.append(f"the file declares lengths in {name!r}, the configuration {override}: {override} was used")
        return override, scale
    own_scale = find_length_scale(name)
    if own_scale is None:
        found = f"the length unit {name!r}, which is ambiguous or unknown" if name else "no length unit"
        if not required:
            oddities.append(f"the file declares {found}: a run needs it, `planarise: {{units: mm}}` (or m, cm)")
            return "", _MILLIMETRE
        raise RecordingError(f"{path}: the file declares {found}; set `planarise: {{units: mm}}` (or m, cm)")
    if name.lower() not in LENGTHS:
        oddities.append(f"the length unit {name!r} is truncated: read as {'metres' if own_scale == 1 else name}")
    return name, own_scale


def thin_frames(positions: FloatArray) -> FloatArray:
    """Return 1000 to 2000 evenly spaced frames of positions (F, M, 3), or all frames if there are fewer."""
    return positions[:: max(1, len(positions) // _BLOCK)]


def rotate_z_up(positions: FloatArray, up: str) -> None:
    """Rotate positions (F, M, 3) in place, so that the file's axis ``up`` becomes Z."""
    rotation = to_z_up(up)
    for at in range(0, len(positions) if up != "Z" else 0, _BLOCK):
        positions[at : at + _BLOCK] = positions[at : at + _BLOCK] @ rotation.T


def clean_positions(path: Path, positions: FloatArray, units: str, oddities: list[str]) -> None:
    """Set impossible samples of positions (F, M, 3), m, to NaN in place, and check the space that the markers occupy.

    If ``units`` of the file is empty, a note gives this space in mm, cm and m; otherwise RecordingError is raised if it
    contradicts the unit.
    """
    _remove_codes(positions, oddities)
    # All samples must not be within 2 cm, nor the middle half of them spread over more than 100 m.
    frames = thin_frames(positions)
    visible = np.isfinite(frames).all(axis=2)
    if visible.any():
        samples = frames[visible]
        spread = float(np.linalg.norm(np.ptp(np.percentile(samples, [25, 75], axis=0), axis=0)))
        extent = float(np.linalg.norm(np.ptp(samples, axis=0)))
        several = int(visible.any(axis=0).sum()) >= 3
        if not units:
            written = spread / _MILLIMETRE
            choices = ", ".join(f"{name} gives {written * LENGTHS[name]:.3g} m" for name in ("mm", "cm", "m"))
            oddities.append(f"half of the marker samples spread over {written:.4g} in the unit of the file: {choices}")
        elif spread > _MAX_SPREAD_M or (several and 0 < extent < _MIN_SPREAD_M):
            size = spread if spread > _MAX_SPREAD_M else extent
            sizes = {name: size / (find_length_scale(units) or 1.0) * LENGTHS[name] for name in ("mm", "cm", "m")}
            possible = {name: at for name, at in sizes.items() if _MIN_SPREAD_M <= at <= _MAX_SPREAD_M}
            fits = ", ".join(f"{name} gives {at:.3g} m" for name, at in possible.items())
            raise RecordingError(
                f"{path}: the markers spread over {size:.3g} m when read in {units!r}, expected {_MIN_SPREAD_M} to "
                f"{_MAX_SPREAD_M:.0f} m; the unit is wrong, set `planarise: {{units: …}}`"
                + (f": {fits}" if fits else "")
            )
    marked = np.zeros(4, dtype=np.int64)  # numbers of non-finite, too far, zero and valid samples
    for at in range(0, len(positions), _BLOCK):
        part = positions[at : at + _BLOCK]
        x, y, z = np.abs(np.moveaxis(part, 2, 0))
        largest = np.maximum(np.maximum(x, y), z)  # NaN if any coordinate is
        broken = ~np.isfinite(largest) & ~(np.isnan(x) & np.isnan(y) & np.isnan(z))
        far, zero = ~broken & (largest > _MAX_DISTANCE_M), largest == 0
        for flags in (broken, far, zero):
            if flags.any():
                part[flags] = np.nan
        valid = (largest <= _MAX_DISTANCE_M).sum() - zero.sum()
        marked += [broken.sum(), far.sum(), zero.sum(), valid]
    for count, what in zip(
        marked,
        ("are not finite", f"are farther than {_MAX_DISTANCE_M:.0f} m away", "are exactly 0, 0, 0"),
        strict=False,
    ):
        if count:
            oddities.append(f"{count} marker samples {what} and were set to missing")
    if not marked[3]:
        oddities.append(f"none of the {positions.shape[1]} markers is ever visible")


def _remove_codes(positions: FloatArray, oddities: list[str]) -> None:
    """Set samples that a number such as 9999 or −16512 marks as missing to NaN, in place.

    Such samples are exactly alike, and farther than a metre from all others. They are on several markers, or between
    other samples of one marker, or their three coordinates are the same number. A code may also be near real samples,
    such as 999.9 mm: its three coordinates are the same number, and at least ten samples of several markers have it.
    """
    flat = positions.reshape(-1, 3)
    if not len(flat):
        return
    extremes = [(axis, reduce.reduce(flat, axis=0)) for reduce in (np.fmin, np.fmax) for axis in range(3)]
    while extremes:
        axis, values = extremes.pop()
        chosen = positions[..., axis] == values[axis]
        alike, markers = positions[chosen], chosen.any(axis=0)
        if (
            len(alike) <= 1
            or not np.abs(values[axis]) <= _MAX_DISTANCE_M
            or not alike[0].any()
            or (alike != alike[0]).any()
        ):
            continue
        apart = True
        for at in range(0, len(positions), _BLOCK):  # a recording may be large
            distance = np.abs(positions[at : at + _BLOCK, :, axis] - values[axis])
            apart &= not (distance[~chosen[at : at + _BLOCK]] <= _APART_M).any()
        between = markers.sum() == 1 and (np.isfinite(positions[:, markers, axis]) & ~chosen[:, markers]).any()
        if apart and (markers.sum() > 1 or between or np.ptp(np.abs(alike[0])) == 0):
            positions[chosen] = np.nan
            code = ", ".join(f"{number:.6g}" for number in alike[0])
            oddities.append(
                f"{len(alike)} marker samples are at ({code}) m, far from all others: this number marks missing "
                "samples, and they were set to missing"
            )
            extremes = [(axis, reduce.reduce(flat, axis=0)) for reduce in (np.fmin, np.fmax) for axis in range(3)]
    found = []
    for at in range(0, len(positions), _BLOCK):
        x, y, z = np.moveaxis(np.abs(positions[at : at + _BLOCK]), 2, 0)
        frame, marker = np.nonzero((x == y) & (x == z) & (x > 0) & (x <= _MAX_DISTANCE_M))
        found.append(np.column_stack([frame + at, marker]))
    same = np.concatenate(found)
    numbers, which, counts = np.unique(
        positions[same[:, 0], same[:, 1]], axis=0, return_inverse=True, return_counts=True
    )
    for k in np.flatnonzero(counts >= _REPEATED):
        frame, marker = same[which == k].T
        if len(np.unique(marker)) > 1:
            positions[frame, marker] = np.nan
            code = ", ".join(f"{number:.6g}" for number in numbers[k])
            oddities.append(
                f"{len(frame)} samples of {len(np.unique(marker))} markers are exactly at ({code}) m: this number "
                "marks missing samples, and they were set to missing"
            )


def assemble_recording(
    path: Path, table: MarkerTable, force: FloatArray | None, options: ReadingOptions, oddities: list[str]
) -> tuple[Recording, FloatArray]:
    """Return a table as a recording without plates, and the rotation (3, 3) from the axes of the file to Z up.

    ``force`` (3,) is the mean ground force in the axes of the file, None without plates.
    """
    required = options.unit_required
    unit, metres = resolve_length_unit(path, table.units, options.units, oddities, required=required)
    naming = name_markers(table.labels, table.outputs)
    positions = table.positions[:, list(naming.keep)] * metres
    clean_positions(path, positions, unit, oddities)
    naming, positions = leave_out_objects(naming, positions)
    oddities += naming.oddities
    # The axis that points up: the user's setting, or along the ground force, or as is usual for the format
    axis = None if force is None or not np.any(force) else nearest_axis(force, 0.9)
    along = None if axis is None else axis.lstrip("-")
    up = options.vertical or along or table.up
    if options.vertical is not None and along not in (None, up.lstrip("-")):
        oddities.append(f"the ground force acts along {along}, the configuration says {up} is up: {up} was used")
    elif options.vertical is None and along is None:
        oddities.append(
            f"the file does not say which axis is up: {up} was assumed, as is usual for its format (if it is another, "
            "set `vertical:`)"
        )
    rotate_z_up(positions, up)
    recording = Recording(
        files=(path,),
        format=table.format,
        labels=naming.labels,
        positions=positions,
        frames=table.frames,
        time=table.time,
        rate=table.rate,
        units=unit,
        vertical=up,
        analog_rate=None,
        plates=(),
        oddities=tuple(oddities),
        left_out=naming.left_out,
        people=naming.people,
    )
    return recording, to_z_up(up)
