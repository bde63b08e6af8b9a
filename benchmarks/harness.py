"""Command lines, simulated trials, worker processes, Markdown tables and generated sections of pages.

Every benchmark prints its sections. With ``--write`` it also writes each section into the pages that have its markers::

    <!-- begin NAME -->

    <!-- end NAME -->

The text outside these markers does not change.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.config import Trial, load
from mocap_id.runner import run, run_stage
from mocap_id.store import Folder, LongTable, Table, Tree
from mocap_id_simulation import Options, simulate

ROOT = Path(__file__).resolve().parents[1]
JOINTS = ("ankle", "knee", "hip")
SEGMENTS = 4
KINEMATIC = ("planarise", "segment", "fit-joints", "ukf-smooth")
DYNAMIC = (*KINEMATIC, "identify-dim")
SHORT = Options(repetitions=2, analog_rate=100)
HARD = replace(SHORT, soft_tissue=2, occlusions=2)
CLEAN = replace(SHORT, marker_noise=0, soft_tissue=0, occlusions=0)
EXACT = "plate_gain_sd: 0, plate_moments_sd: 0, plate_position_sd_m: 0, camera_scale_sd: 0, camera_tilt_sd_deg: 0"
"""Settings of identify-dim for plate and cameras without errors of scale, as simulated: no interval includes any."""
QUANTILE = 1.96
"""Half the width of a 95 % interval, in standard deviations."""
MOVING = 0.5
"""Speed of a movement, rad/s."""


@dataclass(frozen=True)
class Comparison:
    """A trial compared with its truth."""

    codes: tuple[str, ...]  # of its cautions
    errors: Mapping[str, float] = field(default_factory=dict)
    inside: Mapping[str, float] = field(default_factory=dict)  # shares of samples inside 95 % intervals


@dataclass(frozen=True)
class Run:
    """A simulated trial that ran, with its results and its truth."""

    configuration: Path
    trial: Trial

    @cached_property
    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = json.loads((self.trial.out / "summary.json").read_text("utf-8"))
        return summary

    @cached_property
    def truth(self) -> dict[str, Any]:
        return read_truth(self.configuration)

    @property
    def identified(self) -> bool:
        """Whether base parameters have values."""
        base = self.summary["dynamics"]["base"]
        return bool(base) and base[0]["value"] is not None

    def base(self, key: str) -> FloatArray:
        """Return ``value`` or ``sd`` of the base parameters (b,)."""
        return np.array([each[key] for each in self.summary["dynamics"]["base"]], dtype=np.float64)

    @property
    def true_base(self) -> FloatArray:
        return np.array(self.truth["base_parameters"]["values"])

    @property
    def codes(self) -> tuple[str, ...]:
        return tuple(each["code"] for each in self.summary["verdict"]["reasons"] if each.get("level") != "ok")

    def read(self, *names: str) -> list[Any]:
        folder = Folder(self.trial.out)
        return [folder.read(name) for name in names]

    def true(self, time: FloatArray, *names: str) -> list[FloatArray]:
        """Return arrays of ``truth.npz`` at sample times, s."""
        with np.load(self.configuration.with_name("truth.npz")) as arrays:
            at = np.searchsorted(arrays["t"], time - 1e-6)
            return [arrays[name][at].astype(np.float64) for name in names]

    def state_errors(self, states: Table) -> FloatArray:
        """Return the errors (F, n, 3) of angles, velocities and accelerations."""
        return stack_states(states) - np.stack(self.true(states["time"], "q", "qd", "qdd"), axis=2)


def make_parser(
    description: str | None, *, parallel: bool = False, only: Iterable[str] = (), **defaults: int
) -> argparse.ArgumentParser:
    """Return a parser with ``--write`` and an integer option for each default.

    ``parallel`` adds ``--jobs``; names in ``only`` are the choices of ``--only``, which has all of them by default.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        text = "first seed" if name == "first" else f"number of {name.replace('_', ' ')}"
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} (default: {default})")
    if parallel:
        parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="worker processes")
    if every := list(only):
        parser.add_argument("--only", nargs="*", default=every, choices=every, help="parts to measure (default: all)")
    parser.add_argument("--write", action="store_true", help="write the sections into the pages of docs/")
    return parser


def find_recordings() -> Path | None:
    """Return the folder of the shared recordings, from MOCAP_ID_RECORDINGS."""
    folder = os.environ.get("MOCAP_ID_RECORDINGS")
    return Path(folder).resolve() if folder else None


def real_recordings() -> Path:
    """Return the folder of the real sit-to-stands; end the program if MOCAP_ID_RECORDINGS does not name it."""
    folder = find_recordings()
    if folder is None:
        raise SystemExit("MOCAP_ID_RECORDINGS does not name the folder of the recordings")
    return folder / "sit-to-stand"


