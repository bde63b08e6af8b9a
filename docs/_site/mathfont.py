"""The font of the equations, a part of STIX Two Math: few systems have a font for it, so the site brings one.

It comes with ziamath (SIL Open Font License) and is cut down to letters, Greek, operators and their larger forms.
"""

from __future__ import annotations

from importlib.metadata import files
from pathlib import Path
from typing import Any

from fontTools import subset

NAME = "_site/stix-two-math.woff"
KEPT = (
    (0x0020, 0x007E),  # ASCII
    (0x00A0, 0x00FF),
    (0x0300, 0x036F),  # accents
    (0x0391, 0x03F5),  # Greek
    (0x2010, 0x2044),  # dashes, dots, primes
    (0x20D0, 0x20DC),
    (0x2102, 0x2124),
    (0x2190, 0x2199),  # arrows
    (0x2200, 0x22FF),  # operators
    (0x2308, 0x230B),
    (0x239B, 0x23B3),  # pieces of brackets
    (0x1D434, 0x1D467),  # italic letters, which an <mi> of one letter becomes
    (0x1D6A4, 0x1D71B),  # italic Greek
)


def on_post_build(config: Any) -> None:
    """Write it beside the style sheet that names it."""
    target = Path(config.site_dir, NAME)
    target.parent.mkdir(parents=True, exist_ok=True)
    options = subset.Options(flavor="woff", layout_features=["ssty", "dtls"], name_IDs=[0, 1, 2, 13, 14], hinting=False)
    (source,) = (file for file in files("ziamath") or () if file.name == "STIXTwoMath-Regular.ttf")
    font = subset.load_font(str(source.locate()), options)
    cut = subset.Subsetter(options)
    cut.populate(unicodes=[code for first, last in KEPT for code in range(first, last + 1)])
    cut.subset(font)
    subset.save_font(font, str(target), options)
