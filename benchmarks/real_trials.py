"""What a chain of four or five bodies explains of real trials: ``python benchmarks/real_trials.py [--write PAGE]``.

The folder of the recordings is taken from MOCAP_ID_RECORDINGS. Prints docs/real-trials.md, and with ``--write
docs/real-trials.md`` replaces that page. About a minute.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from kinematic_sweep import markdown
from real_trials_page import TEXT
from scipy.signal import butter, sosfiltfilt

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import structural_base
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.geometry.planar import segment_poses
from mocap_id.store import Folder
from mocap_id.workflows.finished import Finished, finished
from mocap_id.workflows.transfer import CARRIED, HELD_OUT, OWN, SERIES, apply, rms
from mocap_id.workflows.transfer_support import AT_HOME

UNITS = {"Fx": ("N", 1.0, 1), "Fy": ("N", 1.0, 1), "tauz": ("N·m", 1.0, 1), "cop_x": ("mm", 1e3, 1)}
HEADS = [f"{'CoP' if name == 'cop_x' else name}, {unit}" for name, (unit, _, _) in UNITS.items()]
PHASES = ("rising, low", "rising, high", "upright", "descending, high", "descending, low")


@dataclass(frozen=True)
class Trial:
    """A finished trial with its run folder."""

    done: Finished
    folder: Path

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_parquet(self.folder / name)

    @property
    def samples(self) -> BoolArray:
        """Those of the fit that were predicted with their repetition left out."""
        frame = self.done.dynamics
        return np.asarray(frame["in_fit"] & np.isfinite(frame["Fy_held_out"]))

    def series(self, suffix: str = "") -> FloatArray:
        return self.done.dynamics[[f"{name}{suffix}" for name in SERIES]].to_numpy(dtype=np.float64)


def run(recordings: Path, folder: Path, recording: str, name: str, **keys: Any) -> Trial:
    """A trial through all stages up to identify-dim."""
    source = recordings / "sit-to-stand"
    files = {"markers": str(source / f"{recording}.trc"), "forces": str(source / f"{recording}_grf.mot")}
    yaml = folder / f"{name}.yaml"
    keys = {"protocol": "sit-to-stand", "subject": {"mass": 60.0}, **keys}
    yaml.write_text(json.dumps({"trial": name, "recording": files, **keys}))
    return Trial(finished(yaml), folder / "runs" / name)


def held_out_error(trial: Trial, body: str, name: str) -> float:
    error = trial.done.facts["held_out"][body][name]
    return float(np.hypot(error["bias"], error["sd"]))


def cells(trial: Trial, *bodies: str) -> list[str]:
    return [
        " / ".join(f"{factor * held_out_error(trial, body, name):.{digits}f}" for body in bodies)
        for name, (_, factor, digits) in UNITS.items()
    ]


def least_errors(trial: Trial) -> list[float]:
    """Least rms error of each component by itself, over all parameters and a constant."""
    regressor, used = trial.done.regressor(), trial.samples
    out = []
    for k in range(3):
        rows = np.column_stack([regressor[used, k], np.ones(used.sum())])
        target = trial.series()[used, k]
        out.append(float(np.sqrt(np.mean((rows @ np.linalg.lstsq(rows, target, rcond=1e-10)[0] - target) ** 2))))
    return out


def centre_of_mass(points: Mapping[str, FloatArray]) -> FloatArray:
    """Of the markers of these recordings, with Winter's masses, (T, d) m."""

    def mid(*names: str) -> FloatArray:
        return np.mean([points[name] for name in names], axis=0)

    hip, shoulder = mid("L.ASIS", "r.ASIS", "L.PSIS", "r.PSIS"), mid("L_Shoulder", "R_Shoulder")
    knee, ankle, foot = mid("L_knee", "r_knee"), mid("L_ankle", "r_ankle"), mid("L_calc", "L_toe", "r_calc", "r_toe")
    elbow = mid("L_elbow_lat", "L_elbow_med", "R_elbow_lat", "R_elbow_med")
    wrist = mid("L_wrist_radius", "L_wrist_ulna", "R_wrist_radius", "R_wrist_ulna")
    head = points["C7"] + 0.3 * (points["C7"] - hip)
    legs = 0.029 * foot + 0.093 * (0.567 * knee + 0.433 * ankle) + 0.2 * (0.567 * hip + 0.433 * knee)
    arms = 0.056 * (0.564 * shoulder + 0.436 * elbow) + 0.032 * (0.57 * elbow + 0.43 * wrist) + 0.012 * wrist
    return np.asarray(legs + 0.142 * hip + 0.355 * (0.4 * hip + 0.6 * shoulder) + 0.081 * head + arms)


