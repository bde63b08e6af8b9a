"""The stage ukf-smooth: tables in, tables out, and its reasons for gaps and time stamps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from simulated_chains import Moving, planar_table, swinging

from mocap_id.arrays import FloatArray
from mocap_id.errors import RecordingError
from mocap_id.stages.base import Context
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.stages.ukf_smooth import STAGE
from mocap_id.store import LongTable, Table, Tree
from mocap_id.store.parquet import conform_table
from mocap_id.store.provenance import CHAIN, SEGMENTS

FRAMES, STILL = 300, 2


@pytest.fixture(scope="module")
def moving() -> Moving:
    return swinging(joints=2, seconds=FRAMES / 100, rate=100.0, seed=1)


def labels(moving: Moving) -> list[str]:
    return [f"M{i}" for i in range(len(moving.segment))] + [f"BASE{i}" for i in range(STILL)] + ["LOOSE"]


def planar(moving: Moving, markers: FloatArray, time: FloatArray | None = None) -> LongTable:
    """Return the chain's markers, two base markers, and one of no segment."""
    names, frames = labels(moving), len(markers)
    still = np.broadcast_to([0.1, 0.0], (frames, STILL, 2))
    loose = np.full((frames, 1, 2), 3.0)
    points = np.concatenate([markers, still, loose], axis=1)
    time = np.arange(frames) / moving.rate + 0.5 if time is None else time
    return planar_table(np.arange(51, 51 + frames), time, names, points, moving.rate)


NO_SEGMENTS = Table(SEGMENTS, {}, {})
"""Segments without bad stretches; the stage reads nothing else of them."""


def chain(moving: Moving) -> Tree:
    """Return the chain as written by fit-joints, with another marker order than the table."""
    names = labels(moving)[:-1]
    segment = np.concatenate([moving.segment, np.zeros(STILL, dtype=np.int64)])
    local = np.concatenate([moving.local, np.broadcast_to([0.1, 0.0], (STILL, 2))])
    order = np.random.default_rng(0).permutation(len(names))
    data = {
        "joints": {
            "name": np.array(["ankle", "knee", "hip", "neck"][: moving.truth.shape[1]], dtype=object),
            "centre": moving.centres,
            "covariance": np.tile(1e-6 * np.eye(2), (2, 1, 1)),
        },
        "segments": {
            "name": np.array(["foot", "shank", "thigh", "trunk", "head"][: moving.truth.shape[1] + 1], dtype=object)
        },
        "markers": {
            "name": np.array(names, dtype=object)[order],
            "segment": segment[order],
            "local": local[order],
            "residual": np.full(len(names), 1e-3),
        },
    }
    return Tree(CHAIN, data)


def run(moving: Moving, table: Table, **settings: Any) -> tuple[Table, LongTable]:
    trial = TrialKeys(trial="swing", recording=Files(markers=Path("swing.c3d")))
    inputs = {"planar.parquet": table, "chain.h5": chain(moving), "segments.parquet": NO_SEGMENTS}
    states, markers, *_ = STAGE.function(Context(trial, STAGE.settings(**settings), inputs))
    assert isinstance(states, Table)
    assert isinstance(markers, LongTable)
    return states, markers


def test_tables_match_their_schemas(moving: Moving) -> None:
    states, markers = run(moving, planar(moving, moving.markers))
    conform_table(states)
    conform_table(markers)
    assert len(states.frame) == FRAMES
    assert len(markers.frame) == FRAMES * (len(moving.segment) + STILL)
    for j in (1, 2):
        np.testing.assert_allclose(states.frame[f"theta_{j}"], moving.truth[:, j - 1, 0], atol=0.02)
        np.testing.assert_allclose(states.frame[f"dtheta_{j}"][20:-20], moving.truth[20:-20, j - 1, 1], atol=0.1)
        assert states.frame[f"observed_{j}"].all()
    assert not states.reasons


def test_predicted_markers_have_the_row_of_their_measurement(moving: Moving) -> None:
    gone = moving.markers.copy()
    gone[40:50, 0] = np.nan
    _, markers = run(moving, planar(moving, gone))
    frame = markers.frame
    one = frame[frame["marker"] == "M0"].set_index("frame")
    np.testing.assert_allclose(one[["x", "y"]], moving.markers[:, 0], atol=5e-3)
    assert one["residual"].isna().to_numpy().nonzero()[0].tolist() == list(range(40, 50))
    assert one["time"].iloc[0] == pytest.approx(0.5)
    np.testing.assert_allclose(frame.loc[frame["marker"] == "BASE1", "residual"], 0.0, atol=1e-12)


