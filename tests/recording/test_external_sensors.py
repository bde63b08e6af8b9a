"""Forces of further sensors in the plane: axes, sign, position and clock; wrong files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_facing import sitting_down
from test_planarise import RATE, person_on_a_plate

from mocap_id import recording
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.geometry import PlaneFrame
from mocap_id.stages.base import Context
from mocap_id.stages.planarise import STAGE, PlanariseSettings
from mocap_id.stages.trial_keys import ExternalForce, Files, TrialKeys
from mocap_id.store import LongTable, Table, parquet

PLACE = (0.3, -0.7, 1.1)


def force_at(time: np.ndarray) -> np.ndarray:
    """Return a force in lab axes with Z up, N."""
    return np.column_stack([20 * np.sin(2 * time), 10 + 5 * np.cos(time), 40 + 30 * np.sin(1.5 * time)])


def log(folder: Path, force: np.ndarray, time: np.ndarray, moment: np.ndarray | None = None) -> Path:
    names = ["time_s", "Fx_N", "Fy_N", "Fz_N"] + ([] if moment is None else ["Mx_Nm", "My_Nm", "Mz_Nm"])
    table = np.column_stack([time, force] + ([] if moment is None else [moment]))
    path = folder / "hand.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9f")
    return path


def run(markers: Path, *sensors: dict[str, Any], forces: Path | None = None) -> tuple[LongTable, Table]:
    external = tuple(ExternalForce(**({"name": "hand", "segment": "torso", "at": PLACE} | each)) for each in sensors)
    trial = TrialKeys(trial="t", recording=Files(markers=markers, forces=forces), external=external)
    planar, wrench = STAGE.function(Context(trial, PlanariseSettings(), {}))
    assert isinstance(planar, LongTable)
    assert isinstance(wrench, Table)
    parquet.conform_table(wrench)
    return planar, wrench


def columns(wrench: Table, number: int = 1) -> np.ndarray:
    return wrench.frame[[f"{name}_external_{number}" for name in ("Fx", "Fy", "tauz")]].to_numpy()


def frame_of(planar: LongTable) -> PlaneFrame:
    plane = planar.facts["plane"]
    return PlaneFrame(np.radians(plane["yaw_deg"]), np.array(plane["origin_m"]))


def expected(planar: LongTable, time: np.ndarray, point: np.ndarray) -> np.ndarray:
    force = force_at(time)
    return frame_of(planar).wrench_to_plane(force, np.cross(point, force))


def test_a_force_at_a_fixed_point_with_a_clock_offset(tmp_path: Path) -> None:
    path, *_ = person_on_a_plate(tmp_path)
    logged = np.arange(-1.0, 12.0, 1 / 500)
    file = log(tmp_path, force_at(logged + 0.25), logged)
    planar, wrench = run(path, {"file": file, "clock_offset_s": 0.25})
    time = wrench.frame["time"].to_numpy()
    np.testing.assert_allclose(columns(wrench), expected(planar, time, np.array(PLACE)), atol=0.02)
    fact = wrench.facts["external"][0]
    assert (fact["name"], fact["segment"], fact["clock"], fact["columns"]) == ("hand", "torso", "cameras", "external_1")
    assert fact["rate_hz"] == pytest.approx(500)
    assert fact["known_fraction"] == 1.0


def test_a_force_at_a_marker_moves_with_it(tmp_path: Path) -> None:
    path, positions, *_ = person_on_a_plate(tmp_path, gap=True)
    logged = np.arange(-0.1, 12.0, 1 / 200)
    file = log(tmp_path, force_at(logged), logged)
    planar, wrench = run(path, {"file": file, "at": "M4"})
    time = wrench.frame["time"].to_numpy()
    found = columns(wrench)
    np.testing.assert_array_equal(np.isnan(found).all(axis=1), np.isnan(positions[:, 4]).any(axis=1))
    seen = np.isfinite(found).all(axis=1)
    np.testing.assert_allclose(found[seen], expected(planar, time, positions[:, 4])[seen], atol=0.02)
    assert wrench.facts["external"][0]["known_fraction"] == pytest.approx(seen.mean())


def test_sign_moments_and_several_sensors(tmp_path: Path) -> None:
    path, *_ = person_on_a_plate(tmp_path)
    logged = np.arange(-0.1, 12.0, 1 / 200)
    moment = 3.0 * force_at(logged)
    file = log(tmp_path, -force_at(logged), logged, -moment)
    one = {"file": file, "force": "on-sensor"}
    planar, wrench = run(path, one, one | {"name": "other", "at": (0, 0, 0), "force": "on-body", "segment": 0})
    time = wrench.frame["time"].to_numpy()
    free = frame_of(planar).axes[2] @ (3.0 * force_at(time)).T
    np.testing.assert_allclose(
        columns(wrench), expected(planar, time, np.array(PLACE)) + np.outer(free, [0, 0, 1]), atol=0.05
    )
    opposite = -expected(planar, time, np.zeros(3)) - np.outer(free, [0, 0, 1])
    np.testing.assert_allclose(columns(wrench, 2), opposite, atol=0.05)


def test_forces_are_in_the_axes_of_the_recording(tmp_path: Path) -> None:
    """TRC files have Y up: force and point are rotated like the markers."""
    positions = sitting_down(-1.0, hands=True)
    path = tmp_path / "trial.trc"
    recording.write_trc(path, [f"M{i}" for i in range(positions.shape[1])], positions, RATE)
    logged = np.arange(-0.1, 12.0, 1 / 200)
    z_up = force_at(logged)
    y_up = z_up[:, [0, 2, 1]] * [1, 1, -1]
    at = (PLACE[0], PLACE[2], -PLACE[1])
    planar, wrench = run(path, {"file": log(tmp_path, y_up, logged), "at": at})
    time = wrench.frame["time"].to_numpy()
    np.testing.assert_allclose(columns(wrench), expected(planar, time, np.array(PLACE)), atol=0.02)


def test_sensors_that_do_not_fit_the_recording_are_refused(tmp_path: Path) -> None:
    path, *_ = person_on_a_plate(tmp_path)
    logged = np.arange(100.0, 112.0, 1 / 200)
    late = {"file": log(tmp_path, force_at(logged), logged)}
    with pytest.raises(RecordingError, match=r"hand\.csv: it has no sample between .* it runs from 100 to 111\.995"):
        run(path, late)
    run(path, late | {"clock_offset_s": -100.0})
    fits = late | {"clock_offset_s": -100.0}
    with pytest.raises(ConfigError, match=r"external: hand: at: no marker is called M77"):
        run(path, fits | {"at": "M77"})
    with pytest.raises(ConfigError, match="expected one"):
        run(path, fits | {"at": "M*"})
    with pytest.raises(RecordingError, match="no such file"):
        run(path, late | {"file": tmp_path / "other.csv"})


def test_without_sensors_and_chair_there_are_no_columns(tmp_path: Path) -> None:
    path, *_ = person_on_a_plate(tmp_path)
    _, wrench = run(path)
    assert wrench.facts["external"] == []
    assert not [name for name in wrench.frame if "external" in name or "seat" in name]
