"""Files to damage: small files made here, and the shared recordings if available."""

from __future__ import annotations

import functools
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
for room in (HERE.parent, HERE.parent / "recording"):
    if str(room) not in sys.path:
        sys.path.append(str(room))

from recording_cases import body, build_c3d, plate_parameters  # noqa: E402

from mocap_id import runner  # noqa: E402
from mocap_id.config import load  # noqa: E402
from mocap_id.recording import write_c3d, write_trc  # noqa: E402
from mocap_id.store.provenance import SCHEMAS  # noqa: E402
from swinging_link import LABELS, RATE, pendulum, plate_under  # noqa: E402

LARGEST = 500_000
"""Bytes of a shared recording that is taken as a seed: larger ones only take longer."""

TRIAL = """\
trial: s01
recording: {markers: trial.c3d}
protocol: sit-to-stand
subject: {height: 1.75, mass: 70.1, sex: female}
window: [2.0, 31.5]
plates: {feet: [1], seat: [2]}
external:
  - {file: hand.csv, name: hand, segment: 2, at: [0.1, 0.2, 0.3]}
out: runs/s01
planarise:
  units: mm
  ignore: ['L*', B1]
segment:
  count: 3
"""
STUDY = """\
study: small
out: runs
defaults:
  protocol: sit-to-stand
  segment: {count: 3}
subjects:
  anna: {height: 1.7, mass: 60.5, sex: female, landmarks_m: {shank: 0.4, thigh: 0.4}}
  ben:
trials:
  - {trial: a1, subject: anna, strategy: normal, recording: trial.c3d}
  - trial: b1
    subject: ben
    strategy: dynamic
    recording: {markers: trial.c3d}
    window: [0, 5]
"""


@dataclass(frozen=True)
class Seed:
    """A valid file: name (its ending determines the reader), bytes, and number of frames or rows."""

    name: str
    data: bytes
    frames: int = 0


def shared() -> Path | None:
    folder = Path(os.environ.get("MOCAP_ID_RECORDINGS", HERE.parents[2] / "shared" / "recordings"))
    return folder if folder.is_dir() else None


@functools.cache
def c3d(with_shared: bool) -> tuple[Seed, ...]:
    points = body(40, 6) * 1e3
    analog = np.random.default_rng(0).normal(size=(160, 8)) * 100 - 50
    plate = plate_parameters(2, [1, 2, 3, 4, 5, 6])
    trial = {"TRIAL:ACTUAL_START_FIELD": np.array([3, 0]), "TRIAL:ACTUAL_END_FIELD": np.array([42, 0])}
    more = {"POINT:DATA_START": 0, "ANALOG:UNITS": ["N"] * 3 + ["Nmm"] * 3 + ["V"] * 2, "ANALOG:FORMAT": "SIGNED"}
    made = {
        "bare.c3d": build_c3d(points, first=1),
        "analog.c3d": build_c3d(points, analog=analog, first=3),
        "plate.c3d": build_c3d(points, analog=analog, first=3, parameters={**plate, **trial, **more}),
        "integer.c3d": build_c3d(points, analog=np.round(analog), scale=0.05, parameters={**plate, **trial}),
        "uncounted.c3d": build_c3d(points, drop=("POINT:FRAMES",)),
    }
    seeds = [Seed(name, data, 40) for name, data in made.items()]
    folder = shared() if with_shared else None
    there = sorted((folder / "c3d").glob("*")) if folder else []
    small = [path for path in there if 0 < path.stat().st_size <= LARGEST]
    seeds += [Seed(path.name.lower(), path.read_bytes(), -1) for path in small]
    return tuple(seeds)


@functools.cache
def _link(folder: Path) -> dict[str, bytes]:
    write_trc(folder / "link.trc", LABELS, pendulum(1.0), RATE)
    write_c3d(folder / "link.c3d", LABELS, pendulum(), RATE, plates=(plate_under(600),))
    return {name: (folder / name).read_bytes() for name in ("link.trc", "link.c3d")}


def trc(folder: Path, with_shared: bool) -> tuple[Seed, ...]:
    seeds = [Seed("link.trc", _link(folder)["link.trc"], 100)]
    where = shared() if with_shared else None
    if where:
        text = (where / "sit-to-stand" / "STS1.trc").read_bytes()
        lines = text.split(b"\n")[:206]
        head = lines[2].split(b"\t")
        head[2] = b"200"
        seeds.append(Seed("sts.trc", b"\n".join([*lines[:2], b"\t".join(head), *lines[3:]]) + b"\n", 200))
    return tuple(seeds)


