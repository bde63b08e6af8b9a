"""Conditions for reading any file, however broken: success, or one of the program's own errors."""

from __future__ import annotations

import json
import shutil
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import c3d_count
import hostile_seeds
import mutations_c3d
import mutations_hdf5
import mutations_stored
import mutations_text
import mutations_yaml
import numpy as np

from mocap_id import recording, runner
from mocap_id.config import load
from mocap_id.config.study import load_study
from mocap_id.errors import MocapIdError, NumericalError
from mocap_id.recording.imu_log import read_imu
from mocap_id.recording.skeleton_log import read_skeleton
from mocap_id.recording.text_tables import read_table
from mocap_id.runner.dependencies import FileHashes
from mocap_id.runner.execution import read_refusal
from mocap_id.stages import STAGES
from mocap_id.store import Folder
from mocap_id.workflows.recording_trial import describe_recording

SHARES = {"c3d": 38, "trc": 12, "mot": 10, "csv": 10, "trial": 9, "study": 4, "stored": 12, "record": 4, "run": 1}
"""How often each is tried, of a hundred."""


@dataclass(frozen=True)
class Case:
    """A damaged file: format, name of its seed, bytes, and known number of frames."""

    form: str
    name: str
    data: bytes
    frames: int = -1


@dataclass(frozen=True)
class Found:
    """Result of a case: ``read``, ``refused`` or ``finding``, with its message."""

    outcome: str
    said: str = ""


class Bench:
    """Creation and execution of cases; seeds are made once.

    Parameters
    ----------
    folder : Path
        An empty folder for files.
    with_shared : bool
        Whether the shared recordings are seeds too.
    """

    def __init__(self, folder: Path, with_shared: bool = True) -> None:
        self.folder, self.with_shared = folder, with_shared
        self.made = folder / "made"
        self.place = folder / "place"
        self.made.mkdir(exist_ok=True)

    def case(self, seed: int, index: int, form: str | None = None) -> Case:
        """Return the case of a seed and an index, always the same."""
        rng = np.random.default_rng([seed, index])
        names, shares = list(SHARES), np.array(list(SHARES.values())) / sum(SHARES.values())
        drawn = str(rng.choice(names, p=shares))
        return getattr(self, f"_{form or drawn}")(rng)

    def _c3d(self, rng: np.random.Generator) -> Case:
        seed = _one(hostile_seeds.c3d(self.with_shared), rng)
        data = bytearray(seed.data)
        intact = mutations_c3d.apply(data, rng)
        padded = data[-1024:] == seed.data[-1024:]  # else it may hold what looks like one frame more
        frames = _frames(self.made, seed) if intact and padded else -1
        return Case("c3d", seed.name, bytes(data), frames)

    def _trc(self, rng: np.random.Generator) -> Case:
        return _text("trc", _one(hostile_seeds.trc(self.made, self.with_shared), rng), rng)

    def _mot(self, rng: np.random.Generator) -> Case:
        return _text("mot", _one(hostile_seeds.mot(self.with_shared), rng), rng)

    def _csv(self, rng: np.random.Generator) -> Case:
        return _text("csv", _one(hostile_seeds.csv(), rng), rng)

    def _trial(self, rng: np.random.Generator) -> Case:
        return _yaml("trial", hostile_seeds.TRIAL, rng)

    def _study(self, rng: np.random.Generator) -> Case:
        return _yaml("study", hostile_seeds.STUDY, rng)

    def _stored(self, rng: np.random.Generator) -> Case:
        seed = _one(hostile_seeds.artefacts(self.made), rng)
        data = bytearray(seed.data)
        (mutations_hdf5.hdf5 if seed.name.endswith(".h5") else mutations_stored.parquet)(data, rng)
        return Case("stored", seed.name, bytes(data))

    def _record(self, rng: np.random.Generator) -> Case:
        seed = _one(hostile_seeds.records(self.made), rng)
        data = bytearray(seed.data)
        mutations_stored.record(data, rng)
        return Case("record", seed.name, bytes(data))

    def _run(self, rng: np.random.Generator) -> Case:
        """Damage a file of a finished trial, or one of its inputs, and run the trial again."""
        done = hostile_seeds.finished(self.made)
        files = [path for path in done.rglob("*") if path.is_file() and path.name != "lock"]
        files += [self.made / "link.c3d", self.made / "link.yaml"] * 5
        path = sorted(files)[rng.integers(len(files))]
        data = bytearray(path.read_bytes())
        kinds = {
            ".c3d": mutations_c3d.apply,
            ".yaml": mutations_yaml.apply,
            ".h5": mutations_hdf5.hdf5,
            ".parquet": mutations_stored.parquet,
            ".json": mutations_stored.record,
        }
        kinds.get(path.suffix, mutations_text.apply)(data, rng)
        return Case("run", path.relative_to(self.made).as_posix(), bytes(data))

    def judge(self, case: Case) -> Found:
        """Run a case; any result except success or one of the program's own errors is a finding."""
        shutil.rmtree(self.place, ignore_errors=True)
        self.place.mkdir()
        try:
            wrong = READERS[case.form](self, case)
        except NumericalError as error:
            return Found("finding" if "unforeseen" in str(error) else "refused", _told(error))
        except MocapIdError as error:
            return _judged(error, case)
        except Exception as error:  # noqa: BLE001  this is what is looked for
            return Found("finding", _told(error))
        return Found("finding", wrong) if wrong else Found("read")


