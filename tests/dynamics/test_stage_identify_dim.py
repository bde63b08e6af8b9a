"""The stage: what it writes for a good trial, and what for every kind of bad one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from dynamics_cases import BODY, CENTRES, moving_body
from scipy.interpolate import CubicSpline

from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import planar_regressor
from mocap_id.errors import Refused, StoreError
from mocap_id.kinematics.chain_fit import ChainState
from mocap_id.kinematics.skin_slides import skin_from_residuals
from mocap_id.stages import skin_motion
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE, IdentifyDimSettings
from mocap_id.stages.trial_keys import Files, Subject, TrialKeys
from mocap_id.store import Table, Tree, hdf5, parquet
from mocap_id.store.provenance import CHAIN, POSES, STATES, WRENCH

MASS = float(BODY[:, 0].sum())
PLATE_FACTS = ("mass_range_kg", "registration", "unusable", "horizontal_measured")
SEGMENT = np.repeat([0, 1, 2, 3], 3)
LOCAL = np.array([[-0.25, 0.02], [0.06, 0.1], [-0.1, 0.05], *3 * [[-0.1, 0.1], [0.1, 0.4], [0.02, 0.85]]])


def context(
    recorded: TrialData,
    *,
    protocol: Any = "free",
    subject: Subject | None = None,
    why: str | None = None,
    standing: float | None = MASS,
    cop_threshold: float = 20.0,
    analog_rate: float = 100.0,
    **settings: Any,
) -> Context:
    plates = {name: settings.pop(name) for name in PLATE_FACTS if name in settings}
    joints = recorded.q.shape[1]
    states = pd.DataFrame({"time": recorded.time})
    for j in range(joints):
        for name, values in (("theta", recorded.q), ("dtheta", recorded.dq), ("ddtheta", recorded.ddq)):
            states[f"{name}_{j + 1}"] = values[:, j]
        states[f"sd_ddtheta_{j + 1}"], states[f"observed_{j + 1}"] = 0.05, recorded.observed
    wrench = pd.DataFrame(recorded.wrench, columns=["Fx", "Fy", "tauz"]).assign(
        time=recorded.time, plate_ok=np.isfinite(recorded.wrench).all(axis=1)
    )
    chain = {
        "joints": {"centre": CENTRES},
        "markers": {"segment": SEGMENT, "local": LOCAL},
    }
    moves = SEGMENT > 0
    placed = ChainState(CENTRES @ [1, 1j], LOCAL[moves] @ [1, 1j], np.cumsum(np.nan_to_num(recorded.q), axis=1))
    skin = skin_from_residuals(
        placed, SEGMENT[moves], np.full(moves.sum(), 0.001), np.tile(1e-6 * np.eye(2), (joints, 1, 1))
    )
    told = {"mass_kg": standing, "why": why, "cop_threshold_N": cop_threshold, "analog_rate_hz": analog_rate, **plates}
    keys = TrialKeys(trial="t", recording=Files(markers=Path("t.c3d")), protocol=protocol, subject=subject or Subject())
    inputs = {
        "states.parquet": Table.from_frame(STATES, states, {"sigma_v": [300.0] * joints}),
        "wrench.parquet": Table.from_frame(WRENCH, wrench, told),
        "chain.h5": Tree(CHAIN, chain),
        "poses.parquet": Table(POSES, {"time": recorded.time}, {"bodies": []}),
        "skin.h5": skin_motion.make_skin_tree(skin, [f"M{k}" for k in range(moves.sum())], 5e-4, "supposed"),
    }
    return Context(keys, IdentifyDimSettings(**settings), inputs)


def run(recorded: TrialData, **changes: Any) -> tuple[Table, Table, Tree]:
    events, table, tree, averages = STAGE.function(context(recorded, **changes))
    for one in (events, table, averages):
        parquet.conform_table(one)
    hdf5.conform_tree(tree)
    assert tuple(each.schema.file for each in (events, table, tree, averages)) == STAGE.outputs
    assert len(table.frame) == len(recorded.time)
    return events, table, tree


def with_(recorded: TrialData, **changes: np.ndarray) -> TrialData:
    return TrialData(**{**recorded.__dict__, **changes})


def codes(tree: Tree) -> list[str]:
    return [reason.code for reason in tree.reasons]


def test_a_good_trial() -> None:
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    events, table, tree = run(recorded)
    base: Any = tree.data["base"]
    assert base["name"][0] == "m1+m2+m3+m4"
    assert base["value"][0] == pytest.approx(MASS, rel=1e-3)
    assert (base["sd"] > 0).all()
    full: Any = tree.data["full"]
    np.testing.assert_allclose(base["regrouping"] @ full["value"], base["value"], atol=1e-5)
    assert np.isnan(full["reference"]).all()
    assert len(events.frame) == 0
    assert codes(tree) == []
    facts = tree.facts
    assert facts["why"] is None
    assert facts["reference_table"] is None
    assert facts["samples"] == table.frame["in_fit"].sum() > 1000
    assert facts["clock_offset_s"] == pytest.approx(0.0, abs=1e-4)
    assert facts["wrench"]["Fy"]["r2"] > 0.9999
    used = table.frame[table.frame["in_fit"]]
    assert facts["cop_rms_m"] == pytest.approx(np.sqrt(np.mean((used["cop_x_model"] - used["cop_x"]) ** 2)))
    error = table.frame["tauz_model"] - table.frame["tauz"]
    assert error.std() == pytest.approx(0.15, rel=0.1)
    loaded = table.frame[table.frame["Fy"] >= 20.0]
    np.testing.assert_allclose(loaded["cop_x"], loaded["tauz"] / loaded["Fy"])
    assert table.frame["cop_x"].notna().sum() == len(loaded)


def test_each_parameter_has_its_verdict_and_what_it_rests_on() -> None:
    _, _, tree = run(moving_body(noise=(0.5, 0.5, 0.15)))
    base: Any = tree.data["base"]
    np.testing.assert_allclose(np.sqrt(np.diag(base["covariance"])), base["sd"])
    np.testing.assert_allclose(base["covariance"], base["covariance"].T)
    assert set(base["verdict"]) == {"known"}
    assert np.all((base["own_share"] > 0) & (base["own_share"] <= 1 + 1e-9))
    assert tree.facts["advice"] == []


def test_a_joint_that_hardly_moves_is_told_with_what_to_do() -> None:
    """The reason names a movement, and says what it would make of each deviation."""
    recorded = moving_body()
    noise = moving_body(noise=(5.0, 5.0, 2.0)).wrench - recorded.wrench
    states = {name: getattr(recorded, name) * [1.0, 1.0, 0.004] for name in ("q", "dq", "ddq")}
    wrench = planar_regressor(CENTRES, **states) @ BODY.ravel() + noise
    _, _, tree = run(with_(recorded, **states, wrench=wrench))
    (reason,) = [reason for reason in tree.reasons if reason.code == "parameters-weak"]
    base: Any = tree.data["base"]
    doubtful = [i for i, verdict in enumerate(base["verdict"]) if verdict != "known"]
    assert reason.value == len(doubtful) > 0
    assert [one["name"] for one in tree.facts["advice"]] == list(base["name"])
    for i in doubtful:
        advice = tree.facts["advice"][i]
        assert f"{base['name'][i]} ({100 * base['relative_sd'][i]:.0f} %)" in reason.message
        if advice["text"]:
            assert advice["text"][1:] in reason.message
            expected = 100 * advice["sd_ratio"] * base["relative_sd"][i]
            assert f"{base['name'][i]} to {expected:.0f} %" in reason.message
        else:
            assert "No faster or larger movement of these joints would determine" in reason.message


def test_what_was_not_fitted_is_not_identifiable_but_the_mass() -> None:
    recorded = moving_body()
    still = {name: 0 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    wrench = planar_regressor(CENTRES, **still) @ BODY.ravel()
    _, _, tree = run(with_(recorded, **still, wrench=wrench), standing=MASS)
    assert codes(tree)[-1] == "standing-still"
    assert "only the mass is known" in tree.reasons[-1].message
    assert list(tree.data["base"]["verdict"]) == ["known"] + 10 * ["not identifiable"]  # type: ignore[call-overload, index]


def test_the_measured_wrench_is_at_the_corrected_clock() -> None:
    recorded = moving_body(seconds=15.0)
    late = with_(recorded, wrench=np.roll(recorded.wrench, -3, axis=0))  # stamped 30 ms too early
    late.wrench[-3:] = np.nan
    _, table, tree = run(late)
    assert tree.facts["clock_offset_s"] == pytest.approx(0.03, abs=1e-4)
    inner = slice(50, -50)
    np.testing.assert_allclose(table.frame["Fy"][inner], recorded.wrench[inner, 1], atol=0.02)
    _, table, tree = run(late, apply_clock_offset=False)
    assert tree.facts["clock_offset_s"] == pytest.approx(0.03, abs=3e-3)
    np.testing.assert_array_equal(table.frame["Fy"][inner], late.wrench[inner, 1])


def test_what_averaging_takes_off_the_wrench_is_put_back() -> None:
    """A plate of 1000 Hz is read as means over 10 ms, which add T²/24 of the second derivative and a little more."""
    recorded = moving_body(seconds=15.0)
    bend = CubicSpline(recorded.time, recorded.wrench)(recorded.time, 2)
    flattened = with_(recorded, wrench=recorded.wrench + (0.01**2 + 2 * 0.001**2) / 24 * bend)

    def base(wrench: TrialData, analog_rate: float) -> np.ndarray:
        found: Any = run(wrench, analog_rate=analog_rate)[2].data["base"]
        return np.asarray(found["value"])

    exact = base(recorded, 100.0)
    off = np.linalg.norm(base(flattened, 100.0) - exact)
    assert off > 1e-3
    assert np.linalg.norm(base(flattened, 1000.0) - exact) < 0.05 * off


def test_a_person_is_compared_with_the_reference() -> None:
    subject = Subject(height=1.72, mass=77.0, sex="male")
    _, table, tree = run(moving_body(noise=(0.5, 0.5, 0.15)), protocol="sit-to-stand", subject=subject)
    assert tree.facts["reference_table"] == "winter"
    full: Any = tree.data["full"]
    assert full["reference"][::4].sum() == pytest.approx(77.0)
    assert table.frame["Fy_reference"].mean() == pytest.approx(9.81 * 77.0, rel=0.01)
    assert table.frame["Fx_reference"].notna().all()


@pytest.mark.parametrize("reference", ["winter", "de-leva"])
def test_the_rivals_are_always_computed(reference: str) -> None:
    """Both tables, whichever is chosen, over the samples of the fit."""
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    subject = Subject(height=1.72, mass=77.0, sex="male")
    _, table, tree = run(recorded, protocol="sit-to-stand", subject=subject, reference=reference)
    facts = tree.facts
    assert facts["reference_table"] == reference
    assert set(facts["rivals"]) == {"winter", "de-leva"}
    used = table.frame[table.frame["in_fit"]]
    own = facts["rivals"][reference]
    for name in ("Fx", "Fy", "tauz"):
        error = used[f"{name}_reference"] - used[name]
        assert own["wrench"][name]["bias"] == pytest.approx(error.mean())
        assert own["wrench"][name]["sd"] == pytest.approx(error.std(ddof=0))
    cop = np.sqrt(np.mean((used["cop_x_reference"] - used["cop_x"]) ** 2))
    assert own["cop_rms_m"] == pytest.approx(cop)
    assert own["cop_rms_m"] > 3 * facts["cop_rms_m"]
    other = facts["rivals"][{"winter": "de-leva", "de-leva": "winter"}[reference]]
    assert other["cop_rms_m"] != own["cop_rms_m"]
    assert (own["height_m"], own["mass_kg"], own["assumed"]) == (1.72, 77.0, [])


def test_the_rivals_do_not_need_a_fit() -> None:
    """Where nothing can be identified the reference's wrench stands all the same, and off the seat its error."""
    recorded = with_(moving_body(seconds=20.0), observed=np.zeros(2000, dtype=bool))
    subject = Subject(height=1.72, mass=77.0, sex="male")
    _, table, tree = run(recorded, protocol="sit-to-stand", subject=subject)
    assert "too-few-samples" in codes(tree)
    assert table.frame["Fy_reference"].mean() == pytest.approx(9.81 * 77.0, rel=0.02)
    assert tree.facts["rivals"]["winter"]["cop_rms_m"] > 0
    assert tree.facts["reference_table"] == "winter"
    full: Any = tree.data["full"]
    assert full["reference"][::4].sum() == pytest.approx(77.0)
    nothing = np.full_like(recorded.wrench, np.nan)
    _, table, tree = run(with_(recorded, wrench=nothing), protocol="sit-to-stand", subject=subject)
    assert codes(tree)[-1] == "no-wrench"
    assert table.frame["cop_x_reference"].notna().any()
    assert tree.facts["rivals"]["winter"]["cop_rms_m"] is None


