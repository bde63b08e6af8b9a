"""Headless Chromium that opens local files and records their requests."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
DESKTOP, PHONE = (1280, 900), (390, 844)
OVERFLOWING = """
const wide = document.documentElement.clientWidth;
const scrolls = (one) => one && one !== document.body
  && (["auto", "scroll", "hidden"].includes(getComputedStyle(one).overflowX) || scrolls(one.parentElement));
return [...document.querySelectorAll("main *, header *, footer")]
  .filter((one) => one.getClientRects().length && !scrolls(one.parentElement) && !one.closest("svg"))
  .filter((one) => one.getBoundingClientRect().right > wide + 1)
  .map((one) => `${one.tagName} ${one.id} ${one.className}`);
"""
"""Script that returns the elements outside the viewport that cannot be scrolled to."""


@contextmanager
def chromium(profile: Path) -> Iterator[webdriver.Chrome]:
    """Start a browser with a fresh profile, or skip the test if there is none."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    driver = shutil.which("chromedriver")
    if browser is None or driver is None:
        pytest.skip("no Chromium with its driver: install the packages chromium and chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    try:
        yield found
    finally:
        found.quit()


def resize(browser: webdriver.Chrome, size: tuple[int, int], *, media: str = "screen", dark: bool = False) -> None:
    """Set the viewport size in CSS pixels and the light or dark mode; a narrow viewport emulates a phone."""
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    wanted = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": wanted})


def complaints(browser: webdriver.Chrome) -> list[str]:
    """Return the new warnings and errors of the console."""
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] not in ("INFO", "DEBUG")]  # type: ignore[no-untyped-call]


def requests(browser: webdriver.Chrome) -> list[str]:
    """Return the addresses requested since the last call, except for embedded data and the browser's own first tab."""
    events: Iterator[dict[str, Any]] = (
        json.loads(entry["message"])["message"]
        for entry in browser.get_log("performance")  # type: ignore[no-untyped-call]
    )
    asked = [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]
    return [
        address for address in asked if not address.startswith(("data:", "blob:", "chrome://", "chrome-untrusted://"))
    ]
