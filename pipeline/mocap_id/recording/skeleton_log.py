"""Skeletons of a depth camera or of markerless software: reader, and search for faults."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, find_runs
from mocap_id.errors import RecordingError
from mocap_id.recording.marker_tables import parse_trc
from mocap_id.recording.markers import clean_positions, resolve_length_unit, rotate_z_up
from mocap_id.recording.model import Recording, check_axis
from mocap_id.recording.sample_checks import SKELETON_HZ, HeldSamples, check_times, describe_held, find_held, list_held
from mocap_id.recording.text_tables import (
    TextTable,
    check_end,
    check_unique,
    read_csv,
    read_text,
    split_lines,
)
from mocap_id.verdict import Reason

KINECT_V2 = (
    *("SpineBase", "SpineMid", "Neck", "Head", "ShoulderLeft", "ElbowLeft", "WristLeft", "HandLeft"),
    *("ShoulderRight", "ElbowRight", "WristRight", "HandRight", "HipLeft", "KneeLeft", "AnkleLeft", "FootLeft"),
    *("HipRight", "KneeRight", "AnkleRight", "FootRight", "SpineShoulder", "HandTipLeft", "ThumbLeft"),
    *("HandTipRight", "ThumbRight"),
)
"""The 25 joints of a Kinect v2, in the order of its interface."""

_KINECT_RATE = 30.0
_TIMES = ("time_s", "time")
_INFERRED = 1
_LONGEST_STEP = 1.75  # largest step between two rows, in usual steps, that is interpolated
_ON_ROW = 0.02  # a time that is closer to a row than this, in usual steps, takes the values of the row
_LEAST_ROWS = 20
_FEW_SHORT, _MANY_SHORT = 0.01, 0.5  # shares of rows
_MANY_REPEATED = 0.1  # share of rows


@dataclass(frozen=True)
class SkeletonRecording:
    """A skeleton at times with a constant step: F frames of M joints."""

    recording: Recording  # joint positions in place of markers; NaN if a joint is missing
    inferred: BoolArray  # (F, M) whether the sensor inferred the position because it did not see the joint
    reasons: tuple[Reason, ...] = ()  # about rows that were left out or corrected


def read_skeleton(path: Path, *, units: str | None = None, vertical: str | None = None) -> SkeletonRecording:
    """Read the joint positions of a skeleton and interpolate them to times with a constant step.

    Three formats are read. (1) TRC. (2) CSV with ``time_s`` (or ``time``), ``JOINT_x``, ``JOINT_y``, ``JOINT_z`` in m,
    and optionally ``JOINT_state`` (2 tracked, 1 inferred, 0 missing), in small or capital letters. (3) Text of a Kinect
    v2 with 75 or 175 numbers in each row: x y z, or x y z and a quaternion, of 25 joints, in m at 30 Hz.

    ``units`` replaces the usual or declared length unit; ``vertical`` is the axis of the file that points up, Y if
    omitted. Raises RecordingError if the file is missing or has another format, or its times do not increase. Raises
    ConfigError if ``units`` or ``vertical`` is unknown.
    """
    axis = "Y" if vertical is None else check_axis(vertical)
    oddities: list[str] = []
    text = read_text(path)
    first = text[:20000].lstrip("\ufeff \t\r\n").split("\n", 1)[0]
    if text[:400].lower().startswith("pathfiletype"):
        table = parse_trc(path, text, oddities)
        check_unique(path, table.labels)
        kind, declared, labels, time, positions = "TRC", table.units, tuple(table.labels), table.time, table.positions
        inferred, reasons = np.zeros(positions.shape[:2], dtype=np.bool_), list[Reason]()
    elif first[:1] and first[:1] in "-+.0123456789":
        kind, declared, labels = "Kinect v2 text", "m", KINECT_V2
        time, positions, reasons = _read_kinect_rows(path, text, oddities)
        inferred = np.zeros(positions.shape[:2], dtype=np.bool_)
    else:
        kind, declared = "CSV", "m"
        labels, time, positions, inferred, reasons = _read_csv_rows(path)
    unit, metres = resolve_length_unit(path, declared, units, oddities, required=True)
    positions[:] *= metres
    clean_positions(path, positions, unit, oddities)
    check_depth(path, positions, oddities)
    check_times(path, time, "the time", SKELETON_HZ, repeated=True)
    reasons += undo_exchanges(labels, time, positions, inferred)
    reasons += find_other_person(path, time, positions)
    held: list[HeldSamples] = []  # positions that software repeated or interpolated
    rate = (len(time) - 1) / float(np.ptp(time))
    for number, label in enumerate(labels):
        found = find_held(positions[:, number], rate)
        held += list_held(f"joint {label}", time, *found)
        positions[found[0] | found[1], number] = np.nan
    reasons += describe_held(held)
    time, positions, inferred = _interpolate(path, time, positions, inferred, oddities)
    rotate_z_up(positions, axis)
    recording = Recording(
        files=(path,),
        format=f"skeleton ({kind})",
        labels=labels,
        positions=positions,
        frames=np.arange(len(time), dtype=np.int64),
        time=time,
        rate=float((len(time) - 1) / (time[-1] - time[0])),
        units=unit,
        vertical=axis,
        analog_rate=None,
        plates=(),
        oddities=tuple(oddities),
    )
    return SkeletonRecording(recording, inferred, tuple(reasons))


def _read_kinect_rows(path: Path, text: str, oddities: list[str]) -> tuple[FloatArray, FloatArray, list[Reason]]:
    """Return times (K,), s, and positions (K, M, 3), m, in a text file of a Kinect v2 without header and times."""
    lines = [line.replace(",", " ") for line in split_lines(text)]
    width = len(next(line for line in lines if line.strip()).split())
    joints = len(KINECT_V2)
    if width not in (3 * joints, 7 * joints):
        raise RecordingError(
            f"{path}: has no header and {width} numbers in its first row; expected a header with time_s and JOINT_x, "
            f"JOINT_y, JOINT_z, or rows of the {joints} joints of a Kinect v2 ({3 * joints} or {7 * joints} numbers)"
        )
    names = [str(k) for k in range(width)]
    table = TextTable(path, names, lines, 1, None)
    check_end(path, table, text)
    values = table.numbers()
    reasons = _leave_out_short_rows(table, values)
    values = values.reshape(len(values), joints, -1)
    if len(values) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(values)} rows, expected at least {_LEAST_ROWS}")
    oddities.append(f"{path.name} has no times: {_KINECT_RATE:.0f} rows per second are assumed, as a Kinect v2 has")
    return np.arange(len(values)) / _KINECT_RATE, values[:, :, :3].copy(), reasons


def _read_csv_rows(path: Path) -> tuple[tuple[str, ...], FloatArray, FloatArray, BoolArray, list[Reason]]:
    """Return labels, times (K,), s, positions (K, M, 3), m, whether each is inferred (K, M), and reasons."""
    table = read_csv(path)
    spelled = [name.strip() for name in table.names]
    names = [name.lower() for name in spelled]
    time = next((names.index(name) for name in _TIMES if name in names), None)
    labels = [name[:-2] for name, lower in zip(spelled, names, strict=True) if lower.endswith("_x")]
    labels = [label for label in labels if {f"{label}_y".lower(), f"{label}_z".lower()} <= set(names)]
    joints = [label.lower() for label in labels]
    if time is None or not joints:
        raise RecordingError(
            f"{path}: has the columns {', '.join(spelled)[:120]}; expected time_s, and JOINT_x, JOINT_y, JOINT_z in m "
            "for every joint, optionally JOINT_state"
        )
    values = table.numbers()
    clock = values[:, time].copy()
    reasons = _leave_out_short_rows(table, values)
    columns = [[names.index(f"{joint}_{axis}") for axis in "xyz"] for joint in joints]
    positions = values[:, np.array(columns)]
    inferred = np.zeros(positions.shape[:2], dtype=np.bool_)
    for k, joint in enumerate(joints):
        if f"{joint}_state" in names:
            state = values[:, names.index(f"{joint}_state")]
            inferred[:, k] = state == _INFERRED
            positions[(state < _INFERRED) | ~np.isfinite(state), k] = np.nan
    return tuple(labels), clock, positions, inferred, reasons


def _leave_out_short_rows(table: TextTable, values: FloatArray) -> list[Reason]:
    """Set rows with fewer cells than others to NaN, in place: their cells may belong to other columns."""
    cells = np.array([len(line.split(table.separator)) for line in table.lines if line.strip()], dtype=np.int64)
    short = cells < len(table.names)
    if not short.any():
        return []
    share = float(short.mean())
    found = (
        f"{int(short.sum())} of {len(short)} rows have fewer cells than the {len(table.names)} columns, down to "
        f"{int(cells.min())}: it is not clear which joints are missing there"
    )
    if share > _MANY_SHORT:
        raise RecordingError(
            f"{table.path}: {found}; expected a cell for every column, empty if a joint is missing. Export it again"
        )
    values[short] = np.nan
    message = f"{found}. These rows are left out as missing; write an empty cell for each missing coordinate"
    return [Reason("skeleton-short-rows", message, share, _FEW_SHORT, "caution" if share > _FEW_SHORT else "ok")]


def _interpolate(
    path: Path, stamps: FloatArray, rows: FloatArray, inferred: BoolArray, oddities: list[str]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return times (F,) with a constant step, s, positions (F, M, 3), and whether each is inferred (F, M).

    Positions are interpolated linearly between rows; they are NaN where rows are missing. Rows that repeat the time of
    the row before are left out; RecordingError if many of them have other positions.
    """
    keep = np.diff(stamps, prepend=-np.inf) > 0
    if not keep.all():
        again = np.flatnonzero(~keep)
        same = (rows[again] == rows[again - 1]) | np.isnan(rows[again])
        unlike = int(np.count_nonzero(~same.all(axis=(1, 2))))
        if unlike > _MANY_REPEATED * len(keep):
            raise RecordingError(
                f"{path}: {unlike} of {len(keep)} rows have the time of the row before, but other positions: the times "
                "are rounded too coarsely; expected a time for each row. Export them in seconds with at least three "
                "decimals"
            )
        oddities.append(f"{path.name}: {len(again)} rows repeat the time of the row before and were left out")
        stamps, rows, inferred = stamps[keep], rows[keep], inferred[keep]
    if len(stamps) < _LEAST_ROWS:
        raise RecordingError(f"{path}: has {len(stamps)} rows with different times, expected at least {_LEAST_ROWS}")
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    count = int(np.floor((stamps[-1] - stamps[0]) / usual + 1e-6)) + 1
    time = stamps[0] + usual * np.arange(count)
    after = np.searchsorted(stamps, time - 1e-9).clip(1, len(stamps) - 1)
    share = ((time - stamps[after - 1]) / steps[after - 1])[:, None]
    near = steps[after - 1] <= _LONGEST_STEP * usual
    low, high = rows[after - 1], rows[after]
    positions = low * (1 - share[..., None]) + high * share[..., None]
    for ends, at in ((low, share < _ON_ROW), (high, share > 1 - _ON_ROW)):  # the next row may be missing
        exact = np.flatnonzero(at[:, 0])
        positions[exact] = ends[exact]
        near[exact] = True
    positions[~near] = np.nan
    inferred = inferred[after - 1] & (share < 1 - _ON_ROW) | inferred[after] & (share > _ON_ROW)
    if np.max(np.abs(steps - usual)) > 0.05 * usual:
        missing = int(np.count_nonzero(~near))
        oddities.append(
            f"{path.name}: its times are uneven: the joints were interpolated at {1 / usual:.6g} Hz"
            + (f"; {missing} of {count} samples, where rows are missing, were left empty" if missing else "")
        )
    return time, positions, inferred


