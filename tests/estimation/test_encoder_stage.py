"""An encoder in ukf-smooth: beside the cameras or instead of them, and its possible errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from simulated_chains import Moving, measured, planar_table

from mocap_id.arrays import FloatArray
from mocap_id.errors import ConfigError, RecordingError
from mocap_id.stages.base import Context
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.store import Table, Tree
from mocap_id.store.parquet import conform_table
from mocap_id.store.provenance import CHAIN, SEGMENTS

RATE, SECONDS, OFFSET, ZERO = 100.0, 8.0, 0.0123, 0.2


def swing(time: FloatArray, order: int = 0) -> FloatArray:
    """Return four swings between rests and their derivatives, rad."""
    step = 1e-4
    if order:
        return (swing(time + step, order - 1) - swing(time - step, order - 1)) / (2 * step)
    return 0.7 * np.exp(-(((time - 4.0) / 2.0) ** 4)) * np.sin(2 * np.pi * (time - 4.0))


@pytest.fixture(scope="module")
def moving() -> Moving:
    """Return the joint angle with opposite sign and another zero."""
    time = np.arange(int(SECONDS * RATE)) / RATE
    derivatives = [-swing(time, order) for order in range(3)]
    truth = np.stack([*derivatives, np.gradient(derivatives[2], 1 / RATE)], axis=-1)[:, None]
    truth[..., 0] += ZERO
    return measured(truth, RATE, 5e-4, np.random.default_rng(4), per_segment=6)


def record(folder: Path, *, late: float = 0.0, factor: float = 1.0, noise: float = 1.0, own: Any = swing) -> Path:
    """Return the encoder's record: 125 Hz, its clock ``OFFSET`` and a further ``late`` behind."""
    rng = np.random.default_rng(9)
    time = np.arange(0.0, SECONDS - 0.02, 1 / 125.0)
    position, velocity = (own(time + OFFSET) if k == 0 else own(time + OFFSET, 1) for k in range(2))
    position, velocity = (
        position + noise * rng.normal(0, 1e-4, len(time)),
        velocity + noise * rng.normal(0, 1e-3, len(time)),
    )
    path = folder / "encoder.csv"
    columns = {"time_s": time + late, "position_rad": factor * position, "velocity_rad_s": factor * velocity}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def run(moving: Moving, encoder: Path | None, **settings: Any) -> tuple[Table, Table]:
    """Return states.parquet and encoder.parquet."""
    labels, frames = [f"M{i}" for i in range(len(moving.segment))], len(moving.markers)
    count = np.arange(frames)
    joints = {
        "name": np.array(["elbow"], dtype=object),
        "centre": moving.centres,
        "covariance": 1e-6 * np.eye(2)[None],
    }
    markers = {
        "name": np.array(labels, dtype=object),
        "segment": moving.segment,
        "local": moving.local,
        "residual": np.full(len(labels), 1e-3),
    }
    segments = {"name": np.array(["base", "link"], dtype=object)}
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("a.c3d")), protocol="robot-joint", encoder=encoder)
    inputs = {
        "planar.parquet": planar_table(1 + count, count / RATE, labels, moving.markers, RATE),
        "segments.parquet": Table(SEGMENTS, {}, {}),
        "chain.h5": Tree(CHAIN, {"joints": joints, "segments": segments, "markers": markers}),
    }
    states, _, _, beside, _, _ = STAGE.function(Context(trial, STAGE.settings(**settings), inputs))
    assert isinstance(states, Table) and isinstance(beside, Table)
    conform_table(states)
    conform_table(beside)
    return states, beside


def test_the_encoder_table_has_the_sign_of_the_plane(moving: Moving, tmp_path: Path) -> None:
    states, beside = run(moving, record(tmp_path))
    facts = beside.facts
    assert facts["sign"] == -1
    assert facts["clock_offset_s"] == pytest.approx(OFFSET, abs=4 * facts["clock_offset_sd_s"])
    assert facts["clock_offset_sd_s"] < 1e-3
    assert facts["zero_rad"] == pytest.approx(ZERO, abs=4 * facts["zero_sd_rad"])
    assert facts["noise"]["position_sd"] == pytest.approx(1e-4, rel=0.3)
    inside = np.isfinite(beside.frame["theta"])
    assert inside.mean() > 0.98
    truth = moving.truth[inside, 0]
    for d, (name, size) in enumerate((("theta", 2e-4), ("dtheta", 4e-3), ("ddtheta", 0.7))):
        off = beside.frame.loc[inside, name].to_numpy() - truth[:, d]
        assert np.abs(off).max() < 6 * size
        pulls = (off - off.mean()) / beside.frame.loc[inside, f"sd_{name}"].to_numpy()
        assert 0.3 < np.sqrt(np.mean(pulls**2)) < 2  # the jerk of a swing is not quite white
    assert facts["camera"]["theta"]["r2"] > 0.9999
    assert states.facts["method"] == "rts"
    assert not states.reasons and not beside.reasons


