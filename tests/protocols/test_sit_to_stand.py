"""Sit-to-stand: all repetitions and the chair contact are found, and squats have no chair."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from protocol_cases import BODY, CENTRES, WEIGHT, sit_to_stand

from mocap_id.arrays import find_runs
from mocap_id.dynamics.preparation import FitSettings, TrialData, prepare
from mocap_id.protocols import sit_to_stand as protocol
from mocap_id.protocols.movement import Movement, find_facing, find_movement
from mocap_id.protocols.repetitions import Posture, compute_posture
from mocap_id.protocols.sit_to_stand import find_contact_in_low_phases, measure_standing_weight, uses_chair

RULES = {"weight_share": 0.72, "knee_bend": 0.8}


def read(recorded: TrialData, rule: str = "seat-force", *, plate: bool = True, stands: bool = True, **fit) -> Movement:
    prepared = prepare(recorded, FitSettings(**fit)) if plate else None
    return find_movement("sit-to-stand", recorded, prepared, rule, **RULES, stands=stands)


@pytest.mark.parametrize("count", [1, 3, 7])
def test_every_repetition_is_found(count: int) -> None:
    recorded, truth = sit_to_stand(count)
    found = read(recorded).repetitions
    assert len(found) == count
    assert all(rep.complete and rep.why == "" for rep in found)
    for name, within in (("start", 0.35), ("stand", 0.35), ("end", 0.35), ("seat_off", 0.12), ("seat_on", 0.12)):
        np.testing.assert_allclose([getattr(rep, name) for rep in found], getattr(truth, name), atol=within)
    for rep in found:
        assert rep.start < rep.seat_off < rep.stand < rep.seat_on < rep.end


def test_no_sample_with_chair_contact_is_used() -> None:
    recorded, truth = sit_to_stand(4)
    movement = read(recorded)
    off_chair = np.zeros(len(recorded.time), dtype=bool)
    for off, on in zip(truth.seat_off, truth.seat_on, strict=True):
        off_chair |= (recorded.time >= off) & (recorded.time <= on)
    assert (movement.free & off_chair).sum() > 0.95 * off_chair.sum()
    # the remaining samples are the end of the unloading, below half a per cent of the weight
    assert (movement.free & ~off_chair).sum() < 0.12 * off_chair.sum()
    assert movement.contact.threshold == pytest.approx(0.005 * WEIGHT, rel=0.01)


def test_seat_force_keeps_more_samples_than_knee_and_misses_less_contact_than_weight() -> None:
    recorded, truth = sit_to_stand(4)
    found = {rule: read(recorded, rule) for rule in ("seat-force", "weight", "knee")}
    assert found["knee"].free.sum() < 0.8 * found["seat-force"].free.sum()
    errors = {
        rule: np.abs([rep.seat_off - off for rep, off in zip(found[rule].repetitions, truth.seat_off, strict=True)])
        for rule in ("seat-force", "weight")
    }
    assert errors["seat-force"].max() < 0.7 * errors["weight"].min()


def test_squats_have_no_chair_and_use_every_sample() -> None:
    recorded, _ = sit_to_stand(3, chair=False, begins_upright=True)
    movement = read(recorded)
    assert not movement.contact.chair
    assert movement.free.all()
    assert [reason.code for reason in movement.reasons] == ["no-chair"]
    assert len(movement.repetitions) == 3
    for rep in movement.repetitions:
        assert rep.complete
        assert np.isnan([rep.seat_off, rep.seat_on]).all()
        assert rep.start < rep.stand == rep.end


def test_a_trial_that_begins_and_ends_upright_reports_missing_events() -> None:
    recorded, truth = sit_to_stand(3)
    cut = slice(int(2.9 * 100), int(15.5 * 100))  # upright to upright
    samples = ("time", "q", "dq", "ddq", "ddq_sd", "observed", "wrench")
    part = replace(recorded, **{name: getattr(recorded, name)[cut] for name in samples})
    found = read(part).repetitions
    assert [rep.complete for rep in found] == [False, True, False]
    assert found[0].why == "the recording begins upright"
    assert np.isnan([found[0].start, found[0].seat_off]).all()
    assert found[0].seat_on == pytest.approx(truth.seat_on[0], abs=0.12)
    assert found[2].why == "the recording ends upright"
    assert np.isnan([found[2].seat_on, found[2].end]).all()


def test_without_a_plate_the_posture_gives_the_repetitions() -> None:
    recorded, truth = sit_to_stand(2)
    found = read(recorded, plate=False).repetitions
    assert len(found) == 2
    assert not any(rep.complete for rep in found)
    assert "no plate" in found[0].why
    np.testing.assert_allclose([rep.stand for rep in found], truth.stand, atol=0.35)


def test_gaps_in_the_angles_do_not_add_repetitions() -> None:
    recorded, _ = sit_to_stand(3)
    q, dq = recorded.q.copy(), recorded.dq.copy()
    q[900:930], dq[900:930] = np.nan, np.nan
    assert len(read(TrialData(**{**recorded.__dict__, "q": q, "dq": dq})).repetitions) == 3


@pytest.mark.parametrize("stands", [True, False])
def test_swaying_is_not_a_rise(stands: bool) -> None:
    """Samples are used only if the person is known to stand, because a seated person sways too."""
    recorded, _ = sit_to_stand(2)
    still = {name: 0.05 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    movement = read(TrialData(**{**recorded.__dict__, **still}), stands=stands)
    assert movement.repetitions == ()
    assert [reason.code for reason in movement.reasons] == ["no-repetitions"]
    assert movement.free.all() == stands
    assert movement.free.any() == stands


def without_plate(recorded: TrialData, upright: bool) -> TrialData:
    """The plate has no reading in the upright, or in the low, phases."""
    body = compute_posture(recorded.q, recorded.dq, CENTRES)
    wrench = recorded.wrench.copy()
    wrench[body.upright == upright] = np.nan
    return TrialData(**{**recorded.__dict__, "wrench": wrench})


@pytest.mark.parametrize("upright", [True, False])
def test_without_plate_readings_in_a_phase_the_chair_is_unknown(upright: bool) -> None:
    recorded, _ = sit_to_stand(4)
    movement = read(without_plate(recorded, upright))
    assert movement.contact.chair is None
    assert movement.contact.touching is None
    assert movement.contact.rule == "knee"
    assert [reason.code for reason in movement.reasons] == ["contact-unknown"]
    bent = np.abs(recorded.q[:, 1]) >= RULES["knee_bend"]
    assert not movement.free[bent].any()
    assert len(movement.repetitions) == 4
    assert not any(rep.complete for rep in movement.repetitions)


def test_without_Fy_in_the_fit_the_seat_force_is_not_used() -> None:
    recorded, _ = sit_to_stand(4)
    movement = read(recorded, components=(0, 2))
    assert movement.contact.rule == "weight"
    assert [reason.code for reason in movement.reasons] == ["contact-rule"]


def test_contact_converges(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, _ = sit_to_stand(4)
    settled = read(recorded)
    assert settled.contact.converged is True
    assert settled.reasons == ()
    monkeypatch.setattr(protocol, "_ROUNDS", 1)
    cut = read(recorded)
    assert cut.contact.converged is False
    assert [reason.code for reason in cut.reasons] == ["contact-unsettled"]
    assert cut.free.sum() < settled.free.sum()  # the contact of both rounds is excluded


def test_alternating_contact_is_excluded(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, _ = sit_to_stand(4)
    steady, thresholds = protocol.compute_contact_threshold, iter([1.0, 60.0] * 10)
    monkeypatch.setattr(protocol, "compute_contact_threshold", lambda *given: next(thresholds) * steady(*given))
    flickering = read(recorded)
    assert flickering.contact.converged is False
    monkeypatch.setattr(protocol, "compute_contact_threshold", steady)
    assert np.mean(flickering.free & ~read(recorded).free) < 0.005


def test_a_round_with_too_few_samples_keeps_the_previous_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, _ = sit_to_stand(4)
    before = read(recorded, "weight").contact
    rules = iter([protocol.find_contact_in_low_phases, lambda body, signs: np.ones(len(signs), dtype=bool)])

    def in_turn(body: Posture, signs: np.ndarray) -> np.ndarray:
        return next(rules)(body, signs)

    monkeypatch.setattr(protocol, "find_contact_in_low_phases", in_turn)
    found = read(recorded).contact
    assert found.converged is False
    assert found.free.sum() > 100
    assert not (found.free & before.touching).any()


def test_too_few_samples_off_the_chair_fall_back_to_the_weight_rule() -> None:
    recorded, _ = sit_to_stand(1)
    wrench = recorded.wrench.copy()
    wrench[200:340] = wrench[380:520] = np.nan  # the plate fails while the person moves
    movement = read(TrialData(**{**recorded.__dict__, "wrench": wrench}))
    assert movement.contact.rule == "weight"
    assert [reason.code for reason in movement.reasons] == ["contact-rule"]


def test_standing_weight_and_chair() -> None:
    recorded, _ = sit_to_stand(2)
    body, vertical = compute_posture(recorded.q, recorded.dq, CENTRES), recorded.wrench[:, 1]
    weight = measure_standing_weight(body, vertical)
    assert weight == pytest.approx(9.81 * BODY[:, 0].sum(), rel=2e-3)
    assert uses_chair(body, vertical, weight)
    assert not uses_chair(body, np.full_like(vertical, weight), weight)
    unknown = np.full_like(vertical, np.nan)
    assert np.isnan(measure_standing_weight(body, unknown))
    assert uses_chair(body, vertical, float("nan")) is None
    assert uses_chair(body, unknown, weight) is None


def test_contact_is_one_interval_per_low_phase_and_extends_to_the_ends() -> None:
    recorded, _ = sit_to_stand(2)
    body = compute_posture(recorded.q, recorded.dq, CENTRES)
    signs = np.zeros(len(recorded.time), dtype=bool)
    lows = find_runs(~body.upright)
    assert len(lows) == 3
    for low in lows:  # flickering signs
        signs[low.start + 60 : low.stop - 60 : 7] = True
    signs[body.height > 0.9] = True  # something else
    found = find_runs(find_contact_in_low_phases(body, signs))
    assert len(found) == 3
    assert found[0].start == 0
    assert found[-1].stop == len(signs)


def test_facing_follows_the_knee() -> None:
    recorded, _ = sit_to_stand(1)
    assert find_facing(recorded) == -1
    assert find_facing(TrialData(**{**recorded.__dict__, "q": -recorded.q})) == 1


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["sts-normal", "sts-dynamic", "sts-stable-rotated-plate"])
def test_events_of_simulated_recordings(recordings: Path, name: str) -> None:
    """Events from true states and a simulated wrench agree with the truth."""
    folder = recordings / "simulated" / name
    told, arrays = json.loads((folder / "truth.json").read_text()), dict(np.load(folder / "truth.npz"))
    thinned = {key: arrays[key][::4] for key in ("t", "q", "qd", "qdd", "wrench", "wrench_total")}
    time, observed = thinned["t"], np.ones(len(thinned["t"]), dtype=bool)
    centres = np.array([s["p_in_parent_m"] for s in told["segments"][1:]])
    noise = np.random.default_rng(0).normal(size=thinned["wrench"].shape) * [0.9, 0.9, 0.3]
    states = (time, thinned["q"], thinned["qd"], thinned["qdd"], 0 * thinned["q"], observed)
    movement = read(TrialData(*states, thinned["wrench"] + noise, centres))
    found = movement.repetitions
    assert len(found) == len(told["reps"])
    for rep, true in zip(found, told["reps"], strict=True):
        assert rep.complete
        assert abs(rep.seat_off - true["seat_off"]) < 0.07
        assert abs(rep.seat_on - true["seat_on"]) < 0.05
        assert abs(rep.start - true["rise_start"]) < 0.3
        assert abs(rep.stand - true["rise_end"]) < 0.4
        assert abs(rep.end - true["sit_end"]) < 0.3
    # the same movement with all its weight under the feet has no chair
    everything = TrialData(*states, thinned["wrench_total"].astype(float) + noise, centres)
    squatting = read(everything)
    assert not squatting.contact.chair
    assert squatting.free.all()
