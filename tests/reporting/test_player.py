"""What the player shows: positions that lose nothing an eye could see, at moments that exist, and forces to scale."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.models import BasicTicker, ColumnDataSource, GlyphRenderer, Line, Model, Plot, Span
from reporting_cases import RATE, Trial, context

from mocap_id.geometry.planar import segment_poses
from mocap_id.reporting.player import frames as moments
from mocap_id.reporting.player.embedding import player
from mocap_id.reporting.player.frames import MOST, Frames, frames
from mocap_id.reporting.player.models import document, model, source
from mocap_id.reporting.player.plots import plots
from mocap_id.stages.report.function import material


def moving(trial: Trial, **changed: object) -> Frames:
    found = frames(material(context(trial.artefacts() | changed)))  # type: ignore[arg-type]
    assert found is not None
    return found


def part(found: Frames, source: str) -> np.ndarray:
    return next(one.values for one in found.parts if one.source == source)


def unpacked(found: Frames) -> dict[str, np.ndarray]:
    """As the page's script reads it."""
    told = found.packed()
    rows = np.frombuffer(base64.b64decode(told["values"]), "<i2").reshape(len(told["time"]), -1)
    values = np.where(rows == told["unknown"], np.nan, rows * told["step"])
    read, start = {}, 0
    for one in told["parts"]:
        size = len(one["columns"]) * one["rows"]
        read[one["source"]] = values[:, start : start + size].reshape(len(values), len(one["columns"]), one["rows"])
        start += size
    assert start == values.shape[1]
    return read


def test_markers_are_those_of_the_recording_at_that_time() -> None:
    trial = Trial()
    found = moving(trial)
    sample = np.round(found.time * RATE).astype(int)
    assert found.time == pytest.approx(trial.time[sample])
    truth = np.where(trial.seen[..., None], trial.predicted + trial.noise, np.nan)[sample].swapaxes(1, 2)
    by_label = [found.labels.index(label) for label in trial.labels]
    assert part(found, "markers")[..., by_label] == pytest.approx(truth, nan_ok=True)


def test_sticks_end_where_the_next_begins() -> None:
    trial = Trial()
    found = moving(trial)
    sticks, joints = part(found, "sticks"), part(found, "joints")
    assert sticks[:, 2:, :-1] == pytest.approx(sticks[:, :2, 1:]) and sticks[:, :2] == pytest.approx(joints)
    sample = np.round(found.time * RATE).astype(int)
    assert joints == pytest.approx(segment_poses(trial.theta[sample], trial.centres)[1][:, 1:].swapaxes(1, 2))


def test_the_arrow_is_the_force_from_the_centre_of_pressure() -> None:
    found = moving(Trial())
    scale = found.newton_per_metre
    assert scale is not None
    x0, y0, x1, y1 = part(found, "measured")[..., 0].T
    table = Trial().wrench().frame.iloc[np.round(found.time * RATE).astype(int)]
    assert (y0 == 0).all()
    for drawn, name in ((x0, "cop_x"), ((x1 - x0) * scale, "Fx"), ((y1 - y0) * scale, "Fy")):
        assert drawn == pytest.approx(table[name].to_numpy())


def test_what_is_packed_is_read_back_to_a_fifth_of_a_millimetre() -> None:
    found = moving(Trial())
    read = unpacked(found)
    assert set(read) == {"sticks", "joints", "markers", "measured", "model"}
    for one in found.parts:
        assert read[one.source] == pytest.approx(one.values, abs=2e-4, nan_ok=True)


@pytest.mark.parametrize(("frames_", "expected"), [(2, 2), (300, 90), (16_000, MOST)])
def test_moments_are_as_many_as_an_eye_needs(frames_: int, expected: int) -> None:
    found = moving(Trial(frames=frames_))
    assert len(found.time) == pytest.approx(expected, abs=2)
    assert np.ptp(np.diff(found.time)) < 1.01 / RATE


