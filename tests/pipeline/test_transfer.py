"""Transfer of a body to other trials of the same person, and warnings for another person."""

from __future__ import annotations

import json
import logging
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.dynamics.prediction import centre_of_pressure, register_bodies, transfer_parameters
from mocap_id.errors import ConfigError, RecordingError, StoreError
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.runner import Step
from mocap_id.store.atomic import write_files
from mocap_id.workflows.identified_trial import IdentifiedTrial, match_bodies, open_identified_trial
from mocap_id.workflows.transfer import (
    SERIES,
    Transfer,
    TrialTransfer,
    apply_model,
    rms_error,
    transfer_model,
)
from mocap_id_cli.__main__ import main
from mocap_id_simulation import Options, Strategy, simulate

SHORT = Options(repetitions=2, analog_rate=100)


@pytest.fixture(autouse=True)
def logging_as_it_was() -> Iterator[None]:
    """Restore the logging, which the command sets up in this process."""
    loggers = [logging.getLogger(name) for name in (None, "mocap_id", "py.warnings")]
    before = [(logger.level, list(logger.handlers)) for logger in loggers]
    yield
    logging.captureWarnings(False)
    for logger, (level, handlers) in zip(loggers, before, strict=True):
        logger.setLevel(level)
        logger.handlers[:] = handlers


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int, Strategy], Path]:
    """Return the YAML file of a person's trial with a strategy, made once."""
    made: dict[tuple[int, Strategy], Path] = {}

    def trial(seed: int, strategy: Strategy) -> Path:
        if (seed, strategy) not in made:
            folder = tmp_path_factory.mktemp("person") / f"s{seed}-{strategy}"
            made[seed, strategy] = simulate("sit-to-stand", folder, replace(SHORT, seed=seed, strategy=strategy))
        return made[seed, strategy]

    return trial


@pytest.fixture(scope="module")
def normal(subject) -> IdentifiedTrial:
    return open_identified_trial(subject(21, "normal"))


@pytest.fixture(scope="module")
def dynamic(subject) -> IdentifiedTrial:
    return open_identified_trial(subject(21, "dynamic"))


def body(trial: TrialTransfer, name: str) -> dict[str, float]:
    """rms error of each series."""
    errors = next(body.errors for body in trial.bodies if body.name == name)
    return {series: rms_error(errors[series]) for series in SERIES}


def with_skeleton(trial: IdentifiedTrial, **changes: object) -> IdentifiedTrial:
    """Return the trial with another skeleton of its chain."""
    assert trial.measured is None
    return replace(trial, chain=replace(trial.chain, skeleton=replace(trial.chain.skeleton, **changes)))


def cop_off_truth(source: IdentifiedTrial, target: IdentifiedTrial) -> float:
    """Return the rms error of the transferred body's centre of pressure off the seat, mm."""
    full = transfer_parameters(source.parameters, register_bodies(source.skeleton, target.skeleton))
    time = target.dynamics["time"].to_numpy()
    truth = json.loads((target.source.parent / "truth.json").read_text())
    with np.load(target.source.parent / "truth.npz") as arrays:
        wrench = CubicSpline(arrays["t"], arrays["wrench"])(time)
    inside = [(time >= rep["seat_off"]) & (time <= rep["seat_on"]) for rep in truth["reps"]]
    error = centre_of_pressure(target.bodies.regressor @ full, target.cop_threshold) - wrench[:, 2] / wrench[:, 1]
    return 1e3 * float(np.sqrt(np.nanmean(error[np.any(inside, axis=0)] ** 2)))


def test_a_seed_keeps_the_body_whatever_the_strategy(subject) -> None:
    truths = [
        json.loads((subject(21, strategy).parent / "truth.json").read_text()) for strategy in ("normal", "dynamic")
    ]
    assert truths[0]["strategy"] != truths[1]["strategy"]
    assert truths[0]["base_parameters"] == truths[1]["base_parameters"]
    assert truths[0]["segments"] == truths[1]["segments"]


@pytest.mark.slow
def test_the_centre_of_pressure_of_another_strategy(subject) -> None:
    """Measured on ten subjects and every pair of strategies in docs/transfer.md: 1.5 mm on the median."""
    errors = []
    for seed in (21, 22, 23):
        trials = [open_identified_trial(subject(seed, strategy)) for strategy in ("normal", "dynamic")]
        errors += [cop_off_truth(*trials), cop_off_truth(*trials[::-1])]
    assert np.median(errors) <= 5
    assert max(errors) <= 8


