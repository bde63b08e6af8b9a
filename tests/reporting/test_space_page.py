"""The page of a trial in space: a skeleton that turns, figures on paper and on the page, and its tables."""

from __future__ import annotations

import base64
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mocap_id.errors import Refused
from mocap_id.reporting.figure import Band, Figure, Line, Points, Spans, from_json, project
from mocap_id.reporting.figures import draw_figures
from mocap_id.reporting.figures.motion import collect_joint_curves
from mocap_id.reporting.figures.skeleton import make_stick_figure
from mocap_id.reporting.page import read_figures
from mocap_id.reporting.paper_figures import make_figure_files
from mocap_id.reporting.player import MOST_IN_SPACE, Player, make_player
from mocap_id.stages.report import STAGE, report_data
from mocap_id.store import Artefact, Document
from spatial_trial import ANGLES_OF_ARM, SpatialTrial, context


@cache
def page(arm: bool = True) -> str:
    artefacts = SpatialTrial(frames=600, arm=arm).artefacts(plates=True)
    return written(artefacts)["report.html"].decode("utf-8")


def written(artefacts: dict[str, Artefact], refused: Refused | None = None) -> dict[str, bytes]:
    found = STAGE.function(context(artefacts, refused))
    return {one.file: one.content for one in found if isinstance(one, Document)}


def moving(trial: SpatialTrial) -> Player:
    found = make_player(report_data(context(trial.artefacts())))
    assert found is not None
    return found


def figure(name: str, trial: SpatialTrial, **changed: Artefact) -> Figure:
    found = draw_figures(report_data(context(trial.artefacts(plates=True) | changed)))[name].figure
    assert isinstance(found, Figure)
    return found


def test_the_page_has_joints_kinds_axes_angles_and_landmarks() -> None:
    text = page()
    for words in (
        "Kinds of the joints",
        "Glide: shift",
        "Axes of hinges",
        "Anatomical landmarks",
        "frames of the segments are the ISB frames",
    ):
        assert words in text
    for name in ANGLES_OF_ARM:
        assert f">{name.replace('_', ' ')}</td>" in text
    assert 'id="player-turn"' in text and "x along the first horizontal axis" in text
    assert "no anatomical meaning" in page(False)


def test_a_page_in_the_plane_has_no_view_to_turn() -> None:
    from reporting_cases import healthy

    text = healthy()["report.html"].decode("utf-8")
    assert 'id="player-turn"' not in text and "x along the motion, y up" in text


def test_the_player_holds_the_measured_markers_and_the_chain() -> None:
    trial = SpatialTrial()
    found = moving(trial)
    sample = np.round(found.time * 100).astype(int)
    assert found.in_space and len(found.time) == pytest.approx(270, abs=2)
    markers = np.concatenate([part.values for part in found.parts if part.name == "markers"], axis=2)
    truth = np.where(trial.seen[..., None], trial.predicted + trial.noise, np.nan)[sample].swapaxes(1, 2)
    assert markers == pytest.approx(truth, nan_ok=True)
    joints = next(part.values for part in found.parts if part.name == "joints")
    assert joints == pytest.approx(trial.origin[sample, 1:].swapaxes(1, 2), abs=1e-9)


def test_frames_are_limited_and_packed_to_a_fifth_of_a_millimetre() -> None:
    """Reads the frames as the script of the page does: one row per frame, with x, y and z of each part."""
    found = moving(SpatialTrial(frames=9000))
    assert len(found.time) <= MOST_IN_SPACE
    told = found.to_json()
    rows = np.frombuffer(base64.b64decode(told["values"]), "<i2").reshape(len(told["time"]), -1)
    values, start = np.where(rows == told["unknown"], np.nan, rows * told["step"]), 0
    for one, count in zip(found.parts, told["rows"], strict=True):
        own = values[:, start : start + 3 * count].reshape(-1, 3, count)
        assert own == pytest.approx(one.values, abs=2e-4, nan_ok=True)
        start += 3 * count
    assert start == values.shape[1] and len(told["centre"]) == 3


@pytest.mark.parametrize("turn", [-2.0, 0.0, 0.7])
@pytest.mark.parametrize("tilt", [-1.5, 0.0, 0.4])
def test_everything_stays_within_the_view_however_it_is_turned(turn: float, tilt: float) -> None:
    found = moving(SpatialTrial())
    told = found.to_json()
    (panel,) = from_json(told["figure"]).panels
    for part in found.parts:
        points = part.values.swapaxes(1, 2).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)] - told["centre"]
        across, up = np.abs(project(points, turn, tilt)).max(axis=0)
        assert across < panel.x_range[1] and up < panel.y_range[1]


