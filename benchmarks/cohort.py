"""Tables 6.1 to 6.3 of the thesis, repeated on a simulated cohort.

``mocap-id simulate cohort`` makes the recordings. Every trial goes through the stages up to ``identify-dim``. Every
model of a person is applied to every trial of that person, as in ``mocap-id transfer``. It takes about three seconds
per trial and core, and as long again for the variants.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from dynamic_sweep import TrialWithTruth, read_with_truth, stack_true_series
from harness import (
    DYNAMIC,
    EXACT,
    JOINTS,
    SEGMENTS,
    Run,
    compute_share_inside,
    describe_source,
    format_numbers,
    format_pairs,
    format_table,
    make_parser,
    publish,
    read_group,
    report_progress,
    rms,
    run_all,
    temporary_folder,
)
from kinematic_sweep import SCORED
from ruamel.yaml import YAML

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.dynamics.instrument_errors import PlanarCalibration
from mocap_id.dynamics.prediction import centre_of_pressure, transfer_parameters
from mocap_id.runner import run_stage
from mocap_id.workflows.identified_trial import IdentifiedTrial, MovingBodies, match_bodies, open_identified_trial
from mocap_id.workflows.transfer import HELD_OUT, OWN, TRANSFERRED, apply_model
from mocap_id_simulation.options import FaultOptions, Options
from mocap_id_simulation.studies import Cohort, simulate_cohort

WINTER = "winter"
TRUTHS = ("Fy", "tauz", "CoP", "tau_1", "tau_2", "tau_3")
CALIBRATION = PlanarCalibration(
    gain=0.01, moments=0.01, lengths=0.003, tilt=0.005, position=0.005, mass=None, mass_sd=1.0
)
_SUBJECT = ("height", "mass", "sex")
_FOUND = 0.25  # s: an event this far from the true one belongs to another


@dataclass(frozen=True)
class Done:
    name: str
    subject: str
    strategy: str
    model: IdentifiedTrial
    truth: TrialWithTruth
    run: Run


def configure(study: Path, place: Path, settings: Mapping[str, Any]) -> list[tuple[Mapping[str, str], Path]]:
    """Write a configuration for every trial of a study, with settings of ``identify-dim``; return the study's rows."""
    study_file, made = YAML(typ="safe").load(study), []
    place.mkdir(exist_ok=True)
    for row in study_file["trials"]:
        subject = {key: study_file["subjects"][row["subject"]][key] for key in _SUBJECT}
        keys = {"trial": row["trial"], "recording": str(study.parent / row["recording"]), "subject": subject}
        file = place / f"{row['trial']}.yaml"
        file.write_text(json.dumps(study_file["defaults"] | keys | {"identify-dim": dict(settings)}))
        made.append((row, file))
    return made


def run(file: Path) -> bool:
    """Run a trial up to ``identify-dim``; return whether no stage refuses it."""
    trial = load(file)
    return all(run_stage(trial, name).refused is None for name in DYNAMIC)


def compare_models(trials: Sequence[Done]) -> pd.DataFrame:
    """Return the errors of every model on every trial of its person, a row for each pair; and of Winter's model.

    ``Fy``, ``tauz`` and ``cop`` are compared with the measurement over the samples of the fit. Torques ``t1`` … are
    compared with the torques of the trial's own model. Columns with ``true_`` are compared with the truth over all
    samples off the seat.
    """
    rows = []
    for source, target in [(source, target) for target in trials for source in trials]:
        if source.subject != target.subject:
            continue
        found = apply_model(source.model, target.model)
        bodies = {body.name: body for body in found.bodies}
        moving = target.model.chain if source.model.measured is None else match_bodies(source.model, target.model)
        of_body = {
            WINTER: (target.model.bodies, target.model.reference),
            TRANSFERRED: (moving, transfer_parameters(source.model.parameters, found.registration)),
        }
        names = {WINTER: WINTER} | (
            {OWN: target.strategy, HELD_OUT: HELD_OUT} if source is target else {TRANSFERRED: source.strategy}
        )
        for body, model in names.items():
            row: dict[str, Any] = {"subject": target.subject, "action": target.strategy, "trial": target.name}
            row |= {"model": model, "own": body == OWN, "condition": found.condition}
            errors = {short: bodies[body].errors[n] for n, short in (("Fy", "Fy"), ("tauz", "tauz"), ("cop_x", "cop"))}
            errors |= {f"t{j}": torque for j, torque in enumerate(bodies[body].torques, start=1)}
            for name, error in errors.items():
                bias, sd = (np.nan, np.nan) if error is None else (error.bias, error.sd)
                row |= {f"{name}_mean": bias, f"{name}_sd": sd, f"{name}_rms": float(np.hypot(bias, sd))}
            if body != HELD_OUT:
                row |= _compare_with_truth(target, of_body.get(body))
            rows.append(row)
    return pd.DataFrame(rows).drop_duplicates(["subject", "action", "trial", "model"], ignore_index=True)


