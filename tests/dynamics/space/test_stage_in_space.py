"""The stage in space: its artefacts for a robot on a plate, and what it says where nothing can be identified."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from space_cases import plate_wrench, robot

from mocap_id.dynamics.space.preparation import COMPONENTS
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE, IdentifyDimSettings
from mocap_id.stages.trial_keys import Files, TrialKeys
from mocap_id.store import Table, Tree, hdf5, parquet
from mocap_id.store.provenance import ANGLES, CHAIN, POSES, WRENCH
from mocap_id_simulation import SpaceRobotTrial


def chain_tree(chain: SpatialChain, base: str) -> Tree:
    joints = chain.joints
    count = len(joints)
    names = [base, *(f"segment_{k}" for k in range(1, count + 1))]
    return Tree(
        CHAIN,
        {
            "joints": {
                "name": np.array([f"joint_{k}" for k in range(1, count + 1)], dtype=object),
                "kind": np.array([joint.kind for joint in joints], dtype=object),
                "parent": np.array([joint.parent for joint in joints]),
                "centre": np.array([joint.centre for joint in joints]),
                "covariance": np.tile(1e-8 * np.eye(3), (count, 1, 1)),
                "axes": np.array([[joint.first_axis, joint.second_axis] for joint in joints]),
                "axes_covariance": np.array([joint.axes_covariance for joint in joints]),
                "offset": np.array([joint.offset for joint in joints]),
                "glide": np.array([joint.glide for joint in joints]),
                "glide_covariance": np.array([joint.glide_covariance for joint in joints]),
                "rest": np.array([joint.rest for joint in joints]),
                "long_axis": np.array([joint.long_axis for joint in joints]),
                "untwisted": np.array([joint.untwisted for joint in joints]),
                "slide_sd": np.array([joint.slide_sd for joint in joints]),
                "known": np.array([joint.known for joint in joints]),
                "arc": np.ones(count),
            },
            "segments": {"name": np.array(names, dtype=object), "length": np.zeros(0), "length_sd": np.zeros(0)},
            "markers": {
                "name": np.array([f"M{k}" for k in range(len(chain.segment))], dtype=object),
                "segment": chain.segment,
                "local": chain.local,
                "residual": np.zeros(len(chain.segment)),
                "on_glide": chain.on_glide,
                "skin": np.zeros(len(chain.segment)),
                "skin_sd": np.zeros(len(chain.segment)),
            },
            "landmarks": {
                "name": np.zeros(0, dtype=object),
                "segment": np.zeros(0, dtype=np.int64),
                "local": np.zeros((0, 3)),
                "sd": np.zeros(0),
            },
        },
    )


def context(
    trial: SpaceRobotTrial, *, base: str = "segment_0", plate: bool = True, moving: float = 0.0, protocol: Any = "free"
) -> Context:
    motion, count = trial.motion, len(trial.time)
    poses: dict[str, Any] = {"time": trial.time}
    for k in range(motion.rotation.shape[1]):
        name = base if k == 0 else f"segment_{k}"
        quaternion = Rotation.from_matrix(motion.rotation[:, k]).as_quat()
        place = motion.origin[:, k] + (moving * np.sin(trial.time)[:, None] if k == 0 else 0.0)
        for i, axis in enumerate("xyz"):
            poses[f"{name}_{axis}"], poses[f"{name}_q{axis}"] = place[:, i], quaternion[:, i]
            poses[f"{name}_omega_{axis}"] = motion.omega[:, k, i]
            poses[f"{name}_alpha_{axis}"] = motion.alpha[:, k, i]
        poses |= {f"{name}_qw": quaternion[:, 3], f"{name}_observed": np.ones(count, dtype=np.bool_)}
        poses |= {f"sd_{name}_omega": np.full(count, 0.01), f"sd_{name}_alpha": np.full(count, 0.1)}
    wrench = plate_wrench(trial) if plate else np.full((count, 6), np.nan)
    columns = dict(zip(COMPONENTS, wrench.T, strict=True))
    facts = {
        "why": None if plate else "the recording has no force plates",
        "cop_threshold_N": 20.0,
        "analog_rate_hz": None,
        "mass_kg": None,
    }
    columns |= {"time": trial.time, "cop_x": wrench[:, 5] / wrench[:, 1], "plate_ok": np.isfinite(wrench[:, 0])}
    keys = TrialKeys(trial="t", space="3d", protocol=protocol, recording=Files(markers=Path("t.c3d")))
    inputs = {
        "poses.parquet": Table(POSES, poses, {}),
        "angles.parquet": Table(ANGLES, {"time": poses["time"]}, {}),
        "wrench.parquet": Table(WRENCH, columns, facts),
        "chain.h5": chain_tree(trial.robot.chain, base),
    }
    return Context(keys, IdentifyDimSettings(plate_position_sd_m=0.001), inputs)


def run(given: Context) -> tuple[Table, Table, Tree, Table]:
    events, table, tree, averages = STAGE.function(given)
    for one in (events, table, averages):
        parquet.conform_table(one)
    hdf5.conform_tree(tree)
    assert tuple(each.schema.file for each in (events, table, tree, averages)) == STAGE.outputs
    assert table.length == given.table("poses.parquet").length
    return events, table, tree, averages


def test_a_robot_on_a_plate_is_identified() -> None:
    trial = robot(1)
    events, table, tree, averages = run(context(trial))
    assert events.length == averages.length == 0
    value, regrouping = tree.numbers("base/value"), tree.numbers("base/regrouping", (-1, 30))
    true = regrouping @ trial.robot.parameters.ravel()
    assert np.linalg.norm(value - true) < 0.03 * np.linalg.norm(true)
    np.testing.assert_allclose(regrouping @ tree.numbers("full/value"), value, atol=1e-4)
    assert np.mean(np.abs(value - true) < 3 * tree.numbers("base/sd")) > 0.8
    assert tree.facts["clock_offset_s"] == pytest.approx(trial.clock_offset, abs=2e-3)
    assert tree.facts["wrench"].keys() == set(COMPONENTS)
    assert tree.facts["consistency"] == "cone"
    assert {row["column"] for row in tree.facts["torques"]} == {"tau_1", "tau_2"}
    inside = table["in_fit"]
    off = np.abs(table["tau_2"] - trial.torque[:, 1])[inside] / table["sd_tau_2"][inside]
    assert np.mean(off < 2) > 0.7
    assert np.isfinite(table.stack(["Fz_model", "taux_model", "tauy_model", "sd_tauy_model"])).all()
    assert not tree.reasons


@pytest.mark.parametrize(
    ("changes", "code", "word"),
    [
        ({"plate": False}, "no-wrench", "no force plates"),
        ({"base": "thorax"}, "base-not-carried", "thorax"),
        ({"protocol": "reach"}, "base-not-carried", "thorax"),
        ({"moving": 0.02}, "base-moves", "mm"),
    ],
)
def test_no_values_are_given_where_nothing_can_be_identified(changes: dict[str, Any], code: str, word: str) -> None:
    _, table, tree, _ = run(context(robot(1), **changes))
    assert np.isnan(tree.numbers("base/value")).all()
    assert np.isnan(table["tau_1"]).all()
    assert np.isnan(table["Fy_model"]).all()
    assert [reason.code for reason in tree.reasons] == [code]
    assert word in tree.facts["why"]


def test_a_plate_under_something_else_is_noticed() -> None:
    trial = robot(1)
    given = context(trial)
    wrench = given.table("wrench.parquet")
    other = context(robot(2)).table("wrench.parquet")
    columns = {name: other[name] if name in COMPONENTS else wrench[name] for name in wrench.names}
    swapped = {**given.inputs, "wrench.parquet": Table(WRENCH, columns, wrench.facts)}
    _, _, tree, _ = run(Context(given.trial, given.settings, swapped))
    assert "wrench-unexplained" in [reason.code for reason in tree.reasons]
