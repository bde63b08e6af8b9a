"""Searching for garbage is put off, and taken up again whatever happens."""

from __future__ import annotations

import gc

import pytest
from matplotlib.figure import Figure
from reporting_cases import Trial, context

from mocap_id.reporting.collection import put_off
from mocap_id.reporting.contents import FIGURES
from mocap_id.reporting.figures import render
from mocap_id.stages.report import STAGE
from mocap_id.stages.report.function import material


def test_it_is_as_it_was_even_after_a_failure() -> None:
    assert gc.isenabled()
    with pytest.raises(ValueError, match="drawn"), put_off():
        assert not gc.isenabled()
        raise ValueError("drawn")
    assert gc.isenabled()


def test_whoever_had_put_it_off_keeps_it_so() -> None:
    gc.disable()
    try:
        with put_off():
            assert not gc.isenabled()
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_a_report_is_searched_once_a_figure_and_among_the_young_alone() -> None:
    searches: list[int] = []
    given = context(Trial(frames=400).artefacts())
    gc.callbacks.append(lambda phase, found: searches.append(found["generation"]) if phase == "start" else None)
    try:
        STAGE.function(given)
    finally:
        gc.callbacks.pop()
    assert gc.isenabled()
    assert len(FIGURES) <= len(searches) <= len(FIGURES) + 1, "one more when it is taken up again"
    assert set(searches[: len(FIGURES)]) == {0}


def test_a_figure_that_is_written_leaves_nothing() -> None:
    given = material(context(Trial(frames=400).artefacts()))
    with put_off():
        before = figures()
        for entry in FIGURES:
            render(entry, given)
        assert figures() == before


def figures() -> int:
    """How many there are, asked of their types: a weak reference whose object is gone cannot answer for itself."""
    return sum(issubclass(type(one), Figure) for one in gc.get_objects())
