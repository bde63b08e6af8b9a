"""Whole trials with a chair on its own plate, and with a hand on a rail that has a sensor, against exact truth."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import CubicSpline

from mocap_id.config import load
from mocap_id.errors import Refused
from mocap_id.geometry import planar
from mocap_id.recording import write_c3d
from mocap_id.runner import run
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE, IdentifyDimSettings
from mocap_id.store import Folder, Table, Tree
from mocap_id_simulation import Options, generate, simulate
from mocap_id_simulation.instruments import measure_load

OPTIONS = Options(seed=410, repetitions=3, seat_plate=True, plate_moved=True, plate_bias=1.0, clock_offset=0.012)
INVARIANT = [0, 4, 7, 10]
"""Base parameters that do not depend on the orientation of a segment's frame: m, I2, I3, I4."""


@dataclass(frozen=True)
class Finished:
    """A run folder and the truth of its recording."""

    folder: Path
    source: Path
    events: pd.DataFrame
    frame: pd.DataFrame
    tree: Tree

    @property
    def truth(self) -> dict[str, Any]:
        return dict(json.loads((self.source / "truth.json").read_text()))

    def true(self, key: str) -> np.ndarray:
        with np.load(self.source / "truth.npz") as arrays:
            return np.asarray(CubicSpline(arrays["t"], arrays[key])(self.frame["time"].to_numpy()))

    @property
    def on_chair(self) -> np.ndarray:
        return np.abs(self.true("chair_force")[:, 1]) > 1.0

    @property
    def base(self) -> tuple[np.ndarray, np.ndarray]:
        """Return values and standard deviations."""
        base: Any = self.tree.data["base"]
        return np.asarray(base["value"]), np.asarray(base["sd"])

    @property
    def own_sd(self) -> np.ndarray:
        """Return the standard deviations without the calibration, which both trials share."""
        return np.asarray(np.sqrt(self.base[1] ** 2 - np.diag(self.tree.facts["calibration_covariance"])))

    @property
    def codes(self) -> list[str]:
        return [reason.code for reason in self.tree.reasons]

    def torques(self, prefix: str = "") -> np.ndarray:
        return self.frame[[f"{prefix}tau_{j}" for j in (1, 2, 3)]].to_numpy()


def rms(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))


def finish(yaml: Path) -> Finished:
    outcome = run(load(yaml))
    folder = Folder(outcome.folder)
    events, table, tree, _ = (folder.read(file) for file in STAGE.outputs)
    assert isinstance(events, Table)
    assert isinstance(table, Table)
    assert isinstance(tree, Tree)
    return Finished(outcome.folder, yaml.parent, events.frame, table.frame, tree)


def again(done: Finished, change: Any = None, **settings: Any) -> Finished:
    """Run identify-dim on the same artefacts with other settings or another wrench of the chair."""
    folder = Folder(done.folder)
    inputs = {file: folder.read(file) for file in STAGE.inputs}
    if change is not None:
        wrench = inputs["wrench.parquet"]
        inputs["wrench.parquet"] = Table.from_frame(wrench.schema, change(wrench.frame), wrench.facts, wrench.reasons)
    trial = load(done.source / "trial.yaml")
    events, table, tree, _ = STAGE.function(Context(trial.keys, IdentifyDimSettings(**settings), inputs))
    return replace(done, events=events.frame, frame=table.frame, tree=tree)