def _judged(error: MocapIdError, case: Case) -> Found:
    """Accept one of the program's own errors if it names its file and memory did not run out."""
    behind: BaseException | None = error
    while behind is not None:
        if isinstance(behind, MemoryError):
            return Found("finding", f"memory ran out: {_told(error)}")
        behind = behind.__cause__ or behind.__context__
    named = str(error) + "".join(getattr(error, "__notes__", []))
    name = Path(case.name).name
    if case.form in ("c3d", "trc", "mot", "csv", "stored", "trial", "study") and name not in named:
        return Found("finding", f"the message does not name {name}: {_told(error)}")
    return Found("refused", _told(error))


def _told(error: BaseException) -> str:
    where = ""
    if not isinstance(error, MocapIdError):
        frames, trace = [], error.__traceback__
        while trace is not None:
            code = trace.tb_frame.f_code
            frames.append(f"{Path(code.co_filename).name}:{trace.tb_lineno} {code.co_name}")
            trace = trace.tb_next
        where = " at " + " < ".join(reversed(frames[-6:]))
    return f"{type(error).__name__}: {str(error)[:300]}{where}"


def _one(seeds: tuple[hostile_seeds.Seed, ...], rng: np.random.Generator) -> hostile_seeds.Seed:
    return seeds[rng.integers(len(seeds))]


def _frames(folder: Path, seed: hostile_seeds.Seed) -> int:
    """Return the number of frames of a valid seed; -1 if it is invalid."""
    if seed.frames >= 0:
        return seed.frames
    path = folder / seed.name
    if not path.exists():
        path.write_bytes(seed.data)
    if seed.name not in _COUNTED:
        try:
            _COUNTED[seed.name] = len(recording.read(path, units="mm").frames)
        except MocapIdError:
            _COUNTED[seed.name] = -1
    return _COUNTED[seed.name]


_COUNTED: dict[str, int] = {}


def _text(form: str, seed: hostile_seeds.Seed, rng: np.random.Generator) -> Case:
    data = bytearray(seed.data)
    mutations_text.apply(data, rng)
    return Case(form, seed.name, bytes(data), seed.frames)


def _yaml(form: str, text: str, rng: np.random.Generator) -> Case:
    data = bytearray(text.encode())
    mutations_yaml.apply(data, rng)
    return Case(form, f"{form}.yaml", bytes(data))


def _read_c3d(bench: Bench, case: Case) -> str:
    path = bench.place / case.name
    path.write_bytes(case.data)
    found = _read_with_units(path)
    json.dumps(describe_recording(found), allow_nan=False)
    count = len(found.frames)
    if found.positions.shape != (count, len(found.labels), 3) or len(found.time) != count:
        return f"{count} frames, but positions of shape {found.positions.shape} and {len(found.time)} times"
    if not (np.isfinite(found.time).all() and (np.diff(found.time) > 0).all()):
        return "the times do not increase"
    if count not in c3d_count.possible(case.data):
        return f"{count} frames, which no declaration with the file's size allows"
    if case.frames >= 0 and count != case.frames and not any("frame" in oddity for oddity in found.oddities):
        return f"{count} frames instead of {case.frames}, and no oddity says so"
    return ""


def _read_with_units(path: Path) -> recording.Recording:
    """Read a file as a user would after being asked for the unit."""
    try:
        return recording.read(path)
    except MocapIdError as error:
        if "`units: mm`" not in str(error):
            raise
    return recording.read(path, units="mm")


_BLANK = b" \t\x0b\x0c\x1c\x1d\x1e\x1f\x85\xa0"
"""What is blank in Latin-1 text."""


def _rows(data: bytes, first: Callable[[bytes], bool]) -> int:
    """Count non-empty lines from the table's first line."""
    lines = [line for line in data.splitlines() if line.strip(_BLANK)]
    start = next((k for k, line in enumerate(lines) if first(line)), len(lines))
    return len(lines) - start


def _read_trc(bench: Bench, case: Case) -> str:
    path = bench.place / case.name
    path.write_bytes(case.data)
    found = recording.read(path)
    json.dumps(describe_recording(found), allow_nan=False)
    lines = [line.strip(_BLANK) for line in case.data.splitlines()]
    names = next((k for k, line in enumerate(lines[1:12], start=1) if line.lower().startswith(b"frame")), 3)
    rows = _rows(b"\n".join(lines[names + 1 :]), lambda line: line.strip(_BLANK)[:1].isdigit())
    return "" if len(found.frames) == rows else f"{len(found.frames)} frames read of {rows} rows"


