"""report.html is well-formed, self-contained, and safe for any labels in the recording."""

from __future__ import annotations

import base64
import hashlib
import re
import time
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from typing import get_args

import numpy as np
import pytest
from reporting_cases import LOST, Trial, contents, context, healthy

from mocap_id.errors import Refused
from mocap_id.kinematics.segmentation import Evidence
from mocap_id.reporting.grids import list_facts
from mocap_id.reporting.page import read_figures
from mocap_id.reporting.report import make_documents
from mocap_id.reporting.sections import AGAINST
from mocap_id.stages.report import STAGE, report_data
from mocap_id.store import Artefact, LongTable, Table, Tree
from mocap_id.verdict import Reason

VOID = {"meta", "link", "br", "hr", "img", "input"}
HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(2)>',
    "$\\frac{",
    "]]>&amp;",
    "R\x00\x1bKNEE",
    "右膝",
)
UNSURE = Reason("segments-unsure", "two hypotheses fit <b>alike</b>; say `segment: {count: 4}`", 0.41, 0.5)


class Page(HTMLParser):
    """Parsed page: elements, text, ids and references; fails on mismatched tags."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.handlers: list[str] = []
        self.text = ""
        self.scripts: list[str] = []
        self.source = content.decode("utf-8")
        self.feed(self.source)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._element(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._element(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ["script"]:
            self.text += data
        elif '<script type="application/json"' not in (self.get_starttag_text() or ""):
            self.scripts.append(data)

    def _element(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id" and value:
                self.ids.append(value)
            elif name in {"src", "href", "xlink:href", "action", "data", "srcset", "poster"}:
                self.references.append(value or "")
            elif name.startswith("on"):
                self.handlers.append(name)
            self.references += re.findall(r"url\(([^)]*)\)", value or "")

    @property
    def sections(self) -> list[str]:
        return re.findall(r'<section id="(\w+)"', self.source)


def digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode()


def report(artefacts: dict[str, Artefact], refused: Refused | None = None) -> dict[str, bytes]:
    return contents(STAGE.function(context(artefacts, refused)))


def checked(files: Mapping[str, bytes]) -> Page:
    """Parse the page and check that it is self-contained, well-formed and runs only our scripts."""
    page = Page(files["report.html"])
    assert not {"link", "iframe", "object", "embed", "img", "form"} & set(page.tags)
    assert not page.handlers
    allowed = re.search(r"script-src ([^;\"]*)", page.source)
    assert [f"'sha256-{digest(script)}'" for script in page.scripts] == (allowed[1].split() if allowed else [])
    assert len(page.ids) == len(set(page.ids)), "an id occurs twice"
    inside = {f"#{name}" for name in page.ids}
    assert set(page.references) <= inside, set(page.references) - inside
    assert "default-src 'none'" in page.source
    charts = re.findall(r'data-figure="(\w+)"', page.source)
    assert charts == [name for name in charts if not read_figures(page.source)[name].missing]
    return page


def relabelled(trial: Trial) -> dict[str, Artefact]:
    """The trial's artefacts with hostile labels on its first markers."""
    new = dict(zip(trial.labels, HOSTILE, strict=False))
    trial.labels = [new.get(label, label) for label in trial.labels]
    trial.names = ("<svg/onload=alert(3)>", *trial.names[1:])
    return trial.artefacts()


def test_healthy_trial_shows_everything() -> None:
    page = checked(healthy())
    assert page.sections == [
        "player",
        "skeleton",
        "states",
        "repetitions",
        "wrench",
        "torques",
        "motion",
        "parameters",
        "markers",
        "origin",
    ]
    assert page.tags.count("figure") == 10
    for wanted in (
        "Good",
        "m1+m2+m3+m4",
        "71.20 ± 0.30",
        "no seat-on was found",
        "27.000 ± 0.008",
        "STRAY",
        "trial.c3d",
        "female",
    ):
        assert wanted in page.text
    assert "somewhere" not in page.text, "folders are private"


def test_rejected_segmentations_and_evidence_against_the_chosen_one_are_shown() -> None:
    page = checked(healthy())
    start = page.text.index("Probability that the segments are right: 0.83")
    shown = [page.text.index(words, start) for words in (AGAINST["axis"], AGAINST["skipped"], "chosen", LOST)]
    assert shown == sorted(shown), "evidence, strongest first; then segmentations, lowest cost first"
    for absent in ("left-out", "first-joint", "base", "runner-up"):
        assert AGAINST[absent] not in page.text
    rows = re.findall(
        r"<tr><td[^>]*>(ankle|knee|hip)</td><td[^>]*>([\d.]+)</td><td[^>]*>([\d.]+)</td></tr>", page.source
    )
    assert rows == [("ankle", "0.90", "31.5"), ("knee", "0.75", "10.5"), ("hip", "0.70", "8.20")]


