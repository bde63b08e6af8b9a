"""The stage on measured poses: a person whose hip gives way by a known function, and what is left out of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import test_stage_identify_dim
from dynamics_cases import CENTRES
from pose_cases import BODIES, HIP, hip_gap, moving, recorded_of
from test_stage_identify_dim import LOCAL, SEGMENT, codes, context

from mocap_id.dynamics.identification import Cutoffs, LeftOutPrediction
from mocap_id.dynamics.measured_motion import USUAL
from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.priors import average_transform
from mocap_id.dynamics.regressor import PlanarMotion, structural_base, torque_regressor, wrench_regressor
from mocap_id.geometry import planar
from mocap_id.stages.base import Context, Findings
from mocap_id.stages.identify_dim import STAGE
from mocap_id.stages.identify_dim.segment_fit import (
    bridge_gaps,
    explain_motion,
    pin_joints_that_hold,
    read_bodies,
    remove_previous_errors,
)
from mocap_id.stages.trial_keys import Subject
from mocap_id.store import Table, Tree, hdf5, parquet
from mocap_id.store.provenance import CHAIN, POSES
from mocap_id.verdict import Reason

RATE = 50
TIME = np.arange(30 * RATE) / RATE
NOISE = (0.5, 0.5, 0.15)
ARM = np.array([[0.03, -0.1], [0.0, -0.2], [-0.03, 0.3]])
"""Markers of no segment about their middle, which is their body's origin, m."""
NAMES = ["foot", "shank", "thigh", "torso", "others"]
MASS = float(BODIES[:, 0].sum())
PERSON = Subject(height=1.72, mass=MASS, sex="male")
SQUATS: dict[str, Any] = {"protocol": "sit-to-stand", "subject": PERSON}
CAMERA = 2.5e-4


def poses_table(motion: PlanarMotion, *, time: np.ndarray = TIME, bodies: int = 5, camera: float = CAMERA) -> Table:
    """As ukf-smooth writes it, three markers a body."""
    rng, facts = np.random.default_rng(7), []
    columns: dict[str, Any] = {"time": time}
    for k in range(bodies):
        local = ARM if k == 4 else LOCAL[k == SEGMENT]
        middle, spread = local.mean(axis=0), np.sqrt(np.sum((local - local.mean(axis=0)) ** 2))
        place = motion.origin[:, k] + planar.rotate(motion.angle[:, k], middle)
        place = place + camera / np.sqrt(3) * rng.normal(size=place.shape)
        columns |= {f"x_{k + 1}": place[:, 0], f"y_{k + 1}": place[:, 1]}
        columns[f"angle_{k + 1}"] = motion.angle[:, k] + camera / spread * rng.normal(size=len(time))
        columns[f"markers_{k + 1}"] = np.full(len(time), 3)
        labels = [f"M{3 * k + i - 3}" if 0 < k < 4 else f"{NAMES[k]} {i}" for i in range(3)]
        markers = dict(zip(labels, local.tolist(), strict=True))
        segments = [] if k == 4 else [k]
        facts.append({"name": NAMES[k], "segments": segments, "markers": markers, "residual_m": camera})
    return Table(POSES, columns, {"bodies": facts})


EXACT = dict.fromkeys(
    ("plate_gain_sd", "plate_moments_sd", "plate_position_sd_m", "camera_scale_sd", "camera_tilt_sd_deg"), 0.0
)
"""The instruments of these cases have no error of calibration."""


@dataclass(frozen=True)
class Ran:
    motion: PlanarMotion
    recorded: TrialData
    table: Table
    tree: Tree

    @property
    def facts(self) -> dict[str, Any]:
        return self.tree.facts

    @property
    def base(self) -> dict[str, Any]:
        return self.tree.data["base"]  # type: ignore[return-value]

    def truth(self) -> np.ndarray:
        """The chain's base parameters, the arm counted where it was on average."""
        used, motion = self.table["in_fit"], self.motion
        turn = motion.angle[used, 4] - motion.angle[used, 3]
        shift = planar.rotate(-motion.angle[used, 3], motion.origin[used, 4] - motion.origin[used, 3])
        torso = BODIES[3] + average_transform(turn, shift) @ BODIES[4]
        return structural_base(CENTRES).regrouping @ np.concatenate([BODIES[:3].ravel(), torso])