def mot(with_shared: bool) -> tuple[Seed, ...]:
    names = [f"ground_force_1_{what}{axis}" for what in "vpm" for axis in "xyz"]
    rows = ["\t".join([f"{k / 100:.3f}", *(f"{(k * j) % 7 + 0.5:.4f}" for j in range(9))]) for k in range(100)]
    head = ["grf", "version=1", "nRows=100", "nColumns=10", "inDegrees=no", "endheader", "\t".join(["time", *names])]
    seeds = [Seed("grf.mot", "\n".join([*head, *rows, ""]).encode(), 100)]
    where = shared() if with_shared else None
    if where:
        seeds.append(Seed("static.mot", (where / "sit-to-stand" / "static1_grf.mot").read_bytes(), -1))
    return tuple(seeds)


def csv() -> tuple[Seed, ...]:
    force = ["time_s,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm"]
    force += [f"{k / 100:.2f},{k % 3},{k % 5}.5,{-k},0.1,0.2," for k in range(100)]
    angles = ["time_s,knee_deg,hip_rad", *(f"{k / 100:.2f},{k},{k / 50}" for k in range(100))]
    encoder = ["time_s,position_rad,velocity_rad_s,torque_Nm", *(f"{k / 100:.2f},{k / 50},2.0,0.5" for k in range(100))]
    own = [
        "time_s,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z",
        *(f"{k / 100:.2f},0.1,{k % 5},0.2,1.5,2,9.8" for k in range(100)),
    ]
    mtw = ["// Update Rate: 100.0Hz", "PacketCounter\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"]
    mtw += [f"{k}\t1.5\t2\t9.8\t0.1\t{k % 5}\t0.2" for k in range(100)]
    channels = [(f"{kind} {axis}", unit) for kind, unit in (("ACC", "G"), ("GYRO", "deg/s")) for axis in "XYZ"]
    delsys = ["Application:,Trigno Discover", "Sensor 1 (75651),,", "sensor mode: 609,,"]
    delsys += [",".join(f"{name} Time Series (s),{name} ({unit})" for name, unit in channels) + ",Type,Label"]
    delsys += [",".join(", 100 Hz" for _ in channels), ",".join(", 0.01 s" for _ in channels)]
    delsys += [",".join(f"{k / 100:.2f},{k % 7}.5" for _ in channels) + ",General,x" for k in range(100)]
    board = ["time_s,tl_kg,tr_kg,bl_kg,br_kg", *(f"{k / 90:.4f},20.1,{k % 3},15.2,15.3" for k in range(100))]
    joints = [
        "time_s,A_x,A_y,A_z,A_state,B_x,B_y,B_z",
        *(f"{k / 30:.3f},{k / 99},0.5,2,2,0.1,1.2,2" for k in range(100)),
    ]
    kinect = [" ".join(f"{0.1 * (k % 25) + 0.5:.2f}" for k in range(75))] * 30
    logs = {"force": force, "angles": angles, "encoder": encoder, "imu-own": own, "imu-mtw": mtw, "imu-delsys": delsys}
    logs |= {"board": board, "skeleton": joints, "skeleton-kinect": kinect}
    return tuple(Seed(f"{name}.csv", "\n".join([*lines, ""]).encode(), 100) for name, lines in logs.items())


@functools.cache
def finished(folder: Path) -> Path:
    """Return a run folder with all artefacts of the swinging link, beside its trial."""
    _link(folder)
    trial = folder / "link.yaml"
    trial.write_text("trial: link\nrecording: link.c3d\nout: done\n")
    runner.run(load(trial))
    return folder / "done"


def artefacts(folder: Path) -> tuple[Seed, ...]:
    """Return the Parquet and HDF5 files and the records of a finished run."""
    done = finished(folder)
    files = [done / file for file in SCHEMAS if (done / file).is_file()]
    return tuple(Seed(path.name, path.read_bytes()) for path in files)


def records(folder: Path) -> tuple[Seed, ...]:
    done = finished(folder)
    return tuple(Seed(path.name, path.read_bytes()) for path in sorted((done / ".mocap-id").glob("*.json")))