def test_segments_without_evidence_against_them_say_so() -> None:
    trial = Trial()
    table = trial.segments()
    facts = dict(table.facts) | {"against": dict.fromkeys(AGAINST, 0.0)}
    page = checked(report(trial.artefacts() | {"segments.parquet": replace(table, facts=facts)}))
    assert "none" in page.text[page.text.index("Probability that the segments are right") :]


def test_every_kind_of_evidence_has_a_text() -> None:
    assert set(AGAINST) == set(get_args(Evidence))


def test_matrices_are_left_out_of_tables() -> None:
    given = {"together": [["LANK", "RANK"]], "window_s": [0.0, 2.5], "covariance": [[1.0, 0.5], [0.5, 2.0]]}
    assert list_facts("Facts", given).rows == (("together", "LANK, RANK"), ("window (s)", "0.000, 2.500"))


def test_a_caution_is_at_the_top_with_what_to_do() -> None:
    trial = Trial()
    note = Reason("window-proposed", "used 2.0 to 31.5 s", level="ok")
    page = checked(report(trial.artefacts() | {"segments.parquet": trial.segments((UNSURE, note))}))
    assert page.text.index("Usable with care") < page.text.index("<b>alike</b>") < page.text.index("Joint states")
    assert "<code>segment: {count: 4}</code>" in page.source
    assert page.sections[-1] == "notes"
    assert page.text.index("Used 2.0 to 31.5 s.") > page.text.index("notes do not affect the verdict")


def test_refused_trial_is_a_short_page() -> None:
    trial = Trial()
    artefacts: dict[str, Artefact] = {"planar.parquet": trial.planar(), "wrench.parquet": trial.wrench()}
    page = checked(report(artefacts, Refused("no-motion", "no joint moves: all within 15 mm", 0.004, 0.015)))
    assert page.sections == ["player", "skeleton", "wrench", "origin"]
    for wanted in ("Refused", "No joint moves: all within 15 mm.", "What to do", "71.4 kg"):
        assert wanted in page.text


def test_a_trial_refused_before_any_artefact_has_a_page() -> None:
    page = checked(report({}, Refused("not-planar", "the motion is not planar", 0.4, 0.2)))
    assert page.sections == ["origin"] and "The motion is not planar." in page.text


def test_without_a_plate_sentences_replace_the_figures() -> None:
    page = checked(report(Trial().artefacts(plates=False)))
    for wanted in ("No ground reaction wrench", "No base parameters", "No point masses"):
        assert f"{wanted}: the recording has no force plate." in page.text
    assert page.tags.count("figure") == 5


def test_standing_still_shows_only_the_mass() -> None:
    trial = Trial()
    tree = trial.dynamics_tree()
    unknown = np.full(4, np.nan)
    base = dict(tree.data["base"]) | {"value": np.array([71.4, *unknown[1:]]), "sd": unknown}
    grid = dict(tree.data["grid"]) | {"mass": np.full_like(tree.data["grid"]["mass"], np.nan)}
    facts = dict.fromkeys(tree.facts) | {"why": "the body stands still"}
    standing = replace(tree, data=dict(tree.data) | {"base": base, "grid": grid}, facts=facts)
    page = checked(report(trial.artefacts() | {"dynamics.h5": standing}))
    assert "71.40" in page.text and "No point masses: the body stands still." in page.text


def test_the_exact_cone_has_a_sentence_instead_of_point_masses() -> None:
    trial = Trial()
    tree = trial.dynamics_tree()
    grid = dict(tree.data["grid"]) | {"mass": np.full_like(tree.data["grid"]["mass"], np.nan)}
    facts = dict(tree.facts) | {"consistency": "bounded-cone"}
    exact = replace(tree, data=dict(tree.data) | {"grid": grid}, facts=facts)
    page = checked(report(trial.artefacts() | {"dynamics.h5": exact}))
    assert "No point masses: the fit uses the exact cone of physically consistent bodies" in page.text
    assert "bounded-cone" in page.text


def test_the_reference_bodies_are_compared_with_the_model() -> None:
    page = checked(report(Trial().artefacts()))
    assert "Errors of the model and of allometric bodies" in page.text
    table = page.text.partition("Errors of the model and of allometric bodies")[2]
    assert "winter" in table and "de-leva" in table and "34.5" in table


