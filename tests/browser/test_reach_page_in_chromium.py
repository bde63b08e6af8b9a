"""The view of what a wrist can reach turns in a browser, by mouse and keys."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from chromium import DESKTOP, chromium, complaints, resize
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from mocap_id.stages.identify_dim.events import find_reach_events
from mocap_id.stages.report import STAGE
from mocap_id.store import Document
from spatial_trial import SpatialTrial, context

pytestmark = [pytest.mark.external, pytest.mark.slow]
PLOT = '[data-figure="reach"] .plot'


def written(folder: Path) -> Path:
    artefacts = SpatialTrial(frames=1200).artefacts()
    trial = SimpleNamespace(subject=SimpleNamespace(height=1.7))
    source: Any = SimpleNamespace(table=artefacts.__getitem__, tree=artefacts.__getitem__, trial=trial)
    made = STAGE.function(context(artefacts | {"events.parquet": find_reach_events(source)}))
    page = next(one for one in made if isinstance(one, Document) and one.file == "report.html")
    (folder / page.file).write_bytes(page.content)
    return folder / page.file


def test_mouse_and_keys_turn_the_view(tmp_path: Path) -> None:
    with chromium(tmp_path / "profile") as browser:
        resize(browser, DESKTOP)
        complaints(browser)
        browser.get(written(tmp_path).as_uri())
        waiting = ".chart:not([data-ready]), #player-body:not([data-ready])"
        WebDriverWait(browser, 30).until(lambda page: not page.find_elements(By.CSS_SELECTOR, waiting))
        plot = browser.find_element(By.CSS_SELECTOR, PLOT)

        def drawn() -> str:
            time.sleep(0.5)
            script = f"return document.querySelector('{PLOT} .scatterlayer').outerHTML"
            return str(browser.execute_script(script))

        first = drawn()
        ActionChains(browser).move_to_element(plot).click_and_hold().move_by_offset(80, 20).release().perform()
        dragged = drawn()
        plot.send_keys(Keys.ARROW_LEFT)
        assert len({first, dragged, drawn()}) == 3
        assert complaints(browser) == []