def _read_mot(bench: Bench, case: Case) -> str:
    path = bench.place / case.name
    path.write_bytes(case.data)
    table = read_table(path)
    rows = _rows(case.data, lambda line: line.strip(_BLANK).lower() == b"endheader") - 2
    if len(table.time) != rows:
        return f"{len(table.time)} rows read of {rows}"
    beside = bench.place / "link.trc"
    beside.write_bytes(hostile_seeds.trc(bench.made, False)[0].data)
    json.dumps(describe_recording(recording.read(beside, path)), allow_nan=False)
    return ""


def _read_csv(bench: Bench, case: Case) -> str:
    path = bench.place / case.name
    path.write_bytes(case.data)
    rows = _rows(case.data, lambda line: True) - 1
    if case.name.startswith("imu"):
        read_imu(path)
        return ""
    if case.name.startswith("skeleton"):
        read_skeleton(path)
        return ""
    if case.name == "board.csv":
        recording.read_board(path)
        return ""
    if case.name == "force.csv":
        count = len(recording.read_force_log(path)[0].force)
    elif case.name == "angles.csv":
        count = len(recording.read_angles(path, ["knee_deg", "hip_rad"])[0])
    else:
        count = len(recording.read_encoder(path).time)
    return "" if count == rows else f"{count} rows read of {rows}"


def _surround(folder: Path) -> None:
    """Create targets of hostile paths: a pipe, circular links, a folder, a socket, a very large file."""
    (folder / "trial.c3d").write_bytes(hostile_seeds.c3d(False)[0].data)
    (folder / "hand.csv").write_bytes(hostile_seeds.csv()[0].data)
    import os

    os.mkfifo(folder / "fifo")
    (folder / "loop").symlink_to("loop")
    (folder / "folder").mkdir()
    with (folder / "big").open("wb") as stream:
        stream.truncate(1 << 42)
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(str(folder / "socket"))
    except OSError:
        (folder / "socket").mkdir()  # the path is too long for one


def _read_trial(bench: Bench, case: Case) -> str:
    _surround(bench.place)
    path = bench.place / case.name
    path.write_bytes(case.data)
    trial = load(path)
    try:
        for stage in STAGES:
            FileHashes(trial).of(stage)
    except MocapIdError as error:
        error.add_note(str(path))
        raise
    return ""


def _read_study(bench: Bench, case: Case) -> str:
    path = bench.place / case.name
    path.write_bytes(case.data)
    for each in load_study(path).trials:
        if not each.trial.out.resolve().is_relative_to(load_study(path).out.resolve()):
            return f"a trial's folder is {each.trial.out}"
    return ""


def _read_stored(bench: Bench, case: Case) -> str:
    (bench.place / case.name).write_bytes(case.data)
    folder = Folder(bench.place)
    artefact = folder.read(case.name)
    return "" if isinstance(artefact.facts, dict) else f"the facts are {type(artefact.facts).__name__}"


def _read_record(bench: Bench, case: Case) -> str:
    """Read records, which decide what an older run wrote and what may be deleted."""
    run = bench.place / "run"
    shutil.copytree(hostile_seeds.finished(bench.made), run)
    (bench.place / "x").write_text("precious")
    (run / ".mocap-id" / case.name).write_bytes(case.data)
    (run / "trial.yaml").write_text("mine")
    folder, stage = Folder(run), case.name.removesuffix(".json")
    documents = folder.documents(stage)
    folder.origin(stage, ["summary.json", "report.html"])
    read_refusal(run, "segment", "x")
    folder.remove_outputs(stage, [])
    if not isinstance(documents, dict) or not (bench.place / "x").exists():
        return f"documents {documents!r}"
    return "" if (run / "planar.parquet").exists() else "an artefact of another stage was deleted"


def _run_again(bench: Bench, case: Case) -> str:
    for name in ("link.c3d", "link.yaml"):
        shutil.copy(bench.made / name, bench.place / name)
    shutil.copytree(hostile_seeds.finished(bench.made), bench.place / "done")
    (bench.place / case.name).write_bytes(case.data)
    trial = load(bench.place / "link.yaml")
    outcome = runner.run(trial)
    json.dumps(outcome.summary(), allow_nan=False)
    return ""


READERS: dict[str, Callable[[Bench, Case], str]] = {
    "c3d": _read_c3d,
    "trc": _read_trc,
    "mot": _read_mot,
    "csv": _read_csv,
    "trial": _read_trial,
    "study": _read_study,
    "stored": _read_stored,
    "record": _read_record,
    "run": _run_again,
}