def _compare_with_truth(target: Done, of_body: tuple[MovingBodies, FloatArray] | None) -> dict[str, float]:
    """Return errors against the truth off the seat.

    ``of_body`` has moving bodies and their full parameters; None for the trial's own model, which also has intervals.
    """
    model, truth = target.model, target.truth
    columns = ["Fy_model", "tauz_model", "cop_x_model", *(f"tau_{j}" for j in range(1, SEGMENTS))]
    if of_body is None:
        series = model.dynamics[columns].to_numpy(dtype=np.float64)
    else:
        bodies, full = of_body
        predicted = bodies.regressor @ full
        pressure = centre_of_pressure(predicted, model.cop_threshold)
        series = np.column_stack([predicted[:, 1:], pressure, bodies.torque_regressor @ full])
    off = (series - stack_true_series(truth.true)[:, 1:])[truth.off_seat]
    parts = [("mean", np.nanmean(off, axis=0)), ("sd", np.nanstd(off, axis=0)), ("rms", rms(off))]
    if of_body is None:
        sd = model.dynamics[[f"sd_{name}" for name in columns]].to_numpy(dtype=np.float64)[truth.off_seat]
        inside = [compute_share_inside(*each) for each in zip(off.T, sd.T, strict=True)]
        parts.append(("inside", np.array(inside)))
    return {f"true_{name}_{part}": values[k] for part, values in parts for k, name in enumerate(TRUTHS)}


def compare_skeletons(trials: Sequence[Done]) -> pd.DataFrame:
    """Return a row for each trial: errors of the lengths, %, errors of lengths from stature, %, and marker rms, mm."""
    rows = []
    for each in trials:
        lengths = read_group(each.truth.chain, "segments")["length"]
        height = each.truth.truth["subject"]["height_m"]
        row: dict[str, Any] = {"subject": each.subject, "strategy": each.strategy}
        for name, length, share in zip(SCORED, lengths, (0.246, 0.245), strict=True):
            true = each.truth.truth["segment_lengths_m"][name]
            row |= {name: 100 * (length / true - 1), f"{name} of stature": 100 * (share * height / true - 1)}
        (markers,) = each.run.read("markers.parquet")
        rows.append(row | {"markers": 1e3 * float(rms(markers.values["residual"].ravel()))})
    return pd.DataFrame(rows)


def compare_repetitions(trials: Sequence[Done]) -> pd.DataFrame:
    """Return a row for each true repetition: whether it was found, and the errors of its events, ms."""
    names = {"start": "rise_start", "seat_off": "seat_off", "stand": "rise_end", "seat_on": "seat_on", "end": "sit_end"}
    rows = []
    for each in trials:
        (events,) = each.run.read("events.parquet")
        true = each.truth.truth["reps"]
        for k, one in enumerate(true):
            row: dict[str, Any] = {"strategy": each.strategy, "trial": each.name, "right": False}
            if len(events.frame) == len(true):
                found = events.frame.iloc[k]
                errors = {name: 1e3 * (float(found[name]) - one[key]) for name, key in names.items()}
                near = abs(errors["seat_off"]) < 1e3 * _FOUND and abs(errors["seat_on"]) < 1e3 * _FOUND
                row |= {"right": bool(found["complete"]) and near, **errors}
            rows.append(row)
    return pd.DataFrame(rows)


ORDINARY = Options(clock_offset=0.005)
HARD = replace(ORDINARY, soft_tissue=2, occlusions=2, plate_bias=1)
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "unchanged": {},
    "`components: [Fy, tauz]`": {"components": ["Fy", "tauz"]},
    "`apply_clock_offset: false`": {"apply_clock_offset": False},
    "`contact: weight` (72 %)": {"contact": "weight"},
    "`contact: knee` (−0.8 rad)": {"contact": "knee"},
    "`contact: weight`, `seat_off_share: 0.5`": {"contact": "weight", "seat_off_share": 0.5},
    "`contact: weight`, `seat_off_share: 0.3`": {"contact": "weight", "seat_off_share": 0.3},
}


