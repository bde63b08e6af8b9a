"""Searching for garbage is put off, and taken up again whatever happens."""

from __future__ import annotations

import gc

import pytest
from reporting_cases import Trial, context

from mocap_id.reporting.collection import put_off
from mocap_id.stages.report import STAGE


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


def test_a_report_is_drawn_without() -> None:
    searches: list[str] = []
    given = context(Trial(frames=400).artefacts())
    gc.callbacks.append(lambda phase, _: searches.append(phase))
    try:
        STAGE.function(given)
    finally:
        gc.callbacks.pop()
    assert gc.isenabled()
    assert len(searches) <= 2, "one when it is taken up again"
