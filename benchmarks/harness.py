"""Command lines, simulated trials, worker processes, Markdown tables and generated sections of pages.

Every benchmark prints its sections. ``--write`` also writes each of them into the pages that have a place for it::

    <!-- begin NAME -->

    <!-- end NAME -->

Everything outside these markers is the page's own text.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from mocap_id.arrays import FloatArray
from mocap_id.config import Trial, load
from mocap_id.runner import run_stage
from mocap_id.simulation import Kind, Options, simulate
from mocap_id.store import Folder, Table, Tree

ROOT = Path(__file__).resolve().parents[1]
JOINTS = ("ankle", "knee", "hip")
SEGMENTS = 4
KINEMATIC = ("planarise", "segment", "fit-joints", "ukf-smooth")
DYNAMIC = (*KINEMATIC, "identify-dim")
SHORT = Options(repetitions=2, analog_rate=100)
EXACT = "plate_gain_sd: 0, plate_moments_sd: 0, plate_position_sd_m: 0, camera_scale_sd: 0, camera_tilt_sd_deg: 0"
"""Settings of identify-dim for plate and cameras without errors of scale, as simulated: no interval includes any."""
QUANTILE = 1.96
"""Half the width of a 95 % interval, in standard deviations."""


@dataclass(frozen=True)
class Comparison:
    """A trial compared with its truth: codes of its cautions, errors, and shares of samples inside 95 % intervals."""

    codes: tuple[str, ...]
    errors: Mapping[str, float] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)


def command_line(description: str | None, *, parallel: bool = False, **defaults: int) -> argparse.ArgumentParser:
    """Return a parser with ``--write``, an integer option for each default and, if ``parallel``, ``--jobs``."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        text = "first seed" if name == "first" else f"number of {name.replace('_', ' ')}"
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} (default: {default})")
    if parallel:
        parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="worker processes")
    parser.add_argument("--write", action="store_true", help="write the sections into the pages of docs/")
    return parser


def recordings() -> Path | None:
    """Return the folder of the shared recordings, from MOCAP_ID_RECORDINGS."""
    folder = os.environ.get("MOCAP_ID_RECORDINGS")
    return Path(folder).resolve() if folder else None


def write_real_trial(recording: Path, file: Path, **keys: Any) -> Path:
    """Write the configuration of a sit-to-stand: ``recording`` without its endings ``.trc`` and ``_grf.mot``."""
    files = {"markers": f"{recording}.trc", "forces": f"{recording}_grf.mot"}
    text = json.dumps({"trial": file.stem, "recording": files, "protocol": "sit-to-stand", **keys})
    file.write_text(text, encoding="utf-8")
    return file


def run_all(function: Callable[[Any], Any], tasks: Iterable[Any], jobs: int | None) -> list[Any]:
    """Return the results of all tasks, computed by ``jobs`` processes."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each process would start as many threads as there are cores
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(function, tasks))


def progress(text: object) -> None:
    """Write a line to standard error."""
    sys.stderr.write(f"{text}\n")


def run_simulated(
    place: Path, options: Options, stages: Sequence[str] = KINEMATIC, kind: Kind = "sit-to-stand", settings: str = ""
) -> tuple[Trial, Path] | None:
    """Simulate a trial in ``place`` and run the stages; return it and its configuration, None if it was refused.

    ``settings`` are lines added to the configuration.
    """
    configuration = simulate(kind, place, options)
    if settings:
        configuration.write_text(f"{configuration.read_text('utf-8')}\n{settings}\n", "utf-8")
    trial = load(configuration)
    if any(run_stage(trial, name).refused is not None for name in stages):
        return None
    return trial, configuration


def read_truth(configuration: Path) -> dict[str, Any]:
    """Return ``truth.json`` of a simulated trial."""
    truth: dict[str, Any] = json.loads(configuration.with_name("truth.json").read_text())
    return truth


def read_summary(folder: Path) -> dict[str, Any]:
    """Return ``summary.json`` of a run folder."""
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text("utf-8"))
    return summary


def caution_codes(summary: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the codes of cautions and refusals."""
    return tuple(reason["code"] for reason in summary["verdict"]["reasons"] if reason.get("level") != "ok")


def read_true_arrays(configuration: Path, time: FloatArray, names: Sequence[str]) -> dict[str, FloatArray]:
    """Return arrays of ``truth.npz`` at these times, s."""
    with np.load(configuration.with_name("truth.npz")) as arrays:
        at = np.searchsorted(arrays["t"], time - 1e-6)
        return {name: arrays[name][at].astype(np.float64) for name in names}


def has_true_segments(states: Table) -> bool:
    """Return whether the states have the joints of a simulated person."""
    return f"theta_{SEGMENTS - 1}" in states.names and f"theta_{SEGMENTS}" not in states.names


def state_arrays(states: Table, prefix: str = "") -> FloatArray:
    """Return (F, n, 3) angles, velocities and accelerations, or with ``sd_`` their standard deviations."""
    orders = ("theta", "dtheta", "ddtheta")
    return np.stack([states.stack([f"{prefix}{s}_{j}" for j in range(1, SEGMENTS)]) for s in orders], axis=2)


def read_artefacts(folder: Folder, *names: str) -> list[Any]:
    """Return several artefacts of a run folder."""
    return [folder.read(name) for name in names]


def read_group(tree: Tree, name: str) -> dict[str, FloatArray]:
    """Return the arrays of one group of an HDF5 artefact."""
    node: Any = tree.data[name]
    return {key: np.asarray(value) for key, value in node.items()}


def rms(values: FloatArray) -> FloatArray:
    """Return the root mean square along the first axis, ignoring NaN."""
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))