def made(recorded: TrialData, poses: Table, **changes: Any) -> Context:
    plain = context(recorded, **({"standing": MASS} | EXACT | changes))
    chain = {
        "joints": {
            "name": np.array(["ankle", "knee", "hip"], dtype=object),
            "centre": CENTRES,
            "covariance": np.tile(1e-6 * np.eye(2), (3, 1, 1)),
        },
        "markers": {"segment": SEGMENT, "local": LOCAL, "residual": np.full(len(SEGMENT), CAMERA)},
    }
    inputs = {**plain.inputs, "chain.h5": Tree(CHAIN, chain), "poses.parquet": poses}
    return Context(plain.trial, plain.settings, inputs)


def run(size: float = 0.03, hide: Any = None, **changes: Any) -> Ran:
    """The stage on a person whose hip gives way by so much; ``hide`` may take poses away."""
    motion = moving(TIME, size=size)
    recorded = recorded_of(TIME, motion, noise=NOISE)
    poses = poses_table(motion)
    if hide is not None:
        samples, body = hide
        for name, gone in (("x", np.nan), ("y", np.nan), ("angle", np.nan), ("markers", 0)):
            poses[f"{name}_{body + 1}"][samples] = gone
    events, table, tree, averages = STAGE.function(made(recorded, poses, **changes))
    for one in (events, table, averages):
        parquet.conform_table(one)
    hdf5.conform_tree(tree)
    return Ran(motion, recorded, table, tree)


@cache
def squats() -> Ran:
    return run(**SQUATS)


@cache
def free() -> Ran:
    return run()


def test_a_hip_that_gives_way_is_said_and_its_poses_are_used() -> None:
    motion = squats().facts["motion"]
    assert (motion["source"], motion["why"]) == ("segments", "the two sides of a joint separate")
    assert motion["bodies"] == NAMES
    assert motion["used"] == [0, 1, 2, 3, 4]
    assert motion["prior"] == "winter"
    assert [name for name, gap in motion["joints"].items() if not gap["pinned"]] == ["hip"]
    gap, acceleration = hip_gap(TIME, 0.03)
    hip = motion["joints"]["hip"]
    assert hip["gap_m"] == pytest.approx(np.sqrt(gap.var(axis=0).sum()), rel=0.02)
    assert hip["acceleration_m_s2"] == pytest.approx(np.sqrt(np.mean(np.sum(acceleration**2, axis=1))), rel=0.05)
    for name in ("ankle", "knee"):
        assert motion["joints"][name]["gap_m"] < 4 * CAMERA
    (reason,) = [each for each in squats().tree.reasons if each.code == "joint-gives-way"]
    assert reason.level == "ok"
    assert reason.value == hip["gap_m"]
    assert "hip 30." in reason.message
    assert "ankle" not in reason.message


def test_left_out_repetitions_are_predicted_and_their_errors_are_as_large_as_stated() -> None:
    facts, frame = squats().facts["held_out"], squats().table.frame
    assert facts["folds"] >= 2
    assert facts["samples"] == frame["Fy_held_out"].notna().sum() > 1000
    assert squats().facts["motion"]["bands_why"].startswith("left-out repetitions are predicted best")
    for name, noise in zip(("Fx", "Fy", "tauz"), NOISE, strict=True):
        assert facts["inside"][name] == pytest.approx(0.95, abs=0.04)
        assert facts["model"][name]["sd"] < max(4 * noise, 3.0)
        off = (frame[f"{name}_held_out"] - frame[name]).dropna()
        inside = np.abs(off) < 1.96 * frame.loc[off.index, f"sd_{name}_model"]
        assert inside.mean() == pytest.approx(0.95, abs=0.05)
    assert np.ptp(facts["clock_offset_s"]) < 2e-3


@pytest.mark.parametrize("ran", [squats, free], ids=["squats", "free"])
def test_wrench_and_torques_are_as_far_off_as_they_say(ran: Any) -> None:
    """Against the exact ones of the true bodies, the hip's joint in the middle of its gap."""
    found = ran()
    frame, regressor = found.table.frame, wrench_regressor(found.motion)
    exact = np.column_stack([regressor @ BODIES.ravel(), torque_regressor(found.motion, regressor) @ BODIES.ravel()])
    for column, name in enumerate(("Fx_model", "Fy_model", "tauz_model", "tau_1", "tau_2", "tau_3")):
        scaled = ((frame[name] - exact[:, column]) / frame[f"sd_{name}"])[frame["in_fit"]]
        assert 0.9 < (np.abs(scaled) < 1.96).mean() <= 1.0, name
        assert name == "tau_3" or scaled.std() > 0.7, name  # the hip's centre is uncertain by its gap


