"""Accuracy of reaches on simulated trials: volume, elevation and order of severities, by markers and by a depth camera.

Rows and limits are in docs/measured/reach.md; the table of the cohort is in docs/reach.md. It takes about five seconds
per trial and core; the cohort has 20 trials by markers and 20 by the camera.
"""

from __future__ import annotations

import itertools
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any, NamedTuple

import harness
import numpy as np
import pandas as pd
from harness import format_share, format_sizes

from mocap_id.config.study import load_study
from mocap_id.errors import MocapIdError
from mocap_id.reporting.grids import show
from mocap_id.workflows.study import run_study
from mocap_id_simulation import ArmOptions, ReachCohort, generate_arm, simulate_reach_cohort, write_arm
from mocap_id_simulation.arm_files import film_skeleton
from mocap_id_simulation.options import Preset

SEVERITIES = (0.0, 0.2, 0.4, 0.6, 0.8)
"""Of five trials in a row, which are a cohort."""
DIFFERENT = 0.1
"""Least relative difference of the true volumes / (arm length)³ of two people who can be told apart."""
THESIS = {"–": "0.374, 0.328, 0.234", "1": "0.358", "2": "0.270", "3": "0.178", "5": "0.0015"}
"""Volumes of table 7.1, m³, by Brooke score."""


class Row(NamedTuple):
    """A kind of recording with the limits that 80 % of the trials must keep."""

    preset: Preset
    camera: bool
    volume: float  # largest error, %
    elevation: float  # largest error of the range, °
    flagged: bool = False  # a trial beyond the limit is right if its verdict is not ok


ROWS: Mapping[str, Row] = {
    "markers, default": Row("default", camera=False, volume=10, elevation=3),
    "markers, hard": Row("hard", camera=False, volume=15, elevation=3),
    "depth camera, default": Row("default", camera=True, volume=20, elevation=8),
    "depth camera, hard": Row("hard", camera=True, volume=30, elevation=8, flagged=True),
}


@dataclass(frozen=True)
class Outcome:
    codes: tuple[str, ...]
    level: str
    seconds: float  # of the processor
    true_size: float = nan  # volume / (arm length)³
    size: float = nan  # the same as found
    error: float = nan  # of the volume, %
    inside: bool = False  # the interval of the volume includes the truth
    elevation: float = nan  # error of the range, °
    covered: bool = False  # the interval of the range includes the truth


def measure(task: tuple[str, int, int]) -> Outcome:
    """Simulate and run a trial of a row, and compare it with its truth."""
    name, first, k = task
    row, severity = ROWS[name], SEVERITIES[k % len(SEVERITIES)]
    options = ArmOptions(seed=first + k, preset=row.preset, severity=severity, cycles=1 if row.preset == "hard" else 2)
    with harness.temporary_folder() as place:
        configuration = write_arm(place / "trial", options)
        if row.camera:
            skeleton, _ = film_skeleton(generate_arm(options), options)
            configuration.with_name("skeleton.csv").write_bytes(skeleton)
            text = configuration.read_text("utf-8")
            text = text.replace("recording: trial.c3d", "recording: {skeleton: skeleton.csv}")
            configuration.write_text(text, "utf-8")
        started = time.process_time()
        try:
            done = harness.run_trial(configuration)
        except MocapIdError as error:
            return Outcome((type(error).__name__,), level="failed", seconds=time.process_time() - started)
        return compare(done, time.process_time() - started)


def compare(done: harness.Run, seconds: float) -> Outcome:
    truth, found, verdict = done.truth, done.summary["workspace"] or {}, done.summary["verdict"]
    low, high = found.get("interval_m3") or (nan, nan)
    elevation = (found.get("ranges") or {}).get("shoulder_elevation") or {"range_deg": nan, "interval_deg": (nan, nan)}
    first, last = elevation["interval_deg"]
    true_range = np.degrees(np.ptp(truth["ranges_rad"]["elevation"]))
    true_volume, arm = truth["reach"]["volume_m3"], sum(truth["subject"]["segment_lengths_m"].values())
    volume = nan if found.get("volume_m3") is None else found["volume_m3"]
    return Outcome(
        codes=tuple(each["code"] for each in verdict["reasons"]),
        level=verdict["level"],
        seconds=seconds,
        true_size=true_volume / arm**3,
        size=volume / (found.get("arm_length_m") or nan) ** 3,
        error=100 * (volume / true_volume - 1),
        inside=low <= true_volume <= high,
        elevation=elevation["range_deg"] - true_range,
        covered=bool(first <= true_range <= last),
    )


