"""Reports as a browser shows them: nothing fetched, no complaint, nothing cut off, and a player that plays."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from chromium import DESKTOP, OVERFLOWING, PHONE, chromium, complaints, requests, resize
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from mocap_id.config import load
from mocap_id.recording.writing import write_c3d
from mocap_id.runner import run
from mocap_id.workflows.simulate import Options, generate
from mocap_id.workflows.study import run as run_study

pytestmark = pytest.mark.external
ROOT = Path(__file__).resolve().parents[2]
SHORT = Options(seed=21, repetitions=2, analog_rate=100, occlusions=0)
TRIALS = ("good", "doubtful", "refused", "robot")
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
    """A browser, and the pages to look at by name."""

    browser: webdriver.Chrome
    files: dict[str, Path]

    def open(self, name: str, size: tuple[int, int] = DESKTOP) -> webdriver.Chrome:
        """Show a page and wait until its player, if it has one, is drawn."""
        resize(self.browser, size)
        complaints(self.browser), requests(self.browser)
        self.browser.get(self.files[name].as_uri())
        if self.browser.find_elements(By.ID, "player-body"):
            WebDriverWait(self.browser, 20).until(
                lambda browser: browser.find_element(By.ID, "player-body").get_attribute("data-ready")
            )
        return self.browser


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pages]:
    folder = tmp_path_factory.mktemp("pages")
    with chromium(tmp_path_factory.mktemp("profile")) as browser:
        yield Pages(browser, made(folder))


def made(folder: Path) -> dict[str, Path]:
    """Reports of a good, a doubtful, a refused and a robot's trial, and a study's page over them."""
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
    told = {name: json.loads((where / "summary.json").read_text("utf-8")) for name, where in folders.items()}
    assert {name: one["verdict"]["level"] for name, one in told.items()} == LEVELS
    return {name: where / "report.html" for name, where in folders.items()} | {"cohort": study.page}


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("name", [*TRIALS, "cohort"])
def test_a_page_fetches_nothing_complains_of_nothing_and_fits(pages: Pages, name: str, size: tuple[int, int]) -> None:
    browser = pages.open(name, size)
    assert requests(browser) == [pages.files[name].as_uri()]
    assert complaints(browser) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(OVERFLOWING) == []
    assert browser.find_element(By.CSS_SELECTOR, ".verdict strong").is_displayed()
    drawings = browser.find_elements(By.CSS_SELECTOR, ".drawing svg")
    assert drawings
    for drawing in drawings:
        box = drawing.rect
        assert box["width"] > 250 and box["height"] > 60
        assert drawing.find_elements(By.CSS_SELECTOR, "path, use")


def look(browser: webdriver.Chrome, name: str) -> list[int]:
    """How many pixels of each canvas in a part of the player are inked, and where they lie on the whole."""
    script = """
      const found = [];
      const visit = (node) => { for (const one of node.querySelectorAll("*")) {
        if (one.shadowRoot) visit(one.shadowRoot);
        if (one.tagName === "CANVAS" && one.width > 50) found.push(one);
      } };
      visit(document.getElementById(arguments[0]));
      return found.flatMap((canvas) => {
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
        copy.drawImage(canvas, 0, 0);
        const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
        let inked = 0, where = 0;
        for (let k = 0; k < data.length; k += 4) {
          if (data[k + 3] > 0 && data[k] + data[k + 1] + data[k + 2] < 600) {
            inked += 1;
            where = (where + k * (data[k] + 1)) % 1e9;
          }
        }
        return [inked, where];
      });
    """
    found: list[int] = browser.execute_script(script, name)
    return found


def inked(found: Sequence[int]) -> int:
    return sum(found[::2])


def settled(browser: webdriver.Chrome, name: str) -> list[int]:
    """The canvases of a part once they no longer change."""
    before: list[int] = []
    for _ in range(50):
        time.sleep(0.1)
        now = look(browser, name)
        if now == before:
            return now
        before = now
    raise AssertionError("the player never comes to rest")


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("name", TRIALS)
def test_the_player_draws_and_what_it_draws_follows_the_slider(pages: Pages, name: str, size: tuple[int, int]) -> None:
    browser = pages.open(name, size)
    first = settled(browser, "player-figure")
    assert inked(first) > 300
    still = name == "refused"
    curves = [] if still else settled(browser, "player-curves")
    slider = browser.find_element(By.ID, "player-time")
    steps = min(25, int(slider.get_attribute("max") or 0))
    slider.send_keys(Keys.HOME, *[Keys.ARROW_RIGHT] * steps)
    shown = browser.find_element(By.ID, "player-now").text
    assert shown != "0.00 s" and slider.get_attribute("aria-valuetext") == shown.replace(" s", " seconds")
    assert steps > 10 and slider.get_attribute("value") == str(steps)
    if not still:
        assert settled(browser, "player-figure") != first
        assert inked(curves) > 1000 and settled(browser, "player-curves") != curves
    slider.send_keys(Keys.HOME)
    assert settled(browser, "player-figure") == first
    assert complaints(browser) == []


def test_the_player_plays_pauses_and_is_sought_by_a_click(pages: Pages) -> None:
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
    ActionChains(browser).move_to_element(browser.find_element(By.ID, "player-curves")).click().perform()
    WebDriverWait(browser, 10).until(lambda _: slider.get_attribute("value") != stopped)
    assert complaints(browser) == []


def test_everything_is_reached_without_a_mouse_and_the_headings_are_in_order(pages: Pages) -> None:
    for name in (*TRIALS, "cohort"):
        browser = pages.open(name)
        levels = [int(one.tag_name[1]) for one in browser.find_elements(By.CSS_SELECTOR, "h1, h2, h3, h4")]
        assert levels[0] == 1 and levels.count(1) == 1
        assert all(after <= before + 1 for before, after in itertools.pairwise(levels)), name
        for one in browser.find_elements(By.CSS_SELECTOR, "[role=img], [role=region]"):
            assert one.get_attribute("aria-label")
        for table in browser.find_elements(By.TAG_NAME, "table"):
            assert table.find_elements(By.CSS_SELECTOR, "th[scope]")


LIGHT, DARK = (27, 28, 31), (232, 232, 234)
"""The page's ink where it is light and where it is dark."""


