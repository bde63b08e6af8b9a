"""Simulated curls: torques that agree with energy, keys of the device, and a study that is valid."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.config import load
from mocap_id.config.study import load_study
from mocap_id.errors import ConfigError
from mocap_id_simulation import ArmOptions, CurlStudy, simulate_arm, simulate_curl_study, write_arm
from mocap_id_simulation.arm import DEVICE
from mocap_id_simulation.options import CurlCondition
from mocap_id_simulation.studies import EFFECTS, curl_study_trials

SHORT = ArmOptions(seed=4, movement="curl", rate=30, failed=1)


def test_the_torque_at_rest_is_that_of_gravity() -> None:
    trial = simulate_arm(3, "clean", "curl", repetitions=1)
    still = trial.time < 1.5
    axis = trial.rotations[:, 1] @ trial.document["body"].elbow_axis
    total = trial.arrays["tau_total"][still]
    np.testing.assert_allclose(total, total[0], atol=1e-3)
    hand, elbow = trial.origins[still, 3], trial.origins[still, 2]
    pull = np.cross(hand - elbow, [0.0, 0.0, 9.81 * 3.59])
    assert 0.8 < total[0] / np.einsum("ti,ti->t", axis[still], pull)[0] < 2.5, "dumbbell, hand and forearm"


@pytest.mark.parametrize(("condition", "sign"), [("C", 0), ("5", 1), ("2", -1)])
def test_a_device_helps_or_resists(condition: CurlCondition, sign: int) -> None:
    trial = simulate_arm(3, "clean", "curl", repetitions=1, condition=condition, rate=60)
    device = trial.arrays["tau_device"]
    assert sign * device.mean() >= 0
    assert (np.abs(device).max() > 1) == bool(sign)
    np.testing.assert_allclose(trial.arrays["tau_total"], device + trial.arrays["tau_human"], atol=1e-9)


def test_a_trial_names_its_device_and_calibration(tmp_path: Path) -> None:
    write_arm(tmp_path / "reach", ArmOptions(seed=4, movement="curl", repetitions=1, rate=30))
    options = ArmOptions(
        seed=4, movement="curl", repetitions=1, rate=30, condition="5", calibration="../reach/trial.yaml"
    )
    keys = load(write_arm(tmp_path / "curl", options)).keys
    assert keys.calibration is not None
    assert keys.curl.device is not None
    assert keys.curl.device["sealed"] == DEVICE.conditions["5"].model_dump(mode="json")
    assert set(keys.curl.loads) == {"dumbbell", "brace"}
    truth = json.loads((tmp_path / "curl" / "truth.json").read_text())
    assert truth["bodies"]["hand"]["mass"] == keys.curl.hand.mass if keys.curl.hand else False


def test_a_study_is_valid_and_has_the_effect_that_was_put_in(tmp_path: Path) -> None:
    study = load_study(simulate_curl_study(tmp_path / "s", CurlStudy(1, 1, ("AC", "5"), SHORT)))
    assert study.curl
    assert study.reference == "AC"
    assert [(one.name, one.condition, one.number) for one in study.trials] == [
        ("s01-AC-1", "AC", 1),
        ("s01-5-1", "5", 1),
    ]
    assert all(one.trial.keys.calibration for one in study.trials)
    many = list(curl_study_trials(CurlStudy(40, 3)))
    count = {one.name: one.options.repetitions for one in many}
    for condition, effect in EFFECTS.items():
        ratios = [
            n / count[name.replace(f"-{condition}-", "-AC-")] for name, n in count.items() if f"-{condition}-" in name
        ]
        assert np.mean(ratios) == pytest.approx(1 + effect, abs=0.07)


def test_a_study_needs_its_reference() -> None:
    with pytest.raises(ConfigError, match="expected AC and, if needed, others of C, AC, 2"):
        CurlStudy(conditions=("C", "5"))
