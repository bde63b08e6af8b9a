"""Trials as laboratories record them: conventional marker sets, bad markers, rests, wrong scales, coloured noise.

Every case is simulated with exact truth and run up to ``report``. A trial is *right* if no error exceeds the limits
below. It is *said* if an error exceeds its limit and the verdict is not ``ok``, and *silent* otherwise. It takes about
four seconds per trial and core.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import dynamic_sweep
import harness
import numpy as np

from mocap_id.arrays import FloatArray
from mocap_id.errors import MocapIdError
from mocap_id_simulation import Options, PersonOptions
from mocap_id_simulation.options import FaultOptions

LENGTH = 0.05  # relative error
ANGLE = np.radians(2)  # rms about its mean
ACCELERATION = 0.97  # r²
CENTRE_OF_PRESSURE = 10.0  # mm rms
PARAMETER = 0.15  # relative error of a known parameter
LEVER = 0.05  # m: the first moment of the base is at least as large as this times the mass
TORQUE = 5.0  # N·m rms
INTERVAL = 2.0  # widths of a stated 95 % interval
STAGES = (*harness.DYNAMIC, "report")
INVISIBLE = {"camera scale + 2 %": "interval of length"}
"""Errors that a recording shows in some trials only, and that docs/measured/faults.md describes."""
AT_JOINTS = {"ANK": (0, 1), "KNE": (1, 2)}
"""Markers at a joint may be on either of its segments."""


def _add_faults(**faults: float) -> Options:
    return replace(harness.SHORT, faults=FaultOptions(**faults))


def _choose_markers(name: Any, **options: Any) -> Options:
    return replace(harness.SHORT, marker_set=name, **options)


SETS: Mapping[str, Options] = {
    "clusters": harness.SHORT,
    "Plug-in-Gait": _choose_markers("plug-in-gait"),
    "Plug-in-Gait, no wands": _choose_markers("plug-in-gait-without-wands"),
    "Plug-in-Gait, left side only": _choose_markers("plug-in-gait", without="R*"),
    "Plug-in-Gait, knee marker on the shank": _choose_markers("plug-in-gait", knee_on_shank=True),
    "one marker at each joint": _choose_markers("joints"),
    "Plug-in-Gait, no knee marker": _choose_markers("plug-in-gait", without="KNE"),
    "Plug-in-Gait, no ankle marker": _choose_markers("plug-in-gait", without="ANK"),
}
FAULTS: Mapping[str, Options] = {
    "rest of 120 s before": replace(harness.SHORT, rest_before=120.0),
    "rest of 60 s standing, 60 s after": replace(harness.SHORT, rest_standing=60.0, rest_after=60.0),
    "frozen for 4 s": _add_faults(frozen_s=4),
    "frozen for 4 s, Plug-in-Gait": _choose_markers("plug-in-gait", faults=FaultOptions(frozen_s=4)),
    "ghost that walks": _add_faults(ghost_walks=1),
    "ghost that reflects": _add_faults(ghost_reflects=1),
    "reattached 60 mm away": _add_faults(reattached_mm=60),
    "two labels exchanged for 2 s": _add_faults(mislabelled_s=2),
    "rate 5 % too high": _add_faults(rate_error=0.05),
    "rate 20 % too high": _add_faults(rate_error=0.2),
    "all gains + 5 %": _add_faults(gain=0.05),
    "all gains − 50 %": _add_faults(gain=-0.5),
    "gain of Fz + 10 %": _add_faults(gain_fz=0.1),
    "gain of the moments + 5 %": _add_faults(gain_moments=0.05),
    "Fz + 30 N": _add_faults(offset_fz_N=30),
    "camera scale + 2 %": _add_faults(camera_scale=0.02),
    "cameras tilted by 1.5°": _add_faults(tilt_deg=1.5),
    "corners 40 mm off": _add_faults(corners_mm=40),
    "filtered at 6 Hz": _add_faults(filter_hz=6),
    "filtered at 3 Hz": _add_faults(filter_hz=3),
    "wander of 1 mm": _add_faults(wander_mm=1),
    "wobble of 2 mm at 4 Hz": _add_faults(wobble_mm=2),
    "30 % of the frames repeated": _add_faults(repeated_share=0.3),
    "heel lift of 30 mm": replace(harness.SHORT, people=PersonOptions(heel_lift_mm=30)),
    "foot slides by 20 mm": _add_faults(foot_slide_mm=20),
    "feet moved by up to 50 mm": _add_faults(foot_moves_mm=50),
    "turned by 10° at mid-trial": _add_faults(turn_deg=10),
    "plane leans by 7°": _add_faults(plane_tilt_deg=7),
}

CASES = {**SETS, **FAULTS}
KINDS = ("right", "said", "invisible", "silent")


@dataclass(frozen=True)
class Outcome:
    wrong: tuple[str, ...]  # quantities beyond the limits
    codes: tuple[str, ...]  # of the verdict, or of the refusal or error; empty if the verdict is ``ok``
    invisible: str = ""  # start of the names of quantities that no check can show in every trial

    @property
    def kind(self) -> str:
        """``right``, ``said``, ``invisible`` or ``silent``."""
        if not self.wrong:
            return "right"
        if self.codes:
            return "said"
        hidden = self.invisible and all(name.startswith(self.invisible) for name in self.wrong)
        return "invisible" if hidden else "silent"


def measure(task: tuple[str, int]) -> Outcome:
    """Simulate and run a trial of a case, and compare it with its truth."""
    case, seed = task
    with harness.temporary_folder() as place:
        try:
            done = harness.run_simulated(place / "trial", replace(CASES[case], seed=seed), STAGES)
        except MocapIdError as error:
            return Outcome(("no result",), (type(error).__name__,))
        summary_file = next(place.rglob("summary.json"), None)
        if summary_file is None:
            return Outcome(("no result",), ("refused",))
        summary = json.loads(summary_file.read_text("utf-8"))
        codes = tuple(reason["code"] for reason in summary["verdict"]["reasons"])
        if done is None:
            return Outcome(("no result",), codes or ("refused",))
        return Outcome(tuple(list_wrong_quantities(done)), codes, INVISIBLE.get(case, ""))


def list_wrong_quantities(run: harness.Run) -> Iterator[str]:
    """Yield the quantities of a finished trial that are beyond the limits."""
    truth, summary = run.truth, run.summary
    # the foot may be a segment on the ground; then it is segment 1, and the true numbers increase by one
    lifted = int(summary["segments"]["names"][0] == "ground")
    found = {label: k for label, k in summary["segments"]["assignment"].items() if k is not None}
    if summary["segments"]["count"] != harness.SEGMENTS + lifted or any(
        found.get(label, link) - lifted not in AT_JOINTS.get(label[1:], (link,))
        for label, link in truth["assignment"].items()
        if label in found and not (lifted and found[label] == 0)
    ):
        yield "segments"
        return
    for name in truth["lengths_scored"]:
        length, true = summary["lengths_m"][name], truth["segment_lengths_m"][name]
        if abs(length["value"] - true) > LENGTH * true:
            yield f"length {name}"
        elif abs(length["value"] - true) > INTERVAL * harness.QUANTILE * length["sd"]:
            yield f"interval of length {name}"
    done = dynamic_sweep.read_with_truth(run)
    if done is None:
        return

    def select_known(*series: FloatArray) -> FloatArray:
        """Return the samples at which all series have a value, one row for each series."""
        rows = np.stack(series)
        return np.asarray(rows[:, np.isfinite(rows).all(axis=0)])

    sign = np.sign(np.corrcoef(select_known(done.states["theta_1"], done.true["q"][:, 0]))[0, 1])
    for j, joint in enumerate(harness.JOINTS, 1):
        angle, true = select_known(done.states[f"theta_{j}"], sign * done.true["q"][:, j - 1])
        if np.std(angle - true) > ANGLE:
            yield f"angle of the {joint}"
        acceleration, true = select_known(done.states[f"ddtheta_{j}"], sign * done.true["qdd"][:, j - 1])
        if 1 - np.mean((acceleration - true) ** 2) / np.var(true) < ACCELERATION:
            yield f"acceleration of the {joint}"
    signs = np.array([sign, 1, sign, sign, sign, sign, sign])
    error = dynamic_sweep.stack_series(done.predicted) - signs * dynamic_sweep.stack_true_series(done.true)
    rms: FloatArray = harness.rms(error[done.off_seat]) * dynamic_sweep.SCALE
    limits = {"CoP": CENTRE_OF_PRESSURE} | dict.fromkeys(harness.JOINTS, TORQUE)
    for name, value in zip(dynamic_sweep.SERIES, rms, strict=True):
        if value > limits.get(name, np.inf):
            yield f"torque of the {name}" if name in harness.JOINTS else name
    if not sign > 0:  # the parameters of a mirrored plane are not compared
        return
    true_base = dynamic_sweep.compute_true_base(done)
    pairs = true_base[2:].reshape(-1, 3)[:, :2]  # (mx, my) of each moving segment, whose frame is a convention
    size = np.abs(true_base)
    size[1] = max(size[1], LEVER * true_base[0])  # as in dynamics.cautions.measure_sizes
    size[2:].reshape(-1, 3)[:, :2] = np.hypot(pairs[:, :1], pairs[:, 1:])
    for entry, true, scale in zip(summary["dynamics"]["base"], true_base, size, strict=True):
        off, interval = abs(entry["value"] - true), harness.QUANTILE * entry["sd"]
        if entry["verdict"] == "known" and off > PARAMETER * scale and off > interval:
            yield f"parameter {entry['name']}"
        elif off > INTERVAL * interval:
            yield f"interval of {entry['name']}"


def make_table(found: Mapping[str, Sequence[Outcome]]) -> str:
    rows = []
    for case, outcomes in found.items():
        kinds = Counter(outcome.kind for outcome in outcomes)
        codes = Counter(code for outcome in outcomes for code in set(outcome.codes))
        wrong = Counter(name for outcome in outcomes if outcome.kind == "silent" for name in outcome.wrong)
        texts = [", ".join(f"`{code}` {count}" for code, count in codes.most_common(4))]
        texts.append(", ".join(f"{name} {count}" for name, count in wrong.most_common(4)))
        rows.append([case, *(str(kinds[kind]) for kind in KINDS), *texts])
    return harness.format_table(["case", *KINDS, "verdict", "silently wrong"], rows)


def main() -> None:
    numbers = {"first": 995_000, "sets": 50, "trials": 10}
    given = harness.make_parser(__doc__, parallel=True, only=CASES, **numbers).parse_args()
    sections = {}
    for name, cases, trials in (("marker-sets", SETS, given.sets), ("faults", FAULTS, given.trials)):
        found = {}
        for case in (each for each in given.only if each in cases):
            tasks = [(case, given.first + k) for k in range(trials)]
            found[case] = harness.run_all(measure, tasks, given.jobs)
        text = harness.describe_source(__file__, f"{trials} trials a case, seeds from {given.first}")
        sections[name] = f"{text}\n\n{make_table(found)}"
    harness.publish(sections, write=given.write)


if __name__ == "__main__":
    main()