_BODY = 6  # least number of joints of a body; the checks need so many
_FLAT_M, _CONSTANT_M = 0.02, 1e-4  # extent of a body along each axis; scatter of a joint along each axis
_FAR_M = 0.2  # a joint that is usually farther from 0 along an axis than this is never exactly at 0
_APART_M, _SUDDEN = 0.2, 4.0  # steps of a pair of joints that may exchange its sides: length, and relative to usual
_CROSSED = 0.35  # largest ratio of the steps with the sides exchanged
_LONGEST_S = 1.0  # gap after which steps say nothing
_JUMP_M, _JUMP_RATIO = 0.04, 8.0  # step of a whole body: least length, and relative to the largest tenth of the steps
_SPEED = 1.0  # m/s of a whole body during a gap
_USUAL_ROWS = 10
_SIZE_STEP = 0.05  # median relative step of all bones; 0.03 in skeletons of one person
_OTHER_BONES, _BONE_ERRORS = 0.03, 4.0  # median relative difference of bones, and relative to their usual differences
_BACK = 0.5  # a body that jumps back is nearer to its place than this part of the jump
_AWAY_S = 10.0  # longest time after which a body that jumps back is judged by its place
_MOST_OTHERS = 0.5  # fraction of the rows
_LISTED = 5
_SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))