@pytest.mark.parametrize("consistency", ["grid", "cone", "bounded-cone"])
def test_the_artefacts_say_which_bodies_counted_as_possible(consistency: str) -> None:
    _, _, tree = run(moving_body(noise=(0.5, 0.5, 0.15)), consistency=consistency)
    assert tree.facts["consistency"] == tree.facts["solver"]["asked"] == consistency
    solver = tree.facts["solver"]
    assert solver["name"] == ("nnls" if consistency == "grid" else "clarabel")
    assert solver["proven"]
    assert {"primal", "stationarity", "dual", "complementarity", "kkt"} <= set(solver)
    base, full = tree.data["base"], tree.data["full"]
    np.testing.assert_allclose(base["regrouping"] @ full["value"], base["value"], atol=1e-5)
    m, mx, my, izz = full["value"].reshape(-1, 4).T
    assert (m >= 0).all()
    assert (m * izz >= (mx**2 + my**2) * (1 - 1e-9)).all()
    assert np.isfinite(tree.data["grid"]["mass"]).all() == (consistency == "grid")
    assert codes(tree) == []


def test_a_reference_that_pulls_is_told() -> None:
    recorded, subject = moving_body(noise=(5.0, 5.0, 1.5)), Subject(height=1.72, mass=77.0, sex="male")
    keys = {"protocol": "sit-to-stand", "subject": subject, "contact": "knee"}
    trees = [run(recorded, reference_pulls=pulls, **keys)[2] for pulls in (False, True)]
    assert [tree.facts["reference_pulls"] for tree in trees] == [False, True]
    off = [np.abs(t.data["base"]["value"] - t.data["base"]["regrouping"] @ t.data["full"]["reference"]) for t in trees]
    scaled = [np.linalg.norm(o / trees[0].data["base"]["sd"]) for o in off]
    assert scaled[1] < scaled[0]
    _, _, without = run(moving_body(noise=(0.5, 0.5, 0.15)), reference_pulls=True)
    assert without.facts["reference_pulls"] is False