def test_pins_would_cost() -> None:
    """The same samples on the pinned chain: several times the error, mostly in Fy."""
    pins = squats().facts["pins"]
    assert pins["why"] is None
    for name in ("Fx", "Fy"):
        assert pins["chain"]["wrench"][name]["sd"] > 3 * pins["segments"]["wrench"][name]["sd"]
    assert pins["chain"]["cop_rms_m"] > 3 * pins["segments"]["cop_rms_m"]


@pytest.mark.parametrize(("ran", "close"), [(squats, 0.02), (free, 0.2)], ids=["squats", "free"])
def test_base_parameters_are_within_their_intervals(ran: Any, close: float) -> None:
    """Without repetitions to choose cut-offs by, and without a table, they are not as close."""
    found = ran()
    base, truth = found.base, found.truth()
    off = (base["value"] - truth) / base["sd"]
    assert np.abs(off).max() < 3.0
    assert base["value"][0] == pytest.approx(MASS, rel=0.01)
    size = np.abs(truth).reshape(-1)
    large = size > 5.0
    assert (np.abs(base["value"] - truth)[large] < close * size[large]).all()
    assert (base["sd"][large] < 0.2 * size[large]).all()
    np.testing.assert_allclose(base["regrouping"] @ found.tree.data["full"]["value"], base["value"], atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(base["covariance"])), base["sd"], rtol=1e-9)


def test_the_prior_s_share_is_one() -> None:
    for found in (squats(), free()):
        share = found.base["prior_share"]
        assert ((share >= 0.0) & (share <= 1.0)).all()
        np.testing.assert_array_equal(share, found.facts["motion"]["prior_share"])
        assert share[0] < 0.01  # gravity tells the mass
        assert share[0] < share.max()


def test_bodies_can_exist_and_weigh_what_the_person_does() -> None:
    bodies: Any = squats().tree.data["bodies"]
    m, mx, my, inertia = bodies["value"].reshape(-1, 4).T
    assert (m > 0).all()
    assert (m * inertia >= (mx**2 + my**2) * (1 - 1e-6)).all()
    assert m.sum() == pytest.approx(MASS, rel=0.01)
    assert bodies["reference"][::4].sum() == pytest.approx(MASS, rel=1e-6)
    legs = slice(12)
    off = (bodies["value"] - BODIES.ravel())[legs] / np.sqrt(np.diag(bodies["covariance"]))[legs]
    assert np.abs(off).max() < 3.0


def test_the_condition_number_is_that_of_the_chain_and_the_bodies_have_their_own() -> None:
    chain, facts = run(motion="chain", **SQUATS).facts, squats().facts
    assert facts["condition_number"] == pytest.approx(chain["condition_number"], rel=1e-9)
    assert facts["condition_number_scaled"] == pytest.approx(chain["condition_number_scaled"], rel=1e-9)
    assert facts["motion"]["bodies_condition_number"] > 10 * facts["condition_number"]
    assert "bodies_condition_number" not in chain["motion"]


def test_without_a_table_the_prior_is_an_even_share() -> None:
    facts = free().facts
    assert facts["motion"]["prior"] == "an even division of the mass"
    assert facts["motion"]["bands_hz"] == dict(zip(("x", "y", "angle"), USUAL, strict=True))
    assert "no repetition" in facts["motion"]["bands_why"]
    assert facts["held_out"]["folds"] is None
    assert facts["pins"]["why"]
    assert np.isnan(free().tree.data["bodies"]["reference"]).all()  # type: ignore[call-overload, index]


def test_the_chain_can_be_asked_for() -> None:
    found = run(motion="chain", **SQUATS)
    motion = found.facts["motion"]
    assert (motion["source"], motion["why"]) == ("chain", "asked for")
    assert not motion["joints"]["hip"]["pinned"]
    assert "joint-gives-way" not in codes(found.tree)
    (reason,) = [each for each in found.tree.reasons if each.code == "pinned-joint-gives-way"]
    assert (reason.level, reason.value) == ("caution", max(gap["gap_m"] for gap in motion["joints"].values()))
    assert "hip" in reason.message
    assert (found.base["prior_share"] == 0.0).all()
    own, poses = (each.facts["wrench"]["Fy"]["sd"] for each in (found, squats()))
    assert own > 3 * poses