def check_depth(path: Path, positions: FloatArray, oddities: list[str]) -> None:
    """Raise RecordingError if the positions (K, M, 3) of a body have no extent along one axis, m.

    Rows without depth, and joints at exactly 0 along an axis from which they are usually far, become NaN, with a note.
    """
    if positions.shape[1] < _BODY:
        return
    lost = np.zeros(positions.shape[:2], dtype=np.bool_)
    for axis, name in enumerate("xyz"):
        values = positions[..., axis]
        seen = np.isfinite(values)
        several = seen.sum(axis=1) >= _BODY
        if not several.any():
            continue
        extent = np.full(len(values), np.nan)
        extent[several] = np.nanmax(values[several], axis=1) - np.nanmin(values[several], axis=1)
        often = seen.sum(axis=0) > 1
        scatter = float(np.median(np.nanstd(values[:, often], axis=0))) if often.any() else np.inf
        if np.nanmedian(extent) < _FLAT_M or scatter < _CONSTANT_M:
            raise RecordingError(
                f"{path}: the {name} of its joints does not change: they are within {100 * np.nanmedian(extent):.1f} "
                f"cm of each other along {name}, and each scatters by {1e3 * scatter:.2g} mm in time. The skeleton has "
                "no depth, so its angles in space are not known; expected joints in three dimensions. Export them from "
                "a depth camera or from several cameras"
            )
        with np.errstate(invalid="ignore"):
            lost[extent < _FLAT_M] = True
        usual = np.zeros(values.shape[1])
        usual[often] = np.abs(np.nanmedian(values[:, often], axis=0))
        lost |= (values == 0.0) & (usual > _FAR_M)
    lost &= np.isfinite(positions).any(axis=2)
    if lost.any():
        positions[lost] = np.nan
        oddities.append(f"{path.name}: {int(lost.sum())} positions of joints have no depth and were set to missing")