def write_real_trial(recording: Path, file: Path, **keys: Any) -> Path:
    """Write the configuration of a real sit-to-stand.

    The files of ``recording`` have this path and the endings ``.trc`` and ``_grf.mot``.
    """
    files = {"markers": f"{recording}.trc", "forces": f"{recording}_grf.mot"}
    text = json.dumps({"trial": file.stem, "recording": files, "protocol": "sit-to-stand", **keys})
    file.write_text(text, encoding="utf-8")
    return file


def run_all(function: Callable[[Any], Any], tasks: Iterable[Any], jobs: int | None) -> list[Any]:
    """Return the results of all tasks, computed by ``jobs`` processes."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each process would start as many threads as there are cores
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(function, tasks))


def report_progress(text: object) -> None:
    sys.stderr.write(f"{text}\n")


def measure_all(function: Callable[[Any], Any], tasks: Iterable[Any], jobs: int | None) -> list[Any]:
    return [result for result in run_all(function, tasks, jobs) if result is not None]


@contextmanager
def temporary_folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@contextmanager
def open_simulated(options: Options, stages: Sequence[str] = KINEMATIC) -> Iterator[Run | None]:
    """Simulate a sit-to-stand, run the stages and yield the trial; yield None if a stage refuses it."""
    with temporary_folder() as folder:
        yield run_simulated(folder / "trial", options, stages)


def run_simulated(place: Path, options: Options, stages: Sequence[str] = KINEMATIC, settings: str = "") -> Run | None:
    """Simulate a sit-to-stand in ``place`` and run the stages; return None if a stage refuses it.

    ``settings`` are lines added to the configuration.
    """
    configuration = simulate("sit-to-stand", place, options)
    if settings:
        configuration.write_text(f"{configuration.read_text('utf-8')}\n{settings}\n", "utf-8")
    trial = load(configuration)
    if any(run_stage(trial, name).refused is not None for name in stages):
        return None
    return Run(configuration, trial)


def run_trial(configuration: Path) -> Run:
    trial = load(configuration)
    run(trial)
    return Run(configuration, trial)


def read_truth(configuration: Path) -> dict[str, Any]:
    truth: dict[str, Any] = json.loads(configuration.with_name("truth.json").read_text("utf-8"))
    return truth


def hide_samples(planar: LongTable, hidden: BoolArray) -> LongTable:
    """Return the planar table without the hidden samples (F, M)."""
    values = {axis: np.where(hidden, np.nan, planar.values[axis]) for axis in "xyz"}
    return replace(planar, values={**values, "visible": planar.values["visible"] & ~hidden})


def choose_gap(speed: FloatArray, rate: float, seed: int, margins: tuple[float, float]) -> slice:
    """Return the frames of a gap of 2 s that begins 0.5 s before a random frame with movement.

    ``speed`` is in rad/s. No such frame is chosen within ``margins``, s, of the start and the end.
    """
    first, last = (round(margin * rate) for margin in margins)
    frames = np.flatnonzero(speed[first:-last] > MOVING) + first
    start = int(np.random.default_rng(seed).choice(frames)) - round(0.5 * rate)
    return slice(start, start + round(2 * rate))


def has_true_segments(states: Table) -> bool:
    """Return whether the states have as many joints as a simulated person."""
    return f"theta_{SEGMENTS - 1}" in states.names and f"theta_{SEGMENTS}" not in states.names


def stack_states(states: Table, prefix: str = "") -> FloatArray:
    """Return (F, n, 3) angles, velocities and accelerations, or with prefix ``sd_`` their standard deviations."""
    orders = ("theta", "dtheta", "ddtheta")
    return np.stack([states.stack([f"{prefix}{s}_{j}" for j in range(1, SEGMENTS)]) for s in orders], axis=2)


def read_group(tree: Tree, name: str) -> dict[str, FloatArray]:
    node: Any = tree.data[name]
    return {key: np.asarray(value) for key, value in node.items()}


def rms(values: FloatArray) -> FloatArray:
    """Return the root mean square along the first axis, ignoring NaN."""
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))


def compute_share_inside(error: FloatArray, sd: FloatArray) -> float:
    """Return the share of the errors inside their 95 % intervals; errors without a value do not count."""
    known = np.isfinite(error) & np.isfinite(sd)
    return float(np.mean(np.abs(error[known]) < QUANTILE * sd[known]))


def format_table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers_from: int | None = None) -> str:
    """Return a table; columns from ``numbers_from`` on are aligned to the right."""
    aligned = len(head) if numbers_from is None else numbers_from
    rule = ["---"] * aligned + ["---:"] * (len(head) - aligned)
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, rule, *rows])


def format_numbers(values: Iterable[float], form: str = ".2f") -> list[str]:
    return [f"{value:{form}}" for value in values]


def format_pairs(values: FloatArray, form: str = ".2f", quantiles: tuple[float, float] = (0.5, 0.9)) -> list[str]:
    """Return two quantiles, by default "median / 90th percentile", of each column, ignoring NaN."""
    return [f"{a:{form}} / {b:{form}}" for a, b in np.nanquantile(values, quantiles, axis=0).T]


def format_share(kept: Any) -> str:
    """Return the share of true values; NaN does not count; return – without values."""
    known = np.asarray(kept, dtype=np.float64)
    known = known[np.isfinite(known)]
    return f"{100 * known.mean():.0f} %" if len(known) else "–"


def format_sizes(errors: Any, limit: float, form: str) -> list[str]:
    """Return the share within a limit, the median and the 80 % quantile of absolute errors; NaN does not count."""
    values = np.abs(np.asarray(errors, dtype=np.float64))
    values = values[np.isfinite(values)]
    quantiles = np.quantile(values, (0.5, 0.8)) if len(values) else (np.nan, np.nan)
    return [format_share(values <= limit), *(f"{value:{form}}" for value in quantiles)]


def count_codes(codes: Iterable[str]) -> str:
    """Return every code with its number of occurrences."""
    return ", ".join(f"`{code}` {count}" for code, count in Counter(codes).most_common()) or "none"


def mark_coverage(share: float, text: str) -> str:
    """Return the text, in bold if the coverage of 95 % intervals, %, is outside the required range."""
    return text if 88 <= share <= 99 else f"**{text}**"


def make_limit_table(limits: Mapping[str, float], trials: Sequence[Comparison]) -> str:
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
    return format_table(head, rows, numbers_from=1)


def format_quantiles(values: FloatArray, form: str = ".2g") -> list[str]:
    """Return the median, the 90th percentile and the largest value."""
    return format_numbers(np.quantile(values, (0.5, 0.9, 1.0)), form)


def format_interval_of_share(good: int, trials: int, form: str = ".0f", unit: float = 100.0) -> str:
    """Return the 95 % interval of a share by Clopper and Pearson, by default in %."""
    low = beta.ppf(0.025, good, trials - good + 1) if good else 0.0
    high = beta.ppf(0.975, good + 1, trials - good) if good < trials else 1.0
    return f"{unit * low:{form}}–{unit * high:{form}}"


def format_share_with_interval(good: int, trials: int) -> list[str]:
    """Return the share of good trials and its 95 % interval, %."""
    return [f"{100 * good / trials:.0f} %", f"{format_interval_of_share(good, trials)} %"]


def describe_source(file: str, trials: str) -> str:
    return f"Measured by `benchmarks/{Path(file).name}` on {trials}."


def merge_rows_on_page(name: str, rows: Mapping[str, str], order: Sequence[str], folder: Path = ROOT / "docs") -> str:
    """Return the rows of a section in their order; each row begins with ``**row**, …``.

    Rows that were not measured are taken from the page.
    """
    texts = (page.read_text("utf-8") for page in folder.rglob("*.md"))
    old = next((found[1] for text in texts if (found := _pattern(name).search(text))), "")
    heads = [*re.finditer(r"^\*\*(.+?)\*\*, ", old, re.MULTILINE), None]
    kept = {
        head[1]: old[head.start() : None if after is None else after.start()].strip()
        for head, after in pairwise(heads)
        if head is not None
    }
    every = kept | dict(rows)
    return "\n\n".join(every[row] for row in order if row in every)


def measure_rows(
    name: str,
    rows: Iterable[str],
    given: argparse.Namespace,
    measure: Callable[[Any], Any],
    table: Callable[[str, Sequence[Any], int], str],
) -> str:
    """Return the tables of a section: the rows in ``--only`` are measured, the others stay as on the page.

    ``measure`` gets the name of the row, the first seed and the number of the trial; ``table`` gets the name of the
    row, all results and the first seed.
    """
    tables = {}
    for row in (each for each in given.only if each in rows):
        tasks = [(row, given.first, k) for k in range(given.trials)]
        tables[row] = table(row, run_all(measure, tasks, given.jobs), given.first)
        report_progress(tables[row])
    return merge_rows_on_page(name, tables, list(rows))


def publish(sections: Mapping[str, str], *, write: bool, folder: Path = ROOT / "docs") -> None:
    """Print the sections; with ``write`` also put them between their markers in the pages of a folder."""
    texts = {name: f"<!-- begin {name} -->\n\n{text}\n\n<!-- end {name} -->" for name, text in sections.items()}
    sys.stdout.write("\n\n".join(texts.values()) + "\n")
    missing = set(sections)
    for page in folder.rglob("*.md") if write else ():
        old = new = page.read_text("utf-8")
        for name in [name for name in sections if f"<!-- begin {name} -->" in old]:
            new = _pattern(name).sub(lambda _, name=name: texts[name], new)  # type: ignore[misc]
            missing.discard(name)
        if new != old:
            page.write_text(new, "utf-8")
    if write and missing:
        raise SystemExit(f"no page has the markers of: {', '.join(sorted(missing))}")


def _pattern(name: str) -> re.Pattern[str]:
    """Return the pattern of a section with its markers."""
    return re.compile(rf"<!-- begin {re.escape(name)} -->(.*?)<!-- end {re.escape(name)} -->", re.DOTALL)