def test_many_markers_make_longer_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(moments, "_VALUES", 10_000)
    assert len(moving(Trial()).time) == 10_000 // (2 * 16 + 32)


def test_a_refused_trial_shows_its_markers_and_what_the_plates_measured() -> None:
    trial = Trial()
    found = frames(material(context({"planar.parquet": trial.planar(), "wrench.parquet": trial.wrench()})))
    assert found is not None and [one.source for one in found.parts] == ["markers", "measured"]
    assert (found.segments == -1).all()


def test_nothing_recorded_has_no_player_and_no_plate_no_arrow() -> None:
    assert player(material(context({}))) is None
    found = moving(Trial(), **Trial().artefacts(plates=False))
    assert found.newton_per_metre is None and {one.source for one in found.parts} == {"sticks", "joints", "markers"}


def test_the_data_end_no_element() -> None:
    trial = Trial(frames=600)
    made = player(material(context(trial.artefacts())))
    assert made is not None
    assert not set("<>&") & set(made.data)
    told = json.loads(made.data)
    assert made.moments == len(told["frames"]["time"])
    assert set(told["roots"].values()) == {"player-figure", "player-curves"}


def read(told: dict[str, Any]) -> Document:
    """What Bokeh's own classes make of a document; they take no name and no value that they do not know."""
    return Document.from_json(told | {"config": {"type": "object", "name": "DocumentConfig", "id": "config"}})


@pytest.mark.parametrize("case", ["all", "no plates", "four joints", "markers alone"])
def test_bokehs_own_classes_understand_the_plots(case: str) -> None:
    trial = Trial(frames=600, joints=4 if case == "four joints" else 3)
    artefacts = trial.artefacts(plates=case != "no plates")
    of = material(context({"planar.parquet": trial.planar()} if case == "markers alone" else artefacts))
    moving = frames(of)
    assert moving is not None
    drawn = plots(of, moving)
    whole = read(drawn.document)
    assert [root.id for root in whole.roots] == [drawn.figure, *([drawn.curves] if drawn.curves else [])]
    figure = whole.get_model_by_id(drawn.figure)
    assert isinstance(figure, Plot)
    held = {one.data_source.name: one.data_source for one in figure.select(GlyphRenderer)}
    assert set(held) == {part.source for part in moving.parts}
    for part in moving.parts:
        for k, name in enumerate(part.columns):
            np.testing.assert_array_equal(held[part.source].data[name], part.values[0, k])
    for sources in whole.select({"type": ColumnDataSource}):
        assert len({len(column) for column in sources.data.values()}) == 1
    assert {one.desired_num_ticks for one in whole.select({"type": BasicTicker})} == {4}


def test_curves_are_those_of_the_states_and_all_stand_at_the_same_time() -> None:
    trial = Trial(frames=600)
    of = material(context(trial.artefacts()))
    drawn = plots(of, moving(trial))
    whole = read(drawn.document)
    column = whole.get_model_by_id(drawn.curves)
    assert isinstance(column, Model) and of.motion is not None
    angles, *wrench = column.children  # type: ignore[attr-defined]
    lines = [one for one in angles.renderers if isinstance(one.glyph, Line)]
    for line, angle in zip(lines, of.motion.angles.T, strict=True):
        np.testing.assert_allclose(line.data_source.data["y"], np.degrees(angle), rtol=1e-6)
    assert len(wrench) == 4 and len({plot.x_range.id for plot in column.children}) == 1  # type: ignore[attr-defined]
    assert [one.name for one in whole.select({"type": Span}) if one.name] == ["now"]


def test_what_two_hold_is_told_once() -> None:
    data = source({"x": np.arange(3.0)}, "held")
    told, ids = document("title", [model("GlyphRenderer", data_source=data), model("GlyphRenderer", data_source=data)])
    first, second = (root["attributes"]["data_source"] for root in told["roots"])
    assert second == {"id": first["id"]} and ids == ["p1", "p3"]