def test_a_transferred_body_is_as_good_as_the_own_one_and_better_than_the_table(normal, dynamic) -> None:
    found = apply_model(normal, dynamic)
    own, carried, table = (body(found, name) for name in ("own", "transferred", "winter"))
    for series in SERIES:
        assert carried[series] < 1.1 * own[series]
        assert carried[series] < 0.5 * table[series]
    assert [each.name for each in found.bodies] == ["own", "own, held out", "transferred", "winter"]
    assert found.samples == dynamic.dynamics["in_fit"].sum()
    assert found.condition == dynamic.facts["condition_number"]
    torques = {each.name: each.torques for each in found.bodies}
    assert torques["own"] == torques["own, held out"] == ()
    for ours, theirs in zip(torques["transferred"], torques["winter"], strict=True):
        assert ours is not None and theirs is not None
        assert rms_error(ours) < 0.5 * rms_error(theirs)
    assert found.reasons == ()
    assert found.supported is True


def test_on_its_own_trial_a_body_is_the_own_model(dynamic) -> None:
    found = apply_model(dynamic, dynamic)
    own, carried = body(found, "own"), body(found, "transferred")
    assert carried == pytest.approx(own, rel=1e-3)
    np.testing.assert_allclose(found.registration.residual, 0.0, atol=1e-12)
    torques = next(each.torques for each in found.bodies if each.name == "transferred")
    assert max(rms_error(each) for each in torques) < 0.05


def test_errors_are_model_less_measurement(normal, dynamic) -> None:
    found, frame = apply_model(normal, dynamic), dynamic.dynamics
    used = frame[frame["in_fit"]]
    for name, suffix in (("own", "_model"), ("winter", "_reference")):
        errors = next(each.errors for each in found.bodies if each.name == name)
        for series in SERIES:
            off = used[f"{series}{suffix}"] - used[series]
            assert errors[series].bias == pytest.approx(off.mean(), abs=1e-6)
            assert errors[series].sd == pytest.approx(off.std(ddof=0), rel=1e-6)
    held = next(each.errors for each in found.bodies if each.name == "own, held out")
    assert held["tauz"].sd == dynamic.facts["held_out"]["model"]["tauz"]["sd"]


def test_another_person_is_noticed(normal, subject) -> None:
    other = open_identified_trial(subject(22, "dynamic"))
    found = apply_model(normal, other)
    assert "transfer-mass" in {reason.code for reason in found.reasons}
    assert {reason.code for reason in found.reasons} <= set(EXPLANATIONS)


def test_markers_that_were_placed_anew_are_noticed(normal, dynamic) -> None:
    scattered = dynamic.skeleton.local + np.random.default_rng(0).normal(scale=0.03, size=dynamic.skeleton.local.shape)
    moved = with_skeleton(dynamic, local=scattered)
    (reason,) = [reason for reason in apply_model(normal, moved).reasons if reason.code == "transfer-markers"]
    assert reason.value > reason.limit == 0.025


def test_a_body_worse_than_the_table_is_reported(normal, dynamic) -> None:
    wrong = replace(normal, parameters=normal.parameters * np.tile([1.0, 1.0, 1.3, 1.5], 4))
    (reason,) = [reason for reason in apply_model(wrong, dynamic).reasons if reason.code == "transfer-worse"]
    assert reason.value > 1
    assert "cop_x" in reason.message


def test_a_body_without_markers_in_the_other_trial_is_refused_by_name(normal, dynamic) -> None:
    """With another number of segments, the bodies are matched by their markers, whose labels must exist."""
    more = with_skeleton(dynamic, segments=(*dynamic.skeleton.segments, "head"))
    assert apply_model(normal, more).registration.markers.min() >= 2
    labels = [f"X{k}" if dynamic.skeleton.segment[k] == 2 else label for k, label in enumerate(normal.skeleton.markers)]
    with pytest.raises(ConfigError, match=r"has 0 of the \d+ markers on the thigh of trial") as raised:
        apply_model(with_skeleton(normal, markers=tuple(labels)), more)
    assert raised.value.exit_code == 2


def test_a_model_matched_by_markers_predicts_like_the_one_on_the_chain(normal, dynamic) -> None:
    """With exact marker places both give the same body, except for errors by skin and filters."""
    moving = match_bodies(normal, dynamic)
    registration = register_bodies(normal.skeleton, moving.skeleton)
    np.testing.assert_allclose(registration.angle, 0.0, atol=0.02)
    carried = transfer_parameters(normal.parameters, registration)
    wrench = moving.regressor @ carried
    on_chain = dynamic.bodies.regressor @ transfer_parameters(
        normal.parameters, register_bodies(normal.skeleton, dynamic.skeleton)
    )
    off = (wrench - on_chain)[dynamic.dynamics["in_fit"]]
    assert np.sqrt(np.nanmean(off[:, 1] ** 2)) < 15.0
    assert np.sqrt(np.nanmean(off[:, 2] ** 2)) < 5.0


