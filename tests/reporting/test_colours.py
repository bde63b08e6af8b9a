"""Colours are distinguishable with any colour vision, on light and dark backgrounds."""

from __future__ import annotations

import itertools
import re
from importlib.resources import files

import numpy as np
import pytest

from mocap_id.reporting import style

# severe protan, deutan and tritan vision in linear RGB (Machado, Oliveira and Fernandes 2009)
VISION = {
    "usual": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
AT_A_GLANCE = 15.0
"""CIE 1976 colour difference; 2.3 is just noticeable."""
JOINTS = {f"joint {k}": style.pick_colour(k) for k in (1, 2, 3)}
FIGURE = {**JOINTS, "base": style.pick_colour(0), "measured": style.MEASURED, "model": style.MODEL}
CURVES = {**JOINTS, "measured": style.MEASURED, "model": style.MODEL, "reference": style.REFERENCE, "now": style.NOW}


def linear(colour: str) -> np.ndarray:
    share = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(light: np.ndarray) -> np.ndarray:
    relative = TO_XYZ @ np.clip(light, 0, 1) / WHITE
    x, y, z = np.where(relative > (6 / 29) ** 3, np.cbrt(relative), relative / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def on_page(*, dark: bool) -> dict[str, str]:
    """The CSS colour variables of the page by name."""
    text = files("mocap_id.reporting").joinpath("templates", "report.css").read_text("utf-8")
    blocks = re.findall(r":root \{([^}]*)\}", text)
    return dict(re.findall(r"(--\w+): (#\w{6})", blocks[1 if dark else 0]))


def shown(colour: str, *, dark: bool) -> str:
    return on_page(dark=dark)[style.ON_PAGE[colour]] if colour in style.ON_PAGE else colour


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("plot", [FIGURE, CURVES], ids=["figure", "curves"])
def test_colours_of_the_player_are_distinguishable(plot: dict[str, str], vision: str, dark: bool) -> None:
    seen = {name: lab(VISION[vision] @ linear(shown(colour, dark=dark))) for name, colour in plot.items()}
    near = {(a, b): float(np.linalg.norm(seen[a] - seen[b])) for a, b in itertools.combinations(seen, 2)}
    assert min(near.values()) > AT_A_GLANCE, min(near, key=near.__getitem__)


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_everything_contrasts_with_the_page(dark: bool) -> None:
    """WCAG contrast with the page is above 3 for lines, except for the established light colours."""
    paper = on_page(dark=dark)["--paper"]
    for name, colour in (FIGURE | CURVES).items():
        light, ground = sorted((TO_XYZ[1] @ linear(one) for one in (shown(colour, dark=dark), paper)), reverse=True)
        assert (light + 0.05) / (ground + 0.05) > (2.2 if name == "reference" else 3.0), name


def test_on_a_light_page_nothing_changes() -> None:
    assert {name: colour for colour, name in style.ON_PAGE.items()}.items() <= on_page(dark=False).items()


def test_the_page_replaces_every_colour_that_plotly_sets_on_elements() -> None:
    text = files("mocap_id.reporting").joinpath("templates", "report.css").read_text("utf-8")
    for colour, name in style.ON_PAGE.items():
        written = ", ".join(str(int(colour[k : k + 2], 16)) for k in (1, 3, 5))
        rule = f'.plot [style*="stroke: rgb({written})"] {{ stroke: var({name}) !important; }}'
        assert rule in text, name


def test_no_two_joints_up_to_the_sixth_look_alike() -> None:
    assert len({style.pick_colour(k) for k in range(7)}) == 7
    assert len({(style.pick_colour(k), style.pick_dash(k)) for k in range(1, 13)}) == 12
