"""Figures show the numbers of the artefacts with units, or a sentence on why they are missing."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from reporting_cases import RATE, Trial, context, healthy

from mocap_id.reporting import FILES, style
from mocap_id.reporting.figure import Band, Bars, Figure, Heat, Item, Line, Panel, Points, Spans, from_json, to_json
from mocap_id.reporting.figures import FIGURES, FigureEntry, draw_figures
from mocap_id.reporting.figures.motion import normalise_time
from mocap_id.reporting.figures.skeleton import choose_moments
from mocap_id.reporting.page import read_figures
from mocap_id.reporting.report_data import read_positions
from mocap_id.stages.report import STAGE, ReportSettings, report_data
from mocap_id.store import Artefact, Document, Table
from mocap_id.store.artefacts import IdentifiedDynamics, JointStates
from mocap_id.store.provenance import SCHEMAS


def motion_of(trial: Trial) -> JointStates:
    return JointStates.from_table(trial.states())


def shown(name: str, artefacts: dict[str, Artefact]) -> Figure:
    found = next(draw for own, draw, *_ in FIGURES if own == name)(report_data(context(artefacts)))
    assert isinstance(found, Figure)
    return found


def items(panel: Panel, kind: type[Item]) -> list[Any]:
    return [item for item in panel.items if isinstance(item, kind)]


def labelled(panel: Panel, label: str) -> Any:
    return next(item for item in panel.items if getattr(item, "label", None) == label)


def told(figure: Figure) -> str:
    """All texts of a figure."""
    own = [(panel.title, panel.x, panel.y, *panel.rows) for panel in figure.panels]
    return " ".join([word for words in own for word in words] + [figure.scale.label if figure.scale else ""])


def test_the_stage_declares_its_outputs_and_writes_figures_on_request() -> None:
    assert set(STAGE.inputs) == set(SCHEMAS)
    assert STAGE.outputs == FILES == tuple(healthy())
    found = Trial(frames=400).artefacts()
    held = {name: found[name] for name in ("dynamics.h5", "chain.h5")}
    asked = replace(context(held), settings=ReportSettings(figures=True))
    written = [output.file for output in STAGE.function(asked) if isinstance(output, Document)]
    drawn = [f"figures/{name}.{kind}" for name in ("parameters", "point_masses") for kind in ("svg", "pdf")]
    assert written == [*FILES, "figures/captions.md", *drawn]


@pytest.mark.parametrize("entry", FIGURES, ids=lambda entry: entry[0])
def test_axes_carry_units(entry: FigureEntry) -> None:
    units = {
        "skeleton": ["(m)"], "recovery": ["(m)"],
        "states": ["(deg)", "(deg/s)", "(deg/s²)", "(s)"], "repetitions": ["(deg)", "(%)"],
        "residuals": ["(mm)"], "wrench": ["(N)", "(N·m)", "(m)", "(s)"], "parameters": ["kg", "kg·m", "kg·m²"],
        "point_masses": ["(m)", "(kg)"], "phases": ["(N)", "(N·m)", "(m)", "(%)"], "torques": ["(N·m)", "(s)"],
    }  # fmt: skip
    text = told(shown(entry[0], Trial().artefacts()))
    assert [unit for unit in units[entry[0]] if unit not in text] == []


def same(one: Any, other: Any) -> bool:
    """Whether two figures are equal, with arrays compared in 32-bit precision."""
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one.astype(np.float32), other.astype(np.float32), equal_nan=True))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return bool(one == other)


def test_all_figures_can_be_read_from_a_page() -> None:
    made = draw_figures(report_data(context(Trial().artefacts())))
    assert same(made, from_json(to_json(made)))
    assert same(made, read_figures(healthy()["report.html"].decode("utf-8")))


@pytest.mark.parametrize("page", ["", "<html>", '<script type="application/json" id="figure-data">{}</script>'])
def test_a_page_without_figures_is_an_error(page: str) -> None:
    with pytest.raises((ValueError, TypeError, KeyError)):
        read_figures(page)


def test_a_page_cannot_name_a_file_in_another_folder() -> None:
    page = healthy()["report.html"].decode("utf-8")
    with pytest.raises(ValueError, match="contains no figures"):
        read_figures(page.replace('"name":"states"', '"name":"../states"'))


def test_the_states_figure_shows_the_table_in_degrees_with_bands_and_gaps() -> None:
    trial = Trial(frames=400)  # short enough to be drawn without downsampling
    figure = shown("states", trial.artefacts() | {"states.parquet": trial.states(bridged=slice(100, 150))})
    angle, _, _, bridged = figure.panels
    knee = labelled(angle, "knee")
    assert knee.x == pytest.approx(trial.time) and knee.y == pytest.approx(np.degrees(trial.theta[:, 1]))
    band = items(angle, Band)[1]
    assert band.high - band.low == pytest.approx(2 * 1.96 * np.degrees(0.002))
    (gap,), (bars,) = items(angle, Spans), items(bridged, Bars)
    assert (gap.start, gap.end) == (pytest.approx([1.0]), pytest.approx([1.5]))
    assert (bars.row.tolist(), bars.low, bars.high) == ([2.0], pytest.approx([1.0]), pytest.approx([1.5]))
    assert all(panel.linked for panel in figure.panels) and bridged.rows == trial.joints


def test_states_without_standard_deviations_are_drawn_without_bands() -> None:
    """Methods for comparison give no standard deviations (NaN)."""
    trial = Trial(frames=400)
    artefacts, states = trial.artefacts(), trial.states()
    unknown = {name: np.full(400, np.nan) for name in states.names if name.startswith("sd_")}
    before, after = (
        draw_figures(report_data(context(artefacts | {"states.parquet": one}))).all
        for one in (states, states.with_columns(**unknown))
    )
    assert [one.name for one, other in zip(before, after, strict=True) if not same(one, other)] == ["states"]
    figure = next(one.figure for one in after if one.name == "states")
    assert isinstance(figure, Figure)
    assert all(np.isnan(band.low).all() for panel in figure.panels for band in items(panel, Band))


def test_the_wrench_figure_shows_the_table_the_model_band_and_the_fit_samples() -> None:
    trial = Trial(frames=400)
    table = trial.dynamics_table()
    for panel, name, spread in zip(
        shown("wrench", trial.artefacts()).panels, ("Fx", "Fy", "tauz", "cop_x"), (4.0, 8.0, 3.0, 0.004), strict=True
    ):
        for label, column in (("measured", name), ("identified model", f"{name}_model")):
            assert labelled(panel, label).y == pytest.approx(table[column])
        (band,), (fit,) = items(panel, Band), items(panel, Spans)
        assert band.high - table[f"{name}_model"] == pytest.approx(1.96 * spread)
        inside = np.zeros(400, dtype=bool)
        for start, end in zip(fit.start, fit.end, strict=True):
            inside |= (trial.time >= start) & (trial.time < end - 1e-9)
        assert (inside == table["in_fit"]).all()


def test_torques_are_shaded_where_an_unmeasured_support_carries_the_body() -> None:
    trial = Trial()
    artefacts = trial.artefacts()
    table = artefacts["dynamics.parquet"]
    assert isinstance(table, Table)
    contact = table["contact"]
    unknown = table.with_columns(tau_2=np.where(contact, np.nan, 20.0))
    figure = shown("torques", artefacts | {"dynamics.parquet": unknown})
    assert [items(panel, Line)[0].label for panel in figure.panels] == ["ankle", "knee", "hip"]
    for panel in figure.panels:
        (shade,) = items(panel, Spans)
        inside = np.zeros(len(trial.time), dtype=bool)
        for start, end in zip(shade.start, shade.end, strict=True):
            inside |= (trial.time >= start) & (trial.time < end - 1e-9)
        assert (inside == contact).all()


def test_phases_are_the_averages_over_the_repetitions() -> None:
    trial = Trial()
    table = trial.artefacts()["phases.parquet"]
    figure = shown("phases", trial.artefacts())
    own = (table["quantity"] == "Fy_model") & (table["span"] == "repetition")  # type: ignore[index]
    curve = labelled(figure.panels[1], "identified model")
    assert curve.y == pytest.approx(table["mean"][own]) and len(curve.x) == 101  # type: ignore[index]
    assert [item.label for item in items(figure.panels[-1], Line)] == [f"{name} torque" for name in trial.joints]


def test_parameters_are_shown_with_intervals_and_reference() -> None:
    figure = shown("parameters", Trial().artefacts())
    assert [panel.x for panel in figure.panels] == ["kg", "kg·m", "kg·m²"]
    points = labelled(figure.panels[0], "identified, 95 % interval")
    assert points.x == pytest.approx([71.2]) and points.half == pytest.approx([1.96 * 0.3])
    assert figure.panels[1].rows == ("mx2", "my2 + p3y*(m3+m4)")


def test_point_masses_are_at_the_grid_positions() -> None:
    trial = Trial()
    tree = trial.dynamics_tree()
    grid = tree.data["grid"]
    figure = shown("point_masses", trial.artefacts() | {"dynamics.h5": tree})
    for k, panel in enumerate(figure.panels):
        own = (grid["segment"] == k) & (grid["mass"] > 1e-3)
        (heat,) = items(panel, Heat)
        assert heat.value == pytest.approx(grid["mass"][own]) and heat.x == pytest.approx(grid["position"][own, 0])
    assert figure.scale is not None and figure.scale.high == grid["mass"].max()


def test_residuals_are_sorted_by_size_within_each_segment() -> None:
    trial = Trial()
    data = report_data(context(trial.artefacts()))
    found = data.residuals["shank5"]
    own = trial.markers().values["residual"][:, trial.labels.index("shank5")]
    assert found["rms"] == pytest.approx(np.sqrt(np.nanmean(own**2))) and found["q95"] == np.nanquantile(own, 0.95)
    assert (data.segment_of["shank5"], found["seen"]) == (1, pytest.approx(np.isfinite(own).mean()))
    (panel,) = shown("residuals", trial.artefacts()).panels
    (bars,) = items(panel, Bars)
    assert bars.high[panel.rows.index("shank5")] == pytest.approx(1e3 * found["rms"])
    assert (np.diff(bars.high.reshape(4, 4)) <= 0).all()


def test_the_skeleton_has_the_posture_of_the_chosen_instant() -> None:
    trial = Trial()
    figure = shown("skeleton", trial.artefacts())
    assert [panel.title for panel in figure.panels] == ["before the rise, 0.00 s", "standing, 3.00 s"]
    for panel, sample in zip(figure.panels, (0, 300), strict=True):
        dots = np.concatenate([np.column_stack([p.x, p.y]) for p in items(panel, Points) if p.symbol == "dot"])
        measured = (trial.predicted + trial.noise)[sample][trial.seen[sample]]
        assert dots[np.argsort(dots[:, 0])] == pytest.approx(measured[np.argsort(measured[:, 0])])
        assert len(items(panel, Line)) == 3 and panel.equal


@pytest.mark.parametrize("entry", FIGURES, ids=lambda entry: entry[0])
def test_a_missing_figure_is_explained_in_a_sentence(entry: FigureEntry) -> None:
    found = entry[1](report_data(context({})))
    assert isinstance(found, str) and found.startswith("No ") and found.endswith("was not computed.")


def test_seated_and_standing_come_from_the_events() -> None:
    trial = Trial()
    seated, standing = choose_moments(motion_of(trial), trial.events())
    assert trial.time[seated[1]] == 0.0 and trial.time[standing[1]] == 3.0


def test_without_events_the_extremes_of_the_motion_are_shown() -> None:
    trial = Trial()
    moments = choose_moments(motion_of(trial), trial.events(0))
    rise = trial.theta[[sample for _, sample in moments], 1]
    assert sorted(rise) == pytest.approx([trial.theta[:, 1].min(), trial.theta[:, 1].max()], abs=1e-6)


def test_a_chosen_instant_has_no_bridged_angle() -> None:
    trial = Trial()
    motion = JointStates.from_table(trial.states(bridged=slice(0, 200)))
    for events in (trial.events(), None):
        assert all(motion.observed[sample].all() for _, sample in choose_moments(motion, events))


def test_a_motionless_recording_has_one_posture() -> None:
    trial = Trial()
    still = {f"theta_{k}": np.full(trial.frames, 0.3) for k in (1, 2, 3)}
    assert len(choose_moments(JointStates.from_table(trial.states(bridged=slice(0)).with_columns(**still)), None)) == 1


def test_repetitions_are_drawn_over_normalised_time() -> None:
    trial = Trial()
    motion = JointStates.from_table(trial.states(bridged=slice(0)))
    curves = normalise_time(motion, np.array([[0.0, 6.0], [6.0, 12.0]]))
    assert curves.shape == (2, 101, 3)
    assert curves[0] == pytest.approx(curves[1], abs=1e-4)
    assert curves[0, 50] == pytest.approx(trial.theta[300], abs=1e-6)
    each, mean = items(shown("repetitions", trial.artefacts()).panels[1], Line)
    assert np.isnan(each.y).sum() == 3 and len(each.y) == 3 * 102  # three repetitions, interrupted after each
    assert mean.y == pytest.approx(np.nanmean(each.y.reshape(3, 102)[:, :101], axis=0))


def test_bridged_samples_leave_a_gap_in_the_repetition() -> None:
    curves = normalise_time(motion_of(Trial()), np.array([[0.0, 6.0]]))
    assert np.isnan(curves[0, 72, 2]) and np.isfinite(curves[0, 72, :2]).all()


def test_known_reference_parameters_are_regrouped_to_base_parameters() -> None:
    tree = Trial().dynamics_tree()
    regrouping = np.zeros((4, 16))
    regrouping[0, [0, 1, 2]] = 1.0
    regrouping[1, [2, 3]] = 1.0  # the fourth has no reference
    data = dict(tree.data) | {"base": dict(tree.data["base"]) | {"regrouping": regrouping}}
    reference = IdentifiedDynamics(type(tree)(tree.schema, data)).base_reference
    assert reference[0] == pytest.approx(0.5 + 1.5 + 2.5) and np.isnan(reference[1])


def test_control_characters_and_long_labels() -> None:
    assert style.clean("R\x1bKNE\n") == "R\ufffdKNE\ufffd"
    assert style.clean("abcdef", 4) == "abc…" and style.clean("abcd", 4) == "abcd"


def test_marker_positions_are_read_at_existing_frames() -> None:
    trial = Trial(frames=200)
    table = trial.planar()
    found = read_positions(table, np.array([0.0, 0.5, 0.505]), ["torso12", "nobody", trial.labels[5]])
    frame, column = round(0.5 * RATE), trial.labels.index("torso12")
    own = [table.values["x"][frame, column], table.values["y"][frame, column]]
    assert found[1, 0] == pytest.approx(own, nan_ok=True)
    assert np.isnan(found[:, 1]).all() and np.isnan(found[2]).all()


def test_in_the_previous_segment_markers_move_on_arcs_about_the_joint() -> None:
    """The distance of every drawn marker from its joint is constant to within the marker noise."""
    trial = Trial(frames=600)
    figure = shown("recovery", trial.artefacts())
    for j, panel in enumerate(figure.lines[0]):
        assert panel.title == f"{trial.joints[j]} in frame of {trial.names[j]}"
        (line,) = items(panel, Line)
        drawn = np.column_stack([line.x, line.y])
        arcs = np.split(drawn, np.flatnonzero(np.isnan(drawn).all(axis=1)))
        spread = [np.nanstd(np.linalg.norm(arc - trial.centres[j], axis=1)) for arc in arcs if len(arc) > 50]
        assert spread and max(spread) < 0.004