def inside(error: FloatArray, sd: FloatArray) -> float:
    """Return the share of the known errors inside their 95 % intervals."""
    known = np.isfinite(error) & np.isfinite(sd)
    return float(np.mean(np.abs(error[known]) < QUANTILE * sd[known]))


def clopper_pearson(good: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    low = beta.ppf(0.025, good, trials - good + 1) if good else 0.0
    high = beta.ppf(0.975, good + 1, trials - good) if good < trials else 1.0
    return float(low), float(high)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers_from: int | None = None) -> str:
    """Return a table; columns from ``numbers_from`` on are aligned to the right."""
    aligned = len(head) if numbers_from is None else numbers_from
    rule = ["---"] * aligned + ["---:"] * (len(head) - aligned)
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, rule, *rows])


def pairs(values: FloatArray, form: str = ".2f", quantiles: tuple[float, float] = (0.5, 0.9)) -> list[str]:
    """Return "median / 90th percentile" of each column, ignoring NaN."""
    return [f"{a:{form}} / {b:{form}}" for a, b in np.nanquantile(values, quantiles, axis=0).T]


def share(kept: Any) -> str:
    """Return the share of true values, ignoring NaN; – without any."""
    known = np.asarray(kept, dtype=np.float64)
    known = known[np.isfinite(known)]
    return f"{100 * known.mean():.0f} %" if len(known) else "–"


def sizes(errors: Any, limit: float, form: str) -> list[str]:
    """Return the share within a limit, the median and the 80 % quantile of the sizes of known errors."""
    values = np.abs(np.asarray(errors, dtype=np.float64))
    values = values[np.isfinite(values)]
    quantiles = np.quantile(values, (0.5, 0.8)) if len(values) else (np.nan, np.nan)
    return [share(values <= limit), *(f"{value:{form}}" for value in quantiles)]


def count_codes(codes: Iterable[str]) -> str:
    """Return every code with its number."""
    return ", ".join(f"`{code}` {count}" for code, count in Counter(codes).most_common()) or "none"


def limit_table(limits: Mapping[str, float], trials: Sequence[Comparison]) -> str:
    """Return for each quantity the share of trials within the limit, the median and the 80 % quantile.

    The shares inside intervals follow, with their mean and their 10 % and 90 % quantiles. A missing error is infinite.
    """
    rows = []
    for quantity, limit in limits.items():
        values = np.array([each.errors.get(quantity, np.nan) for each in trials])
        values = np.where(np.isfinite(values), values, np.inf)
        share = f"{100 * np.mean(values <= limit):.0f} %" if len(values) else "–"
        method: Any = "linear" if np.isfinite(values).all() else "higher"
        quantiles = np.quantile(values, (0.5, 0.8), method=method) if len(values) else (np.nan, np.nan)
        shown = (f"{value:.2f}" if value >= 1 or value == 0 else f"{value:.2g}" for value in quantiles)
        rows.append([quantity, f"{limit:g}", share, *shown])
    for quantity in dict.fromkeys(name for each in trials for name in each.inside):
        values = np.array([each.inside[quantity] for each in trials if quantity in each.inside])
        low, high = np.quantile(values, (0.1, 0.9))
        rows.append([f"inside 95 %: {quantity}", "0.88–0.99", f"{np.mean(values):.3f}", f"{low:.3f}", f"{high:.3f}"])
    head = ["quantity", "limit", "within it", "median (10 %)", "80 % (90 %)"]
    return markdown(head, rows, numbers_from=1)


def measured_by(file: str, trials: str) -> str:
    """Return the sentence that names the benchmark and its trials."""
    return f"Measured by `benchmarks/{Path(file).name}` on {trials}."


def rows_on_page(name: str, rows: Mapping[str, str], order: Sequence[str], folder: Path = ROOT / "docs") -> str:
    """Return the rows of a section, each headed ``**row**, …``, in their order; those not measured as on the page."""
    texts = (page.read_text("utf-8") for page in folder.rglob("*.md"))
    pattern = re.compile(rf"<!-- begin {re.escape(name)} -->(.*?)<!-- end {re.escape(name)} -->", re.DOTALL)
    old = next((found[1] for text in texts if (found := pattern.search(text))), "")
    heads = [*re.finditer(r"^\*\*(.+?)\*\*, ", old, re.MULTILINE), None]
    kept = {
        head[1]: old[head.start() : None if after is None else after.start()].strip()
        for head, after in pairwise(heads)
        if head is not None
    }
    every = kept | dict(rows)
    return "\n\n".join(every[row] for row in order if row in every)


def publish(sections: Mapping[str, str], *, write: bool, folder: Path = ROOT / "docs") -> None:
    """Print the sections; with ``write`` also put them between their markers in the pages of a folder."""
    sys.stdout.write("\n\n".join(_section(name, text) for name, text in sections.items()) + "\n")
    if write:
        missing = set(sections) - {name for page in folder.rglob("*.md") for name in splice(page, sections)}
        if missing:
            raise SystemExit(f"no page has the markers of: {', '.join(sorted(missing))}")


def splice(page: Path, sections: Mapping[str, str]) -> list[str]:
    """Replace the sections that a page has markers for, and return their names."""
    old = page.read_text("utf-8")
    found = [name for name in sections if f"<!-- begin {name} -->" in old]
    new = old
    for name in found:
        pattern = re.compile(rf"<!-- begin {re.escape(name)} -->.*?<!-- end {re.escape(name)} -->", re.DOTALL)
        new = pattern.sub(lambda _, name=name: _section(name, sections[name]), new)  # type: ignore[misc]
    if new != old:
        page.write_text(new, "utf-8")
    return found


def _section(name: str, text: str) -> str:
    return f"<!-- begin {name} -->\n\n{text}\n\n<!-- end {name} -->"