def marker_error(trial: Trial) -> float:
    """rms error of Fy by the markers' centre of mass, N."""
    planar, time = trial.table("planar.parquet"), trial.done.dynamics["time"].to_numpy()
    points = {str(name): one[["x", "y"]].to_numpy() for name, one in planar.groupby("marker", observed=True)}
    smooth = sosfiltfilt(
        butter(2, 6.0 / 0.802, fs=1 / (time[1] - time[0]), output="sos"), centre_of_mass(points), axis=0
    )
    up = np.gradient(np.gradient(smooth[:, 1], time), time)
    assert trial.done.mass is not None
    error = trial.done.mass * (up + 9.81) - trial.series()[:, 1]
    return float(np.sqrt(np.mean(error[trial.samples] ** 2)))


def phases(trial: Trial) -> FloatArray:
    """Index of the phase of each sample (T,) in PHASES."""
    _, origin = segment_poses(trial.done.q, trial.done.skeleton.centres)
    hip = origin[:, 3, 1]
    height = (hip - hip.min()) / np.ptp(hip)
    rising = np.gradient(hip) > 0
    moving = np.where(rising, np.where(height < 0.5, 0, 1), np.where(height < 0.5, 4, 3))
    return np.where(height > 0.9, 2, moving)


def pelvis_above(trial: Trial) -> FloatArray:
    """How far the pelvis's markers are above the chain's, (T,) m."""
    predicted, measured = trial.table("markers.parquet"), trial.table("planar.parquet")
    both = predicted.merge(measured, on=["frame", "marker"], suffixes=("", "_seen"))
    pelvis = both[both["marker"].astype(str).str.contains("ASIS|PSIS")]
    return (pelvis["y_seen"] - pelvis["y"]).groupby(pelvis["frame"]).mean().to_numpy()


def phase_rows(name: str, trial: Trial) -> list[list[str]]:
    used, phase, above = trial.samples, phases(trial), pelvis_above(trial)
    squares = (trial.series("_held_out") - trial.series()) ** 2
    rows = []
    for k, label in enumerate(PHASES):
        here = used & (phase == k)
        shares = np.nansum(squares[here], axis=0) / np.nansum(squares[used], axis=0)
        row = [name, label, f"{100 * here.sum() / used.sum():.0f} %", *(f"{100 * share:.0f} %" for share in shares)]
        rows.append([*row, f"{1e3 * above[here].mean():+.0f}"])
    return rows


def unexplained(name: str, trial: Trial) -> str:
    shares = {key: 1 - trial.done.facts["held_out"]["model"][key]["r2"] for key in SERIES}
    return f"{name} " + ", ".join(
        f"{'CoP' if key == 'cop_x' else key} {100 * share:.0f} %" for key, share in shares.items()
    )


def standing(recordings: Path) -> dict[str, float]:
    """CoP and centre of mass in front of the ankles, m, and the mass, kg, in quiet standing."""
    source = recordings / "sit-to-stand"
    lines = (source / "static1.trc").read_text().splitlines()
    labels = [label for label in lines[3].split("\t")[2:] if label]
    rows = np.array([[float(cell) for cell in line.split("\t")[2:]] for line in lines[5:] if line.strip()])
    points = {label: rows[:, 3 * i : 3 * i + 3] for i, label in enumerate(labels)}
    head, _, body = (source / "static1_grf.mot").read_text().partition("endheader\n")
    assert head
    forces = pd.read_csv(pd.io.common.StringIO(body), sep="\t")
    load = {plate: forces[f"ground_force_{plate}_vy"].mean() for plate in (1, 2)}
    pressure = sum(load[plate] * forces[f"ground_force_{plate}_px"].mean() for plate in load) / sum(load.values())
    ankle = float(np.mean([points[name][:, 0].mean() for name in ("L_ankle", "r_ankle")]))
    mass_centre = float(centre_of_mass(points)[:, 0].mean())
    return {"cop": pressure - ankle, "com": mass_centre - ankle, "mass": sum(load.values()) / 9.81}


def as_they_are(source: Trial, target: Trial) -> list[str]:
    """Errors of the source's base parameters with the target's regressor."""
    kept = structural_base(target.done.skeleton.centres).kept
    base = np.asarray(Folder(source.folder).read("dynamics.h5").data["base"]["value"])
    wrench = target.done.regressor()[:, :, kept] @ base
    model = np.column_stack([wrench, centre_of_pressure(wrench, target.done.cop_threshold)])
    used = target.done.dynamics["in_fit"].to_numpy()
    errors = np.sqrt(np.nanmean((model - target.series())[used] ** 2, axis=0))
    return [f"{factor * error:.{digits}f}" for error, (_, factor, digits) in zip(errors, UNITS.values(), strict=True)]