def test_hostile_labels_are_shown_as_text() -> None:
    name = "<script>steal()</script>"
    files = contents(make_documents(replace(report_data(context(relabelled(Trial()))), trial=name)))
    page = checked(files)
    assert page.text.count(name) >= 2, "title and heading"
    for label in HOSTILE[:4]:
        assert label in page.text
    assert "右膝" in str(read_figures(page.source)["residuals"].figure)
    assert not re.search(r"[\x00-\x08\x0b-\x1f]", page.source)


@pytest.mark.parametrize("joints", [1, 4])
def test_short_and_long_chains(joints: int) -> None:
    page = checked(report(Trial(joints=joints).artefacts()))
    assert page.tags.count("figure") == 10


def test_a_trial_without_repetitions_says_so() -> None:
    trial = Trial()
    page = checked(report(trial.artefacts() | {"events.parquet": trial.events(0)}))
    assert "No repetitions to compare: none were found." in page.text
    assert "extreme posture" in page.source


def _emptied(table: Table | LongTable) -> Table | LongTable:
    """The table with all numbers unknown except time, frame and segment."""
    held = table.values if isinstance(table, LongTable) else table.columns
    unknown = {
        name: np.full_like(values, np.nan) if values.dtype == np.float64 and name != "time" else values
        for name, values in held.items()
    }
    return replace(table, values=unknown) if isinstance(table, LongTable) else replace(table, columns=unknown)


def _rowless(table: Table | LongTable) -> Table | LongTable:
    if isinstance(table, LongTable):
        none = {name: values[:0] for name, values in table.values.items()}
        return replace(table, frames=table.frames[:0], time=table.time[:0], values=none)
    return replace(table, columns={name: values[:0] for name, values in table.columns.items()})


def test_tables_without_numbers_or_rows_give_a_page() -> None:
    artefacts = Trial(frames=600).artefacts()
    emptied = {name: _emptied(one) for name, one in artefacts.items() if isinstance(one, Table | LongTable)}
    checked(report(artefacts | emptied))
    checked(report(artefacts | {name: _rowless(one) for name, one in emptied.items()}))


def test_two_frames_are_enough() -> None:
    """The test's velocities need at least two frames."""
    checked(report(Trial(frames=2).artefacts()))


@pytest.mark.slow
def test_a_recording_forty_times_as_long_is_no_larger_and_takes_less_than_five_times_as_long() -> None:
    long, short = Trial(frames=16_000, per_segment=12).artefacts(), Trial(frames=400, per_segment=12).artefacts()
    small = report(short)
    started = time.process_time()
    report(short)
    between = time.process_time()
    files = report(long)
    assert time.process_time() - between < 5 * (between - started)
    assert len(files["report.html"]) < min(8e6, len(small["report.html"]) + 4e6)


def test_left_out_repetitions_are_compared_with_fit_and_reference() -> None:
    page = checked(report(Trial().artefacts()))
    table = page.text.partition("Prediction errors on left-out repetitions")[2][:600]
    assert "880 samples, 3 fits for 3 repetitions" in table
    for part in ("models fitted without the repetition", "model of the whole trial", "allometric body", "6.10"):
        assert part in table
    trial = Trial()
    tree = trial.dynamics_tree()
    nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s"))
    facts = tree.facts | {"held_out": {"repetitions": 1, **nothing, "why": "only one repetition was found"}}
    page = checked(report(trial.artefacts() | {"dynamics.h5": replace(tree, facts=facts)}))
    assert "Prediction errors on left-out" not in page.text
    assert "only one repetition was found" in page.text


def rows(page: Page, caption: str) -> list[list[str]]:
    """Return the cells, row by row, of the table whose caption begins with ``caption``."""
    body = re.search(r"<tbody>(.*?)</tbody>", page.source[page.source.index(f">{caption}") :], flags=re.DOTALL)
    assert body
    found = re.findall(r"<tr>(.*?)</tr>", body[1], flags=re.DOTALL)
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in found]


def test_each_joint_names_both_its_segments() -> None:
    """The hip of a trunk in one piece is another joint than that of a pelvis; both are called hip."""
    joints = rows(checked(report(Trial().artefacts())), "Joint centres")
    names = ["foot", "shank", "thigh", "torso"]
    assert [[re.sub(r"<[^>]*>", "", cell) for cell in row[1:3]] for row in joints] == [list(p) for p in pairwise(names)]


