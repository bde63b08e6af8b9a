"""Reports in a browser load nothing, cause no warnings, cut nothing off, and have a working player."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from chromium import DESKTOP, OVERFLOWING, PHONE, chromium, complaints, requests, resize
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from mocap_id.config import load
from mocap_id.recording.writer import write_c3d
from mocap_id.reporting.figure import Drawing, Drawings, Figure, Key, Line, Panel, Points, Text
from mocap_id.reporting.page import embed, make_environment, read_figures
from mocap_id.runner import run
from mocap_id.workflows.sensitivity.perturbations import SensitivityOptions
from mocap_id.workflows.sensitivity.study import study_sensitivity
from mocap_id.workflows.study import run_study
from mocap_id.workflows.study.robots import validate_robot
from mocap_id_simulation import Options, RobotSet, generate, simulate_robot_set

pytestmark = [pytest.mark.external, pytest.mark.slow]
ROOT = Path(__file__).resolve().parents[2]
SHORT = Options(seed=21, repetitions=2, analog_rate=100, occlusions=0)
TRIALS = ("good", "doubtful", "refused", "robot")
OVER = ("cohort", "sensitivity", "validation")
LEVELS = {"good": "ok", "doubtful": "caution", "refused": "refused", "robot": "ok"}
STUDY = """\
study: several
defaults: {protocol: sit-to-stand}
subjects:
  s01: {height: 1.7}
  s02: {height: 1.8}
trials:
  - {trial: good, subject: s01, strategy: normal, recording: normal.c3d}
  - {trial: doubtful, subject: s02, strategy: dynamic, recording: no-plate.c3d}
  - {trial: refused, subject: s02, strategy: normal, recording: still.c3d}
  - {trial: failed, subject: s02, strategy: normal, recording: gone.c3d}