ACTIONS = ("dynamic", "normal", "stable")
THESIS_CONDITION = {"dynamic": "83 ± 30", "normal": "113 ± 57", "stable": "101 ± 44"}
THESIS: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("dynamic", WINTER): ("-13.4 ± 99.4", "25.6 ± 21.5", "3.8 ± 4.1", "14.2 ± 4.3", "16.4 ± 3.9", "5.3 ± 3.6"),
    ("dynamic", "dynamic"): ("-16.4 ± 86.7", "7.0 ± 19.5", "1.2 ± 5.9", "–", "–", "–"),
    ("dynamic", "normal"): ("-12.8 ± 91.5", "32.4 ± 19.4", "3.8 ± 2.7", "3.0 ± 2.2", "6.3 ± 2.2", "1.3 ± 2.5"),
    ("dynamic", "stable"): ("-19.3 ± 99.1", "33.4 ± 23.3", "3.9 ± 4.2", "6.7 ± 4.3", "9.5 ± 4.6", "4.9 ± 4.8"),
    ("normal", WINTER): ("-8.5 ± 48.2", "19.9 ± 15.0", "3.3 ± 1.8", "11.3 ± 3.5", "10.3 ± 2.7", "4.4 ± 1.7"),
    ("normal", "dynamic"): ("-11.5 ± 42.1", "-20.3 ± 15.5", "-2.4 ± 2.0", "-2.9 ± 1.6", "-6.5 ± 1.8", "-1.2 ± 1.6"),
    ("normal", "normal"): ("-6.9 ± 42.4", "5.4 ± 13.8", "0.9 ± 1.7", "–", "–", "–"),
    ("normal", "stable"): ("-14.6 ± 49.7", "5.8 ± 17.4", "1.5 ± 2.2", "3.9 ± 3.0", "3.4 ± 2.9", "3.8 ± 2.2"),
    ("stable", WINTER): ("8.2 ± 15.6", "16.8 ± 9.2", "2.4 ± 1.4", "7.5 ± 2.0", "7.4 ± 2.5", "0.8 ± 1.8"),
    ("stable", "dynamic"): ("1.1 ± 15.3", "-20.7 ± 9.5", "-3.2 ± 1.6", "-6.5 ± 2.9", "-10.4 ± 4.5", "-4.1 ± 3.2"),
    ("stable", "normal"): ("6.4 ± 15.3", "5.0 ± 9.8", "0.6 ± 3.6", "-3.7 ± 2.6", "-3.5 ± 3.5", "-3.3 ± 2.2"),
    ("stable", "stable"): ("1.4 ± 14.7", "5.5 ± 10.2", "0.8 ± 2.6", "–", "–", "–"),
}
THESIS_LENGTHS = {"shank": ("-0.4 ± 2.8", "-6.0 ± 2.9"), "thigh": ("3.2 ± 5.3", "-6.5 ± 3.0")}
THESIS_STRATEGIES = {
    "dynamic": ("-0.2 ± 4.2", "-3.9 ± 5.4", "4.3 ± 2.4"),
    "normal": ("1.0 ± 3.7", "-4.3 ± 5.7", "5.2 ± 4.1"),
    "stable": ("0.3 ± 4.0", "-1.3 ± 3.6", "3.8 ± 2.8"),
}
MODELS = (WINTER, *ACTIONS)
RELEASE, COP = 30.0, 5.0  # ms, mm: required medians


@dataclass(frozen=True)
class Outcome:
    models: pd.DataFrame
    skeletons: pd.DataFrame
    repetitions: pd.DataFrame
    lost: tuple[str, ...]


def measure(study: Path, place: Path, settings: Mapping[str, Any], jobs: int) -> Outcome:
    """Run a cohort with settings of ``identify-dim`` and compare it with the truth."""
    files, good, lost = configure(study, place, settings), [], []
    for (row, file), through in zip(files, run_all(run, [file for _, file in files], jobs), strict=True):
        done = Run(study.parent / "truth" / row["trial"] / "truth.json", load(file))
        truth = read_with_truth(done) if through else None  # None without four segments or without parameters
        if truth is None:
            lost.append(row["trial"])
        else:
            model = open_identified_trial(done.trial.out)
            good.append(Done(row["trial"], row["subject"], row["strategy"], model, truth, done))
    return Outcome(compare_models(good), compare_skeletons(good), compare_repetitions(good), tuple(lost))