def test_a_hip_that_holds_stays_pinned() -> None:
    found = run(size=0.0, **SQUATS)
    assert found.facts["motion"]["source"] == "chain"
    assert "noise" in found.facts["motion"]["why"]
    assert all(gap["pinned"] for gap in found.facts["motion"]["joints"].values())
    assert "joint-gives-way" not in codes(found.tree)


def test_a_hip_that_hardly_gives_way_is_unpinned_where_that_predicts_better() -> None:
    found = run(size=0.012, **SQUATS)
    hip = found.facts["motion"]["joints"]["hip"]
    assert 0.05 < hip["acceleration_m_s2"] < 0.1
    assert found.facts["motion"]["source"] == "segments"


def predict_indifferently(_: Cutoffs) -> LeftOutPrediction:
    """Predict all motions equally well, so that the forces open no joint."""
    ones, part = np.ones((len(TIME), 3)), np.zeros(len(TIME), dtype=np.int64)
    return LeftOutPrediction(part == 0, part, ones, 0 * ones, ones, 0 * ones, np.zeros((2, 9)), np.zeros(2))


def opened_by(motion: PlanarMotion, *, skin: float = CAMERA, shift: float = 0.0) -> list[int]:
    """Joints that are open although the forces open none; ``skin`` is the markers' misfit, ``shift`` a bend, m."""
    bodies = bridge_gaps(read_bodies(poses_table(motion), CENTRES, range(5), CAMERA))
    poses = replace(bodies.poses, shift=np.array([[0.0, 0.0], [0.0, 0.0], [shift, 0.0]]))
    bodies = replace(bodies, poses=poses, residual=(skin,) * 5)
    assert HIP in bodies.loose
    return pin_joints_that_hold(bodies, lambda _: predict_indifferently, HIP).loose


def test_a_hip_that_gives_way_is_open_whatever_the_forces_say() -> None:
    """The distance from the knee on the shank to the hip on the trunk shows it."""
    assert opened_by(moving(TIME)) == [HIP]


def test_skin_of_the_thigh_opens_no_hip() -> None:
    """The thigh's markers slide, the shank and the trunk turn about joints that hold."""
    motion = moving(TIME, size=0.0)
    origin = motion.origin.copy()
    origin[:, HIP] += hip_gap(TIME)[0]
    assert opened_by(replace(motion, origin=origin)) == []


def test_other_causes_of_the_distance_open_no_hip() -> None:
    """Skin of shank and trunk, a trunk that bends, or a knee that gives way more."""
    assert opened_by(moving(TIME), skin=0.02) == []
    assert opened_by(moving(TIME), shift=0.01) == []
    motion = moving(TIME, size=0.004)
    origin = motion.origin.copy()
    origin[:, HIP:] += 2 * hip_gap(TIME)[0][:, None]
    assert opened_by(replace(motion, origin=origin)) == []


def test_samples_without_a_pose_are_left_out() -> None:
    """A second without the thigh, and moments, which are bridged but not identified on either."""
    long, short = (TIME >= 12) & (TIME < 13), (TIME >= 20) & (TIME < 20.1)
    found = run(hide=(long | short, 2))
    frame = found.table.frame
    assert found.facts["motion"]["source"] == "segments"
    assert not frame.loc[long | short, "in_fit"].any()
    assert frame.loc[long, "Fy_model"].isna().all()
    assert frame.loc[short, "Fy_model"].notna().all()
    assert frame.loc[(TIME > 14) & (TIME < 19), "in_fit"].all()
    assert np.abs((found.base["value"] - found.truth()) / found.base["sd"]).max() < 3.0


@pytest.mark.parametrize("seconds", [0.5, 1.6])
def test_arms_that_are_hardly_ever_seen_do_not_cost_the_trial(seconds: float) -> None:
    found = run(hide=(seconds < TIME, 4), **SQUATS)
    assert found.facts["why"] is None
    assert found.facts["samples"] > 1000


def test_without_arms_the_segments_do() -> None:
    motion = moving(TIME, size=0.03)
    recorded = recorded_of(TIME, motion, noise=NOISE)
    *_, tree, _ = STAGE.function(made(recorded, poses_table(motion, bodies=4), **SQUATS))
    assert tree.facts["motion"]["bodies"] == NAMES[:4]
    assert tree.data["base"]["value"][0] == pytest.approx(MASS, rel=0.02)  # type: ignore[call-overload, index]


