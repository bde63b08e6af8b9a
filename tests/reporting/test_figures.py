"""The figures: the same bytes every time, nothing global left behind, the right moments and curves in them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from reporting_cases import Trial, context, healthy

from mocap_id.reporting import figures, style
from mocap_id.reporting.contents import FIGURES, FILES, FigureEntry
from mocap_id.reporting.figures import recovery
from mocap_id.reporting.figures.repetitions import on_common_time
from mocap_id.reporting.figures.skeleton import two_moments
from mocap_id.reporting.tracks import tracks
from mocap_id.reporting.views import Dynamics, Motion
from mocap_id.stages.report import STAGE
from mocap_id.stages.report.function import material
from mocap_id.store.schemas import SCHEMAS


def motion_of(trial: Trial) -> Motion:
    return Motion.from_frame(trial.states().frame)


def test_the_stage_promises_what_it_writes() -> None:
    assert set(STAGE.inputs) == set(SCHEMAS)
    assert STAGE.outputs == FILES == tuple(healthy())


def test_same_trial_same_bytes_and_nothing_global_left() -> None:
    settings = dict(mpl.rcParams)
    for entry in FIGURES:
        again = figures.render(entry, material(context(Trial().artefacts()))).files
        assert all(healthy()[file] == content for file, content in again.items())
        assert b"<dc:date>" not in again[entry.svg] and b"/CreationDate" not in again[entry.pdf]
    assert dict(mpl.rcParams) == settings


@pytest.mark.parametrize("entry", FIGURES, ids=lambda entry: entry.name)
def test_axes_carry_units(entry: FigureEntry) -> None:
    content = healthy()[entry.svg]
    text = " ".join("".join(element.itertext()) for element in ET.fromstring(content).iter())
    units = {
        "skeleton": ["(m)"], "recovery": ["(m)"],
        "states": ["(deg)", "(deg/s)", "(deg/s²)", "(s)"], "repetitions": ["(deg)", "(%)"],
        "residuals": ["(mm)"], "wrench": ["(N)", "(N·m)", "(m)", "(s)"], "parameters": ["kg", "kg·m", "kg·m²"],
        "point_masses": ["(m)", "(kg)"], "phases": ["(N)", "(N·m)", "(m)", "(%)"],
    }  # fmt: skip
    for unit in units[entry.name]:
        assert unit in text
    assert f"{entry.title}: s01-sts" in text


def test_seated_and_standing_come_from_the_events() -> None:
    trial = Trial()
    seated, standing = two_moments(motion_of(trial), trial.events().frame)
    assert trial.time[seated.sample] == 0.0 and trial.time[standing.sample] == 3.0


def test_without_events_the_extremes_of_the_motion_are_shown() -> None:
    trial = Trial()
    moments = two_moments(motion_of(trial), trial.events(0).frame)
    rise = trial.theta[[moment.sample for moment in moments], 1]
    assert sorted(rise) == pytest.approx([trial.theta[:, 1].min(), trial.theta[:, 1].max()], abs=1e-6)


def test_a_moment_never_rests_on_a_bridged_angle() -> None:
    trial = Trial()
    motion = Motion.from_frame(trial.states(bridged=slice(0, 200)).frame)
    for events in (trial.events().frame, None):
        assert all(motion.observed[moment.sample].all() for moment in two_moments(motion, events))


def test_a_motionless_recording_has_one_posture() -> None:
    trial = Trial()
    still = trial.states(bridged=slice(0)).frame
    still[[f"theta_{k}" for k in (1, 2, 3)]] = 0.3
    assert len(two_moments(Motion.from_frame(still), None)) == 1


def test_repetitions_are_stretched_onto_one_time() -> None:
    trial = Trial()
    motion = Motion.from_frame(trial.states(bridged=slice(0)).frame)
    curves = on_common_time(motion, np.array([[0.0, 6.0], [6.0, 12.0]]))
    assert curves.shape == (2, 101, 3)
    assert curves[0] == pytest.approx(curves[1], abs=1e-4)
    assert curves[0, 50] == pytest.approx(trial.theta[300], abs=1e-6)


def test_bridged_samples_leave_a_hole_in_the_repetition() -> None:
    curves = on_common_time(motion_of(Trial()), np.array([[0.0, 6.0]]))
    assert np.isnan(curves[0, 72, 2]) and np.isfinite(curves[0, 72, :2]).all()


def test_reference_base_parameters_are_regrouped_where_they_are_known() -> None:
    tree = Trial().dynamics_tree()
    regrouping = np.zeros((4, 16))
    regrouping[0, [0, 1, 2]] = 1.0
    regrouping[1, [2, 3]] = 1.0  # the fourth has no reference
    data = dict(tree.data) | {"base": dict(tree.data["base"]) | {"regrouping": regrouping}}
    reference = Dynamics.from_tree(type(tree)(tree.schema, data)).base_reference
    assert reference[0] == pytest.approx(0.5 + 1.5 + 2.5) and np.isnan(reference[1])


def test_residuals_are_those_of_the_table() -> None:
    trial = Trial()
    table = material(context(trial.artefacts())).residuals
    rows = trial.markers().frame
    own = rows.loc[rows["marker"] == "shank5", "residual"].to_numpy()
    expected = pd.Series({
        "segment": 1.0, "rms": np.sqrt(np.nanmean(own**2)), "q95": np.nanquantile(own, 0.95),
        "seen": np.isfinite(own).mean(),
    })  # fmt: skip
    assert table.loc["shank5", expected.index.to_list()].to_numpy(dtype=float) == pytest.approx(expected.to_numpy())


def test_control_characters_and_long_labels() -> None:
    assert style.printable("R\x1bKNE\n") == "R\ufffdKNE\ufffd"
    assert style.printable("abcdef", 4) == "abc…" and style.printable("abcd", 4) == "abcd"


def test_inlined_figures_share_no_id() -> None:
    one, other = (
        style.inline(b'<?xml?><svg><g id="a"/><use xlink:href="#a" clip-path="url(#b)"/></svg>', name)
        for name in ("one", "other")
    )
    assert one == '<svg><g id="one-a"/><use xlink:href="#one-a" clip-path="url(#one-b)"/></svg>'
    assert "other-a" in other and "one-a" not in other


def test_states_without_standard_deviations_are_drawn_without_bands() -> None:
    """Methods that are there to be compared with give none (NaN)."""
    trial = Trial()
    states = trial.states()
    bands = [name for name in states.frame if name.startswith("sd_")]
    unknown = replace(states, frame=states.frame.assign(**dict.fromkeys(bands, np.nan)))
    given = {**trial.artefacts(), "states.parquet": unknown}
    for entry in FIGURES:
        drawn = figures.render(entry, material(context(given))).svg
        assert (drawn == healthy()[entry.svg]) == (entry.name != "states")


def test_tracks_are_the_tables_where_it_has_the_moment() -> None:
    trial = Trial(frames=200)
    table = trial.planar().frame.drop(index=[5])  # a marker that has no row at all in the first frame
    time = np.array([0.0, 0.5, 0.505])
    found = tracks(table, time, ["torso12", "nobody", trial.labels[5]])
    own = table[(table["marker"] == "torso12") & (table["time"] == 0.5)]
    assert found[1, 0] == pytest.approx(own[["x", "y"]].to_numpy()[0], nan_ok=True)
    assert np.isnan(found[:, 1]).all() and np.isnan(found[0, 2]).all() and np.isnan(found[2]).all()


def test_seen_from_the_segment_before_markers_run_on_arcs_about_the_joint() -> None:
    """The distance of every drawn marker from its joint is as steady as the markers' noise."""
    trial = Trial(frames=600)
    with style.house():
        figure = recovery.draw(material(context(trial.artefacts())))
    assert not isinstance(figure, str)
    above = [axes for axes in figure.axes if "seen from" in axes.get_title(loc="left")][:3]
    for j, axes in enumerate(above):
        assert axes.get_title(loc="left") == f"{trial.joints[j]}, seen from {trial.names[j]}"
        drawn = np.column_stack([values.astype(float) for values in axes.lines[0].get_data()])
        arcs = np.split(drawn, np.flatnonzero(np.isnan(drawn).all(axis=1)))
        spread = [np.nanstd(np.linalg.norm(arc - trial.centres[j], axis=1)) for arc in arcs if len(arc) > 50]
        assert spread and max(spread) < 0.004
