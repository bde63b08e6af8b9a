"""identify-dim with a chair on its own plate and other sensors: used, refused where they cannot be, and told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from dynamics_cases import BODY, CENTRES
from test_external_fit import CHAIR, HAND, supported
from test_stage_identify_dim import MASS, codes, context

from mocap_id.dynamics.preparation import TrialData
from mocap_id.dynamics.regressor import SEAT, planar_regressor
from mocap_id.errors import ConfigError
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import STAGE
from mocap_id.store import Table, Tree, hdf5, parquet

NAMES = ["foot", "shank", "thigh", "torso"]


def with_external(
    recorded: TrialData, factor: float = 1.0, segments: dict[str, str | int] | None = None, **settings: Any
) -> Context:
    """The stage's context with the recording's external wrenches among the columns."""
    made = context(recorded, **settings)
    wrench, chain = made.table("wrench.parquet"), made.tree("chain.h5")
    columns, facts = dict(wrench.columns), []
    for number, each in enumerate(recorded.external, start=1):
        suffix = SEAT if each.name == SEAT else f"external_{number}"
        values = dict(zip(("Fx", "Fy", "tauz"), factor * each.wrench.T, strict=True))
        columns |= {f"{name}_{suffix}": column for name, column in values.items()}
        fact = {"name": each.name, "columns": suffix, "clock": "plates" if each.by_plates else "cameras"}
        if each.name != SEAT:
            fact["segment"] = (segments or {}).get(each.name, each.segment)
        facts.append(fact)
    inputs = {
        "wrench.parquet": replace(wrench, columns=columns, facts={**wrench.facts, "external": facts}),
        "chain.h5": replace(chain, data={**chain.data, "segments": {"name": NAMES}}),
    }
    return Context(made.trial, made.settings, {**made.inputs, **inputs})


def run(made: Context) -> tuple[pd.DataFrame, Tree]:
    _, table, tree, _ = STAGE.function(made)
    assert isinstance(table, Table)
    assert isinstance(tree, Tree)
    parquet.conform_table(table), hdf5.conform_tree(tree)
    return table.frame, tree


def mass(tree: Tree) -> float:
    base: Any = tree.data["base"]
    return float(base["value"][0])


def test_chair_and_hand_are_inputs() -> None:
    recorded = supported(CHAIR, HAND)
    frame, tree = run(with_external(recorded, segments={"hand": "torso"}))
    assert mass(tree) == pytest.approx(MASS, rel=3e-4)
    assert codes(tree) == ["seat-measured"]
    inner = slice(10, -10)
    external = sum(each.wrench for each in recorded.external)
    for k, name in enumerate(("Fx", "Fy", "tauz")):
        np.testing.assert_allclose(frame[f"{name}_external"][inner], external[inner, k], atol=0.5)
        np.testing.assert_allclose(frame[name][inner], recorded.wrench[inner, k], atol=1.0)
        np.testing.assert_allclose(frame[f"{name}_model"][inner], recorded.wrench[inner, k], atol=4.0)
    assert [(fact["name"], fact["segment"]) for fact in tree.facts["external"]] == [(SEAT, 2), ("hand", 3)]
    for fact in tree.facts["external"]:
        for factor in fact["factors"].values():
            assert factor["value"] == pytest.approx(1.0, abs=0.02)
    assert tree.facts["wrench"]["Fy"]["r2"] > 0.999


def test_without_external_wrenches_nothing_is_told() -> None:
    frame, tree = run(context(replace(supported(), external=())))
    assert tree.facts["external"] == []
    assert not [name for name in frame if "external" in name]


def test_the_seat_may_push_on_another_segment() -> None:
    """It makes no difference to the body, and all of it to the torques."""
    recorded = supported(CHAIR)
    thigh, tree = run(with_external(recorded))
    torso, named = run(with_external(recorded, seat_segment="torso"))
    _, numbered = run(with_external(recorded, seat_segment=3))
    assert mass(tree) == mass(named) == mass(numbered)
    assert numbered.facts["external"] == named.facts["external"]
    np.testing.assert_array_equal(torso["tau_1"], thigh["tau_1"])
    assert np.nanmax(np.abs(torso["tau_3"] - thigh["tau_3"])) > 50


@pytest.mark.parametrize(
    ("wanted", "settings", "key"),
    [({}, {"seat_segment": "leg"}, "identify-dim: seat_segment"), ({"hand": 4}, {}, "external: hand: segment")],
)
def test_a_segment_that_is_not_there(wanted: dict[str, str | int], settings: dict[str, Any], key: str) -> None:
    made = with_external(supported(CHAIR, HAND), segments=wanted, **settings)
    with pytest.raises(ConfigError, match=f"{key}: there is no segment .* 0 \\(foot\\), 1 \\(shank\\)"):
        run(made)


def test_a_chair_whose_plate_has_the_wrong_sign_is_left_out() -> None:
    recorded = supported(CHAIR)
    frame, tree = run(with_external(recorded, factor=-1.0))
    assert "seat-contradiction" in codes(tree)
    message = next(reason.message for reason in tree.reasons if reason.code == "seat-contradiction")
    assert "times -1.0" in message
    assert tree.facts["external"] == []
    assert "Fy_external" not in frame
    unused, without = run(with_external(recorded, seat_plate=False))
    assert mass(tree) == mass(without)
    assert "seat-measured" not in codes(without)
    np.testing.assert_array_equal(unused["tau_1"], frame["tau_1"])


def test_a_sensor_with_the_wrong_sign_is_said() -> None:
    _, tree = run(with_external(supported(HAND), factor=-1.0))
    assert codes(tree).count("external-contradiction") == 1
    message = next(reason.message for reason in tree.reasons if reason.code == "external-contradiction")
    assert "`hand` times -1.0" in message
    assert "on-sensor" in message


def seated() -> TrialData:
    """Trunk and legs move a little, a chair on its own plate carries three quarters of the weight, nobody rises."""
    recorded = supported(CHAIR)
    still = {name: 0.15 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    total = planar_regressor(CENTRES, **still) @ BODY.ravel()
    noise = np.random.default_rng(5).normal(size=total.shape) * [0.5, 0.5, 0.15]
    chair = recorded.external[0].wrench
    return replace(recorded, **still, wrench=total - chair + noise)


def test_somebody_who_stays_seated_is_identified_where_the_chair_is_measured() -> None:
    _, tree = run(with_external(seated(), protocol="sit-to-stand", standing=None))
    assert mass(tree) == pytest.approx(MASS, rel=2e-3)
    assert {"seat-measured", "no-repetitions"} <= set(codes(tree))
    assert "the force of the chair is measured" in next(
        reason.message for reason in tree.reasons if reason.code == "no-repetitions"
    )
    _, blind = run(with_external(seated(), protocol="sit-to-stand", standing=None, seat_plate=False))
    assert "not-free" in codes(blind)


def test_rest_on_two_plates_shows_the_whole_mass() -> None:
    recorded = seated()
    still = {name: 0 * getattr(recorded, name) for name in ("q", "dq", "ddq")}
    weight = np.tile([0.0, 9.81 * MASS, -12.0], (len(recorded.time), 1))
    external = (replace(recorded.external[0], wrench=0.7 * weight),)
    resting = replace(recorded, **still, wrench=0.3 * weight, external=external)
    _, tree = run(with_external(resting, protocol="sit-to-stand", standing=None))
    assert "standing-still" in codes(tree)
    assert mass(tree) == pytest.approx(MASS, rel=1e-6)