def transfers(pairs: Mapping[str, tuple[Trial, Trial]]) -> tuple[str, str, str]:
    """Tables of errors and of what is known beforehand, and the verdicts in words."""
    errors, known, verdicts = [], [], []
    for name, (source, target) in pairs.items():
        found = apply(source.done, target.done)
        bodies = {body.name: body.errors for body in found.bodies}
        for body in (OWN, HELD_OUT, CARRIED, "winter"):
            values = [f"{factor * rms(bodies[body][key]):.{digits}f}" for key, (_, factor, digits) in UNITS.items()]
            errors.append([name, body, *values])
        errors.insert(-1, [name, "as they are", *as_they_are(source, target)])
        assert found.support is not None
        told = [found.support.apart[key] / found.support.sd[key] for key in AT_HOME]
        known.append([name, *(f"{value:.1f}" for value in told), *(f"{v:.2f}" for v in found.support.at_home.values())])
        codes = ", ".join(f"`{reason.code}`" for reason in found.reasons)
        verdicts.append(f"{name}: {'supported' if found.supported else 'not supported'} ({codes}).")
    heads = [f"{what} {key}" for what in ("apart, sd:", "at home:") for key in ("Fy", "tauz", "CoP")]
    return markdown(["", "body", *HEADS], errors), markdown(["", *heads], known), " ".join(verdicts)


def other_settings(recordings: Path, folder: Path) -> list[list[str]]:
    """Errors on left-out repetitions, and the table's, by setting."""
    others: dict[str, dict[str, Any]] = {
        "default": {},
        "`identify-dim: {cutoff_hz: 5}`": {"identify-dim": {"cutoff_hz": 5.0}},
        "`identify-dim: {components: [Fy, tauz]}`": {"identify-dim": {"components": ["Fy", "tauz"]}},
    }
    for hz in (3, 4, 6):
        low_pass = {"method": "butterworth", "butterworth_hz": float(hz)}
        others[f"`ukf-smooth: {{method: butterworth, butterworth_hz: {hz}}}`"] = {"ukf-smooth": low_pass}
    rows = []
    for recording in ("STS1", "squats1"):
        for k, (name, keys) in enumerate(others.items()):
            trial = run(recordings, folder, recording, f"{recording}-{k}", **keys)
            rows.append([recording, name, *cells(trial, "model", "reference")])
    return rows


def page(recordings: Path, folder: Path) -> str:
    """The whole page."""
    trials = {
        "STS1, 5 segments": run(recordings, folder, "STS1", "sts"),
        "STS1, 4 segments": run(recordings, folder, "STS1", "sts-4", segment={"count": 4}),
        "squats1, 4 segments": run(recordings, folder, "squats1", "squats"),
    }
    sts, sts4, squats = trials.values()
    named: Sequence[tuple[str, Trial]] = [("STS1", sts), ("squats1", squats)]
    upright = phases(sts) == 2
    above, still = pelvis_above(sts), standing(recordings)
    high = np.isin(phases(sts), (1, 3))
    errors, known, verdict = transfers({"STS1 → squats1": (sts4, squats), "squats1 → STS1": (squats, sts4)})
    floors = [(name, cells(one, "model"), least_errors(one), marker_error(one)) for name, one in trials.items()]
    return TEXT.format(
        held_out=markdown(
            ["", "samples", *HEADS],
            [[n, str(t.samples.sum()), *cells(t, "in_sample", "model", "reference")] for n, t in trials.items()],
        ),
        fy_worse=100 * (held_out_error(sts, "model", "Fy") / held_out_error(sts, "reference", "Fy") - 1),
        floor=markdown(
            ["", *(f"{head}: left out / any body" for head in HEADS[:3]), "Fy, N: markers"],
            [
                [n, *(f"{o} / {f:.1f}" for o, f in zip(own, least, strict=False)), f"{m:.1f}"]
                for n, own, least, m in floors
            ],
        ),
        phases=markdown(
            ["", "phase", "samples", "Fx", "Fy", "tauz", "CoP", "pelvis above, mm"],
            [row for name, trial in named for row in phase_rows(name, trial)],
        ),
        unexplained="; ".join(unexplained(name, trial) for name, trial in named),
        drop=1e3 * (above[sts.samples & high].mean() - above[sts.samples & upright].mean()),
        static_cop=1e3 * still["cop"],
        static_com=1e3 * still["com"],
        static_mass=still["mass"],
        settings=markdown(["", "settings", *HEADS], other_settings(recordings, folder)),
        transfer=errors,
        support=known,
        verdict=verdict,
    )


def main() -> None:
    """Measure, print and perhaps write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--write", type=Path, help="page to replace")
    arguments = parser.parse_args()
    recordings = os.environ.get("MOCAP_ID_RECORDINGS")
    if not recordings:
        parser.error("MOCAP_ID_RECORDINGS does not name the folder of the recordings")
    with tempfile.TemporaryDirectory() as folder:
        text = page(Path(recordings).resolve(), Path(folder))
    sys.stdout.write(text)
    if arguments.write:
        arguments.write.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