"""


@dataclass(frozen=True)
class Pages:
    """A browser, and the pages to open by name."""

    browser: webdriver.Chrome
    files: dict[str, Path]

    def open(self, name: str, size: tuple[int, int] = DESKTOP) -> webdriver.Chrome:
        """Open a page and wait until its figures and its player, if any, are drawn."""
        resize(self.browser, size)
        complaints(self.browser), requests(self.browser)
        self.browser.get(self.files[name].as_uri())
        waiting = ".chart:not([data-ready]), #player-body:not([data-ready])"
        WebDriverWait(self.browser, 30).until(lambda browser: not browser.find_elements(By.CSS_SELECTOR, waiting))
        return self.browser


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pages]:
    folder = tmp_path_factory.mktemp("pages")
    with chromium(tmp_path_factory.mktemp("profile")) as browser:
        yield Pages(browser, made(folder))


def made(folder: Path) -> dict[str, Path]:
    """Reports of a good, an uncertain, a refused and a robot trial, and pages of several trials."""
    scene = generate("sit-to-stand", SHORT)
    labels = list(scene.scene.markers.labels)
    write_c3d(folder / "normal.c3d", labels, scene.points, SHORT.rate, plates=(scene.signals,))
    write_c3d(folder / "no-plate.c3d", labels, scene.points, SHORT.rate)
    write_c3d(folder / "still.c3d", labels, scene.points[:60] * 0 + scene.points[:1], SHORT.rate)
    (folder / "study.yaml").write_text(STUDY, "utf-8")
    study = run_study(folder / "study.yaml")
    for file in ("trial.yaml", "trial.c3d", "encoder.csv"):
        shutil.copy(ROOT / "sample_trials" / "robot-joint" / file, folder / file)
    robot = load(folder / "trial.yaml")
    run(robot)
    folders = {name: study.study.out / name for name in TRIALS} | {"robot": robot.out}
    summaries = {name: json.loads((where / "summary.json").read_text("utf-8")) for name, where in folders.items()}
    assert {name: one["verdict"]["level"] for name, one in summaries.items()} == LEVELS
    options = SensitivityOptions().only(["wrench-bias"])
    sensitivity_study, *_ = study_sensitivity(folder / "trial.yaml", options, jobs=1, out=folder / "sensitivity")
    robot_options = Options(seed=31, repetitions=2, rate=120.0, analog_rate=600.0)
    simulated = simulate_robot_set(folder / "robots", RobotSet(1, ("elbow",), ("fast",), (45.0,), robot_options))
    validation = validate_robot([simulated], folder / "validation").page
    over = {"cohort": study.page, "sensitivity": sensitivity_study / "sensitivity.html", "validation": validation}
    return {name: where / "report.html" for name, where in folders.items()} | over


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("name", [*TRIALS, *OVER])
def test_a_page_loads_nothing_has_no_warnings_and_fits(pages: Pages, name: str, size: tuple[int, int]) -> None:
    browser = pages.open(name, size)
    assert requests(browser) == [pages.files[name].as_uri()]
    assert complaints(browser) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(OVERFLOWING) == []
    held = read_figures(pages.files[name].read_text("utf-8"))
    charts = browser.find_elements(By.CSS_SELECTOR, ".chart")
    assert {one.get_attribute("data-figure") for one in charts} == {one.name for one in held.all if not one.missing}
    for chart in charts:
        figure = held[chart.get_attribute("data-figure") or ""].figure
        assert isinstance(figure, Figure)
        told = browser.execute_script(DRAWN, chart)
        assert [one["cut"] for one in told] == [[]] * len(figure.panels)
        for panel, drawn in zip(figure.panels, told, strict=True):
            assert drawn["wide"] > 180 and drawn["high"] > 40
            assert drawn["marks"] >= sum(not isinstance(item, Key) for item in panel.items) / 3, panel.title


DRAWN = """
const seen = (one) => one.getBoundingClientRect();
return [...arguments[0].querySelectorAll(".plot")].map((plot) => {
  const whole = seen(plot.querySelector("svg.main-svg"));
  const texts = [...plot.querySelectorAll(".xtick text, .ytick text, .xtitle, .ytitle")];
  const cut = (one) => one.left < whole.left - 1 || one.right > whole.right + 1 || one.bottom > whole.bottom + 2;
  return {
    wide: whole.width, high: whole.height,
    marks: plot.querySelectorAll(".scatterlayer path, .barlayer path, .shapelayer path, .scatterlayer text").length,
    cut: texts.filter((one) => seen(one).width && cut(seen(one))).map((one) => one.textContent),
  };
});
"""
"""Script that returns the size in pixels, the number of marks and the cut-off texts of each panel."""


def settled(browser: webdriver.Chrome, name: str) -> str:
    """Return the drawing of a part of the player once it no longer changes."""
    script = """
      const layers = document.getElementById(arguments[0]).querySelectorAll(".scatterlayer, .shapelayer");
      return [...layers].map((one) => one.outerHTML).join("");
    """
    before = ""
    for _ in range(50):
        now = str(browser.execute_script(script, name))
        if now and now == before:
            return now
        before = now
        time.sleep(0.1)
    raise AssertionError("the player does not stop changing")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("name", TRIALS)
def test_the_player_follows_the_slider(pages: Pages, name: str, size: tuple[int, int]) -> None:
    browser = pages.open(name, size)
    first = settled(browser, "player-figure")
    still = name == "refused"
    curves = "" if still else settled(browser, "player-curves")
    slider = browser.find_element(By.ID, "player-time")
    steps = min(25, int(slider.get_attribute("max") or 0))
    slider.send_keys(Keys.HOME, *[Keys.ARROW_RIGHT] * steps)
    shown = browser.find_element(By.ID, "player-now").text
    assert shown != "0.00 s" and slider.get_attribute("aria-valuetext") == shown.replace(" s", " seconds")
    assert steps > 10 and slider.get_attribute("value") == str(steps)
    if not still:
        assert settled(browser, "player-figure") != first
        assert settled(browser, "player-curves") != curves
    slider.send_keys(Keys.HOME)
    assert settled(browser, "player-figure") == first
    assert complaints(browser) == []


def test_the_player_plays_pauses_and_jumps_on_a_click(pages: Pages) -> None:
    browser = pages.open("good")
    slider, button = browser.find_element(By.ID, "player-time"), browser.find_element(By.ID, "player-play")
    button.click()
    assert button.text == "Pause"
    WebDriverWait(browser, 10).until(lambda _: int(slider.get_attribute("value") or 0) > 5)
    button.click()
    stopped = slider.get_attribute("value")
    assert button.text == "Play"
    time.sleep(0.3)
    assert slider.get_attribute("value") == stopped
    ActionChains(browser).move_to_element(
        browser.find_element(By.CSS_SELECTOR, "#player-curves .plot")
    ).click().perform()
    WebDriverWait(browser, 10).until(lambda _: slider.get_attribute("value") != stopped)
    assert complaints(browser) == []


def test_everything_works_without_a_mouse_and_headings_are_in_order(pages: Pages) -> None:
    for name in (*TRIALS, *OVER):
        browser = pages.open(name)
        levels = [int(one.tag_name[1]) for one in browser.find_elements(By.CSS_SELECTOR, "h1, h2, h3, h4")]
        assert levels[0] == 1 and levels.count(1) == 1
        assert all(after <= before + 1 for before, after in itertools.pairwise(levels)), name
        for one in browser.find_elements(By.CSS_SELECTOR, "[role=img], [role=region]"):
            assert one.get_attribute("aria-label")
        for table in browser.find_elements(By.TAG_NAME, "table"):
            assert table.find_elements(By.CSS_SELECTOR, "th[scope]")


def test_zooming_one_curve_zooms_all_and_hovering_shows_values(pages: Pages) -> None:
    browser = pages.open("good")
    ranges = """
      const plots = [...document.querySelectorAll("[data-figure=wrench] .plot")];
      return plots.map((plot) => plot.layout.xaxis.range.map((end) => Math.round(1000 * end) / 1000));
    """
    whole = browser.execute_script(ranges)
    plot = browser.find_element(By.CSS_SELECTOR, "[data-figure=wrench] .plot")
    browser.execute_script("arguments[0].scrollIntoView({ block: 'center' })", plot)
    ActionChains(browser).move_to_element_with_offset(plot, -100, 0).click_and_hold().move_by_offset(
        200, 0
    ).release().perform()
    WebDriverWait(browser, 10).until(lambda _: browser.execute_script(ranges)[-1] != whole[-1])
    zoomed = browser.execute_script(ranges)
    assert len(zoomed) == 4 and zoomed == [zoomed[0]] * 4
    assert whole[0][0] < zoomed[0][0] < zoomed[0][1] < whole[0][1]
    ActionChains(browser).move_to_element(plot).perform()
    hovered = (By.CSS_SELECTOR, "[data-figure=wrench] .hoverlayer text")
    WebDriverWait(browser, 10).until(lambda _: any("identified" in one.text for one in browser.find_elements(*hovered)))

    def reset(_: webdriver.Chrome) -> bool:  # again if a busy computer took two clicks for single ones
        ActionChains(browser).double_click(plot).perform()
        return bool(browser.execute_script(ranges) == whole)

    WebDriverWait(browser, 10).until(reset)
    assert complaints(browser) == []


HOSTILE = '<img src=x onerror="alert(1)"><b>%{x}</b> &lt;a href="javascript:alert(2)">'
PAGE = """{% from "parts.html.j2" import chart, scripts %}<!DOCTYPE html><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{{ held.policy | safe }}"><h1>x</h1>
{{ chart(drawing) }}{{ scripts(held) }}"""


def test_names_from_files_are_shown_as_text(pages: Pages, tmp_path: Path) -> None:
    two = np.arange(2.0)
    items = (Line(two, two, "#1b1c1f", HOSTILE), Points(two, two, "#1b1c1f", HOSTILE, names=(HOSTILE, HOSTILE)))
    panels = (Panel((*items, Text(0, 0, HOSTILE)), HOSTILE, HOSTILE, HOSTILE), Panel(items, rows=(HOSTILE, "b")))
    drawing = Drawing("one", HOSTILE, HOSTILE, Figure((panels[:1], panels[1:])))
    page = make_environment().from_string(PAGE).render(drawing=drawing, held=embed(Drawings("of", (drawing,))))
    (tmp_path / "page.html").write_text(page, "utf-8")
    browser = Pages(pages.browser, {"hostile": tmp_path / "page.html"}).open("hostile")
    ActionChains(browser).move_to_element(browser.find_element(By.CSS_SELECTOR, ".plot")).perform()
    assert complaints(browser) == [] and requests(browser) == [(tmp_path / "page.html").as_uri()]
    assert not browser.find_elements(By.CSS_SELECTOR, ".chart img, .chart b, .chart a:not(.modebar-btn)")
    shown = browser.execute_script("return document.querySelector('.chart').textContent")
    assert shown.count("onerror") >= 6


def test_a_legend_entry_hides_and_shows_its_curves(pages: Pages) -> None:
    browser = pages.open("good")
    count = "return document.querySelectorAll('[data-figure=wrench] .scatterlayer .trace').length"
    before = browser.execute_script(count)
    key = browser.find_element(By.XPATH, "//*[@data-figure='wrench']//button[contains(., 'measured')]")
    for pressed, fewer in (("false", 4), ("true", 0)):
        key.send_keys(Keys.ENTER)
        assert key.get_attribute("aria-pressed") == pressed
        WebDriverWait(browser, 10).until(lambda _, fewer=fewer: browser.execute_script(count) == before - fewer)


LIGHT, DARK = "rgb(27, 28, 31)", "rgb(232, 232, 234)"
"""The text colour of the page in light and dark mode."""
COLOURS = """
const found = new Set();
for (const one of document.querySelectorAll(".plot svg *")) {
  const style = getComputedStyle(one);
  if (one.closest("defs, .modebar")) continue;
  if (["path", "text", "rect"].includes(one.tagName)) found.add(style.fill).add(style.stroke);
}
return [...found];
"""


@pytest.mark.parametrize("name", ["good", "refused", *OVER])
def test_figures_follow_the_dark_mode_of_the_page(pages: Pages, name: str) -> None:
    browser = pages.open(name)
    for dark in (False, True, False):
        resize(browser, DESKTOP, dark=dark)
        ink, other = (DARK, LIGHT) if dark else (LIGHT, DARK)
        seen = set(browser.execute_script(COLOURS))
        assert ink in seen and other not in seen
        assert not dark or not {"rgb(211, 212, 216)", "rgb(0, 114, 178)", "rgb(136, 34, 85)"} & seen
        paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert paper == ("rgb(23, 24, 27)" if dark else "rgb(255, 255, 255)")
    assert complaints(browser) == []


def test_the_printed_page_has_figures_and_no_player(pages: Pages) -> None:
    browser = pages.open("good")
    resize(browser, DESKTOP, media="print")
    assert not browser.find_element(By.ID, "player").is_displayed()
    plots = browser.find_elements(By.CSS_SELECTOR, ".chart .plot svg.main-svg")
    assert len(plots) > 20 and all(one.is_displayed() for one in plots)
    width = 7.48 * 96  # pixels; A4 with margins of 1 cm
    assert (
        max(browser.execute_script("return arguments[0].map((one) => one.getBoundingClientRect().width)", plots))
        < width
    )
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    assert len(base64.b64decode(printed["data"])) > 50_000


def test_without_scripts_the_page_shows_everything_else(pages: Pages) -> None:
    browser = pages.browser
    resize(browser, DESKTOP)
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get(pages.files["good"].as_uri())
        laid_out = ""
        for _ in range(50):  # without scripts there is no event when the layout is complete
            seen = browser.execute_cdp_cmd("DOMSnapshot.captureSnapshot", {"computedStyles": []})
            laid_out = " ".join(seen["strings"][k] for k in seen["documents"][0]["layout"]["text"] if k >= 0)
            if laid_out:
                break
            time.sleep(0.1)
        for words in ("needs JavaScript", "Joint states.", "95 % confidence bands", "mocap-id figures"):
            assert words in laid_out
        assert "Play" not in laid_out.split()
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
