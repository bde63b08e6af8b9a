"""summary.json of a trial in space has its joints, angles and landmarks; a null has a reason."""

from __future__ import annotations

import numpy as np
import pytest
from test_summary import assert_nulls_explained

from mocap_id.errors import Refused
from mocap_id.geometry.so3 import shift_to_shortest_arc
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.reporting.summary_schema import Summary
from mocap_id.stages.report import report_data
from mocap_id.store import Artefact
from spatial_trial import ANGLES_OF_ARM, SpatialTrial, context


def summary_of(artefacts: dict[str, Artefact], refused: Refused | None = None) -> dict:
    found = summarise(report_data(context(artefacts, refused)))
    Summary.model_validate_json(encode_summary(found))
    told = found.model_dump(mode="json", by_alias=True)
    assert_nulls_explained(told)
    return told


def test_an_arm() -> None:
    trial = SpatialTrial()
    summary = summary_of(trial.artefacts())
    assert summary["space"] == "3d" and summary["version"] == 1
    assert [joint["name"] for joint in summary["joints"]] == ["shoulder", "elbow", "wrist"]
    assert [joint["kind"] for joint in summary["joints"]] == ["ball", "two-axis", "two-axis"]
    shoulder, elbow, _ = summary["joints"]
    assert shoulder["centre_m"] == pytest.approx([0.0, -0.02, 0.17])
    assert shoulder["sd_m"] == pytest.approx([1e-3, 2e-3, 3e-3])
    assert shoulder["axis"] is None and shoulder["why"] == "axis: a ball has no axis"
    assert shoulder["glide_m"] == [0.0, 0.015, 0.0] and len(shoulder["glide_sd_m"]) == 3 and elbow["glide_m"] == []
    assert elbow["axis"] == [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    assert elbow["axis_sd_deg"] == pytest.approx([np.degrees(1e-2)] * 2)
    assert elbow["evidence"] == {"ball": 0.0, "two-axis": 2.5, "hinge": 9.0}
    assert {name: entry["value"] for name, entry in summary["lengths_m"].items()} == {"upper_arm": 0.3, "forearm": 0.25}
    assert summary["segments"]["assignment"] == dict(zip(trial.labels, trial.chain.segment.tolist(), strict=True))
    assert summary["landmarks"]["EL"]["segment"] == "upper_arm" and summary["landmarks"]["EL"]["sd_m"] == 0.003
    assert summary["plane"]["planarity"] == 0.31 and summary["plane"]["yaw_deg"] is None
    assert summary["workspace"]["volume_m3"] is None and summary["curls"]["count"] is None


def test_plane_and_axial_rotation_are_judged_away_from_the_pole() -> None:
    trial = SpatialTrial()
    found = summary_of(trial.artefacts())["angles"]
    assert tuple(found) == ANGLES_OF_ARM
    away = np.abs(np.sin(trial.angles[:, 1])) > np.sin(np.radians(15))
    assert 0.3 < away.mean() < 1.0
    for k, name in enumerate(ANGLES_OF_ARM):
        gated = name in ("shoulder_plane", "shoulder_axial")
        truth = np.degrees(np.ptp(trial.angles[away, k] if gated else trial.angles[:, k]))
        assert found[name]["range_deg"] == pytest.approx(truth)
        assert found[name]["used_share"] == pytest.approx(away.mean() if gated else 1.0)
        low, high = found[name]["interval_deg"]
        assert low <= truth <= high


def test_turns_lost_near_the_pole_do_not_widen_the_range() -> None:
    trial = SpatialTrial()
    table = trial.angles_table()
    turned = table["shoulder_axial"] + 2 * np.pi * (trial.time > 5.0)
    before = summary_of(trial.artefacts())["angles"]["shoulder_axial"]
    after = summary_of(trial.artefacts() | {"angles.parquet": table.with_columns(shoulder_axial=turned)})["angles"]
    assert after["shoulder_axial"]["range_deg"] == pytest.approx(before["range_deg"])
    assert after["shoulder_axial"]["low_deg"] == pytest.approx(before["low_deg"])


@pytest.mark.parametrize("start", np.linspace(-700, 700, 15))
def test_the_shortest_arc_is_found_anywhere(start: float) -> None:
    values = start + np.linspace(0, 140, 40)
    found = np.degrees(shift_to_shortest_arc(np.radians(values)))
    assert np.ptp(found) == pytest.approx(140)
    assert np.mod(found - values + 1e-9, 360) == pytest.approx(1e-9, abs=1e-8)
    assert abs(found.min() + found.max()) / 2 <= 180 + 1e-9


def test_the_interval_of_a_range_holds_the_errors_of_both_ends_and_of_the_landmarks() -> None:
    trial = SpatialTrial(frames=120)
    entry = summary_of(trial.artefacts())["angles"]["elbow_flexion"]
    sd = np.degrees(np.sqrt(0.01**2 + 0.01**2 + 0.03**2))
    assert entry["interval_deg"] == pytest.approx([entry["range_deg"] - 1.96 * sd, entry["range_deg"] + 1.96 * sd])
    assert (entry["sd_deg"], entry["constant_sd_deg"]) == pytest.approx((np.degrees(0.01), np.degrees(0.03)))


def test_a_centre_that_the_motion_does_not_show_has_no_number() -> None:
    shoulder = summary_of(SpatialTrial(known=False).artefacts())["joints"][0]
    assert (shoulder["centre_m"], shoulder["sd_m"], shoulder["known"]) == (None, None, False)
    assert "calibration" in shoulder["why"]


def test_a_plain_chain() -> None:
    summary = summary_of(SpatialTrial(arm=False).artefacts(plates=True))
    assert [joint["kind"] for joint in summary["joints"]] == ["ball", "hinge"]
    assert summary["joints"][1]["axis"] == pytest.approx([0.6, 0.0, 0.8])
    assert tuple(summary["angles"]) == ("joint_1_1", "joint_1_2", "joint_1_3", "joint_2_1")
    assert summary["landmarks"] == {} and summary["dynamics"]["mass_kg"] == 71.4


def test_a_refused_trial_in_space() -> None:
    trial = SpatialTrial()
    refusal = Refused("no-motion", "nothing moves")
    for artefacts in ({}, {"planar.parquet": trial.planar()}):
        summary = summary_of(artefacts, refusal)
        assert (summary["space"], summary["joints"], summary["angles"]) == ("3d", None, {})