def test_a_segment_without_a_pose_leaves_the_chain() -> None:
    motion = moving(TIME, size=0.03)
    poses = poses_table(motion, bodies=3)
    *_, tree, _ = STAGE.function(made(recorded_of(TIME, motion, noise=NOISE), poses))
    assert tree.facts["motion"]["source"] == "chain"
    assert "too few" in tree.facts["motion"]["why"]


def test_with_one_repetition_the_cut_offs_are_the_usual_ones() -> None:
    motion, cut = moving(TIME, size=0.03), TIME < 5.0
    whole, poses = recorded_of(TIME, motion, noise=NOISE), poses_table(motion)
    names = ("time", "q", "dq", "ddq", "ddq_sd", "observed", "wrench")
    recorded = TrialData(**{name: getattr(whole, name)[cut] for name in names}, centres=CENTRES)
    few = Table(POSES, {name: column[cut] for name, column in poses.columns.items()}, poses.facts)
    *_, tree, _ = STAGE.function(made(recorded, few, **SQUATS))
    assert tree.facts["motion"]["source"] == "segments"
    assert "only one repetition" in tree.facts["held_out"]["why"]
    assert list(tree.facts["motion"]["bands_hz"].values()) == list(USUAL)
    assert tree.facts["held_out"]["model"] is None
    assert np.isfinite(tree.data["base"]["sd"]).all()  # type: ignore[call-overload, index]


def test_pelvis_and_trunk_count_as_two_or_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A waist that does not bend: its torque cannot be told where both are one body, and the sum is the torso's."""
    centres = np.vstack([CENTRES, [0.0, 0.15]])
    local = np.vstack([LOCAL[:9], LOCAL[9:] - [0.0, 0.1], LOCAL[9:]])
    for name, value in (("CENTRES", centres), ("SEGMENT", np.repeat(range(5), 3)), ("LOCAL", local)):
        monkeypatch.setattr(test_stage_identify_dim, name, value)
    motion = moving(TIME, size=0.03)
    four = recorded_of(TIME, motion, noise=NOISE)
    rng = np.random.default_rng(2)
    waist = 0.01 * np.sin(2 * np.pi * 0.4 * TIME + rng.uniform(0, 6))[:, None]
    pulse = 2 * np.pi * 0.4
    q = np.hstack([four.q, waist])
    states = {"q": q, "dq": np.hstack([four.dq, 0 * waist]), "ddq": np.hstack([four.ddq, -(pulse**2) * waist])}
    recorded = replace(four, **states, ddq_sd=np.full_like(q, 0.05), centres=centres)
    one = poses_table(motion)
    columns, facts = {"time": TIME}, []
    torso, arm = one.facts["bodies"][3], one.facts["bodies"][4]
    two = {"pelvis": (3, np.zeros(2), 0.0), "trunk": (4, centres[3], 1.0)}
    for k in range(3):
        columns |= {f"{n}_{k + 1}": one[f"{n}_{k + 1}"] for n in ("x", "y", "angle", "markers")}
        facts.append(one.facts["bodies"][k])
    for k, (name, (segment, at, bends)) in enumerate(two.items(), start=4):
        places = local[3 * segment : 3 * segment + 3]
        angle = motion.angle[:, 3] + bends * waist[:, 0]
        place = motion.origin[:, 3] + planar.rotate(motion.angle[:, 3], at) + planar.rotate(angle, places.mean(axis=0))
        columns |= {
            f"x_{k}": place[:, 0],
            f"y_{k}": place[:, 1],
            f"angle_{k}": angle,
            f"markers_{k}": np.full(len(TIME), 3),
        }
        markers = {f"{name} {i}": each for i, each in enumerate(places.tolist())}
        facts.append({"name": name, "segments": [segment], "markers": markers, "residual_m": CAMERA})
    for k, (own, fact) in enumerate(((4, {**torso, "segments": [3, 4]}), (5, arm)), start=6):
        columns |= {f"{n}_{k}": one[f"{n}_{own}"] for n in ("x", "y", "angle", "markers")}
        facts.append(fact)
    poses = Table(POSES, columns, {"bodies": facts})
    plain = context(recorded, standing=MASS, **SQUATS)
    chain = {
        "joints": {
            "name": np.array(["ankle", "knee", "hip", "lumbar"], dtype=object),
            "centre": centres,
            "covariance": np.tile(1e-6 * np.eye(2), (4, 1, 1)),
        },
        "markers": {"segment": np.repeat(range(5), 3), "local": local, "residual": np.full(15, CAMERA)},
    }
    inputs = {**plain.inputs, "chain.h5": Tree(CHAIN, chain), "poses.parquet": poses}
    _, table, tree, _ = STAGE.function(Context(plain.trial, plain.settings, inputs))
    hdf5.conform_tree(tree)
    motion_facts = tree.facts["motion"]
    assert motion_facts["used"] in ([0, 1, 2, 5, 6], [0, 1, 2, 3, 4, 6])
    merged = motion_facts["used"] == [0, 1, 2, 5, 6]
    assert motion_facts["bodies"][3] == ("torso" if merged else "pelvis")
    assert table.frame["tau_4"].isna().all() == merged == ("tau_4" in tree.facts["untold"])
    assert table.frame["tau_3"].notna().any()
    full, base = tree.data["full"], tree.data["base"]
    np.testing.assert_allclose(base["regrouping"] @ full["value"], base["value"], atol=1e-6)  # type: ignore[call-overload, index]
    m, mx, my, inertia = full["value"].reshape(-1, 4).T  # type: ignore[call-overload, index]
    assert (m >= 0).all()
    assert (m * inertia >= (mx**2 + my**2) * (1 - 1e-6)).all()
    assert m.sum() == pytest.approx(MASS, rel=0.01)


