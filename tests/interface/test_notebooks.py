"""The notebooks of docs/notebooks run from the first to the last cell, in one folder, and their results are right."""

from __future__ import annotations

import ast
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "docs" / "notebooks"
ORDER = ("first-trial", "own-analysis", "simulated-truth", "a-study")
"""The second and the third use the run of the first."""


def cells(name: str, kind: str) -> list[str]:
    content = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    return ["".join(cell["source"]) for cell in content["cells"] if cell["cell_type"] == kind]


def shown(value: Any) -> str:
    """Return what a notebook shows of a value."""
    html = value._repr_html_() if hasattr(value, "_repr_html_") else None
    return html or repr(value)


def execute(name: str) -> tuple[dict[str, Any], list[str]]:
    """Execute the code cells as a notebook does; return its variables and what the last lines of the cells show."""
    space: dict[str, Any] = {"__name__": "__main__"}
    seen = []
    for number, text in enumerate(cells(name, "code"), 1):
        tree = ast.parse(text)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        where = f"{name}.ipynb, code cell {number}"
        exec(compile(tree, where, "exec", dont_inherit=True), space)
        if isinstance(last, ast.Expr):
            seen.append(shown(eval(compile(ast.Expression(last.value), where, "eval", dont_inherit=True), space)))
    return space, seen


def exact_work(truth: Path, events: Any) -> list[float]:
    """Return the work of each joint in each repetition from the true torques and velocities, J."""
    exact = np.load(truth)
    rises = [(exact["t"] >= one.seat_off) & (exact["t"] <= one.stand) for one in events.itertuples()]
    power = exact["tau"] * exact["qd"]
    return [float(np.trapezoid(power[rise, joint], exact["t"][rise])) for rise in rises for joint in range(3)]


@pytest.fixture
def executed(
    once: Callable[[str, Callable[[Path], Any]], Any], monkeypatch: pytest.MonkeyPatch
) -> dict[str, dict[str, Any]]:
    """What the notebooks show and find; plain values, since processes share them."""
    monkeypatch.setenv("MPLBACKEND", "Agg")

    def make(folder: Path) -> dict[str, dict[str, Any]]:
        monkeypatch.chdir(folder)
        found: dict[str, dict[str, Any]] = {}
        for name in ORDER:
            space, seen = execute(name)
            kept = {key: space[key] for key in ("work", "numbers", "states_table", "torques", "rises") if key in space}
            found[name] = {"seen": seen, "files": sorted(path.name for path in folder.rglob("*.*")), **kept}
            if name == "own-analysis":
                found[name]["exact"] = exact_work(folder / "first" / "truth.npz", space["run"].events)
        return found

    found: dict[str, dict[str, Any]] = once("notebooks", make)
    return found


def test_every_notebook_is_executed() -> None:
    assert sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")) == sorted(ORDER)


@pytest.mark.parametrize("name", ORDER)
def test_it_is_stored_without_results(name: str) -> None:
    content = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    assert [cell for cell in content["cells"] if cell.get("outputs") or cell.get("execution_count")] == []
    assert [line for text in cells(name, "code") for line in text.splitlines() if re.match(r"\s*[%!?]", line)] == []


@pytest.mark.parametrize("name", ORDER)
def test_its_links_lead_to_pages(name: str) -> None:
    links = re.findall(r"\]\(([^)\s#]+)", "\n".join(cells(name, "markdown")))
    assert links
    assert [link for link in links if not (NOTEBOOKS / link).exists()] == []


def test_the_first_trial_shows_verdict_player_and_figures(executed: dict[str, dict[str, Any]]) -> None:
    seen = executed["first-trial"]["seen"]
    assert sum("srcdoc=" in html for html in seen) == 2
    assert any("95 % interval" in html for html in seen)
    assert {"trial.c3d", "report.html", "wrench.pdf"} <= set(executed["first-trial"]["files"])


def test_the_work_of_the_joints_is_right(executed: dict[str, dict[str, Any]]) -> None:
    work, exact = executed["own-analysis"]["work"], executed["own-analysis"]["exact"]
    assert len(work) == len(exact) == 6
    assert (np.abs(work["work (J)"] - exact) < 1.96 * work["sd at most (J)"]).all()
    assert work.groupby("joint")["work (J)"].mean().idxmax() == 2  # as the text says


def test_the_truth_is_found(executed: dict[str, dict[str, Any]]) -> None:
    found = executed["simulated-truth"]
    assert found["numbers"]["z"].abs().max() < 4
    assert found["states_table"]["angle error (°)"].max() < 0.5
    assert (found["torques"]["rms error (N·m)"] < 0.03 * found["torques"]["largest torque (N·m)"].max()).all()


def test_the_study_has_every_rise(executed: dict[str, dict[str, Any]]) -> None:
    rises = executed["a-study"]["rises"]
    assert rises.groupby("trial").size().tolist() == [2, 2, 2, 2]
    assert np.isfinite(rises["rise"]).all()
    assert sum("srcdoc=" in html for html in executed["a-study"]["seen"]) == 2


@pytest.mark.slow
@pytest.mark.external
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ORDER)
def test_it_runs_in_jupyter(name: str, tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="needs `pip install nbclient ipykernel`")
    nbformat = pytest.importorskip("nbformat", reason="needs `pip install nbclient ipykernel`")
    pytest.importorskip("ipykernel", reason="needs `pip install nbclient ipykernel`")
    shutil.copy(NOTEBOOKS / f"{name}.ipynb", tmp_path)
    notebook = nbformat.read(tmp_path / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    done = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs]
    assert [output for output in outputs if output.output_type == "error"] == []
    assert any("text/html" in output.get("data", {}) for output in outputs)