def test_states_can_come_from_the_encoder(moving: Moving, tmp_path: Path) -> None:
    states, beside = run(moving, record(tmp_path), method="encoder")
    inside = np.isfinite(beside.frame["theta"])
    for name in ("theta", "dtheta", "ddtheta", "sd_theta", "sd_ddtheta"):
        np.testing.assert_array_equal(states.frame[f"{name}_1"], beside.frame[name])
    assert states.frame["dddtheta_1"].isna().all()
    np.testing.assert_array_equal(states.frame["observed_1"], inside)
    assert {reason.code for reason in states.reasons} == {"states-method", "gap"}
    assert "record does not cover" in " ".join(reason.message for reason in states.reasons)
    assert states.facts["sd_holds"] == "encoder noise"


def test_wrong_markers_do_not_bridge_states_from_the_encoder(moving: Moving, tmp_path: Path) -> None:
    markers, own = moving.markers.copy(), np.flatnonzero(moving.segment == 1)
    markers[300:330, own] += np.random.default_rng(3).normal(0.0, 0.2, (len(own), 2))
    wrong, encoder = replace(moving, markers=markers), record(tmp_path)
    assert "markers-rejected" in {reason.code for reason in run(wrong, encoder)[0].reasons}
    states, _ = run(wrong, encoder, method="encoder")
    assert "markers-rejected" not in {reason.code for reason in states.reasons}
    assert states.frame["observed_1"][300:330].all()


def test_without_an_encoder_there_are_no_rows_and_a_reason(moving: Moving) -> None:
    _, beside = run(moving, None)
    assert len(beside.frame) == 0
    assert "names no encoder" in beside.facts["why"]
    with pytest.raises(ConfigError, match=r"method: encoder.*names no encoder"):
        run(moving, None, method="encoder")


def test_a_record_of_another_time_contradicts_the_recording(moving: Moving, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"encoder\.csv.*30.*37\.97.* covers less than half.*0 to 7\.99"):
        run(moving, record(tmp_path, late=30.0))


def test_degrees_in_a_column_of_radians_are_detected(moving: Moving, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"57\.\d times the cameras. angles.*degrees"):
        run(moving, record(tmp_path, factor=180 / np.pi))


def test_another_joints_record_disagrees(moving: Moving, tmp_path: Path) -> None:
    def other(time: FloatArray, order: int = 0) -> FloatArray:
        return swing(0.8 * time, order) * 0.8**order

    (reason,) = run(moving, record(tmp_path, own=other))[1].reasons
    assert (reason.code, reason.level) == ("encoder-disagrees", "caution")


def test_a_clock_beyond_the_search_is_doubtful(moving: Moving, tmp_path: Path) -> None:
    (reason,) = run(moving, record(tmp_path, late=0.03), encoder_offset_limit_s=0.0177)[1].reasons
    assert reason.code in {"encoder-weak", "encoder-disagrees"}


def test_a_swing_without_rest_does_not_determine_the_sign(moving: Moving, tmp_path: Path) -> None:
    """A sine shifted by half a period changes its sign."""
    time = np.arange(int(SECONDS * RATE)) / RATE
    waves = [0.5 * (2 * np.pi) ** d * np.sin(2 * np.pi * time + d * np.pi / 2) for d in range(4)]
    endless = measured(np.stack(waves, axis=-1)[:, None], RATE, 5e-4, np.random.default_rng(4), per_segment=6)

    def sine(at: FloatArray, order: int = 0) -> FloatArray:
        return 0.5 * (2 * np.pi) ** order * np.sin(2 * np.pi * at + order * np.pi / 2)

    (reason,) = run(endless, record(tmp_path, own=sine), encoder_offset_limit_s=0.6)[1].reasons
    assert reason.code == "encoder-weak"
    assert "does not determine the encoder" in reason.message
