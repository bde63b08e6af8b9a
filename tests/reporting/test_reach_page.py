"""Reach in the summary, on the page and on paper."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_summary import assert_nulls_explained

from mocap_id.reporting.figure import Figure, Line, Points, project
from mocap_id.reporting.page import read_figures
from mocap_id.reporting.paper_figures import make_figure_files
from mocap_id.stages.identify_dim.events import find_reach_events
from mocap_id.stages.report import STAGE
from mocap_id.store import Artefact, Document, Table
from spatial_trial import SpatialTrial, context


def with_reach(artefacts: dict[str, Artefact]) -> tuple[dict[str, Artefact], Table]:
    trial = SimpleNamespace(subject=SimpleNamespace(height=1.7))
    source: Any = SimpleNamespace(table=artefacts.__getitem__, tree=artefacts.__getitem__, trial=trial)
    events = find_reach_events(source)
    return artefacts | {"events.parquet": events}, events


def reported(artefacts: dict[str, Artefact]) -> tuple[dict[str, Any], str]:
    made = {one.file: one.content for one in STAGE.function(context(artefacts)) if isinstance(one, Document)}
    return json.loads(made["summary.json"]), made["report.html"].decode()


def test_summary_and_page_show_the_reach() -> None:
    artefacts, events = with_reach(SpatialTrial(frames=2500).artefacts())
    assert not events.reasons
    json.dumps(events.facts, allow_nan=False)
    summary, page = reported(artefacts)
    found, facts = summary["workspace"], events.facts["reach"]
    assert_nulls_explained(summary)
    assert found["why"] is None and found["volume_m3"] == facts["volume_m3"] > 0
    assert found["interval_m3"][0] < found["volume_m3"] < found["interval_m3"][1]
    assert set(found["box_deg"]) == {"plane", "elevation", "axial", "flexion"}
    assert found["visited"]["volume_m3"] < found["volume_m3"]
    assert found["visited"]["meaning"] in page
    assert set(found["heights"]["levels"]) == {"waist", "mouth", "overhead"}
    assert "mesh" not in found and len(facts["mesh"]["box_m"]) == len(facts["mesh"]["theta_deg"])
    figure = read_figures(page)["reach"].figure
    assert isinstance(figure, Figure)
    (panel,) = figure.panels
    assert panel.view is not None
    for item, flat in zip(panel.items, panel.flat().items, strict=True):
        assert isinstance(item, Line | Points) and isinstance(flat, Line | Points) and item.z is not None
        points = np.stack([item.x, item.y, item.z], axis=1)
        seen = project(points, *np.radians(panel.view).tolist())
        assert np.allclose(np.stack([flat.x, flat.y], axis=1), seen, equal_nan=True)
        known = np.linalg.norm(points[np.isfinite(points).all(axis=1)], axis=1)
        assert known.max() < 1.5 * facts["arm_length_m"]
    assert b"<svg" in make_figure_files(read_figures(page))["figures/reach.svg"]


def test_a_trial_without_a_volume_says_why() -> None:
    artefacts, events = with_reach(SpatialTrial(known=False).artefacts())
    assert [reason.code for reason in events.reasons] == ["no-reach"]
    summary, page = reported(artefacts)
    assert_nulls_explained(summary)
    assert summary["workspace"]["volume_m3"] is None
    assert "centre of the joint" in summary["workspace"]["why"]
    assert summary["workspace"]["ranges"]["elbow_flexion"]["range_deg"] > 0
    assert "The reachable volume is unknown" in page


def test_an_arm_taken_for_the_other_one_has_no_volume() -> None:
    """In frames of the wrong side the elbow bends backwards."""
    artefacts = SpatialTrial().artefacts()
    angles = artefacts["angles.parquet"]
    assert isinstance(angles, Table)
    flexion = {"elbow_flexion": -np.asarray(angles.columns["elbow_flexion"])}
    wrong = Table(angles.schema, dict(angles.columns) | flexion, angles.facts, angles.reasons)
    _, events = with_reach(artefacts | {"angles.parquet": wrong})
    assert [reason.code for reason in events.reasons] == ["no-reach"]
    assert "correct `side:`" in events.reasons[0].message


def test_other_protocols_have_no_reach() -> None:
    summary, page = reported(SpatialTrial().artefacts())
    assert summary["workspace"]["volume_m3"] is None and "protocol: reach" in summary["workspace"]["why"]
    assert 'id="reach"' not in page


@pytest.mark.parametrize(("turn", "expected"), [(0.0, [1.0, 2.0]), (np.pi / 2, [-3.0, 2.0])])
def test_a_view_turns_about_the_upward_axis(turn: float, expected: list[float]) -> None:
    assert np.allclose(project(np.array([1.0, 2.0, 3.0]), turn, 0.0), expected)
