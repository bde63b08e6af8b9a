"""cohort.html: well-formed, self-contained, every verdict in words, inert whatever stands in it."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest
from small_study import Ran
from study_cases import Made, body, landmarks

from mocap_id.reporting.study import CohortData
from mocap_id.reporting.study.sit_to_stand import render_cohort_page
from mocap_id.workflows.study.sit_to_stand import STUDY, TrialResult

HOSTILE = '"><script>alert(1)</script>$\\frac{'


class Parsed(HTMLParser):
    """Elements, references and text; fails on tags that do not match."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(content.decode("utf-8"))
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            assert not name.startswith("on"), "a script"
            self.references += [value or ""] if name in {"src", "href", "xlink:href"} else []
            self.ids += [value or ""] if name == "id" else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] == ["script"]:
            return
        self.text += " ".join(data.split()) + " "


def checked(content: bytes) -> Parsed:
    """The page, known to fetch nothing."""
    found = Parsed(content)
    assert not {"link", "iframe", "img", "form", "object"} & set(found.tags)
    assert len(found.ids) == len(set(found.ids))
    outside = [one for one in found.references if not one.startswith("#")]
    assert all(re.fullmatch(r"\.\./[\w.+-]+/report\.html", one) for one in outside), outside
    assert {one[1:] for one in found.references if one.startswith("#")} <= set(found.ids)
    assert b"default-src 'none'" in content
    return found


def page(trials: list[TrialResult]) -> bytes:
    """The page of a study with these trials."""
    entries = tuple(
        trial.entry(trial.name, f"{trial.subject}, {trial.strategy}", f"../{trial.name}/report.html")
        for trial in trials
    )
    return render_cohort_page(CohortData("a study", entries, STUDY.make_tables(trials)))


def test_the_page_of_a_study_that_ran(ran: Ran) -> None:
    found = checked(ran.outcome.page.read_bytes())
    assert found.tags.count("figure") == found.tags.count("details") == 3
    assert "2 of 5 trials have results" in found.text
    for words in ("s01-dynamic-1", "Good", "Refused", "Failed", "no such file", "thesis table 6.3", "mr2", "winter"):
        assert words in found.text, words
    assert {"../s01-normal-1/report.html", "../s01-refused/report.html"} <= set(found.references)
    assert "../s01-gone/report.html" not in found.references


def test_every_reason_is_explained_in_words() -> None:
    person = landmarks(0.4, 0.4)
    own = (body("own", 0.001, 0.002), body("winter", 0.01, 0.02))
    cases = [Made("a", bodies=own, person=person).case(), Made("b", failed="the C3D file: empty").case()]
    found = checked(page(cases))
    for words in ("Usable with care", "What to do.", "code parameters-weak", "The C3D file: empty."):
        assert words in found.text, words


def test_what_comes_from_files_is_only_text() -> None:
    made = Made("a", subject=HOSTILE, strategy=HOSTILE, bodies=(body("own", 0.0, 1.0),))
    broken = Made("b", failed=HOSTILE)
    content = page([made.case(), broken.case()])
    checked(content)
    assert content.count(b"<script") == 3 and b"<script>alert" not in content


@pytest.mark.parametrize("made", [Made("a", failed="gone"), Made("a", value=None, shank=None, thigh=None)])
def test_where_nothing_was_found_the_page_says_so(made: Made) -> None:
    found = checked(page([made.case()]))
    assert "No base parameters: nothing was identified on any trial." in found.text
    assert "No segment lengths" in found.text
    assert "No centre of pressure was predicted" in found.text