def pair_sides(labels: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return the numbers of the left and the right joint of each pair.

    Examples
    --------
    >>> pair_sides(("Neck", "ElbowLeft", "ElbowRight", "RKnee", "LKnee"))
    [(1, 2), (4, 3)]
    """
    pairs = []
    for number, label in enumerate(labels):
        others = [label.replace(left, right) for left, right in _SIDES if left in label]
        others += [f"R{label[1:]}"] if label[:1] == "L" and not others else []
        pairs += [(number, labels.index(other)) for other in others if other in labels]
    return pairs


def undo_exchanges(
    labels: tuple[str, ...], time: FloatArray, positions: FloatArray, inferred: BoolArray
) -> tuple[Reason, ...]:
    """Exchange left and right joints back, in place, where the file exchanges them for some time.

    Two joints exchange their places from one row to the next, which no body does. The labels in most rows are right.
    """
    exchanged: dict[str, BoolArray] = {}
    for left, right in pair_sides(labels):
        rows = np.flatnonzero(np.isfinite(positions[:, [left, right]]).all(axis=(1, 2)))
        if len(rows) < _USUAL_ROWS:
            continue
        a, b = positions[rows, left], positions[rows, right]
        along = np.linalg.norm(np.diff(a, axis=0), axis=1) + np.linalg.norm(np.diff(b, axis=0), axis=1)
        crossed = np.linalg.norm(b[1:] - a[:-1], axis=1) + np.linalg.norm(a[1:] - b[:-1], axis=1)
        near = np.diff(time[rows]) <= _LONGEST_S
        turns = near & (along > max(_APART_M, _SUDDEN * float(np.median(along)))) & (crossed < _CROSSED * along)
        if not turns.any():
            continue
        state = np.concatenate([[0], np.cumsum(turns)]) % 2 == 1
        state = ~state if state.mean() > 0.5 else state
        wrong = np.zeros(len(time), dtype=np.bool_)
        wrong[rows] = state
        for values in (positions, inferred):
            values[wrong, left], values[wrong, right] = values[wrong, right], values[wrong, left]
        exchanged[labels[left]] = wrong
    if not exchanged:
        return ()
    anywhere = np.any(list(exchanged.values()), axis=0)
    names = ", ".join(list(exchanged)[:_LISTED]) + (" …" if len(exchanged) > _LISTED else "")
    message = (
        f"left and right joints ({names}) are exchanged {_list_times(time, anywhere)}: they jump to each other's place "
        "from one row to the next. They were exchanged back in the results, so that the sides in most rows hold. Look "
        "at these times whether the person turned round"
    )
    return (Reason("skeleton-exchanged", message, float(anywhere.mean()), 0.0),)


def find_other_person(path: Path, time: FloatArray, positions: FloatArray) -> tuple[Reason, ...]:
    """Set the rows of another person to NaN, in place, and return a reason if there are any.

    A camera that takes another person for the recorded one moves all joints at once, and changes the lengths of all
    bones. The person with most rows is the recorded one; RecordingError if less than half of the rows remain.
    """
    if positions.shape[1] < _BODY:
        return ()
    rows = np.flatnonzero(np.isfinite(positions[..., 0]).sum(axis=1) >= _BODY)
    if len(rows) < 2 * _USUAL_ROWS:
        return ()
    body, stamps = positions[rows], time[rows]
    with np.errstate(invalid="ignore"):
        steps = np.nanmedian(np.linalg.norm(np.diff(body, axis=0), axis=2), axis=1)
    apart = np.diff(stamps)
    least = max(_JUMP_M, _JUMP_RATIO * float(np.nanquantile(steps, 0.9)))
    jumps = np.nan_to_num(steps) > least + _SPEED * np.maximum(apart - np.median(apart), 0.0)
    # Bones: the logarithms (K, B) of those distances between joints that change least
    first, second = np.triu_indices(body.shape[1], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        bones = np.log(np.linalg.norm(body[:, first] - body[:, second], axis=2))
        bones = bones[:, np.isfinite(bones).any(axis=0)]  # some joints are never seen together
        scatter = np.nanmedian(np.abs(bones - np.nanmedian(bones, axis=0)), axis=0)
    bones = bones[:, np.argsort(scatter)[: 2 * body.shape[1]]]
    jumps |= _find_steps(bones)
    if not jumps.any():
        return ()
    cuts = [0, *(np.flatnonzero(jumps) + 1).tolist(), len(rows)]
    parts = [slice(a, b) for a, b in pairwise(cuts)]
    own = max(parts, key=lambda part: part.stop - part.start)
    usual = np.nanmedian(bones[own], axis=0)
    wrong, jump, bone = np.zeros(len(time), dtype=np.bool_), 0.0, 0.0
    for forwards in (True, False):
        last = own
        order = [part for part in parts if (part.start > own.start if forwards else part.start < own.start)]
        order = order if forwards else order[::-1]
        for part, after in zip(order, (*order, None)[1:], strict=True):
            leaves, enters = (last.stop - 1, part.start) if forwards else (last.start, part.stop - 1)
            moved = _measure_displacement(body, leaves, enters)
            difference, error = _compare_bones(bones, part, own, usual)
            other = difference > max(_OTHER_BONES, _BONE_ERRORS * error)
            if not other and after is not None and moved > least and abs(stamps[enters] - stamps[leaves]) < _AWAY_S:
                back = _measure_displacement(body, leaves, after.start if forwards else after.stop - 1)
                other = back < _BACK * moved
            if not other:
                last = part
                continue
            wrong[rows[part.start] : rows[part.stop - 1] + 1] = True
            jump, bone = max(jump, moved), max(bone, difference)
    if not wrong.any():
        return ()
    share = float(wrong.mean())
    evidence = (
        f"{_list_times(time, wrong)} the joints are displaced by up to {100 * jump:.0f} cm from one row to the next, "
        f"and the bones differ by up to {100 * bone:.0f} %"
    )
    if share > _MOST_OTHERS:
        raise RecordingError(
            f"{path}: {evidence}: the file shows several people in turn, none of them in half of the rows; record with "
            "one person in view, or delete the rows of the others"
        )
    positions[wrong] = np.nan
    message = (
        f"{evidence}: the camera took another person for the recorded one. These rows are left out as missing. Record "
        "with one person in view"
    )
    return (Reason("skeleton-other-person", message, share, 0.0),)


def _find_steps(bones: FloatArray) -> BoolArray:
    """Return between which rows (K - 1,) all bones become longer or shorter at once, and stay so."""
    with np.errstate(invalid="ignore"):
        size = np.nan_to_num(np.nanmedian(bones - np.nanmedian(bones, axis=0), axis=1))
    summed = np.concatenate([[0.0], np.cumsum(size)])
    mean = (summed[_USUAL_ROWS:] - summed[:-_USUAL_ROWS]) / _USUAL_ROWS
    lasting = np.zeros(len(size) - 1)
    lasting[_USUAL_ROWS - 1 : len(size) - _USUAL_ROWS] = np.abs(mean[_USUAL_ROWS:] - mean[:-_USUAL_ROWS])
    return np.asarray(np.minimum(lasting, np.abs(np.diff(size))) > _SIZE_STEP)


def _compare_bones(bones: FloatArray, part: slice, own: slice, usual: FloatArray) -> tuple[float, float]:
    """Return the median difference of the bones in two parts, and its usual size in parts of the same length."""
    difference = float(np.nanmedian(np.abs(np.nanmedian(bones[part], axis=0) - usual)))
    length, count = part.stop - part.start, own.stop - own.start
    blocks = [slice(own.start + k, own.start + k + length) for k in range(0, count - length + 1, max(length, 1))]
    same = [float(np.nanmedian(np.abs(np.nanmedian(bones[each], axis=0) - usual))) for each in blocks[:200]]
    return difference, float(np.median(same)) if same else 0.0


def _measure_displacement(body: FloatArray, first: int, second: int) -> float:
    """Return the median displacement of the joints between two rows, m; 0 if they have no joint in common."""
    moved = np.linalg.norm(body[second] - body[first], axis=1)
    return float(np.nanmedian(moved)) if np.isfinite(moved).any() else 0.0


def _list_times(time: FloatArray, rows: BoolArray) -> str:
    runs = find_runs(rows)
    listed = ", ".join(f"{time[run.start]:.2f} to {time[run.stop - 1]:.2f} s" for run in runs[:_LISTED])
    return f"from {listed}" + (f" and {len(runs) - _LISTED} more times" if len(runs) > _LISTED else "")
