"""Errors of scale: their effect on the parameters, and which of them a recording names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dynamics_cases import BODY, CENTRES, moving_body

from mocap_id.config import load
from mocap_id.dynamics.cautions import check_scales, find_body_ratios
from mocap_id.dynamics.consistency import build_grid
from mocap_id.dynamics.fit import Fit, fit
from mocap_id.dynamics.identification import Identification, identify
from mocap_id.dynamics.instrument_errors import (
    KinematicError,
    PlanarCalibration,
    ScaleCheck,
    compute_scale_variance,
    propagate_calibration,
)
from mocap_id.dynamics.preparation import FitSettings, PreparedTrial, TrialData, prepare
from mocap_id.runner import run_stage
from mocap_id.store import Folder
from mocap_id_simulation import Options, simulate
from mocap_id_simulation.options import FaultOptions

GRID = build_grid(
    CENTRES, np.repeat([0, 1, 2, 3], 2), np.array([[-0.25, 0.0], [0.08, 0.1], *3 * [[-0.12, 0.1], [0.12, 0.85]]])
)
MASS = float(BODY[:, 0].sum())


def calibration(mass: float | None = None, mass_sd: float = 1.0) -> PlanarCalibration:
    return PlanarCalibration(0.01, 0.01, lengths=0.003, tilt=0.005, position=0.005, mass=mass, mass_sd=mass_sd)


NOISE = (1.0, 1.0, 0.3)
STAGES = ("planarise", "segment", "fit-joints", "ukf-smooth", "identify-dim")


def identified(recorded: TrialData) -> tuple[PreparedTrial, Identification]:
    prepared = prepare(recorded, FitSettings())
    everything = np.ones(len(recorded.time), dtype=bool)
    return prepared, identify(prepared, everything, GRID, np.full(16, np.nan), KinematicError.none(3))


def with_wrench(gain: tuple[float, float, float] = (1, 1, 1), force: float = 0.0, position: float = 0.0) -> TrialData:
    """A recording whose plate has these gains, constant vertical force (N) and displacement (m)."""
    recorded = moving_body(24.0, noise=NOISE)
    wrench = recorded.wrench * gain
    wrench[:, 2] += position * recorded.wrench[:, 1]
    wrench[:, 1] += force
    return replace(recorded, wrench=wrench)


def with_rate(error: float) -> TrialData:
    """A recording whose file has a wrong rate: velocities and accelerations are computed with it."""
    recorded = moving_body(24.0, noise=NOISE)
    factor = 1 + error
    return replace(recorded, time=recorded.time / factor, dq=recorded.dq * factor, ddq=recorded.ddq * factor**2)


def with_cameras(scale: float = 1.0, tilt: float = 0.0) -> TrialData:
    """A recording with wrong lengths, or with a frame that is tilted by an angle (rad)."""
    recorded = moving_body(24.0, noise=NOISE)
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    centres, q = scale * CENTRES, recorded.q.copy()
    centres[0] = turn @ centres[0]
    q[:, 0] += tilt
    return replace(recorded, centres=centres, q=q)


def solution(found: Fit) -> np.ndarray:
    """Base parameters, bias and shift of the clocks by least squares with fixed weights."""
    return np.linalg.lstsq(found.design.reshape(-1, found.design.shape[-1]), found.target.ravel(), rcond=None)[0]


def checked(recorded: TrialData, mass: float | None = None) -> ScaleCheck:
    prepared, found = identified(recorded)
    ratios = find_body_ratios(
        prepared.base, recorded.centres, BODY.ravel(), float(found.base[0]), calibration(mass=mass)
    )
    scales = check_scales(prepared, np.ones(len(recorded.time), dtype=bool), found, ratios)
    assert scales is not None
    return scales


@pytest.mark.parametrize(
    ("recorded", "cause", "size"),
    [
        (with_rate(0.05), "inertia", 1.05**-2 - 1),
        (with_rate(-0.2), "inertia", 0.8**-2 - 1),
        (with_wrench((1, 1, 1.05)), "moments", 0.05),
        (with_wrench((1, 0.95, 1)), "vertical gain", -0.05),
        (with_wrench(force=40.0), "vertical force", 40.0),
        (with_wrench(position=0.03), "position", 0.03),
        (with_cameras(scale=1.04), "lengths", 0.04),
        (with_cameras(tilt=0.026), "tilt", 0.026),
    ],
)
def test_a_wrong_scale_is_named_with_its_size(recorded: TrialData, cause: str, size: float) -> None:
    causes, suspects = checked(recorded, MASS)
    assert suspects == (cause,)
    assert causes[cause].value == pytest.approx(size, rel=0.25)


@pytest.mark.parametrize("mass", [None, MASS])
def test_a_good_recording_raises_no_alarm(mass: float | None) -> None:
    assert checked(with_wrench(), mass)[1] == ()


def test_only_a_known_mass_shows_a_common_gain() -> None:
    spoiled = with_wrench((1.1, 1.1, 1.1))
    causes, suspects = checked(spoiled)
    assert suspects == ()
    assert "gain" not in causes
    assert checked(spoiled, MASS)[1] == ("gain",)


@pytest.mark.parametrize(
    ("mode", "name", "spoiled"),
    [
        (0, "gain", with_wrench((1.01, 1.01, 1.01))),
        (1, "moments", with_wrench((1, 1, 1.01))),
        (4, "position", with_wrench(position=0.01)),
        (6, "lengths", with_cameras(scale=1.01)),
        (7, "tilt", with_cameras(tilt=0.01)),
    ],
)
def test_a_mode_is_the_change_of_the_fit(mode: int, name: str, spoiled: TrialData) -> None:
    prepared, found = identified(with_wrench())
    effect = propagate_calibration(prepared, found.fit, found.base, {name: 0.01})
    again = prepare(spoiled, prepared.settings)
    after = fit(again, np.ones(len(spoiled.time), dtype=bool), like=found.fit)  # with the same weights
    moved = (solution(after) - solution(found.fit))[: len(found.base)]
    assert moved == pytest.approx(effect.parameters[:, mode], abs=0.1 * np.max(np.abs(effect.parameters[:, mode])))
    others = np.delete(effect.parameters, mode, axis=1)
    assert not others.any()
    rows = found.add_calibration(effect, None)
    assert np.trace(rows.covariance) > np.trace(found.covariance)


def test_a_prior_of_the_foot_for_the_torques_leaves_the_parameters_alone() -> None:
    """A displaced plate contradicts the prior, so the torques follow from the data alone too."""
    everything = np.ones(len(with_wrench().time), dtype=bool)
    prepared = prepare(with_wrench(), FitSettings())
    found = [
        identify(
            prepare(with_wrench(position=moved), FitSettings()),
            everything,
            GRID,
            BODY.ravel(),
            KinematicError.none(3),
            foot_sd=sd,
            plate_sd=0.005,
        )
        for moved, sd in ((0.0, None), (0.0, 0.001), (0.1, 0.001))
    ]
    alone, good, displaced = found
    assert alone.with_foot is None
    assert not good.uses_reference
    assert good.base == pytest.approx(alone.base)
    assert good.with_foot is not None
    assert good.with_foot.uses_reference
    assert good.with_foot.gain is not None
    calibrated = good.add_calibration(propagate_calibration(prepared, good.fit, good.base, {"position": 0.005}), None)
    assert calibrated.with_foot is not None
    assert calibrated.with_foot.base_sd[1] < calibrated.base_sd[1]
    assert displaced.with_foot is None


def test_a_prior_of_the_foot_leaves_a_displaced_plate_to_the_other_parameters() -> None:
    """Without it, mx1 takes most of it."""
    everything = np.ones(len(with_wrench().time), dtype=bool)
    prepared = prepare(with_wrench(), FitSettings(plate_zero=(3.0, 0.5)))
    alone, held = (
        identify(prepared, everything, GRID, BODY.ravel(), KinematicError.none(3), foot_sd=sd) for sd in (None, 1e-5)
    )
    size = {"position": 0.01}
    free, fixed = (
        one.add_calibration(propagate_calibration(prepared, one.fit, one.base, size), None) for one in (alone, held)
    )
    assert free.calibration is not None
    assert fixed.calibration is not None
    first = prepared.base.kept.tolist().index(1)  # mx1
    assert abs(fixed.calibration.parameters[first, 4]) < 0.05 * abs(free.calibration.parameters[first, 4])
    moved = fit(prepare(with_wrench(position=0.01), prepared.settings), everything, like=held.fit)
    change = (held.refit(moved.problem) - held.refit(held.fit.problem))[: len(held.base)]
    expected = fixed.calibration.parameters[:, 4]
    assert change == pytest.approx(expected, abs=0.15 * np.abs(expected).max())


def test_a_gain_changes_every_torque_in_proportion() -> None:
    prepared, found = identified(with_wrench())
    effect = propagate_calibration(prepared, found.fit, found.base, {"gain": 0.02})
    sd = np.sqrt(compute_scale_variance(prepared, found.base, effect))
    rows = (np.swapaxes(prepared.motion.jacobian, 1, 2) @ prepared.regressor)[:, 0]
    moving = rows * np.repeat(prepared.motion.beyond[0], 4)
    torque = moving[:, prepared.base.kept] @ found.base
    assert sd[::10, 0] == pytest.approx(0.02 * np.abs(torque[::10]), abs=1e-6)


def test_a_weighed_person_limits_the_gain() -> None:
    assert calibration().estimate_gain_error(70.0, 0.5) == 0.01
    weighed = calibration(mass=70.0, mass_sd=0.1).estimate_gain_error(70.0, 0.1)
    assert weighed == pytest.approx(0.002, rel=0.03)


def test_the_gain_of_a_weighed_person_is_as_uncertain_as_its_errors_are_large() -> None:
    """The forces are not corrected, so over many plates, one in twenty wrong, the mean square is that of the plates."""
    rng = np.random.default_rng(0)
    count = 20000
    gain = rng.normal(0.0, np.where(rng.uniform(size=count) < 0.05, 0.05, 0.01))
    scale = rng.normal(0.0, 1.0, count)
    stated = [calibration(mass=70 + s).estimate_gain_error(70 * (1 + g), 0.1) for g, s in zip(gain, scale, strict=True)]
    assert np.mean(np.square(stated)) == pytest.approx(np.mean(gain**2), rel=0.1)
    of_five_percent = calibration(mass=70.0).estimate_gain_error(73.5, 0.1)
    assert 1.96 * of_five_percent > 0.05
    assert calibration(mass=70.0).estimate_gain_error(700.0, 0.1) > 1.0


def test_heavy_people_show_a_wrong_mass_best() -> None:
    limits = [calibration(mass=mass).mass_limit(mass) for mass in (50.0, 80.0, 100.0)]
    assert limits == pytest.approx([0.05, 0.0413, 0.0365], abs=1e-4)


@pytest.mark.parametrize(("faults", "code"), [(FaultOptions(), None), (FaultOptions(gain_fz=0.1), "scale-error")])
def test_a_simulated_trial_reports_it(tmp_path: Path, faults: FaultOptions, code: str | None) -> None:
    options = Options(seed=31002, repetitions=2, analog_rate=100, faults=faults)
    trial = load(simulate("sit-to-stand", tmp_path / "trial", options))
    for stage in STAGES:
        run_stage(trial, stage)
    tree = Folder(trial.out).read("dynamics.h5")
    said = {reason.code for reason in tree.reasons}
    assert said & {"scale-error", "scales-contradict"} == ({code} if code else set())
