"""``sensitivity.html``: one file that opens anywhere, with nothing to fetch."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from mocap_id.reporting import style
from mocap_id.reporting.embedding import embedded
from mocap_id.reporting.figure import Drawings
from mocap_id.reporting.numbers import UNKNOWN, show, show_fixed, show_with_sd
from mocap_id.reporting.page import environment
from mocap_id.reporting.sections import Glance
from mocap_id.reporting.sensitivity import tornado
from mocap_id.reporting.sensitivity.material import SensitivityMaterial
from mocap_id.reporting.tables import Grid, grid

_TRIED = ("perturbation", "worst of what is tolerated", "parameter", "new cautions", "condition", "r² Fx, Fy, tauz")
_MORE = ("CoP rms", "worst torque", "acceleration r²", "offset found")


def page(material: SensitivityMaterial) -> bytes:
    """The page as UTF-8."""
    figures = Drawings(style.printable(material.trial), (tornado.drawing(material),))
    html = (
        environment()
        .get_template("sensitivity.html.j2")
        .render(
            trial=style.printable(material.trial),
            product=material.product,
            note=style.printable(material.note),
            criterion=criterion(material.share),
            glance=_glance(material),
            sentences=[style.printable(sentence) for sentence in material.tables["tolerates"]["sentence"]],
            drawing=figures.all[0],
            embedded=embedded(figures),
            own=_own(material),
            tried=_tried(material),
        )
    )
    return html.encode("utf-8")


def criterion(share: float) -> str:
    """When a perturbation is tolerated, in words."""
    return (
        f"Tolerated is what moves no parameter by more than {show(100 * share, 2, '%')} of its size, or by its own "
        "stated standard deviation where that is more."
    )


def _glance(material: SensitivityMaterial) -> list[Glance]:
    tried = material.tables["perturbations"]
    beyond = tried[~tried["tolerated"]]
    silent = beyond[(beyond["raised"] == "") & ~beyond["verdict"].isin(("refused", "failed"))]
    return [
        Glance("perturbations", str(len(tried)), f"{tried['kind'].nunique()} kinds, seed {material.seed}"),
        Glance("tolerated", str(len(tried) - len(beyond)), "of them"),
        Glance("unnoticed", str(len(silent)), "too much, and no new caution"),
        Glance("unperturbed verdict", material.verdict, material.trial),
    ]


def _own(material: SensitivityMaterial) -> Grid:
    rows = [
        (
            entry.name,
            show_with_sd(entry.value, entry.sd, style.unit(entry.unit)),
            show(entry.size, 3, style.unit(entry.unit)),
            show(100 * entry.allowed(material.share), 2, "%"),
        )
        for entry in material.parameters
    ]
    return grid("The unperturbed parameters", ("parameter", "value", "size", "may move by"), rows)


def _tried(material: SensitivityMaterial) -> Grid:
    rows = list(_rows(material.tables["perturbations"]))
    return grid("Every perturbation", (*_TRIED, *_MORE), rows, text=(0, 2, 3))


def _rows(tried: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    torques = [name for name in tried.columns if name.startswith("tau_")]
    for _, row in tried.iterrows():
        fate = row["verdict"] if row["verdict"] in ("refused", "failed") else ""
        yield (
            row["perturbation"],
            "lost" if row["ratio"] == float("inf") else show(row["ratio"], 2),
            row["parameter"],
            row["raised"] or fate,
            show(row["condition_number"]),
            ", ".join(show_fixed(row[f"{name}_r2"], 4) for name in ("Fx", "Fy", "tauz")),
            show_fixed(1e3 * row["cop_rms"], 1, "mm"),
            show(row[torques].max(), 2, "N·m") if torques else UNKNOWN,
            show_fixed(row["ddtheta_r2"], 4),
            show_fixed(1e3 * row["clock_offset"], 2, "ms"),
        )
