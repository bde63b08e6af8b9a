"""The page of a trial in space in a browser: it fits, loads nothing, and its skeleton turns."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from chromium import DESKTOP, OVERFLOWING, PHONE, chromium, complaints, requests, resize
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from mocap_id.stages.report import STAGE
from mocap_id.store import Document
from spatial_trial import SpatialTrial, context

pytestmark = [pytest.mark.external, pytest.mark.slow]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = STAGE.function(context(SpatialTrial(frames=600).artefacts(plates=True)))
    found = {one.file: one.content for one in made if isinstance(one, Document)}
    where = tmp_path_factory.mktemp("space") / "report.html"
    where.write_bytes(found["report.html"])
    return where


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    with chromium(tmp_path_factory.mktemp("profile")) as found:
        yield found


def opened(browser: webdriver.Chrome, file: Path, size: tuple[int, int]) -> webdriver.Chrome:
    """Open the page and wait until its figures and its player are drawn."""
    resize(browser, size)
    complaints(browser), requests(browser)
    browser.get(file.as_uri())
    waiting = ".chart:not([data-ready]), #player-body:not([data-ready])"
    WebDriverWait(browser, 30).until(lambda page: not page.find_elements(By.CSS_SELECTOR, waiting))
    return browser


def settled(browser: webdriver.Chrome) -> str:
    """Return the drawing of the skeleton once it no longer changes."""
    script = "return document.querySelector('#player-figure .scatterlayer').outerHTML"
    before = ""
    for _ in range(50):
        now = str(browser.execute_script(script))
        if now == before:
            return now
        before = now
        time.sleep(0.1)
    raise AssertionError("the skeleton does not stop changing")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_page_loads_nothing_has_no_warnings_and_fits(
    browser: webdriver.Chrome, file: Path, size: tuple[int, int]
) -> None:
    opened(browser, file, size)
    assert requests(browser) == [file.as_uri()] and complaints(browser) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(OVERFLOWING) == []


def test_sliders_and_mouse_turn_the_skeleton(browser: webdriver.Chrome, file: Path) -> None:
    opened(browser, file, DESKTOP)
    first, turn, tilt = settled(browser), *(browser.find_element(By.ID, f"player-{name}") for name in ("turn", "tilt"))
    turn.send_keys(*[Keys.ARROW_RIGHT] * 10)
    turned = settled(browser)
    assert turned != first and turn.get_attribute("value") == "40"
    tilt.send_keys(*[Keys.ARROW_LEFT] * 5)
    assert settled(browser) != turned and tilt.get_attribute("value") == "10"
    plot = browser.find_element(By.CSS_SELECTOR, "#player-figure .plot")
    ActionChains(browser).move_to_element(plot).click_and_hold().move_by_offset(60, 20).release().perform()
    settled(browser)
    assert int(turn.get_attribute("value") or 0) < 20 and int(tilt.get_attribute("value") or 0) > 12
    browser.execute_script("arguments[0].value = 30; arguments[1].value = 15;", turn, tilt)
    turn.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert settled(browser) == first, "the frame is still the same"
    slider = browser.find_element(By.ID, "player-time")
    slider.send_keys(*[Keys.ARROW_RIGHT] * 15)
    assert settled(browser) != first and complaints(browser) == []
