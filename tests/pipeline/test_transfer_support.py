"""Support of a transfer: known without the other trial's forces, and confirmed by them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.dynamics.prediction import centre_of_pressure, register_bodies, transfer_covariance, transfer_parameters
from mocap_id.dynamics.priors import ReferencePrior
from mocap_id.errors import ConfigError
from mocap_id.reporting.explanations import EXPLANATIONS
from mocap_id.workflows.identified_trial import IdentifiedTrial, open_identified_trial
from mocap_id.workflows.transfer import (
    SERIES,
    TRANSFERRED,
    TrialTransfer,
    apply_model,
    find_support,
    predict_sd,
    predict_series,
    rms_error,
    share_inside,
    stated_sd,
    warn_if_worse_than_stated,
)
from mocap_id_simulation import Options, simulate

STS = {"protocol": "sit-to-stand", "subject": {"mass": 60.0}}


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[IdentifiedTrial, IdentifiedTrial]:
    """Two strategies of one simulated person, on the pinned chain."""
    folder = tmp_path_factory.mktemp("person")
    options = Options(repetitions=2, analog_rate=100, seed=41)
    made = []
    for strategy in ("normal", "dynamic"):
        trial = Path(simulate("sit-to-stand", folder / strategy, replace(options, strategy=strategy)))
        trial.write_text(f"{trial.read_text()}identify-dim: {{motion: chain}}\n")
        made.append(open_identified_trial(trial))
    return made[0], made[1]


def on(source: IdentifiedTrial, target: IdentifiedTrial) -> tuple[FloatArray, FloatArray]:
    """Return what the source's body on the target's chain predicts, with the standard deviations."""
    registration = register_bodies(source.skeleton, target.chain.skeleton)
    parameters = transfer_parameters(source.parameters, registration)
    covariance = transfer_covariance(source.covariance, registration)
    sd = predict_sd(target, target.chain, parameters, covariance)
    return predict_series(target, target.chain, parameters), sd


def codes(found: TrialTransfer) -> set[str]:
    assert {reason.code for reason in found.reasons} <= set(EXPLANATIONS)
    return {reason.code for reason in found.reasons}


def test_the_full_covariance_contains_that_of_the_base_parameters() -> None:
    """In undetermined directions it is the prior's, as samples conditioned on the base parameters show."""
    rng = np.random.default_rng(0)
    regrouping, root = rng.normal(size=(5, 8)), rng.normal(size=(5, 5))
    prior, known = ReferencePrior(rng.normal(size=8), rng.uniform(0.5, 2.0, 8)), root @ root.T
    full = prior.complete(known, regrouping)
    np.testing.assert_allclose(regrouping @ full @ regrouping.T, known, atol=1e-10)
    half = np.diag(prior.sd)
    draws = half @ rng.normal(size=(8, 200_000))
    nearest = half @ np.linalg.pinv(regrouping @ half)
    other = nearest @ (root @ rng.normal(size=(5, 200_000)) - regrouping @ draws) + draws
    np.testing.assert_allclose(np.cov(other), full, atol=0.02 * np.max(np.diag(full)))


def test_the_transferred_covariance_is_that_of_transferred_samples(pair) -> None:
    source, target = pair
    registration = register_bodies(source.skeleton, target.skeleton)
    registration = replace(
        registration, angle=registration.angle + 0.3, shift=registration.shift + np.array([0.1, -0.05])
    )
    rng = np.random.default_rng(1)
    root = rng.normal(size=(16, 16))
    draws = root @ rng.normal(size=(16, 1000))
    moved = np.column_stack([transfer_parameters(one, registration) for one in draws.T])
    expected = transfer_covariance(np.cov(draws), registration)
    np.testing.assert_allclose(np.cov(moved), expected, atol=1e-9 * np.max(np.abs(expected)))


def test_no_force_of_the_other_trial_is_used(pair) -> None:
    source, target = pair
    blind = target.dynamics.assign(**dict.fromkeys(("Fx", "Fy", "tauz", "cop_x"), np.nan), in_fit=False)
    unseen = replace(target, dynamics=blind, parameters=np.full(16, np.nan))
    carried = on(source, target)
    assert find_support(source, unseen, *carried) == find_support(source, target, *carried)
    found = apply_model(source, unseen)
    assert codes(found) == {"transfer-nothing"}
    assert found.supported is None


def test_without_a_table_nothing_is_shown(pair) -> None:
    source, target = pair
    bare = replace(target, reference=np.full(16, np.nan), facts={**target.facts, "reference_table": None})
    found = apply_model(source, bare)
    assert (found.support, found.reasons, found.supported) == (None, (), None)


def test_the_difference_is_that_of_two_predictions(pair) -> None:
    source, target = pair
    carried = on(source, target)
    found = find_support(source, target, *carried)
    assert found is not None
    parameters = transfer_parameters(source.parameters, register_bodies(source.skeleton, target.chain.skeleton))
    ours, table = (target.bodies.regressor @ full for full in (parameters, target.reference))
    pressures = [centre_of_pressure(wrench, target.cop_threshold) for wrench in (ours, table)]
    assert found["cop_x"]["apart_rms"] == pytest.approx(np.sqrt(np.nanmean((pressures[0] - pressures[1]) ** 2)))
    assert found["tauz"]["apart_rms"] == pytest.approx(np.sqrt(np.mean((ours - table)[:, 2] ** 2)))


def test_a_hardly_known_body_cannot_be_distinguished_from_the_table(pair) -> None:
    source, target = pair
    vague = replace(source, covariance=source.covariance * 400)
    found = apply_model(vague, target)
    assert codes(found) == {"transfer-not-told-apart"}
    assert found.supported is False