def test_the_effect_of_pinned_joints_is_shown() -> None:
    page = checked(report(Trial().on_segments()))
    assert rows(page, "Pinned chain and measured poses: rms error on left-out repetitions, below 5 Hz") == [
        ["pinned chain", "10.0", "10.0", "10.0", "26.1", "−5.20"],
        ["measured poses", "5.00", "5.00", "5.00", "8.7", "7.10"],
    ]
    assert rows(page, "Gap between the two sides of each joint") == [
        ["ankle", "2.1", "0.731", "pinned"],
        ["knee", "12.5", "0.731", "free"],
        ["hip", "12.5", "0.731", "inside one body (trunk)"],
    ]
    facts = dict(rows(page, "Measured poses"))
    assert facts["bodies"] == "foot, shank, trunk, others"
    assert [facts[f"cut-off frequency for {axis} (Hz)"] for axis in ("x", "y", "angle")] == ["3.5", "6", "4"]
    assert facts["reason for these cut-off frequencies"] == "left-out repetitions are predicted best with these"
    for wanted in (
        "because the two sides of a joint separate",
        "on the same 654 samples, below 5 Hz",
        "2.0 times as large for Fx",
        "3.0 times as large for the centre of pressure",
        "The two clock offsets differ by 12.3 ms.",
    ):
        assert wanted in page.text


def test_measured_poses_show_band_intervals_and_prior() -> None:
    page = checked(report(Trial().on_segments()))
    held_out = rows(page, "Prediction errors on left-out repetitions, below 5 Hz")
    assert [row[0] for row in held_out] == [
        "models fitted without the repetition", "the same, unfiltered", "model of the whole trial", "allometric body",
        "samples within the 95 % interval (%)",
    ]  # fmt: skip
    assert held_out[1][1] == "0.800 ± 3.30"
    assert held_out[-1][1:] == ["93.6", "96.8", "95.4", "93.1"]
    assert [row[-1] for row in rows(page, "Base parameters;")] == ["1.6", "84.8", "18.2", "13.4"]
    captions = page.text.count(
        "The masses move with the measured poses, low-pass filtered (x 3.5 Hz, y 6 Hz, angle 4 Hz)."
    )
    assert captions == 4, "wrench, phases, torques, parameters"
    for wanted in (
        "The fit does not determine the torque of: hip.",
        "No point masses",
        "modelled forces use the measured poses",
    ):
        assert wanted in page.text


def test_point_mass_panels_have_the_names_of_the_bodies() -> None:
    trial = Trial()
    artefacts = trial.on_segments()
    tree = artefacts["dynamics.h5"]
    assert isinstance(tree, Tree)
    grid = dict(tree.data) | {"grid": trial.dynamics_tree().data["grid"]}
    files = report(artefacts | {"dynamics.h5": replace(tree, data=grid, facts=tree.facts | {"consistency": "grid"})})
    shown = read_figures(files["report.html"].decode("utf-8"))["point_masses"]
    assert not isinstance(shown.figure, str)
    titles = [panel.title.split(",")[0] for panel in shown.figure.panels]
    assert titles == ["foot", "shank", "trunk", "others"]
    assert "Each panel is a body of the fit" in shown.caption


def test_the_pinned_chain_is_explained_in_one_sentence_with_the_gaps() -> None:
    page = checked(healthy())
    gaps = ", ".join(f"{name} 0.6 mm and 0.012 m/s²" for name in ("ankle", "knee", "hip"))
    reason = "the gaps of all joints are within the noise"
    assert f"The masses move with the pinned chain, because {reason} (rms gaps: {gaps})." in page.text
    assert "share of prior" not in page.text and "Pinned chain and measured poses" not in page.text
    assert "Prediction errors on left-out repetitions, unfiltered" in page.text
    trial = Trial()
    tree = trial.dynamics_tree()
    asked = replace(tree, facts=tree.facts | {"motion": {"source": "chain", "why": "asked for"}})
    page = checked(report(trial.artefacts() | {"dynamics.h5": asked}))
    assert "The masses move with the pinned chain, because it is configured." in page.text


def test_a_missing_comparison_with_pins_is_explained() -> None:
    artefacts = Trial().on_segments()
    tree = artefacts["dynamics.h5"]
    pins = {"why": "only one repetition was found", "chain": None, "segments": None, "clock_offset_s": 0.0}
    page = checked(report(artefacts | {"dynamics.h5": replace(tree, facts=tree.facts | {"pins": pins})}))
    assert "The effect of pinned joints is unknown: only one repetition was found." in page.text
