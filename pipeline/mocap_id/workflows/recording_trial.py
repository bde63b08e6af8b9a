"""Trials from recordings without a YAML file: space and protocol are guessed, and a file with the keys is written."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import tempfile
import unicodedata
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePath, PurePosixPath
from typing import Any

import numpy as np

from mocap_id import plain_files
from mocap_id.arrays import GRAVITY
from mocap_id.config import Trial, load
from mocap_id.config.parsing import Source
from mocap_id.config.trial import compose
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.protocols.movement import recognise_movement
from mocap_id.recording import Recording, ThinnedFrames, read, write_recording, write_recording_as_text
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.stages.trial_keys import IN_PLANE, IN_SPACE
from mocap_id.store.atomic import converting_errors, hash_file, write_files
from mocap_id.store.folder import Owner, describe_conflict, is_other, read_owner
from mocap_id.workflows.study.discovery import choose_sides, find_forces, read_joints, read_reach

_TEXTS = (".csv", ".txt", ".tsv")  # endings of files that may be skeletons


def read_content(file: Path, forces: Path | None = None, **options: Any) -> Recording:
    """Read the files that `mocap-id run` would use: also the MOT file beside a text file, and skeletons.

    ``options`` are those of :func:`mocap_id.recording.read` and :func:`mocap_id.recording.skeleton_log.read_skeleton`.
    Raises the errors of these functions.
    """
    found = find_forces(file, file.parent.iterdir()) if forces is None and file.is_file() else None
    try:
        content = read(file, forces or found, **options, unit_required=False)
    except RecordingError as error:
        if file.suffix.lower() not in _TEXTS:
            raise
        try:
            units, vertical = options.get("units"), options.get("vertical")
            return read_skeleton(file, units=units, vertical=vertical).recording
        except RecordingError as other:
            raise RecordingError(f"{error}. As a skeleton it cannot be read either: {other}") from error
    note = (
        () if found is None else (f"the forces are from {found.name}, which is beside it; `mocap-id run` uses it too",)
    )
    return replace(content, oddities=(*note, *content.oddities))


def describe_recording(recording: Recording) -> dict[str, Any]:
    """Return a summary of a recording as JSON values; None for an unknown quantity.

    ``mass_kg`` is the mean upward force divided by gravity: for one plate, or for all plates together.
    """
    loaded = [plate for plate in recording.plates if plate.usable and plate.ok.any()]
    total = sum(plate.mean_vertical() for plate in loaded)
    plates = []
    for plate in recording.plates:
        force, number = plate.mean_vertical() if plate.usable else float("nan"), plate.kind.removeprefix("type ")
        entry = {
            "index": plate.index,
            "type": int(number) if number.isdigit() else plate.kind,
            "mean_fz_N": force if np.isfinite(force) else None,
            "mass_kg": force / GRAVITY if np.isfinite(force) else None,
            "problem": plate.problem or None,
        }
        plates.append(entry)
    return {
        "file": ", ".join(str(path) for path in recording.files),
        "format": recording.format,
        "frames": len(recording.frames),
        "first_frame": int(recording.frames[0]),
        "rate_hz": recording.rate,
        "duration_s": float(recording.time[-1] - recording.time[0]),
        "markers": list(recording.labels),
        "missing_fraction": recording.missing_fraction,
        "units": recording.units or None,
        "vertical": recording.vertical,
        "analog_rate_hz": recording.analog_rate,
        "plates": plates,
        "mass_kg": total / GRAVITY if loaded else None,
        "oddities": [*recording.oddities, *(f"{each}: they were left out" for each in recording.held)],
    }


FILE = "trial.yaml"
_ARRAYS, _ARRAYS_AS_TEXT = "recording.c3d", "recording.trc"
_HEAD = "# Made by `mocap-id run` from a recording. Paths are relative to this file.\n"
_CHECKSUM = "# Checksum {:08x}: mocap-id does not replace this file once you have edited it.\n"

_LONGEST = 100  # characters of a trial's name
_ALWAYS = ("trial", "recording", "space", "protocol", "side", "guessed", "out")
"""Keys that are written even if they were not given."""

_log = logging.getLogger(__name__)


def make_trial(recording: Path | Recording, given: Mapping[str, Any], save: Path | None = None) -> Trial:
    """Write a YAML file for the trial of a recording, and return the trial.

    Arrays in memory are written to ``recording.c3d`` in the run folder, or to ``recording.trc`` and ``recording.mot``
    if the plates have no corners. ``given`` are keys of the trial, and ``forces``; paths may be relative to the working
    folder. The file is ``save``, by default ``trial.yaml`` in the run folder.

    Raises
    ------
    ConfigError
        A key is wrong, or the recording is neither a path nor a Recording.
    RecordingError
        There is no such recording, or the arrays cannot be written with their times and plates.
    StoreError
        The file exists and was edited or not written by this function, or the file or the folder belongs to another
        recording or trial.
    """
    if not isinstance(recording, Path | Recording):
        raise ConfigError(
            f"a {type(recording).__name__} is not a trial; expected the path of a trial's YAML file or of a recording, "
            "or a mocap_id.Recording"
        )
    base = Path.cwd() if save is None else save.absolute().parent
    keys = {name.replace("_", "-"): value for name, value in given.items() if value is not None}
    if isinstance(recording, Path):
        if not recording.is_file():
            hint = plain_files.suggest(recording)
            raise RecordingError(f"{recording}: no such file; expected a recording or a trial's YAML file{hint}")
        recording = recording.absolute()
        keys["trial"], out = _choose_folder(recording, hash_file(recording), keys, base, save)
    else:
        with tempfile.TemporaryDirectory() as scratch:
            written = _write_arrays(recording, Path(scratch))
            source = recording.files[0] if recording.files else Path("arrays")
            keys["trial"], out = _choose_folder(source, hash_file(written), keys, base, save, arrays=True)
            write_files(out, {file.name: file.read_bytes() for file in Path(scratch).iterdir()})
        recording = out / written.name
    # The checked trial with guesses for missing keys; a warning lists the guesses.
    forces, named = keys.pop("forces", None), Path.cwd() / recording.name
    if forces is None:
        forces = find_forces(recording, sorted(recording.parent.iterdir()))
        if forces is not None:
            _log.warning("%s: the forces are from %s beside it", recording.name, forces.name)

    def build(more: Mapping[str, Any]) -> Trial:
        # A number of numpy becomes a Python number, and any other value a text.
        plain = json.dumps(
            {**keys, **more, "out": str(out)}, default=lambda one: one.item() if hasattr(one, "item") else str(one)
        )
        return compose(Source(named, json.loads(plain), {}))

    try:
        guessed, files = _guess(recording, forces if forces is None else Path(str(forces)), keys)
    except ConfigError:
        space = "3d" if keys.keys() & {"static", "landmarks", "calibration", "side", "pointers"} else "plane"
        build({"space": space, "protocol": "free", "recording": str(recording)})  # a wrong key is reported first
        raise
    if "guessed" in guessed:
        what = ", ".join(f"`{name}: {guessed[name]}`" for name in guessed["guessed"]["keys"])
        why = guessed["guessed"]["evidence"]
        _log.warning(
            "%s: %s was guessed, because %s; if this is wrong, give the correct values", recording.name, what, why
        )
    trial = build({**guessed, "recording": files})
    file = out / FILE if save is None else save.absolute()
    text = _format_trial(trial, keys, file, base / "runs" / str(keys["trial"]))
    if not file.is_file() or file.read_text("utf-8", errors="replace") != text:
        if file.exists() and not _is_ours(file):
            raise StoreError(
                f"{file} exists already and was not made by `mocap-id run`, or was edited: run it with `mocap-id run "
                f"{file}`, or choose a different name"
            )
        write_files(file.parent, {file.name: text.encode()})
    if file != trial.out / FILE and _is_ours(trial.out / FILE):
        (trial.out / FILE).unlink()  # a run folder has one file
    return load(file)


def _choose_folder(
    recording: Path, content: str, keys: Mapping[str, Any], base: Path, save: Path | None, *, arrays: bool = False
) -> tuple[str, Path]:
    """Return the trial's name and its run folder, by default ``base/runs/<name>``.

    If the user gave neither, the name is that of the recording. If that folder belongs to another recording, the names
    of the folders above the recording are put before the name: ``p1/sts.c3d`` and ``p2/sts.c3d`` have separate results.
    For arrays in memory, a part of the hash ``content`` is put after the name instead. Raises StoreError if the folder,
    or the file ``save``, belongs to another recording.
    """
    stem = _clean(recording.stem) or "trial"
    names = [stem, f"{stem}-{content[:8]}"] if arrays else [stem]
    if not arrays:
        for parent in recording.parents[:3]:
            names += [f"{_clean(parent.name)}-{names[-1]}"] if _clean(parent.name) else []
        names += [f"{name}-{recording.suffix.lower()[1:]}" for name in names]
    given = bool({"trial", "out"} & keys.keys())
    names = [str(keys.get("trial", stem))] if given else [name for name in names if len(name) <= _LONGEST]
    folders = {name: Path(keys.get("out", base / "runs" / name)).absolute() for name in names}
    others = {}
    for name, out in folders.items():
        file = out / FILE if save is None else save.absolute()
        # Under a name that the user gave, arrays may change. A file that this module wrote does not identify a trial.
        owner = Owner(name, file if arrays and given else recording, (content,), None if arrays else recording)
        others[name] = _find_other(out, owner)
    if save is not None and _is_ours(save):
        previous = _read_recording(save)
        places = (recording, *(out / previous.name for out in folders.values()))
        own = previous.resolve() in [place.resolve() for place in places]
        if not own and not (previous.is_file() and hash_file(previous) == content):
            raise StoreError(
                f"{save} belongs to another recording: it contains the settings of {previous}. Those of {recording} "
                "would replace them: choose another name with `--save`"
            )
    free = [name for name, other in others.items() if not other]
    if not free:
        raise StoreError(describe_conflict(folders[names[0]], others[names[0]], str(recording)))
    chosen = next((name for name in free if (folders[name] / ".mocap-id").exists()), free[0])
    out = folders[chosen]
    file = out / FILE
    if save is None and not _is_ours(file) and (file.exists() or (out / ".mocap-id").exists()):
        raise StoreError(
            f"{out} belongs to another trial, or its {FILE} was edited: choose a different folder for the results "
            f"(`out`), or run this {FILE}"
        )
    if others[names[0]]:
        _log.warning(
            f"{folders[names[0]]} contains the results of {others[names[0]]}; the results of {recording} are in {out}"
        )
    return chosen, out


def _clean(name: str) -> str:
    """Return a name with only the characters that a trial's name may have."""
    return re.sub(r"[^\w.+-]+", "-", unicodedata.normalize("NFC", name)).strip("-.+")