@pytest.fixture(scope="module")
def seated(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    return finish(simulate("sit-to-stand", tmp_path_factory.mktemp("seat") / "trial", OPTIONS))


@pytest.fixture(scope="module")
def gated(seated: Finished) -> Finished:
    """The same trial as if the chair had no plate."""
    return again(seated, seat_plate=False)


def test_the_chairs_plate_is_found_and_its_weight_subtracted(seated: Finished) -> None:
    wrench = Folder(seated.folder).read("wrench.parquet")
    assert isinstance(wrench, Table)
    assert [plate["use"] for plate in wrench.facts["plates"]] == ["feet", "seat"]
    (fact,) = wrench.facts["external"]
    assert fact["plates"] == [2]
    assert fact["zero"]["Fy"] == pytest.approx(6 * 9.81, abs=10)  # and the plate's own error of up to 10 N
    stamped = seated.frame["time"].to_numpy() + OPTIONS.clock_offset
    inside = stamped < stamped[-1] - 0.05
    with np.load(seated.source / "truth.npz") as arrays:
        force = CubicSpline(arrays["t"], arrays["chair_force"])(stamped)[inside]
    found = wrench.frame[["Fx_seat", "Fy_seat"]].to_numpy()[inside]
    np.testing.assert_allclose(found, force, atol=2.0)


def test_parameters_and_torques_are_right_on_all_samples(seated: Finished) -> None:
    """Measured: torques within 0.6, 0.4 and 0.9 N·m rms of the truth on the chair, parameters within 1.2 %."""
    assert seated.codes == ["seat-measured"]
    assert seated.frame["in_fit"][seated.on_chair].mean() > 0.8
    value, sd = seated.base
    truth = np.array(seated.truth["base_parameters"]["values"])
    assert np.abs(value / truth - 1)[INVARIANT].max() < 0.02
    assert (np.abs(value - truth)[INVARIANT] < 3 * sd[INVARIANT]).all()
    error = seated.torques() - seated.true("tau")
    assert (rms(error[seated.on_chair]) < (3.0, 2.0, 1.0)).all()
    assert (rms(error[~seated.on_chair]) < (3.0, 2.0, 1.0)).all()
    covered = (np.abs(error) < 1.96 * seated.torques("sd_"))[seated.on_chair & np.isfinite(error).all(axis=1)]
    assert (covered.mean(axis=0)[:2] > 0.9).all()  # the joints that the chair relieves
    assert seated.tree.facts["clock_offset_s"] == pytest.approx(0.012, abs=0.001)
    for reps in ("seat_off", "seat_on"):
        np.testing.assert_allclose(seated.events[reps], [rep[reps] for rep in seated.truth["reps"]], atol=0.08)


def test_the_ground_is_the_model_less_the_chair(seated: Finished) -> None:
    model = seated.frame[["Fx_model", "Fy_model", "tauz_model"]].to_numpy()
    assert (rms((model - seated.true("wrench"))[seated.on_chair]) < (2.0, 6.0, 2.0)).all()
    chair = seated.true("chair_force")
    np.testing.assert_allclose(seated.frame["Fy_external"][5:-5], chair[5:-5, 1], atol=3.0)


def test_the_benefit_of_the_chairs_plate(seated: Finished, gated: Finished) -> None:
    """Without it, torques below the chair are unknown; with it, the median deviation falls to 0.69."""
    assert gated.frame["in_fit"].sum() < 0.6 * seated.frame["in_fit"].sum()
    assert np.isfinite(seated.torques()[seated.on_chair]).all(axis=1).mean() > 0.95
    assert not seated.frame["contact"].any()
    shank_and_thigh = slice(2, 8)
    assert np.median((seated.own_sd / gated.own_sd)[shank_and_thigh]) < 0.85
    np.testing.assert_allclose(seated.base[0][INVARIANT], gated.base[0][INVARIANT], rtol=0.03)


@pytest.mark.parametrize("rule", ["seat-force", "weight", "knee"])
def test_torques_are_unknown_while_a_chair_without_a_plate_carries_the_body(seated: Finished, rule: str) -> None:
    """Before, the chair's load made the knee's torque wrong by up to 130 N·m."""
    done = again(seated, seat_plate=False, contact=rule)
    contact, error = done.frame["contact"].to_numpy(), done.torques() - done.true("tau")
    carried = done.true("chair_force")[:, 1] > 0.02 * np.max(done.true("wrench")[:, 1])
    assert contact[carried].all()
    unknown = np.isnan(done.torques())
    np.testing.assert_array_equal(unknown[5:-5], np.column_stack([contact, contact, np.zeros_like(contact)])[5:-5])
    np.testing.assert_array_equal(unknown, np.isnan(done.torques("sd_")))
    assert np.nanmax(np.abs(error[:, :2])) < 12
    assert contact[~carried].mean() < (0.05 if rule == "seat-force" else 0.35)
    assert (np.abs(error) < 1.96 * done.torques("sd_"))[contact, 2].mean() > 0.9


def test_a_chair_segment_that_is_given_decides_which_torques_are_unknown(seated: Finished) -> None:
    done = again(seated, seat_plate=False, seat_segment="torso")
    contact = done.frame["contact"].to_numpy()
    assert np.isnan(done.torques()[contact]).all() and np.isfinite(done.torques()[~contact]).all()


def test_where_the_plates_are_silent_a_chair_may_carry_the_body(seated: Finished) -> None:
    """While the hips are low, one plate signal is lost: nobody knows whether the chair is touched there."""
    begin, finish = seated.truth["reps"][1]["rise_start"] - 2.5, seated.truth["reps"][1]["rise_start"] + 0.4

    def lose(frame: pd.DataFrame) -> pd.DataFrame:
        lost = frame["time"].between(begin, finish)
        return frame.assign(plate_ok=frame["plate_ok"] & ~lost)

    done = again(seated, lose, seat_plate=False)
    low = done.frame["time"].between(begin + 0.3, finish).to_numpy()
    assert done.frame["contact"][low].all() and np.isnan(done.torques()[low][:, :2]).all()


def test_without_plates_in_standing_a_chair_may_be_there_whenever_the_hips_are_low(seated: Finished) -> None:
    """Reason `contact-unknown`: nobody knows whether there is a chair."""
    stands = seated.true("chair_force")[:, 1] < 1.0

    def lose(frame: pd.DataFrame) -> pd.DataFrame:
        return frame.assign(plate_ok=frame["plate_ok"] & ~stands)

    done = again(seated, lose, seat_plate=False)
    assert "contact-unknown" in done.codes
    assert done.frame["contact"][seated.on_chair].all()
    assert np.isnan(done.torques()[seated.on_chair][:, :2]).all()


def test_without_a_protocol_that_knows_chairs_a_trial_on_one_is_refused(seated: Finished) -> None:
    """The movement gives a smaller mass than standing, so something carries the body at unknown times."""
    folder = Folder(seated.folder)
    inputs = {file: folder.read(file) for file in STAGE.inputs}
    trial = load(seated.source / "trial.yaml")
    settings = IdentifyDimSettings(seat_plate=False)
    with pytest.raises(Refused) as refused:
        STAGE.function(Context(trial.keys.model_copy(update={"protocol": "free"}), settings, inputs))
    assert refused.value.code == "load-shared"


WRONG = {
    "reversed": (-1.0, -1.0, -1.0, 0.0),
    "turned half round": (-1.0, 1.0, -1.0, 0.0),
    "ten centimetres off": (1.0, 1.0, 1.0, 0.1),
    "one of four legs beside it": (0.75, 0.75, 0.75, 0.0),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_seat_plate_is_caught(seated: Finished, gated: Finished, name: str) -> None:
    fx, fy, tauz, shift = WRONG[name]

    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame["tauz_seat"] = tauz * frame["tauz_seat"] + shift * frame["Fy_seat"]
        return frame.assign(Fx_seat=fx * frame["Fx_seat"], Fy_seat=fy * frame["Fy_seat"])

    caught = again(seated, change)
    assert "seat-contradiction" in caught.codes
    assert caught.tree.facts["external"] == []
    np.testing.assert_array_equal(caught.base[0], gated.base[0])  # as if there were no such plate
    np.testing.assert_array_equal(caught.events["seat_off"], gated.events["seat_off"])


def test_plates_swapped_in_the_configuration_are_caught(seated: Finished, tmp_path: Path) -> None:
    yaml = tmp_path / "trial.yaml"
    keys = {"trial": "swapped", "recording": str(seated.source / "trial.c3d"), "protocol": "sit-to-stand"}
    yaml.write_text(json.dumps({**keys, "plates": {"feet": [2], "seat": [1]}}))
    outcome = run(load(yaml))
    wrench = Folder(outcome.folder).read("wrench.parquet")
    doubts = [reason.message for reason in wrench.reasons if reason.code == "plates-doubtful"]
    assert len(doubts) == 2
    assert "Are they swapped in" in doubts[0]
    assert wrench.facts["external"] == []
    assert outcome.summary()["verdict"]["level"] == "caution"


RAIL = np.array([-0.35, 1.0, 0.0])
"""Position of the hand on the rail, plane frame, m."""


def on_rail(time: np.ndarray) -> np.ndarray:
    """Return the wrench (T, 3) of the rail on the hand: up to 80 N up and 25 N along x, varying between movements."""
    level = 0.5 + 0.5 * np.sin(0.9 * time + 0.4) * np.sin(2.3 * time)
    force = np.column_stack([25 * np.sin(1.7 * time), 80 * level])
    return np.column_stack([force, RAIL[0] * force[:, 1] - RAIL[1] * force[:, 0]])


@pytest.fixture(scope="module")
def holding(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The seated trial with a hand on a rail, whose sensor logs the force of the hand, 0.2 s early."""
    folder = tmp_path_factory.mktemp("rail") / "trial"
    simulate("sit-to-stand", folder, OPTIONS)
    made = generate("sit-to-stand", OPTIONS)
    stamps = np.arange(len(made.signals.channels)) / OPTIONS.analog_rate + OPTIONS.clock_offset
    state = made.scene.at(stamps)
    load_now = made.scene.load_on_plate(replace(state, wrench=state.wrench - on_rail(stamps)))
    signals = measure_load(np.random.default_rng(3), made.scene.plate, *load_now, OPTIONS.analog_rate)
    plates = (signals, made.seat_signals)
    write_c3d(folder / "trial.c3d", made.scene.markers.labels, made.points, OPTIONS.rate, plates=plates)
    logged = np.arange(0.0, made.scene.motion.duration, 1 / 400)
    force = np.column_stack([on_rail(logged)[:, :2], 0 * logged]) @ made.scene.plane.axes
    table = np.column_stack([logged - 0.2, -force])
    np.savetxt(folder / "rail.csv", table, delimiter=",", header="time_s,Fx_N,Fy_N,Fz_N", comments="", fmt="%.6f")
    at = made.scene.plane.from_plane(RAIL).tolist()
    sensor = {"file": "rail.csv", "name": "rail", "segment": "torso", "at": at, "force": "on-sensor"}
    with (folder / "trial.yaml").open("a") as yaml:
        yaml.write(f"external: [{json.dumps({**sensor, 'clock_offset_s': 0.2})}]\n")
    return finish(folder / "trial.yaml")


def test_a_hand_on_a_rail_with_a_sensor(holding: Finished) -> None:
    """Errors are as without the rail; without the sensor the mass is 4 kg too small."""
    assert holding.codes == ["seat-measured"]
    value, _ = holding.base
    truth = np.array(holding.truth["base_parameters"]["values"])
    assert np.abs(value / truth - 1)[INVARIANT].max() < 0.02
    time = holding.frame["time"].to_numpy()
    with np.load(holding.source / "truth.npz") as arrays:
        q = CubicSpline(arrays["t"], arrays["q"])(time)
    centres = np.array([segment["p_in_parent_m"] for segment in holding.truth["segments"][1:]])
    moment = np.einsum("tcj,tc->tj", planar.joint_twists(q, centres), on_rail(time))
    error = holding.torques() - (holding.true("tau") - moment)
    assert (rms(error) < (3.0, 2.0, 1.0)).all()
    assert (rms(moment) > 15).all()
    ground = holding.frame[["Fx_model", "Fy_model", "tauz_model"]].to_numpy()
    assert (rms(ground - (holding.true("wrench") - on_rail(time))) < (2.0, 6.0, 2.0)).all()
    facts = {fact["name"]: fact for fact in holding.tree.facts["external"]}
    assert facts["rail"]["segment"] == 3
    for factor in facts["rail"]["factors"].values():
        assert factor["value"] == pytest.approx(1.0, abs=0.1)
    names = [f"{name}_external_1" for name in ("Fx", "Fy", "tauz")]
    blind = again(holding, lambda frame: frame.assign(**{name: 0.0 * frame[name] for name in names}))
    assert blind.base[0][0] < value[0] - 3.0


def test_a_sensor_with_the_wrong_sign_is_reported(holding: Finished) -> None:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        return frame.assign(**{name: -frame[name] for name in frame if name.endswith("_external_1")})

    told = again(holding, change)
    message = next(reason.message for reason in told.tree.reasons if reason.code == "external-contradiction")
    assert "`rail` times -" in message


@pytest.mark.parametrize("late", [-0.08, 0.3])
def test_a_sensor_with_a_wrong_clock_is_reported(holding: Finished, late: float) -> None:
    """Its samples come ``late``, s: the time stamp t was given at t - late."""

    def change(frame: pd.DataFrame) -> pd.DataFrame:
        names = [name for name in frame if name.endswith("_external_1")]
        time = frame["time"].to_numpy()
        return frame.assign(**{name: np.interp(time - late, time, frame[name]) for name in names})

    told = again(holding, change)
    reason = next(each for each in told.tree.reasons if each.code == "external-clock")
    assert reason.value == pytest.approx(-late, abs=0.02)
    assert "`rail`" in reason.message