def measure_variants(study: Path, place: Path, jobs: int) -> dict[str, pd.DataFrame]:
    """Run the cohort with each variant of ``identify-dim``, and without errors of scale, after the earlier stages."""
    found = {}
    for k, (name, settings) in enumerate({EXACT: YAML(typ="safe").load(f"{{{EXACT}}}"), **VARIANTS}.items()):
        other = place.with_name(f"variant-{k}")
        shutil.copytree(place, other)
        found[name] = measure(study, other, settings, jobs).models
        shutil.rmtree(other)
    return found


def measure_with_scale(folder: Path, subjects: int, options: Options, jobs: int) -> pd.DataFrame:
    """Run persons whose instruments have the errors of scale that the intervals contain, drawn for each person."""
    drawn, found = np.random.default_rng(options.seed), []
    for number in range(subjects):
        gain, moments, lengths, tilt, position = drawn.standard_normal(5)
        faults = FaultOptions(
            gain=CALIBRATION.gain * gain,
            gain_moments=CALIBRATION.moments * moments,
            camera_scale=CALIBRATION.lengths * lengths,
            tilt_deg=float(np.degrees(CALIBRATION.tilt * tilt)),
            corners_mm=1e3 * CALIBRATION.position * abs(position),
        )
        own = replace(options, seed=options.seed + number, faults=faults)
        study = simulate_cohort(folder / f"scale-{number}", Cohort(1, options=own))
        outcome = measure(study, study.parent / "trials", {}, jobs)
        report_progress(f"errors of scale, person {number + 1}: trials without a model {outcome.lost}")
        found.append(outcome.models.assign(subject=f"s{number + 1:02d}"))
    return pd.concat(found, ignore_index=True)


def format_pooled(frame: pd.DataFrame, name: str, scale: float = 1.0, form: str = ".2f") -> str:
    """Return mean ± standard deviation over the samples of several trials with equal weights."""
    means, sds = frame[f"{name}_mean"].to_numpy() * scale, frame[f"{name}_sd"].to_numpy() * scale
    if not np.isfinite(means).all():
        return "–"
    return f"{means.mean():{form}} ± {np.sqrt(np.mean(sds**2 + (means - means.mean()) ** 2)):{form}}"


def format_wrench(frame: pd.DataFrame) -> list[str]:
    """Return the pooled errors of the wrench against the measurement."""
    return [format_pooled(frame, "Fy"), format_pooled(frame, "tauz"), format_pooled(frame, "cop", 100)]


def list_models(found: pd.DataFrame) -> Iterator[tuple[str, str, pd.DataFrame]]:
    for action, model in product(ACTIONS, MODELS):
        yield action, model, found[(found["action"] == action) & (found["model"] == model)]


def make_table_6_3(found: pd.DataFrame) -> str:
    """Return the errors of every model on every action; the thesis's errors are in the row below."""
    head = ["action", "model", "", "condition", "Fy, N", "tauz, N·m", "CoP, cm", "tau 1, N·m", "tau 2", "tau 3"]
    rows = []
    for action, model, here in list_models(found):
        cells = [*format_wrench(here), *(format_pooled(here, f"t{j}") for j in (1, 2, 3))]
        rows.append([action, model, "ours", format_spread(here["condition"], ".0f"), *cells])
        rows.append(["", "", "thesis", THESIS_CONDITION[action], *THESIS[action, model]])
    return format_table(head, rows)


def make_torque_table(found: pd.DataFrame) -> str:
    """Return mean ± standard deviation of the errors of every model on every action, against the truth."""
    head = ["action", "model", "Fy, N", "tauz, N·m", "CoP, mm", *(f"{joint} torque, N·m" for joint in JOINTS)]
    rows = [
        [action, model, *(format_pooled(here, f"true_{name}", 1e3 if name == "CoP" else 1.0) for name in TRUTHS)]
        for action, model, here in list_models(found)
    ]
    return format_table(head, rows)


def format_spread(values: pd.Series[float], form: str = ".2f") -> str:
    return f"{values.mean():{form}} ± {values.std():{form}}"