def make_table(name: str, outcomes: Sequence[Outcome], first: int) -> str:
    row = ROWS[name]
    errors = np.array([each.error for each in outcomes])
    known = np.isfinite(errors)
    far = ~(np.abs(errors) <= row.volume)
    flagged = np.array([each.level != "ok" for each in outcomes])
    elevation = np.array([each.elevation for each in outcomes])
    head = (
        f"**{name}**, {len(outcomes)} trials, seeds from {first}: {int(known.sum())} with a volume, "
        f"{int(flagged.sum())} not `ok`, {int((far & ~flagged).sum())} beyond the limit and `ok`; "
        f"bias of the volume {np.mean(errors[known]):+.1f} %. "
        f"Codes: {harness.count_codes(code for each in outcomes for code in each.codes)}."
    )
    size = len(SEVERITIES)
    cohorts = [outcomes[start : start + size] for start in range(0, len(outcomes) - size + 1, size)]
    # only cohorts whose true volumes are in order count, and neighbours whose true volumes differ clearly
    true = [one for one in cohorts if np.all(np.diff([each.true_size for each in one]) < 0)]
    right = sum(bool(np.all(np.diff([each.size for each in one]) < 0)) for one in true)
    pairs = [pair for one in cohorts for pair in itertools.pairwise(one)]
    clear = [(more, less) for more, less in pairs if more.true_size > (1 + DIFFERENT) * less.true_size]
    ordered = f"{sum(more.size > less.size for more, less in clear)} of {len(clear)}"
    kept = format_share(~far | flagged if row.flagged else ~far)
    inside = format_share([each.inside for each in outcomes if np.isfinite(each.error)])
    covered = format_share([each.covered for each in outcomes if np.isfinite(each.elevation)])
    elevated = format_share(np.abs(elevation) <= row.elevation)
    seconds = format_sizes([each.seconds for each in outcomes], 5, ".1f")
    rows = [
        [
            f"volume, %{', or not `ok`' * row.flagged}",
            f"{row.volume:g}",
            kept,
            *format_sizes(errors, np.inf, ".1f")[1:],
        ],
        ["inside the 95 % interval", "0.88–0.99", inside, "", ""],
        ["range of elevation, °", f"{row.elevation:g}", elevated, *format_sizes(elevation, np.inf, ".1f")[1:]],
        ["range of elevation inside its 95 % interval", "", covered, "", ""],
        ["five severities in order, if the true ones are", "all", f"{right} of {len(true)}", "", ""],
        [f"neighbours that differ by more than {100 * DIFFERENT:.0f} % in order", "all", ordered, "", ""],
        ["processor time, s", "5", *seconds],
    ]
    columns = ["quantity", "limit", "within it", "median", "80 %"]
    return head + "\n\n" + harness.format_table(columns, rows, numbers_from=1)


def measure_cohort(jobs: int) -> str:
    """Return table 7.1 of the cohort that `mocap-id simulate reach-cohort` makes, by markers and by a depth camera.

    It has a row for every person: score, volumes in the thesis, in truth, by markers and by the camera.
    """

    def format_with_interval(row: Any, name: str) -> str:
        return f"{show(row[name])} ({show(row[f'{name}_low'])} … {show(row[f'{name}_high'])})"

    people, about, true = [], [], {}
    with harness.temporary_folder() as place:
        for name, skeletons in (("markers", False), ("camera", True)):
            file = simulate_reach_cohort(place / name, ReachCohort(skeletons=skeletons))
            folder = run_study(file, jobs).study.folder
            people.append(pd.read_parquet(folder / "people.parquet"))
            row = pd.read_parquet(folder / "correlation.parquet").iloc[0]
            spearman = format_with_interval(row, "spearman")
            about.append(f"by {name} {spearman}, p = {show(row['p'], 2)}, {row['people']} people")
            true = defaultdict(list)
            for trial in load_study(file).trials:
                truth = harness.read_truth(file.parent / "truth" / trial.name / "truth.json")
                true[trial.subject].append(truth["reach"]["volume_m3"])
    rows = []
    for k, subject in enumerate(people[0]["subject"]):
        score = "–" if np.isnan(people[0]["score"][k]) else f"{people[0]['score'][k]:g}"
        found = [format_with_interval(frame.iloc[k], name) for name in ("volume", "visited") for frame in people]
        rows.append([subject, score, THESIS[score], show(np.mean(true[subject])), *found])
    head = ["person", "score", "thesis", "truth", "markers", "camera", "visited, markers", "visited, camera"]
    table = harness.format_table(head, rows, numbers_from=1)
    return f"{table}\n\nSpearman's correlation with the score: {'; '.join(about)}."


def main() -> None:
    only, sections = [*ROWS, "cohort"], {}
    given = harness.make_parser(__doc__, parallel=True, only=only, trials=20, first=310_000).parse_args()
    if given.only != ["cohort"]:
        sections["reach"] = harness.measure_rows("reach", ROWS, given, measure, make_table)
    if "cohort" in given.only:
        sections["reach-cohort"] = measure_cohort(given.jobs)
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