def test_facts_state_noise_and_fit(moving: Moving) -> None:
    facts = run(moving, planar(moving, moving.markers))[0].facts
    assert facts["marker_sd_m"] == pytest.approx(5e-4, rel=0.05)
    assert len(facts["sigma_v"]) == 2
    assert facts["reprojection_rms_m"] == pytest.approx(5e-4 * np.sqrt(2), rel=0.05)
    assert facts["outlier_fraction"] < 0.001
    assert (facts["method"], facts["engine"]) == ("rts", "compiled")


def test_the_thesiss_fixed_noise_can_be_set(moving: Moving) -> None:
    facts = run(moving, planar(moving, moving.markers), marker_sd=1e-3, sigma_v=1e2)[0].facts
    assert (facts["marker_sd_m"], facts["sigma_v"]) == (1e-3, [1e2, 1e2])


def test_a_joint_that_is_lost_is_named_with_its_time(moving: Moving) -> None:
    markers = moving.markers.copy()
    markers[100:250, moving.segment == 2] = np.nan
    states, predicted = run(moving, planar(moving, markers))
    (reason,) = states.reasons
    missing = states.frame["theta_2"].isna()
    assert (reason.code, reason.level) == ("gap", "caution")
    assert "knee" in reason.message
    assert reason.value == pytest.approx(missing.sum() / moving.rate, rel=0.01)
    assert missing[150:200].all()
    assert not states.frame["theta_1"].isna().any()
    conform_table(predicted)


def test_a_segment_whose_markers_are_wrong_is_named_with_its_times(moving: Moving) -> None:
    """The markers of the thigh are those of another object for a while: far away, and not rigid with the segment."""
    markers, own = moving.markers.copy(), np.flatnonzero(moving.segment == 2)
    markers[100:130, own] += np.random.default_rng(3).normal(0.0, 0.2, (len(own), 2))
    states, predicted = run(moving, planar(moving, markers))
    frame = states.frame
    reason = next(each for each in states.reasons if each.code == "markers-rejected")
    assert reason.level == "caution"
    assert "thigh at 1.50–1.79 s" in reason.message
    assert reason.value == pytest.approx(0.3, abs=0.02)
    assert not frame["observed_2"][100:130].any()
    assert frame["observed_1"].all()
    assert frame["observed_2"].drop(range(100, 130)).all()
    conform_table(predicted)


def test_few_frames_with_wrong_markers_are_not_reported(moving: Moving) -> None:
    markers, own = moving.markers.copy(), moving.segment == 2
    markers[100:103, own] += np.random.default_rng(3).normal(0.0, 0.2, (np.count_nonzero(own), 2))
    states, _ = run(moving, planar(moving, markers))
    assert not states.reasons
    assert not states.frame["observed_2"][100:103].any()


def test_a_segment_never_seen_is_reported_as_lost_throughout(moving: Moving) -> None:
    markers = moving.markers.copy()
    markers[:, moving.segment == 2] = np.nan
    (reason,) = run(moving, planar(moving, markers))[0].reasons
    assert "throughout" in reason.message


def test_time_stamps_that_skip_are_refused(moving: Moving) -> None:
    time = np.arange(FRAMES) / moving.rate
    time[120:] += 0.02
    with pytest.raises(RecordingError, match=r"trial swing.*uniform: frame 171 is at 1\.2200 s, expected 1\.2000 s"):
        run(moving, planar(moving, moving.markers, time))


def test_time_stamps_rounded_to_milliseconds_are_uniform_enough(moving: Moving) -> None:
    run(moving, planar(moving, moving.markers, np.round(np.arange(FRAMES) / moving.rate, 3)))


@pytest.mark.parametrize("method", ["two-filter", "butterworth", "spline"])
def test_another_method_is_reported_as_for_comparison(moving: Moving, method: str) -> None:
    states, markers = run(moving, planar(moving, moving.markers), method=method)
    conform_table(states)
    conform_table(markers)
    (reason,) = states.reasons
    assert (reason.code, reason.level) == ("states-method", "caution")
    assert f"`{method}`" in reason.message
    assert states.facts["method"] == method
    np.testing.assert_allclose(states.frame["theta_2"][20:-20], moving.truth[20:-20, 1, 0], atol=0.02)
    unknown = states.frame["sd_ddtheta_1"].isna().all()
    assert unknown == ("no standard deviations" in reason.message) == (method != "two-filter")


def test_a_gap_left_open_by_another_method_is_reported(moving: Moving) -> None:
    markers = moving.markers.copy()
    markers[100:150, moving.segment == 2] = np.nan
    states, _ = run(moving, planar(moving, markers), method="spline")
    gap, method = states.reasons
    assert (gap.code, method.code) == ("gap", "states-method")
    assert "`spline`, which bridges up to 0.2 s, leaves a gap" in gap.message
    assert gap.value == pytest.approx(0.5)


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ValidationError, match="two-filter"):
        STAGE.settings(method="kalman")