def make_people_table(found: pd.DataFrame) -> str:
    """Return rms errors of every person's own models and of Winter's model, against the truth."""
    head = ["person", "CoP, mm: own", "Winter"]
    head += [f"{joint}, N·m: {whose}" for joint in JOINTS for whose in ("own", "W.")]
    rows = []
    for subject, here in found.groupby("subject"):
        cells = []
        for name, scale in (("CoP", 1e3), *((f"tau_{j}", 1.0) for j in (1, 2, 3))):
            cells += [f"{scale * value:.2f}" for value in compute_own_and_winter(here, name)]
        rows.append([str(subject), *cells])
    return format_table(head, rows)


def compute_own_and_winter(here: pd.DataFrame, name: str) -> tuple[float, float]:
    """Return rms errors of the own models and of Winter's model over some trials, against the truth."""
    column = f"true_{name}_rms"
    return tuple(
        float(np.sqrt(np.mean(part[column] ** 2))) for part in (here[here["own"]], here[here["model"] == WINTER])
    )


def make_interval_table(**found: pd.DataFrame) -> str:
    """Return errors of the own models' torques, and the share of the samples inside their intervals.

    ``found`` has the errors by the kind of the intervals; the torques are those of the first kind.
    """
    head = ["strategy", *(f"{joint} torque, N·m" for joint in JOINTS)]
    head += [f"inside, {kind}: {part}" for kind in found for part in ("mean", "lowest", "highest")]
    rows = []
    for name in (*ACTIONS, "all"):
        own = [
            each[each["own"] & ((each["action"] == name) | (name == "all"))].filter(regex="true_tau_._(rms|inside)")
            for each in found.values()
        ]
        rows.append([name, *format_pairs(own[0].filter(like="rms").to_numpy(), quantiles=(0.5, 1.0))])
        for each in own:
            shares = 100 * each.filter(like="inside").to_numpy()
            rows[-1] += format_numbers((shares.mean(), shares.min(), shares.max()), ".0f")
    return format_table(head, rows)


def make_length_table(found: pd.DataFrame) -> str:
    """Return table 6.1 with errors against the truth."""
    rows = []
    for name, (framework, stature) in THESIS_LENGTHS.items():
        by_stature = format_spread(found.groupby("subject")[f"{name} of stature"].first())
        rows.append([name, format_spread(found[name]), framework, by_stature, stature])
    return format_table(["error, %", "framework: ours", "thesis", "stature: ours", "thesis"], rows)


def make_strategy_table(found: pd.DataFrame) -> str:
    """Return table 6.2 with errors against the truth."""
    head = ["", *(f"{action}: {whose}" for action in ACTIONS for whose in ("ours", "thesis"))]
    rows = []
    for k, name in enumerate(("shank, %", "thigh, %", "markers, mm")):
        rows.append([name])
        for action in ACTIONS:
            ours = found[found["strategy"] == action][name.split(",")[0]]
            rows[-1] += [format_spread(ours), THESIS_STRATEGIES[action][k]]
    return format_table(head, rows)


def make_event_table(found: pd.DataFrame) -> str:
    """Return the share of repetitions that are right, and the errors of their events."""
    head = ["strategy", "repetitions", "right"]
    head += ["seat-off: median, ms", "90 %", "largest", "seat-on: median", "90 %", "largest"]
    rows = []
    for name, here in [*((action, found[found["strategy"] == action]) for action in ACTIONS), ("all", found)]:
        cells = [f"{len(here)}", f"{100 * here['right'].mean():.0f} %"]
        for event in ("seat_off", "seat_on"):
            cells += [f"{value:.0f}" for value in np.nanquantile(here[event].abs(), (0.5, 0.9, 1.0))]
        rows.append([name, *cells])
    return format_table(head, rows)