def test_a_view_keeps_the_hand_of_the_frame() -> None:
    turn, tilt = 0.4, -0.3
    across, up = project(np.eye(3), turn, tilt).T
    towards = np.array([np.sin(turn) * np.cos(tilt), np.sin(tilt), np.cos(turn) * np.cos(tilt)])
    np.testing.assert_allclose(np.cross(across, up), towards, atol=1e-12)


def test_sticks_lead_from_joint_to_joint_and_leave_out_what_is_unknown() -> None:
    whole, partly = SpatialTrial(frames=60), SpatialTrial(frames=60, known=False)
    found = make_stick_figure(report_data(context(whole.artefacts())), np.arange(60))
    assert found is not None and found[0] == (0, 1, 2, 3) and found[3] == whole.joints
    for k, stick in list(enumerate(found[1]))[1:3]:
        np.testing.assert_allclose(stick, whole.origin[:, [k, k + 1]], atol=1e-9)
    other = make_stick_figure(report_data(context(partly.artefacts())), np.arange(60))
    assert other is not None and other[0] == (1, 2, 3) and other[3] == ("elbow", "wrist")
    assert not np.allclose(other[1][0][:, 0], partly.origin[:, 1]), "an unknown centre is not drawn"


def test_three_views_at_two_instants_show_every_joint() -> None:
    found = figure("skeleton", SpatialTrial())
    assert [len(line) for line in found.lines] == [3, 3]
    for panel in found.panels:
        assert panel.equal and panel.x.endswith("(m)") and panel.y.endswith("(m)")
        rings = next(one for one in panel.items if isinstance(one, Points) and one.symbol == "ring")
        assert rings.names == ("shoulder", "elbow", "wrist")
    front, side, above = found.lines[0]
    x, y, z = (line_of(one, "upper_arm") for one in (front, side, above))
    assert x.y == pytest.approx(y.y) and z.x == pytest.approx(x.x) and z.y == pytest.approx(-y.x)


def line_of(panel: object, label: str) -> Line:
    return next(one for one in panel.items if isinstance(one, Line) and one.label == label)  # type: ignore[attr-defined]


def test_angles_are_shaded_and_broken_where_they_have_no_meaning() -> None:
    trial = SpatialTrial()
    shoulder, elbow, wrist = figure("angles", trial).panels
    assert [len([one for one in panel.items if isinstance(one, Band)]) for panel in (shoulder, elbow, wrist)] == [
        3,
        3,
        2,
    ]
    shade = next(one for one in shoulder.items if isinstance(one, Spans))
    pole = np.abs(np.sin(trial.angles[:, 1])) < np.sin(np.radians(15))
    assert shade.start[0] == pytest.approx(trial.time[pole.argmax()], abs=0.03)
    plane = collect_joint_curves(report_data(context(trial.artefacts())))[0][2].mean[:, :, 0]
    assert np.isnan(plane[pole][:, [0, 2]]).all() and np.isfinite(plane[:, 1]).all()
    assert not [one for one in elbow.items if isinstance(one, Spans)]
    bridged = next(one for one in wrist.items if isinstance(one, Spans))
    assert (bridged.start[0], bridged.end[0]) == pytest.approx((3.0, 3.3), abs=0.03)


def test_six_components_of_the_wrench() -> None:
    labels = [panel.y for panel in figure("wrench", SpatialTrial(frames=200)).panels]
    assert labels == ["Fx (N)", "Fy, up (N)", "Fz (N)", "τx (N·m)", "τy (N·m)", "τz (N·m)"]


def test_figures_are_drawn_on_paper_from_the_page() -> None:
    held = read_figures(page())
    few = replace(held, all=tuple(one for one in held.all if one.name in ("skeleton", "angles")))
    files = make_figure_files(few)
    assert {"figures/skeleton.svg", "figures/skeleton.pdf", "figures/angles.svg"} <= set(files)


def test_a_refused_trial_shows_its_markers() -> None:
    trial = SpatialTrial(frames=200)
    refusal = Refused("no-motion", "nothing moves")
    text = written({"planar.parquet": trial.planar()}, refusal)["report.html"].decode("utf-8")
    assert 'id="player-turn"' in text and "Markers as recorded" in text and ">Angles</h2>" not in text
    assert "Refused" in written({}, refusal)["report.html"].decode("utf-8")


def test_a_joint_far_from_all_markers_is_within_the_views() -> None:
    trial = SpatialTrial(frames=60, arm=False)
    tree = trial.tree()
    poses = trial.poses()
    far = {f"segment_1_{axis}": poses[f"segment_1_{axis}"] + 1.5 for axis in "xyz"}
    for panel in figure("skeleton", trial, **{"chain.h5": tree, "poses.parquet": poses.with_columns(**far)}).panels:
        rings = next(one for one in panel.items if isinstance(one, Points) and one.symbol == "ring")
        assert panel.x_range[0] < rings.x.min() and rings.x.max() < panel.x_range[1]
        assert panel.y_range[0] < rings.y.min() and rings.y.max() < panel.y_range[1]