def test_markers_of_another_protocol_are_refused(normal, dynamic) -> None:
    renamed = tuple(f"X{label}" for label in dynamic.skeleton.markers)
    with pytest.raises(ConfigError, match="0 common markers on the shank"):
        apply_model(normal, with_skeleton(dynamic, markers=renamed))


def test_markers_in_one_spot_are_refused(normal, dynamic) -> None:
    skeleton = dynamic.skeleton
    torso = np.flatnonzero(skeleton.segment == 3)
    kept = np.isin(np.arange(len(skeleton.segment)), torso[:2]) | (skeleton.segment != 3)
    near = normal.skeleton.local.copy()
    places = [normal.skeleton.markers.index(skeleton.markers[i]) for i in torso[:2]]
    near[places[1]] = near[places[0]] + [0.005, 0.0]
    few = replace(
        skeleton,
        markers=tuple(np.array(skeleton.markers)[kept]),
        segment=skeleton.segment[kept],
        local=skeleton.local[kept],
    )
    with pytest.raises(ConfigError, match="2 common markers on the torso, with a spread of"):
        apply_model(with_skeleton(normal, local=near), replace(dynamic, chain=replace(dynamic.chain, skeleton=few)))


def test_a_person_who_faces_the_other_way_is_refused(normal, dynamic) -> None:
    turned = replace(dynamic.skeleton, local=dynamic.skeleton.local * [-1.0, 1.0])
    with pytest.raises(ConfigError, match="faces opposite directions"):
        apply_model(normal, replace(dynamic, chain=replace(dynamic.chain, skeleton=turned)))


def test_a_trial_without_an_identified_body_is_no_model(subject, tmp_path) -> None:
    """With states but without parameters there is nothing to transfer or compare."""
    source = subject(21, "dynamic").parent
    blind = tmp_path / "blind.yaml"
    keys = {"trial": "blind", "recording": str(source / "trial.c3d"), "protocol": "sit-to-stand"}
    blind.write_text(json.dumps(keys | {"identify-dim": {"still_arc_deg": 200.0}}))
    with pytest.raises(RecordingError, match="no body to transfer from trial blind") as raised:
        transfer_model(blind, [source / "trial.yaml"])
    assert raised.value.exit_code == 3
    (found,) = transfer_model(source / "trial.yaml", [blind]).trials
    assert [reason.code for reason in found.reasons] == ["transfer-nothing"]
    assert found.samples == 0
    assert all(error is None for each in found.bodies for error in each.errors.values())
    applied = Transfer("m", ("foot", "shank", "thigh", "torso"), (found,))
    json.dumps(applied.as_json(), allow_nan=False)
    assert found.supported is None
    (tmp_path / "t.parquet").write_bytes(applied.format_table(".parquet"))
    assert pd.read_parquet(tmp_path / "t.parquet")["supported"].isna().all()


def test_a_run_folder_is_taken_as_it_is(subject, normal, tmp_path) -> None:
    folder = subject(21, "normal").parent / "runs" / "s21-normal"
    assert open_identified_trial(folder).parameters == pytest.approx(normal.parameters)
    assert open_identified_trial(folder).name == "s21-normal"
    part = tmp_path / "part"
    shutil.copytree(folder, part)
    (part / "dynamics.h5").unlink()
    with pytest.raises(StoreError, match=r"dynamics\.h5 is missing"):
        open_identified_trial(part)
    with pytest.raises(StoreError, match="is missing"):
        open_identified_trial(tmp_path)


def test_a_run_folder_of_two_runs_is_refused(subject, normal, dynamic, tmp_path) -> None:
    mixed = tmp_path / "mixed"
    shutil.copytree(subject(21, "normal").parent / "runs" / "s21-normal", mixed)
    shutil.copy(subject(21, "dynamic").parent / "runs" / "s21-dynamic" / "chain.h5", mixed / "chain.h5")
    with pytest.raises(StoreError, match=r"chain\.h5 is damaged or was edited") as raised:
        open_identified_trial(mixed)
    assert raised.value.exit_code == 6
    shutil.rmtree(mixed / ".mocap-id")  # the files alone still tell what they were made from
    with pytest.raises(StoreError, match=r"not made from the chain\.h5"):
        open_identified_trial(mixed)