def colours(browser: webdriver.Chrome, name: str) -> dict[tuple[int, int, int], int]:
    """Opaque pixels of the canvases in a part of the player by their colours."""
    script = """
      const found = {};
      const visit = (node) => { for (const one of node.querySelectorAll("*")) {
        if (one.shadowRoot) visit(one.shadowRoot);
        if (one.tagName !== "CANVAS" || !(one.width > 50)) continue;
        const copy = new OffscreenCanvas(one.width, one.height).getContext("2d", { willReadFrequently: true });
        copy.drawImage(one, 0, 0); // reading the canvas itself again and again makes the browser complain
        const { data } = copy.getImageData(0, 0, one.width, one.height);
        for (let k = 0; k < data.length; k += 4) {
          if (data[k + 3] === 255) { const own = data.slice(k, k + 3).join(); found[own] = (found[own] ?? 0) + 1; }
        }
      } };
      visit(document.getElementById(arguments[0]));
      return found;
    """
    found: dict[str, int] = browser.execute_script(script, name)
    return {(int(r), int(g), int(b)): many for own, many in found.items() for r, g, b in [own.split(",")]}


@pytest.mark.parametrize("name", ["good", "refused"])
def test_where_the_page_is_dark_so_is_the_player_even_if_that_changes(pages: Pages, name: str) -> None:
    browser = pages.open(name)
    body = browser.find_element(By.ID, "player-body")
    parts = ["player-figure", *(["player-curves"] if name == "good" else [])]
    slider = browser.find_element(By.ID, "player-time")
    slider.send_keys(Keys.HOME, *[Keys.ARROW_RIGHT] * 12)
    at = browser.find_element(By.ID, "player-now").text
    pictures = {}
    for dark in (False, True, False):
        resize(browser, DESKTOP, dark=dark)
        for part in parts:
            ink, other = (DARK, LIGHT) if dark else (LIGHT, DARK)
            WebDriverWait(browser, 20).until(lambda _, part=part, ink=ink: ink in colours(browser, part))
            seen = settled(browser, part) and colours(browser, part)
            assert seen.get(ink, 0) > 100 and other not in seen
            assert (255, 255, 255) not in seen, "the page shines through"
            assert pictures.setdefault((part, dark), seen) == seen, "as it was before"
        paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert paper == ("rgb(23, 24, 27)" if dark else "rgb(255, 255, 255)")
        assert body.value_of_css_property("background-color") == "rgba(0, 0, 0, 0)"
        assert body.value_of_css_property("color") == f"rgba{(*(DARK if dark else LIGHT), 1)}"
        assert browser.find_element(By.ID, "player-now").text == at
    assert complaints(browser) == []


def test_on_paper_there_are_figures_and_no_player(pages: Pages) -> None:
    browser = pages.open("good")
    resize(browser, DESKTOP, media="print")
    assert not browser.find_element(By.ID, "player").is_displayed()
    assert all(one.is_displayed() for one in browser.find_elements(By.CSS_SELECTOR, ".drawing svg"))
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})
    assert len(base64.b64decode(printed["data"])) > 50_000


def test_without_scripts_the_page_says_so_and_shows_the_rest(pages: Pages) -> None:
    browser = pages.browser
    resize(browser, DESKTOP)
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        browser.get(pages.files["good"].as_uri())
        seen = browser.execute_cdp_cmd("DOMSnapshot.captureSnapshot", {"computedStyles": []})
        laid_out = " ".join(seen["strings"][k] for k in seen["documents"][0]["layout"]["text"] if k >= 0)
        for words in ("needs a browser that runs JavaScript", "Joint states", "acceleration (deg/s²)", "CoP x (m)"):
            assert words in laid_out
        assert "Play" not in laid_out.split()
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