def assert_nothing_known(table: Table, tree: Tree, code: str, *, mass: float | None = None) -> None:
    assert code in codes(tree)
    assert [reason.level for reason in tree.reasons if reason.code == code] == ["caution"]
    assert tree.facts["why"]
    assert all(value is None for name, value in tree.facts.items() if name != "why")
    base: Any = tree.data["base"]
    assert len(base["name"]) == 11
    if mass is None:
        assert np.isnan(base["value"]).all()
    else:
        assert base["value"][0] == pytest.approx(mass, rel=1e-3)
        assert np.isnan(base["value"][1:]).all()
    assert not table.frame["in_fit"].any()
    assert table.frame[["Fx_model", "tau_1", "sd_tau_3", "cop_x_reference"]].isna().all().all()


def test_no_plate() -> None:
    recorded = moving_body()
    nothing = with_(recorded, wrench=np.full_like(recorded.wrench, np.nan))
    _, table, tree = run(nothing, why="the recording has no force plate")
    assert_nothing_known(table, tree, "no-wrench")
    assert "no force plate" in tree.facts["why"]


def resting() -> TrialData:
    recorded = moving_body()
    states = {name: 1e-3 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    return with_(recorded, **states, wrench=np.tile([0.0, 9.81 * MASS, -12.0], (len(recorded.time), 1)))


@pytest.mark.parametrize(("protocol", "standing"), [("free", MASS), ("robot-joint", None)])
def test_standing_still_gives_the_mass_alone(protocol: str, standing: float | None) -> None:
    _, table, tree = run(resting(), protocol=protocol, standing=standing)
    assert_nothing_known(table, tree, "standing-still", mass=MASS)
    np.testing.assert_allclose(table.frame["cop_x"], -12.0 / (9.81 * MASS))


def test_a_resting_load_that_nothing_shows_to_be_the_whole_weight_is_no_mass() -> None:
    _, table, tree = run(resting(), standing=None)
    assert_nothing_known(table, tree, "standing-still")


def seated() -> TrialData:
    """Trunk and legs move a little on a chair that carries three quarters of the weight: nobody rises."""
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    states = {name: 0.15 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    wrench = planar_regressor(CENTRES, **states) @ BODY.ravel()
    return with_(recorded, **states, wrench=wrench - np.array([0.0, 0.75 * 9.81 * MASS, 0.0]))


def test_a_sit_to_stand_in_which_nobody_is_seen_to_stand_is_not_identified() -> None:
    _, table, tree = run(seated(), protocol="sit-to-stand", standing=None)
    assert_nothing_known(table, tree, "not-free")
    assert codes(tree) == ["no-repetitions", "no-reference", "not-free"]


def test_a_free_movement_whose_mass_nothing_confirms_says_so() -> None:
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    assert codes(run(recorded, standing=None, why="nobody stands")[2]) == ["mass-unchecked"]
    assert codes(run(recorded, standing=None, subject=Subject(mass=MASS))[2]) == []
    assert codes(run(recorded, standing=None, protocol="robot-joint")[2]) == []


def test_a_mass_that_is_not_the_standing_one_is_said() -> None:
    _, _, tree = run(moving_body(noise=(0.5, 0.5, 0.15)), standing=1.15 * MASS)
    assert codes(tree) == ["load-shared"]


def test_a_mass_far_from_the_standing_one_is_refused() -> None:
    with pytest.raises(Refused) as refused:
        run(moving_body(noise=(0.5, 0.5, 0.15)), standing=1.3 * MASS)
    assert refused.value.code == "load-shared"


@pytest.mark.parametrize("factor", [0.75, 1.3, 2.0])
def test_a_given_mass_far_from_the_standing_one_is_refused(factor: float) -> None:
    with pytest.raises(Refused, match=f"{MASS:.1f} kg while the person stands") as refused:
        run(moving_body(noise=(0.5, 0.5, 0.15)), subject=Subject(mass=factor * MASS))
    assert refused.value.code == "mass-contradiction"


def test_a_load_in_the_hands_explains_a_given_mass() -> None:
    """The person stands with a load most of the time, and also without it."""
    given, recorded = 0.75 * MASS, moving_body(noise=(0.5, 0.5, 0.15))
    _, _, tree = run(recorded, subject=Subject(mass=given), mass_range_kg=[given, MASS])
    assert "mass-contradiction" in codes(tree)
    with pytest.raises(Refused):
        run(recorded, subject=Subject(mass=given), mass_range_kg=[0.98 * MASS, MASS])


@pytest.mark.parametrize(
    ("index", "told", "known"),
    [
        (13.8, True, True),
        (16.0, False, True),
        (35.0, False, True),
        (40.0, False, True),  # or pounds of a person with 18.1
        (50.0, True, True),
        (8.0, True, False),
        (112.0, True, False),
    ],
)
def test_the_mass_is_compared_with_the_height(index: float, told: bool, known: bool) -> None:
    """The mass index is m/h²; outside what anybody has, nothing is identified."""
    height = float(np.sqrt(MASS / index))
    if height > 2.7:  # heights that the configuration accepts
        height, scale = 2.0, index * 4.0 / MASS
    else:
        scale = 1.0
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    recorded = with_(recorded, wrench=scale * recorded.wrench)
    _, table, tree = run(recorded, subject=Subject(height=height), standing=scale * MASS)
    assert ("mass-implausible" in codes(tree)) == told
    assert ("mass-unusual" in codes(tree)) == (index == 40.0)
    assert (tree.facts["why"] is None) == known
    assert table.frame["tau_1"].notna().any() == known
    confirmed = run(recorded, subject=Subject(height=height, mass=scale * MASS), standing=scale * MASS)[2]
    assert not {"mass-implausible", "mass-unusual"} & set(codes(confirmed))


def test_nothing_is_identified_if_a_foot_is_beside_the_plates_and_the_mass_is_too_small() -> None:
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    beside = {"foot_beside": {"beside_m": None, "share": 0.02}}
    thin, usual = (Subject(height=float(np.sqrt(MASS / index))) for index in (12.5, 22.0))
    _, table, tree = run(recorded, subject=thin, registration=beside)
    assert_nothing_known(table, tree, "mass-implausible")
    assert run(recorded, subject=usual, registration=beside)[2].facts["why"] is None


def test_nothing_is_identified_if_a_foot_is_clearly_beside_the_plates() -> None:
    recorded, height = moving_body(noise=(0.5, 0.5, 0.15)), float(np.sqrt(MASS / 22.0))
    beside = {"foot_beside": {"beside_m": 0.14, "share": 0.02}}
    _, table, tree = run(recorded, subject=Subject(height=height), registration=beside)
    assert_nothing_known(table, tree, "no-wrench")
    weighed = run(recorded, subject=Subject(height=height, mass=MASS), registration=beside)[2]
    assert weighed.facts["why"] is None  # the plates measure the whole weight: their corners are wrong


def test_missing_moments_leave_the_mass() -> None:
    _, table, tree = run(moving_body(), unusable="the moments are missing")
    assert_nothing_known(table, tree, "no-wrench", mass=MASS)
    assert "the moments are missing" in tree.facts["why"]


def test_without_horizontal_force_the_parameters_are_those_of_Fy_and_tauz() -> None:
    recorded = moving_body(noise=(0.5, 0.5, 0.15))
    wrench = recorded.wrench.copy()
    wrench[:, 0] = 0.0
    _, table, tree = run(with_(recorded, wrench=wrench), horizontal_measured=False)
    expected = run(recorded, components=("Fy", "tauz"))[2]
    np.testing.assert_allclose(tree.data["base"]["value"], expected.data["base"]["value"], rtol=0.02, atol=0.02)
    assert table.frame["Fx"].isna().all() and table.frame["Fx_model"].notna().any()


def test_components_that_do_not_tell_all_leave_the_rest_empty() -> None:
    _, table, tree = run(moving_body(noise=(0.5, 0.5, 0.15)), components=("Fx", "Fy"))
    assert "components-short" in codes(tree)
    assert tree.facts["untold"] == ["tauz", "cop_x", "tau_1", "tau_2", "tau_3"]
    assert "tau_2" in tree.facts["why"]
    assert tree.facts["wrench"]["tauz"] is None
    assert tree.facts["cop_rms_m"] is None
    assert tree.facts["wrench"]["Fy"]["r2"] > 0.999
    empty = ["tauz_model", "sd_tauz_model", "cop_x_model", "sd_cop_x_model", "tau_2", "sd_tau_2"]
    assert table.frame[empty].isna().all().all()
    assert table.frame[["Fy_model", "sd_Fy_model"]].notna().all().all()
    assert table.frame["tauz"].notna().sum() > 1000


def test_the_threshold_of_the_centre_of_pressure_is_the_plates_own() -> None:
    recorded = moving_body()
    threshold = float(np.median(recorded.wrench[:, 1]))
    _, table, _ = run(recorded, cop_threshold=threshold)
    np.testing.assert_array_equal(table.frame["cop_x"].notna(), table.frame["Fy"] > threshold)
    np.testing.assert_array_equal(table.frame["cop_x_model"].notna(), table.frame["Fy_model"] > threshold)


def test_plate_and_markers_that_hardly_overlap() -> None:
    recorded = moving_body()
    wrench = recorded.wrench.copy()
    wrench[60:] = np.nan
    _, table, tree = run(with_(recorded, wrench=wrench))
    assert_nothing_known(table, tree, "no-common-samples", mass=MASS)


def test_too_little_between_the_gaps() -> None:
    recorded = moving_body()
    wrench = recorded.wrench.copy()
    wrench[::40] = np.nan
    _, table, tree = run(with_(recorded, wrench=wrench))
    assert_nothing_known(table, tree, "too-few-samples", mass=MASS)


def test_angles_that_are_never_known() -> None:
    recorded = moving_body()
    unknown = {name: np.full_like(getattr(recorded, name), np.nan) for name in ("q", "dq", "ddq")}
    _, table, tree = run(with_(recorded, **unknown))
    assert_nothing_known(table, tree, "no-common-samples", mass=MASS)


def test_a_contradicting_mass_is_said() -> None:
    _, _, tree = run(moving_body(noise=(0.5, 0.5, 0.15)), subject=Subject(mass=60.0), standing=None)
    assert "mass-contradiction" in codes(tree)


def test_a_clock_that_is_out_of_reach_is_said() -> None:
    recorded = moving_body(seconds=15.0)
    late = with_(recorded, wrench=np.roll(recorded.wrench, 12, axis=0))
    late.wrench[:12] = np.nan
    _, _, tree = run(late, clock_offset_limit_s=0.05)
    assert "clock-offset-unknown" in codes(tree)
    assert tree.facts["clock_offset_s"] is None


def test_a_clock_that_is_left_as_it_is() -> None:
    recorded = moving_body(seconds=15.0, noise=(0.5, 0.5, 0.15))
    late = with_(recorded, wrench=np.roll(recorded.wrench, 2, axis=0))
    late.wrench[:2] = np.nan
    for wrench, told in ((late, True), (recorded, False)):
        _, _, tree = run(wrench, apply_clock_offset=False)
        assert ("clock-offset-kept" in codes(tree)) == told
    assert "clock-offset-kept" not in codes(run(late)[2])


def with_clock(recorded: TrialData, offset: float, clock: dict[str, Any], **settings: Any) -> tuple[Table, Tree]:
    """Return dynamics of a plate ``offset`` late, s, whose wrench the coarse search corrected by ``clock``."""
    coarse = round(clock["offset_s"] * recorded.rate)
    late = recorded.wrench.copy()
    late[: max(coarse, 0)] = late[len(late) + min(coarse, 0) :] = np.nan
    moved = CubicSpline(recorded.time, recorded.wrench)(recorded.time + offset - coarse / recorded.rate)
    given = context(with_(recorded, wrench=np.where(np.isfinite(late), moved, np.nan)), **settings)
    wrench = given.table("wrench.parquet")
    given = Context(given.trial, given.settings, {**given.inputs, "wrench.parquet": wrench_with(wrench, clock)})
    _, table, tree, _ = STAGE.function(given)
    return table, tree


def wrench_with(wrench: Table, clock: dict[str, Any]) -> Table:
    return Table(wrench.schema, wrench.columns, {**wrench.facts, "clock": clock}, wrench.reasons)


FOUND = {"offset_s": 0.5, "peak_s": 0.5, "rivals_s": [], "why": None}


def test_a_coarse_offset_and_the_rest_are_one_offset() -> None:
    recorded = moving_body(seconds=15.0, noise=(0.5, 0.5, 0.15))
    table, tree = with_clock(recorded, 0.513, FOUND)
    assert tree.facts["clock_offset_s"] == pytest.approx(0.513, abs=5e-4)
    assert tree.facts["clock"]["applied_s"] == pytest.approx(0.013, abs=5e-4)
    (reason,) = [each for each in tree.reasons if each.code.startswith("clock")]
    assert reason.code == "clock-offset-large"
    assert reason.value == pytest.approx(0.513, abs=5e-4)
    assert "513 ms too early" in reason.message
    np.testing.assert_allclose(table["Fy"][100:-100], moving_body(seconds=15.0).wrench[100:-100, 1], atol=6.0)


def test_the_settings_hold_for_the_coarse_offset_too() -> None:
    """Without correction, the wrench is used as it was recorded; beyond the user's limit, the offset is unknown."""
    recorded = moving_body(seconds=15.0, noise=(0.5, 0.5, 0.15))
    table, tree = with_clock(recorded, 0.513, FOUND, apply_clock_offset=False)
    assert tree.facts["clock_offset_s"] == pytest.approx(0.513, abs=2e-3)
    assert "clock-offset-kept" in codes(tree)
    raw = CubicSpline(recorded.time, recorded.wrench[:, 1])(recorded.time + 0.513)
    known = np.isfinite(table["Fy"])
    assert known.mean() > 0.95
    np.testing.assert_allclose(table["Fy"][known][50:-150], raw[known][50:-150], atol=1e-6)
    _, tree = with_clock(recorded, 0.513, FOUND, clock_offset_limit_s=0.2)
    assert "clock-offset-unknown" in codes(tree)
    assert tree.facts["clock_offset_s"] is None


def test_an_offset_that_cannot_be_told_is_said_and_not_reported() -> None:
    recorded = moving_body(seconds=15.0, noise=(0.5, 0.5, 0.15))
    why = "the movement repeats"
    _, tree = with_clock(recorded, 0.0, {"offset_s": 0.0, "peak_s": 0.0, "rivals_s": [1.5], "why": why})
    (reason,) = [each for each in tree.reasons if each.code.startswith("clock")]
    assert reason.code == "clock-offset-unknown"
    assert why in reason.message
    assert tree.facts["clock_offset_s"] is None
    assert tree.facts["wrench"]["Fy"]["r2"] > 0.999  # the fit is that of the assumed offset


@pytest.mark.parametrize("drift", [0.0, -5e-4, 2e-3])
def test_a_drift_is_measured_and_said(drift: float) -> None:
    recorded = moving_body(seconds=20.0, noise=(0.5, 0.5, 0.15))
    stamped = recorded.time + drift * (recorded.time - recorded.time.mean())
    wrench = CubicSpline(recorded.time, moving_body(seconds=20.0).wrench)(stamped)
    noise = recorded.wrench - moving_body(seconds=20.0).wrench
    _, _, tree = run(with_(recorded, wrench=wrench + noise))
    clock = tree.facts["clock"]
    assert abs(clock["drift_s_per_s"] - drift) < max(4 * clock["drift_sd_s_per_s"], 0.05 * abs(drift))
    assert ("clock-drift" in codes(tree)) == (drift != 0.0)


def test_artefacts_that_do_not_belong_together() -> None:
    broken = context(moving_body())
    wrench = broken.table("wrench.parquet")
    shorter = Table.from_frame(WRENCH, wrench.frame.iloc[:-5], wrench.facts)
    with pytest.raises(StoreError, match="1195"):
        STAGE.function(Context(broken.trial, broken.settings, {**broken.inputs, "wrench.parquet": shorter}))
