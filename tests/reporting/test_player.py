"""The player shows accurate positions at times of the recording, and forces to scale."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from reporting_cases import RATE, Trial, context

from mocap_id.geometry.planar import segment_poses
from mocap_id.reporting import player as players
from mocap_id.reporting.figure import Line, from_json
from mocap_id.reporting.player import MOST, Player, make_player
from mocap_id.stages.report import report_data


def moving(trial: Trial, **changed: object) -> Player:
    found = make_player(report_data(context(trial.artefacts() | changed)))  # type: ignore[arg-type]
    assert found is not None
    return found


def parts(found: Player, name: str) -> np.ndarray:
    """All parts with this name, concatenated to (K, 2, rows)."""
    return np.concatenate([one.values for one in found.parts if one.name == name], axis=2)


def names(found: Player) -> list[str]:
    return list(dict.fromkeys(one.name for one in found.parts))


def test_markers_are_those_of_the_recording_at_that_time() -> None:
    trial = Trial()
    found = moving(trial)
    sample = np.round(found.time * RATE).astype(int)
    assert found.time == pytest.approx(trial.time[sample])
    truth = np.where(trial.seen[..., None], trial.predicted + trial.noise, np.nan)[sample].swapaxes(1, 2)
    labels = [label for one in found.parts if one.name == "markers" for label in one.look["names"]]
    by_label = [labels.index(label) for label in trial.labels]
    assert parts(found, "markers")[..., by_label] == pytest.approx(truth, nan_ok=True)


def test_sticks_end_where_the_next_begins() -> None:
    trial = Trial()
    found = moving(trial)
    sticks, joints = parts(found, "stick"), parts(found, "joints")
    assert sticks[..., 1:-1:2] == pytest.approx(sticks[..., 2::2]) and sticks[..., ::2] == pytest.approx(joints)
    sample = np.round(found.time * RATE).astype(int)
    assert joints == pytest.approx(segment_poses(trial.theta[sample], trial.centres)[1][:, 1:].swapaxes(1, 2))


def test_the_arrow_is_the_force_from_the_centre_of_pressure() -> None:
    found = moving(Trial())
    scale = found.newton_per_metre
    assert scale is not None
    (x0, x1), (y0, y1) = np.moveaxis(parts(found, "force"), 0, -1)
    row, table = np.round(found.time * RATE).astype(int), Trial().wrench()
    assert (y0 == 0).all()
    for drawn, name in ((x0, "cop_x"), ((x1 - x0) * scale, "Fx"), ((y1 - y0) * scale, "Fy")):
        assert drawn == pytest.approx(table[name][row])


def test_packed_positions_are_accurate_to_a_fifth_of_a_millimetre() -> None:
    """Reads the frames as the script of the page does: one row per frame, with x and then y of each part."""
    found = moving(Trial())
    told = found.to_json()
    rows = np.frombuffer(base64.b64decode(told["values"]), "<i2").reshape(len(told["time"]), -1)
    values, start = np.where(rows == told["unknown"], np.nan, rows * told["step"]), 0
    for one, count in zip(found.parts, told["rows"], strict=True):
        own = values[:, start : start + 2 * count].reshape(-1, 2, count)
        assert own == pytest.approx(one.values, abs=2e-4, nan_ok=True)
        start += 2 * count
    assert start == values.shape[1]
    (panel,) = from_json(told["figure"]).panels
    assert len(panel.items) == 1 + len(found.parts), "the ground, and the moving parts"


@pytest.mark.parametrize(("frames_", "expected"), [(2, 2), (300, 90), (16_000, MOST)])
def test_the_number_of_frames_is_limited(frames_: int, expected: int) -> None:
    found = moving(Trial(frames=frames_))
    assert len(found.time) == pytest.approx(expected, abs=2)
    assert np.ptp(np.diff(found.time)) < 1.01 / RATE


def test_many_markers_make_longer_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(players, "_VALUES", 10_000)
    assert len(moving(Trial()).time) == 10_000 // (2 * 16 + 32)


def test_a_refused_trial_shows_markers_and_measured_forces() -> None:
    trial = Trial()
    found = make_player(report_data(context({"planar.parquet": trial.planar(), "wrench.parquet": trial.wrench()})))
    assert found is not None and names(found) == ["markers", "force", "force origin"]
    assert [one.look["symbol"] for one in found.parts if one.name == "markers"] == ["x"]
    assert [panel.y for panel in found.curves] == ["Fx (N)", "Fy, up (N)", "τz (N·m)", "CoP x (m)"]


def test_without_markers_there_is_no_player_and_without_plates_no_arrow() -> None:
    assert make_player(report_data(context({}))) is None
    found = moving(Trial(), **Trial().artefacts(plates=False))
    assert found.newton_per_metre is None and set(names(found)) == {"stick", "joints", "markers"}


@pytest.mark.parametrize("joints", [3, 4])
def test_curves_have_the_time_of_the_recording_and_all_joints(joints: int) -> None:
    trial = Trial(frames=600, joints=joints)
    found = moving(trial)
    angles, *wrench = found.curves
    assert [item.label for item in angles.items if isinstance(item, Line)] == list(trial.joints)
    assert len(wrench) == 4 and all(panel.linked and panel.x_range == (0.0, 5.99) for panel in found.curves)


def test_everything_that_moves_stays_within_the_figure() -> None:
    found = moving(Trial())
    (panel,) = from_json(found.to_json()["figure"]).panels
    for axis, shown in enumerate((panel.x_range, panel.y_range)):
        seen = np.concatenate([one.values[:, axis].ravel() for one in found.parts if not one.name.startswith("force")])
        assert shown[0] < np.nanmin(seen) and np.nanmax(seen) < shown[1]