def test_a_chain_that_is_asked_for_is_not_doubted_where_every_joint_holds() -> None:
    found = run(size=0.0, motion="chain", **SQUATS)
    assert all(gap["pinned"] for gap in found.facts["motion"]["joints"].values())
    assert "pinned-joint-gives-way" not in codes(found.tree)


def facts_of(source: str, offsets: list[float] | None, pinned: bool = False) -> dict[str, Any]:
    gap = {"gap_m": 0.0123, "acceleration_m_s2": 0.3, "pinned": pinned}
    held_out = None if offsets is None else {"clock_offset_s": offsets}
    return {"motion": {"source": source, "why": "measured", "joints": {"hip": gap}}, "held_out": held_out}


def said_of(facts: dict[str, Any]) -> list[Reason]:
    out = Findings()
    explain_motion(out, facts)
    return out.reasons


@pytest.mark.parametrize(
    ("offsets", "said"),
    [(None, False), ([], False), ([0.1], False), ([-0.004, 0.0, 0.0009], False), ([0.002, -0.0035, 0.0], True)],
)
def test_clocks_that_disagree_are_said(offsets: list[float] | None, said: bool) -> None:
    found = said_of(facts_of("chain", offsets))
    assert [each.code for each in found] == ["clocks-disagree"] * said
    if said:
        assert found[0].value == pytest.approx(0.0055)
        assert (found[0].level, found[0].limit) == ("caution", 0.005)


def test_the_place_of_a_joint_is_without_the_error_of_the_previous_one() -> None:
    """The distance of two places with independent errors has the sum of their variances."""
    places = np.random.default_rng(5).normal(size=(200_000, 3)) * [3.0, 2.0, 4.0]
    relative = np.var(np.diff(places, axis=1, prepend=0.0), axis=0)
    np.testing.assert_allclose(remove_previous_errors(relative), [9.0, 4.0, 16.0], rtol=0.05)
    np.testing.assert_allclose(remove_previous_errors(np.array([9.0, 8.0])), [8.0, 2.0])  # never none
    np.testing.assert_allclose(remove_previous_errors(np.array([50.0, 50.0, 4.0])), [50.0, 4.0, 1.0])  # within the next


@pytest.mark.parametrize(
    ("source", "pinned", "said"), [("segments", False, True), ("segments", True, False), ("chain", False, False)]
)
def test_only_joints_that_part_are_named(source: str, pinned: bool, said: bool) -> None:
    found = said_of(facts_of(source, None, pinned))
    assert [(each.code, each.level) for each in found] == [("joint-gives-way", "ok")] * said
    if said:
        assert "hip 12.3 mm" in found[0].message
    assert said_of({"motion": {"source": "chain", "why": "asked for"}, "held_out": None}) == []