def _list_requirements(cohort: Outcome) -> Iterator[tuple[str, str, str]]:
    """Yield quantity, requirement and result; a result is bold if it does not meet the requirement."""

    def in_bold(kept: bool, text: str) -> str:
        return text if kept else f"**{text}**"

    trials = cohort.models["trial"].nunique()
    yield "trials with a model", "all", in_bold(not cohort.lost, f"{trials} of {trials + len(cohort.lost)}")
    right = cohort.repetitions["right"]
    yield "repetitions right", "100 %", in_bold(bool(right.all()), f"{right.sum()} of {len(right)}")
    for event in ("seat_off", "seat_on"):
        middle, most = np.nanquantile(cohort.repetitions[event].abs(), (0.5, 1.0))
        limit = f"median {RELEASE:g} ms" if event == "seat_off" else "–"
        kept = event == "seat_on" or middle <= RELEASE
        yield event.replace("_", "-"), limit, in_bold(kept, f"median {middle:.0f}, largest {most:.0f} ms")
    own = 1e3 * cohort.models[cohort.models["own"]]["true_CoP_rms"]
    text = f"median {own.median():.2f}, largest {own.max():.2f} mm"
    yield "own model's CoP", f"median {COP:g} mm", in_bold(own.median() <= COP, text)
    for name, what in (("CoP", "CoP"), *((f"tau_{j}", f"{joint} torque") for j, joint in enumerate(JOINTS, start=1))):
        pairs = [compute_own_and_winter(here, name) for _, here in cohort.models.groupby("subject")]
        better = sum(mine < table for mine, table in pairs)
        whole = compute_own_and_winter(cohort.models, name)
        scale, unit = (1e3, "mm") if name == "CoP" else (1.0, "N·m")
        text = f"{better} of {len(pairs)} ({scale * whole[0]:.2f} against {scale * whole[1]:.2f} {unit} rms)"
        required = "in every person" if name == "CoP" else "all persons together"
        kept = better == len(pairs) if name == "CoP" else whole[0] < whole[1]
        yield f"own model's {what} nearer the truth than Winter's", required, in_bold(kept, text)


def make_variant_table(found: Mapping[str, pd.DataFrame]) -> str:
    """Return the errors of the own models and of Winter's with other settings of ``identify-dim``."""
    head = ["`identify-dim`", "condition", "Fy, N", "tauz, N·m", "CoP, cm", "true CoP, mm rms"]
    rows = []
    for name, frame in found.items():
        own, table = frame[frame["own"]], frame[frame["model"] == WINTER]
        for whose, here in (("own", own), ("Winter", table)):
            condition = f"{here['condition'].median():.0f}" if whose == "own" else ""
            true = np.sqrt(np.mean((1e3 * here["true_CoP_rms"]) ** 2))
            rows.append([name if whose == "own" else "", whose, condition, *format_wrench(here), f"{true:.2f}"])
    return format_table([head[0], "model", *head[1:]], rows)


def main() -> None:
    arguments = make_parser(__doc__, parallel=True, subjects=12, repetitions=5, first=970_000).parse_args()
    found, varied = {}, {}
    with temporary_folder() as folder:
        for k, (name, options) in enumerate((("ordinary", ORDINARY), ("hard", HARD))):
            own = replace(options, seed=arguments.first + k, repetitions=arguments.repetitions)
            study = simulate_cohort(folder / name, Cohort(arguments.subjects, options=own))
            found[name] = measure(study, study.parent / "trials", {}, arguments.jobs)
            report_progress(f"{name}: {len(found[name].lost)} trials without a model {found[name].lost}")
            if name == "ordinary":
                varied = measure_variants(study, study.parent / "trials", arguments.jobs)
        own = replace(ORDINARY, seed=arguments.first + 2, repetitions=arguments.repetitions)
        with_scale = measure_with_scale(folder, arguments.subjects, own, arguments.jobs)
    first = found["ordinary"]
    source = (
        f"{arguments.subjects} persons with three strategies, one trial of {arguments.repetitions} sit-to-stands each: "
        f"an ordinary cohort (seed {arguments.first}) and a hard one (seed {arguments.first + 1})"
    )
    columns = [list(_list_requirements(each)) for each in found.values()]
    required = [[*each[0][:2], *(text for _, _, text in each)] for each in zip(*columns, strict=True)]
    names = {"start": "start of the rise", "stand": "upright", "end": "seated"}  # events without an exact instant
    others = [f"{name} {first.repetitions[event].median():+.0f} ms" for event, name in names.items()]
    sections = {
        "cohort": describe_source(__file__, source),
        "cohort-requirements": format_table(["quantity", "required", *found], required),
        "cohort-people": make_people_table(first.models),
        "cohort-intervals": make_interval_table(default=first.models, exact=varied.pop(EXACT)),
        "cohort-scale": make_interval_table(default=with_scale),
        "cohort-models": make_table_6_3(first.models),
        "cohort-truth": make_torque_table(first.models),
        "cohort-lengths": make_length_table(first.skeletons),
        "cohort-strategies": make_strategy_table(first.skeletons),
        "cohort-events": make_event_table(first.repetitions),
        "cohort-other-events": f"Median difference, found minus scheduled: {', '.join(others)}.",
        "cohort-variants": make_variant_table(varied),
    }
    publish(sections, write=arguments.write)


if __name__ == "__main__":
    main()