def _find_other(out: Path, owner: Owner) -> str:
    """Return a description of the other recording whose results a run folder contains; empty if there is none."""
    stored = read_owner(out)
    if stored is not None:
        if not is_other(stored, owner, out):
            return ""
        return str(_read_recording(stored.file)) if _is_ours(stored.file) else stored.describe()
    if not _is_ours(out / FILE) or owner.file == out / FILE:
        return ""
    previous = _read_recording(out / FILE)
    own = previous.resolve() == owner.file.resolve() or not previous.is_file() or hash_file(previous) in owner.contents
    return "" if own else str(previous)


def _read_recording(file: Path) -> Path:
    """Return the absolute path of the recording in a file that this module wrote."""
    lines = file.read_text("utf-8").splitlines()
    named = json.loads(next(line for line in lines if line.startswith("recording: ")).partition(" ")[2])
    named = named if isinstance(named, str) else named.get("markers") or named["skeleton"]
    return Path(os.path.normpath(file.parent.resolve() / named))


def _guess(recording: Path, forces: Path | None, given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return guesses for the keys that ``given`` lacks, and the files of the recording by role.

    The guesses include the key ``guessed``, unless the given protocol determines the space. ConfigError is raised if
    neither protocol nor space is given, and the movement is none that has a protocol.
    """
    skeleton = read_joints(recording)
    files = {"markers" if skeleton is None else "skeleton": str(recording)}
    if forces is not None:
        files["forces"] = str(forces)
    protocol, space = given.get("protocol"), given.get("space")
    guessed: dict[str, Any] = {}
    if protocol in IN_PLANE or protocol in IN_SPACE:
        guessed["space"] = "plane" if protocol in IN_PLANE else "3d"
    elif protocol is None or space is None:
        content = skeleton
        if content is None:  # read as the stage planarise will read it
            settings = given.get("planarise") or {}
            options = ("units", "vertical", "force_unit", "moment_unit")
            known = {name: settings[name] for name in options if settings.get(name) is not None}
            content = read(recording, forces, **known)
        seen = ThinnedFrames.of(content.positions, content.time, content.rate)
        inside = slice(None)
        with contextlib.suppress(TypeError, ValueError):  # no window, or a wrong one, which is reported later
            first, last = given.get("window", (-np.inf, np.inf))
            inside = slice(*np.searchsorted(seen.time, [first - 1e-9, last + 1e-9]))
        kind, evidence = recognise_movement(content.labels, seen.positions[inside], seen.rate)
        if kind == "sit-to-stand" and skeleton is not None:
            kind = "unknown"
        if protocol is None and space is None and kind in {"unknown", "one-body"}:
            ways = (
                "Give the protocol, on the command line `--protocol sit-to-stand` (also squats and lifts: the feet "
                "stand), `--protocol reach` or `--protocol curl` (one arm), or `--protocol robot-joint` (one link). "
                "For any other chain on a base that stands, give `--protocol free` with `--space plane` (hinges in a "
                "vertical plane) or `--space 3d`"
            )
            if skeleton is not None:
                ways = (
                    "These are joint positions of a skeleton, of which only an arm can be analysed: give `--protocol "
                    "reach`, `--protocol curl`, or `--protocol free`, on the command line, all with `--space 3d`"
                )
            raise ConfigError(f"{recording.name}: the movement fits no protocol: {evidence}. {ways}")
        guessed["space"] = space or ("3d" if kind in IN_SPACE or skeleton is not None else "plane")
        fits = kind in (IN_PLANE if guessed["space"] == "plane" else IN_SPACE)
        guessed["protocol"] = protocol or (kind if fits else "free")
        names = [name for name in ("space", "protocol") if given.get(name) is None]
        guessed["guessed"] = {"keys": names, "movement": kind, "evidence": evidence}
    if (space or guessed.get("space")) == "3d":
        reach = read_reach(recording, None)
        if reach is not None:
            named = PurePosixPath(*recording.parts[-2:])  # a folder further up may be called L by chance
            guessed["side"] = choose_sides(reach[1], named)[0]
    return {name: value for name, value in guessed.items() if given.get(name) is None}, files


def _add_head(lines: str) -> str:
    """Return the lines of a file, preceded by a head with a checksum, which reveals later edits."""
    return f"{_HEAD}{_CHECKSUM.format(zlib.crc32(lines.encode()))}{lines}"


def _is_ours(file: Path) -> bool:
    """Return whether a file was written by this module and has not been edited."""
    if not file.is_file():
        return False
    text = file.read_text("utf-8", errors="replace")
    return text == _add_head("".join(text.splitlines(keepends=True)[2:]))


def _write_arrays(recording: Recording, out: Path) -> Path:
    """Write arrays to files and return the path; raise RecordingError if only some of the plates have corners."""
    without_corners = {plate.index: plate.corners is None for plate in recording.plates if plate.usable}
    if len(set(without_corners.values())) > 1:
        without, known = (
            ", ".join(str(k) for k, one in without_corners.items() if one == kind) for kind in (True, False)
        )
        raise RecordingError(
            f"plates with corners: {known}; plates without corners: {without}; expected the corners of all plates or "
            "of none"
        )
    with converting_errors(out):
        if not any(without_corners.values()):
            write_recording(out / _ARRAYS, recording)
            return out / _ARRAYS
        write_recording_as_text(out / _ARRAYS_AS_TEXT, recording)
        return out / _ARRAYS_AS_TEXT


def _format_trial(trial: Trial, given: Mapping[str, Any], file: Path, usual: Path) -> str:
    """Return the YAML text of a trial with the given and guessed keys; paths are relative to ``file``."""
    keys = trial.keys.model_dump(exclude_unset=True, exclude_none=True)
    keys["recording"] = {name: path for name, path in keys["recording"].items() if path is not None}
    if trial.keys.calibration is not None:
        keys["calibration"] = trial.keys.calibration.trial
    if list(keys["recording"]) == ["markers"]:
        keys["recording"] = keys["recording"]["markers"]
    if trial.out != usual or file.parent == trial.out:
        keys["out"] = trial.out
    stages = {name: one.model_dump(exclude_unset=True) for name, one in trial.settings.items() if name in given}
    lines = [
        f"{name}: {json.dumps(_relative(value, file.parent), ensure_ascii=False)}\n"
        for name, value in {**keys, **stages}.items()
        if name in given or name in _ALWAYS
    ]
    return _add_head("".join(lines))


def _relative(value: Any, folder: Path) -> Any:
    """Return a value as JSON values; paths in the value become relative to ``folder``."""
    if isinstance(value, PurePath):
        if folder.resolve() != folder:  # `..` leads out of the folder that a link names, not out of the link
            value, folder = Path(value).parent.resolve() / value.name, folder.resolve()
        return PurePath(os.path.relpath(value, folder)).as_posix()
    if isinstance(value, Mapping):
        return {str(key): _relative(one, folder) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_relative(one, folder) for one in value]
    return value
