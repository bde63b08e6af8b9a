"""Faults that are put into two real trials, STS1 and squats1, and what the program reports about them.

A fault is *named* if a note or the verdict names the marker or the instrument. It is *said* if the verdict has a code
that it does not have without the fault. It is *corrected* if the clock offset is found. It is *harmless* if lengths,
angles and torques stay as without the fault or inside their intervals. Otherwise it is *silent*.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import harness
import numpy as np

from mocap_id import recording
from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.errors import MocapIdError
from mocap_id.runner import run_stage

TRIALS = ("STS1", "squats1")
STAGES = (*harness.DYNAMIC, "report")
FROZEN, OTHER = "r_thigh2", "r_shank_antsup"  # markers
LENGTH, ANGLE, TORQUE = 0.05, np.radians(2), 5.0
Names = tuple[str, ...]


@dataclass(frozen=True)
class Fault:
    words: tuple[str, ...]  # one of these words names the fault
    markers: Callable[[Names, FloatArray], tuple[Names, FloatArray]] | None = None  # changes labels and (F, M, 3)
    forces: tuple[float, float] = (1.0, 0.0)  # factor of all components, and delay of their clock, s


def _freeze(labels: Names, points: FloatArray) -> tuple[Names, FloatArray]:
    points, frames = points.copy(), len(points)
    points[frames // 3 : frames // 3 + 300, labels.index(FROZEN)] = points[frames // 3, labels.index(FROZEN)]
    return labels, points


def _exchange(labels: Names, points: FloatArray) -> tuple[Names, FloatArray]:
    points, start, pair = points.copy(), len(points) // 3, [labels.index(FROZEN), labels.index(OTHER)]
    points[start : start + 200, pair] = points[start : start + 200, pair[::-1]]
    return labels, points


def _add_ghost(labels: Names, points: FloatArray) -> tuple[Names, FloatArray]:
    centre = np.nanmedian(points, axis=(0, 1))
    walk = centre + np.linspace((-0.8, -0.5, -0.3), (0.8, 0.5, 0.4), len(points))
    return (*labels, "GHOST1"), np.concatenate([points, walk[:, None]], axis=1)


FAULTS: Mapping[str, Fault] = {
    "marker frozen for 3 s": Fault((FROZEN,), _freeze),
    "two labels exchanged for 2 s": Fault((FROZEN, OTHER), _exchange),
    "ghost that walks": Fault(("GHOST1",), _add_ghost),
    "all gains + 5 %": Fault(("plate",), forces=(1.05, 0.0)),
    "forces 40 ms late": Fault(("ms apart", "clock"), forces=(1.0, 0.04)),
}


def judge(fault: Fault, clean: Mapping[str, Any] | None, found: Mapping[str, Any] | None) -> tuple[str, list[str]]:
    """Return the kind of outcome, and the codes that the trial has only with the fault."""
    if clean is None or found is None:
        return "said", ["refused"]
    before = {reason["code"]: reason["message"] for reason in clean["reasons"]}
    new = [
        reason
        for reason in found["reasons"]
        if reason["code"] not in before or (fault.markers and before[reason["code"]] != reason["message"])
    ]
    codes = sorted({reason["code"] for reason in new} - set(before))
    if any(word in reason["message"] for reason in new for word in fault.words):
        return "named", codes
    if {reason["code"] for reason in found["reasons"] if reason["level"] != "ok"} - set(before):
        return "said", codes
    if fault.forces[1] and abs(abs(found["offset"] - clean["offset"]) - fault.forces[1]) < 2e-3:
        return "corrected", codes
    if clean["lengths"].keys() != found["lengths"].keys():
        return "silent", codes
    lengths = all(abs(found["lengths"][k] / one - 1) < LENGTH for k, one in clean["lengths"].items())
    off = found["torques"] - clean["torques"]
    torques = harness.rms(off) < TORQUE
    inside = np.nanmean((off / found["torque_sd"]) ** 2, axis=0) < harness.QUANTILE**2
    angles = np.nanstd(found["angles"] - clean["angles"], axis=0) < ANGLE
    known = np.isfinite(off).any(axis=0)  # no torque inside a body
    alike = lengths and angles.all() and (torques | inside)[known].all()
    return ("harmless" if alike else "silent"), codes


def _run(source: Path, folder: Path, name: str, fault: Fault) -> dict[str, Any] | None:
    """Write the trial with its fault, run it and return its reasons and results; return None if it was refused."""
    folder.mkdir()
    _write(source, folder, name, fault)
    trial = load(harness.write_real_trial(folder / name, folder / "trial.yaml", subject={"mass": 60.0}))
    try:
        if any(run_stage(trial, stage).refused is not None for stage in STAGES):
            return None
    except MocapIdError:
        return None
    done = harness.Run(trial.file, trial)
    states, dynamics, tree = done.read("states.parquet", "dynamics.parquet", "dynamics.h5")
    summary = done.summary
    joints = range(1, len(summary["joints"]) + 1)
    files = done.read("planar.parquet", "segments.parquet", "dynamics.h5")
    notes = [reason.as_dict() for file in files for reason in file.reasons]
    return {
        "reasons": [*summary["verdict"]["reasons"], *notes],
        "lengths": {k: one["value"] for k, one in summary["lengths_m"].items()},
        "angles": states.stack([f"theta_{j}" for j in joints]),
        "torques": dynamics.stack([f"tau_{j}" for j in joints]),
        "torque_sd": dynamics.stack([f"sd_tau_{j}" for j in joints]),
        "offset": tree.facts["clock_offset_s"] or 0.0,
    }


def _write(source: Path, folder: Path, name: str, fault: Fault) -> None:
    lines = (source / f"{name}.trc").read_text().splitlines()
    text = "\n".join(lines) + "\n"
    if fault.markers is not None:
        labels = tuple(label for label in lines[3].split("\t")[2:] if label)
        rows = [line.split("\t") for line in lines[5:] if line.strip()]
        cells = [[float(cell) if cell.strip() else np.nan for cell in row[: 2 + 3 * len(labels)]] for row in rows]
        table = np.array([row + [np.nan] * (2 + 3 * len(labels) - len(row)) for row in cells])
        labels, points = fault.markers(labels, table[:, 2:].reshape(len(table), -1, 3))
        text = recording.format_trc(
            f"{name}.trc", labels, points, time=table[:, 1], frames=table[:, 0].astype(int), rate=100.0
        )
    (folder / f"{name}.trc").write_text(text)
    lines = (source / f"{name}_grf.mot").read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("endheader")) + 1
    columns = lines[head].split("\t")
    gain, delay = fault.forces
    factor = [1.0 if column == "time" or column[-2] == "p" else gain for column in columns]
    measured = [[float(cell) for cell in line.split("\t")] for line in lines[head + 1 :] if line.strip()]
    changed = [[value * f for value, f in zip(row, factor, strict=True)] for row in measured]
    body = ["\t".join(f"{v + (delay if k == 0 else 0.0):.6f}" for k, v in enumerate(row)) for row in changed]
    (folder / f"{name}_grf.mot").write_text("\n".join([*lines[: head + 1], *body]) + "\n")


def main() -> None:
    given, source, rows = harness.make_parser(__doc__).parse_args(), harness.real_recordings(), []
    with harness.temporary_folder() as place:
        for name in TRIALS:
            clean = _run(source, place / name, name, Fault(()))
            for case, fault in FAULTS.items():
                kind, codes = judge(fault, clean, _run(source, place / f"{name} {case}", name, fault))
                rows.append([name, case, kind, ", ".join(f"`{code}`" for code in codes)])
    text = harness.describe_source(__file__, "two real trials, with `subject: {mass: 60}`")
    table = harness.format_table(["trial", "fault", "outcome", "new codes"], rows)
    harness.publish({"real-faults": f"{text}\n\n{table}"}, write=given.write)


if __name__ == "__main__":
    main()
