"""The number of segments of all trials of a person in a study in the plane, chosen together.

Alone, every trial chooses the number that explains its own markers best. Two trials of a person may then differ, and so
do the meanings of their joints. The number used for both is the one with the smallest sum of the costs.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mocap_id.config import Trial
from mocap_id.config.study import StudyTrial
from mocap_id.errors import StoreError
from mocap_id.reporting.contents import SUMMARY_FILE
from mocap_id.stages import STAGES
from mocap_id.store import Folder, dumps, hash_bytes
from mocap_id.workflows.parallel import TrialRun

_STAGE = "segment"


@dataclass(frozen=True)
class Evidence:
    """What a trial alone says about the number of its segments."""

    count: int  # the number that it chose
    base: str  # name of its base; a trial in which the foot turns on the floor has another chain
    costs: Mapping[int, float]  # cost of the best segments, by their number; smaller is better
    inputs: str  # hash of everything from which this follows

    @classmethod
    def read(cls, trial: Trial) -> Evidence | None:
        """Return the evidence of a finished trial; None if it has no segments."""
        settings: Any = trial.settings[_STAGE]
        try:
            segments = json.loads((trial.out / SUMMARY_FILE).read_text("utf-8"))["segments"]
            inputs = hash_inputs(trial)
        except (OSError, ValueError, StoreError):
            return None
        if segments["count"] is None or not segments["names"]:
            return None
        count = int(segments["count"])
        costs: dict[int, float] = {}
        for each in segments["hypotheses"] or ():
            costs[each["segments"]] = min(each["cost"], costs.get(each["segments"], each["cost"]))
        if count not in costs or settings.count is not None or settings.names is not None:
            costs = {count: 0.0}  # the user or a turning foot fixes the number, or no other number was compared
        return cls(count, segments["names"][0], costs, inputs)


def hash_inputs(trial: Trial) -> str:
    """Return a hash of everything from which the segments of a finished trial follow, except their number."""
    stage = next(stage for stage in STAGES if stage.name == _STAGE)
    settings = trial.settings[_STAGE].model_dump(mode="json", exclude={"count", "count_alone"})
    origin = Folder(trial.out).origin(STAGES[0].name, STAGES[0].outputs)
    return hash_bytes(dumps([stage.version, settings, None if origin is None else origin.key]).encode())


def run_with_counts(
    trials: Sequence[StudyTrial],
    known: Mapping[str, Mapping[str, Any]],
    run: Callable[[list[Trial]], Sequence[TrialRun]],
) -> tuple[tuple[TrialRun, ...], dict[str, Any], list[str]]:
    """Run the trials, and those whose number of segments differs from the person's other trials once more.

    Parameters
    ----------
    known : mapping
        Result of the previous time, from study.json: so that a trial with another number is not run twice each time.
    run : callable
        Runs trials and returns their results.

    Returns
    -------
    runs : tuple of TrialRun
    changed : dict
        The number, and the evidence, of each trial that has not the number that it chose, for study.json.
    remarks : list of str
    """
    alone = {one.name: one.trial for one in trials}
    now = dict(alone)
    for name, entry in known.items():
        settings: Any = alone[name].settings[_STAGE] if name in alone else None
        if settings is not None and settings.count is None and settings.names is None:
            now[name] = fix_count(alone[name], int(entry["count"]), int(entry["alone"]))
    runs = dict(zip(now, run(list(now.values())), strict=True))

    def run_again(names: Mapping[str, Trial]) -> None:
        now.update(names)
        runs.update(zip(names, run(list(names.values())) if names else (), strict=True))

    fixed = {name for name in now if now[name] is not alone[name]}
    stale = {n for n in fixed if runs[n].exit_code or hash_inputs(alone[n]) != known[n]["inputs"]}
    run_again({name: alone[name] for name in sorted(stale)})
    found: dict[str, Evidence] = {}
    for name, trial in alone.items():
        one = None
        if name in fixed - stale:
            entry = known[name]
            costs = {int(number): float(cost) for number, cost in entry["costs"].items()}
            one = Evidence(int(entry["alone"]), str(entry["base"]), costs, str(entry["inputs"]))
        elif runs[name].exit_code == 0:
            one = Evidence.read(trial)
        if one is not None:
            found[name] = one
    chosen = choose_counts(trials, found)
    wanted = {name: fix_count(alone[name], chosen[name], found[name].count) for name in chosen}
    wanted |= {name: alone[name] for name in fixed - stale - chosen.keys()}
    run_again({name: trial for name, trial in wanted.items() if trial.settings != now[name].settings})
    failed = {name: alone[name] for name in chosen if runs[name].exit_code}
    run_again(failed)  # as it was: a trial with its own number is better than none
    chosen = {name: count for name, count in chosen.items() if name not in failed}
    changed = {
        name: {"count": count, "alone": one.count, "base": one.base, "costs": one.costs, "inputs": one.inputs}
        for name, count in chosen.items()
        for one in [found[name]]
    }
    return tuple(runs.values()), changed, describe_counts(trials, found, chosen)


def fix_count(trial: Trial, count: int, alone: int) -> Trial:
    """Return a trial with a number of segments that was chosen together; ``alone`` is the number it has alone."""
    settings = trial.settings[_STAGE].model_copy(update={"count": count, "count_alone": alone})
    return replace(trial, settings={**trial.settings, _STAGE: settings})


def choose_counts(trials: Sequence[StudyTrial], found: Mapping[str, Evidence]) -> dict[str, int]:
    """Return the number of segments, by trial, of the trials that should have another number than alone.

    The number is that of the smallest sum of costs among the numbers that every trial of the person considered. The
    number stays as it is if there is none.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for one in trials:
        if one.name in found:
            groups.setdefault((one.subject, found[one.name].base), []).append(one.name)
    chosen: dict[str, int] = {}
    for names in groups.values():
        own = [found[name] for name in names]
        common = set.intersection(*(set(each.costs) for each in own))
        if len({each.count for each in own}) == 1 or not common:
            continue
        count = min(sorted(common), key=lambda number: sum(each.costs[number] for each in own))
        chosen |= {name: count for name, each in zip(names, own, strict=True) if each.count != count}
    return chosen


def describe_counts(
    trials: Sequence[StudyTrial], found: Mapping[str, Evidence], chosen: Mapping[str, int]
) -> list[str]:
    """Return a remark about each person whose trials have, alone, different numbers of segments."""
    remarks = []
    for subject in dict.fromkeys(one.subject for one in trials):
        own = [one.name for one in trials if one.subject == subject and one.name in found]
        numbers = {name: chosen.get(name, found[name].count) for name in own}
        if any(name in chosen for name in own):
            changed = ", ".join(f"{name} (alone {found[name].count})" for name in own if name in chosen)
            count = next(chosen[name] for name in own if name in chosen)
            remarks.append(
                f"the number of segments of {subject}, {count}, was chosen from all trials together; it changes "
                f"{changed}"
            )
        if len(set(numbers.values())) > 1:
            listed = ", ".join(f"{name} {number}" for name, number in numbers.items())
            remarks.append(
                f"the trials of {subject} have different numbers of segments ({listed}), so their joints do not mean "
                "the same; give `segment: {count: …}` for all of them"
            )
    return remarks