def test_only_outdated_stages_are_computed(subject, tmp_path) -> None:
    shutil.copytree(subject(21, "normal").parent, tmp_path / "trial")
    yaml = tmp_path / "trial" / "trial.yaml"
    steps: list[tuple[str, str]] = []

    def note(step: Step) -> None:
        if step.action != "begun":
            steps.append((step.stage, step.action))

    open_identified_trial(yaml, note)
    assert [stage for stage, _ in steps] == ["planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim"]
    yaml.write_text(yaml.read_text() + "\nidentify-dim: {reference: de-leva}\n")
    steps.clear()
    assert open_identified_trial(yaml, note).facts["reference_table"] == "de-leva"
    assert [action for _, action in steps] == ["reused"] * 4 + ["computed"]
    assert not (tmp_path / "trial" / "runs" / "s21-normal" / "report.html").exists()


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["mocap-id", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        return int(left.value.code or 0), out, err

    return call


def test_the_command_prints_a_table(cli, subject, normal, dynamic) -> None:
    code, out, _ = cli("transfer", subject(21, "normal"), subject(21, "dynamic"), "--quiet")
    assert code == 0
    lines = out.splitlines()
    assert "s21-normal" in lines[0]
    assert f"s21-dynamic: {dynamic.dynamics['in_fit'].sum()} samples, condition number" in out
    for row in ("Fx (N)", "Fy (N)", "tauz (N·m)", "cop_x (mm)", "tau_3 minus own (N·m)"):
        assert any(line.startswith(row) for line in lines)
    assert "percentage of the samples in the 95 % interval" in out
    assert lines[-1].startswith("verdict: the transfer is supported")
    heads = next(line for line in lines if "transferred" in line)
    assert heads.split("  ")[-1].strip() == "winter"


def test_json_and_files_hold_the_same_numbers(cli, subject, normal, dynamic, tmp_path) -> None:
    arguments = ("transfer", subject(21, "normal"), subject(21, "dynamic"), subject(21, "normal"), "-q")
    code, out, _ = cli(*arguments, "--json", "--out", tmp_path / "new" / "t.csv")
    assert code == 0
    told = json.loads(out)
    assert (told["schema"], told["model"]) == ("mocap-id/transfer", "s21-normal")
    assert [trial["trial"] for trial in told["trials"]] == ["s21-dynamic", "s21-normal"]
    frame = pd.read_csv(tmp_path / "new" / "t.csv")
    assert len(frame) == sum(len(trial["bodies"]) for trial in told["trials"]) == 8
    for trial in told["trials"]:
        for each in trial["bodies"]:
            row = frame[(frame["trial"] == trial["trial"]) & (frame["body"] == each["body"])].iloc[0]
            for series in SERIES:
                for what in ("mean", "sd", "rms"):
                    assert row[f"{series}_{what}"] == pytest.approx(each["errors"][series][what])
            assert np.isnan(row["tau_1_mean"]) == (each["torques"] is None)
        assert trial["supported"] is True
        assert set(trial["support"]) == {"Fy", "tauz", "cop_x"}
        assert {name: each["unit"] for name, each in trial["intervals"].items()} == SERIES
        assert all(each["inside"] >= 0.8 and each["sd_rms"] > 0 for each in trial["intervals"].values())
        assert frame[frame["trial"] == trial["trial"]]["supported"].all()
        assert [part["segment"] for part in trial["registration"]] == ["foot", "shank", "thigh", "torso"]
    assert cli(*arguments, "--out", tmp_path / "t.parquet")[0] == 0
    schema = pq.read_schema(tmp_path / "t.parquet")
    assert schema.field("cop_x_rms").metadata == {b"unit": b"m"}
    assert schema.field("tau_2_sd").metadata == {b"unit": b"N*m"}
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "t.parquet"), frame, check_dtype=False)


def test_the_table_is_written_whole_or_not_at_all(normal, dynamic, tmp_path) -> None:
    found = Transfer("m", normal.skeleton.segments, (apply_model(normal, dynamic),))
    (tmp_path / "in-the-way").write_text("a file")
    with pytest.raises(StoreError, match="cannot be written"):
        write_files(tmp_path / "in-the-way", {"t.csv": found.format_table(".csv")})
    assert list(found.as_frame()["body"]) == ["own", "own, held out", "transferred", "winter"]


def test_mistakes_on_the_command_line(cli, subject, tmp_path) -> None:
    yaml = subject(21, "normal")
    code, out, err = cli("transfer", yaml, yaml, "--out", tmp_path / "t.xlsx")
    assert (code, out) == (2, "")
    assert ".csv or .parquet" in err and "reused" not in err, "before anything is computed"
    assert cli("transfer", yaml)[0] == 2
    code, _, err = cli("transfer", yaml, tmp_path / "missing.yaml")
    assert code == 2
    assert "missing.yaml" in err
    code, _, err = cli("transfer", tmp_path, yaml, "-q")
    assert code == 6
    assert "is missing" in err


def test_a_refused_trial_is_refused_here_too(cli, subject, tmp_path) -> None:
    keys = {"trial": "still", "recording": str(subject(21, "normal").parent / "trial.c3d"), "protocol": "sit-to-stand"}
    yaml = tmp_path / "still.yaml"
    yaml.write_text(json.dumps(keys | {"window": [0.0, 0.4]}))
    code, _, err = cli("transfer", subject(21, "normal"), yaml, "-q")
    assert code == 4
    assert "trial still" in err