def test_a_body_no_better_than_the_table_in_its_own_trial_is_not_transferred(pair) -> None:
    source, target = pair
    held_out = source.facts["held_out"]
    swapped = {**held_out, "model": held_out["reference"], "reference": held_out["model"]}
    found = apply_model(replace(source, facts={**source.facts, "held_out": swapped}), target)
    assert codes(found) == {"transfer-not-at-home"}
    (reason,) = found.reasons
    assert reason.value == pytest.approx(
        max(
            np.hypot(held_out["reference"][name]["bias"], held_out["reference"][name]["sd"])
            / np.hypot(held_out["model"][name]["bias"], held_out["model"][name]["sd"])
            for name in ("Fy", "tauz", "cop_x")
        )
    )


def test_a_joint_at_two_places_is_reported(pair) -> None:
    source, target = pair
    centres = source.skeleton.centres + np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.04]])
    placed = replace(source.chain, skeleton=replace(source.skeleton, centres=centres))
    found = apply_model(replace(source, chain=placed), target)
    (reason,) = [reason for reason in found.reasons if reason.code == "transfer-joints"]
    assert "between thigh and torso" in reason.message
    assert reason.value == pytest.approx(0.04, abs=0.005)


def errors(found: TrialTransfer, name: str, series: str) -> float:
    return next(rms_error(body.errors[series]) for body in found.bodies if body.name == name)


def test_the_stated_deviation_covers_parameters_and_the_own_error(pair) -> None:
    source, target = pair
    carried = on(source, target)
    known = stated_sd(source, target, np.zeros_like(carried[1]))
    held_out = source.facts["held_out"]["model"]
    expected = [1.4 * np.hypot(held_out[name]["bias"], held_out[name]["sd"]) for name in SERIES]
    np.testing.assert_allclose(np.nanmax(known, axis=0), expected)
    wider = stated_sd(source, target, carried[1])
    both = np.isfinite(wider)
    assert (wider[both] >= known[both]).all()


def test_intervals_with_too_few_samples_inside_are_reported() -> None:
    rng = np.random.default_rng(3)
    ours, samples = np.zeros((20_000, 4)), np.arange(20_000) % 3 > 0
    measured = rng.normal(size=(20_000, 4)) * [1.0, 1.0, 2.0, 1.0]
    measured[:, 3] = np.nan
    shares = share_inside(ours, measured, np.ones((20_000, 4)), samples)
    assert shares["Fx"] == pytest.approx(0.95, abs=0.01)
    assert shares["tauz"] == pytest.approx(0.673, abs=0.01)
    assert np.isnan(shares["cop_x"])
    (reason,) = warn_if_worse_than_stated(shares)
    assert reason.code == "transfer-worse-than-stated"
    assert reason.value == shares["tauz"] < reason.limit == 0.8
    assert "tauz (67 %)" in reason.message


def test_a_body_worse_than_stated_is_not_supported(pair) -> None:
    source, target = pair
    off = target.dynamics.assign(tauz=target.dynamics["tauz"] + 60.0)
    found = apply_model(source, replace(target, dynamics=off))
    assert "transfer-worse-than-stated" in codes(found)
    assert found.supported is False


@pytest.mark.recordings
def test_transfer_between_real_sit_to_stand_and_squats(trial) -> None:
    """Five segments in one trial, four in the other, and shoulders on the torso in only one of them."""
    sts = open_identified_trial(Path(trial("sit-to-stand/STS1.trc", **STS).folder))
    squats = open_identified_trial(Path(trial("sit-to-stand/squats1.trc", **STS).folder))
    assert len(sts.chain.skeleton.segments) == 5
    assert len(squats.chain.skeleton.segments) == 4
    for source, target, limit in ((sts, squats, 0.012), (squats, sts, 0.015)):
        found = apply_model(source, target)
        assert errors(found, TRANSFERRED, "cop_x") <= limit
        assert errors(found, TRANSFERRED, "cop_x") < errors(found, "winter", "cop_x")
        assert "transfer-markers" not in codes(found), "arms change their shape"
        assert min(found.inside.values()) > 0.8
        json.dumps([reason.as_dict() for reason in found.reasons], allow_nan=False)


@pytest.mark.recordings
def test_a_real_body_without_markers_is_refused_by_name(trial) -> None:
    sts = open_identified_trial(Path(trial("sit-to-stand/STS1.trc", **STS).folder))
    squats = open_identified_trial(Path(trial("sit-to-stand/squats1.trc", **STS).folder))
    assert sts.measured is not None
    skeleton = sts.measured.skeleton
    torso = skeleton.segments.index("torso")
    labels = [f"X{label}" if k == torso else label for label, k in zip(skeleton.markers, skeleton.segment, strict=True)]
    renamed = replace(sts, measured=replace(sts.measured, skeleton=replace(skeleton, markers=tuple(labels))))
    with pytest.raises(ConfigError, match="markers on the torso of trial"):
        apply_model(renamed, squats)


@pytest.mark.recordings
def test_on_its_own_trial_a_matched_body_is_the_own_model(trial) -> None:
    """The markers have the same places, so the registration is the identity and the wrench the same."""
    squats = open_identified_trial(Path(trial("sit-to-stand/squats1.trc", **STS).folder))
    found = apply_model(squats, squats)
    np.testing.assert_allclose(found.registration.angle, 0.0, atol=0.01)
    assert errors(found, TRANSFERRED, "cop_x") == pytest.approx(errors(found, "own", "cop_x"), rel=0.1)
    assert found.reasons == ()
