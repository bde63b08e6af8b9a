"""What held-out repetitions become in the artefacts, and when the verdict warns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dynamics_cases import moving_body
from test_stage_identify_dim import codes, run, with_

from mocap_id.protocols.repetitions import compute_posture
from mocap_id.protocols.sit_to_stand import find_sit_to_stand_repetitions
from mocap_id.stages.base import Findings
from mocap_id.stages.identify_dim.dynamics_artefacts import SERIES, explain_validation
from mocap_id.verdict import Reason

NOISE = (0.5, 0.5, 0.15)


def errors(**rms: float) -> dict[str, dict[str, float] | None]:
    """Errors without bias; one in every series that is not named."""
    return {name: {"bias": 0.0, "sd": rms.get(name, 1.0), "r2": 0.9} for name in SERIES}


def found(model: Any, within: Any, table: Any) -> dict[str, Any]:
    return {"model": model, "in_sample": within, "reference": table}


def said(facts: dict[str, Any]) -> list[Reason]:
    out = Findings()
    explain_validation(out, facts)
    return out.reasons


def test_a_repeated_movement_is_validated() -> None:
    recorded = moving_body(seconds=30.0, noise=NOISE)
    events, table, tree = run(recorded, protocol="robot-joint")
    facts, frame = tree.facts["held_out"], table.frame
    assert facts["repetitions"] == len(events.frame) >= 2
    assert facts["folds"] == len(facts["clock_offset_s"]) == min(facts["repetitions"], 5)
    assert facts["why"] is None
    assert facts["reference"] is None
    assert list(facts["model"]) == list(facts["in_sample"]) == ["Fx", "Fy", "tauz", "cop_x"]
    seen = frame["in_fit"] & frame["Fy_held_out"].notna()
    assert facts["samples"] == seen.sum() == frame["in_fit"].sum()
    assert frame.loc[~frame["in_fit"], "Fy_held_out"].isna().all()
    for part, noise in zip(("Fx", "Fy", "tauz"), NOISE, strict=True):
        assert facts["model"][part]["sd"] == pytest.approx(noise, rel=0.1)
        assert facts["model"][part]["sd"] >= 0.999 * facts["in_sample"][part]["sd"]
        assert facts["in_sample"][part] == pytest.approx(tree.facts["wrench"][part])
    off = (frame["cop_x_held_out"] - frame["cop_x"])[seen]
    assert facts["model"]["cop_x"]["sd"] == pytest.approx(off.std(ddof=0), rel=0.02)
    held: Any = tree.data["held_out"]
    assert held["base"].shape == (facts["folds"], len(tree.data["base"]["value"]))  # type: ignore[call-overload, index]
    np.testing.assert_array_equal(held["clock_offset"], facts["clock_offset_s"])
    assert codes(tree) == []


@pytest.mark.parametrize(("protocol", "many"), [("free", "no repetition"), ("sit-to-stand", "only one repetition")])
def test_without_two_repetitions_it_says_so(protocol: str, many: str) -> None:
    recorded = moving_body(seconds=30.0, noise=NOISE)
    if protocol == "sit-to-stand":
        body = compute_posture(recorded.q, recorded.dq, recorded.centres)
        first = find_sit_to_stand_repetitions(recorded.time, body, None, chair=False)[0]
        last = recorded.time < first.end + 0.3
        cut = {
            name: getattr(recorded, name)[last] for name in ("time", "q", "dq", "ddq", "ddq_sd", "observed", "wrench")
        }
        recorded = with_(recorded, **cut)
    _, table, tree = run(recorded, protocol=protocol)
    facts = tree.facts["held_out"]
    assert many in facts["why"]
    assert all(facts[name] is None for name in ("folds", "samples", "model", "in_sample", "reference"))
    assert table.frame[["Fx_held_out", "cop_x_held_out"]].isna().all().all()
    held: Any = tree.data["held_out"]
    assert held["base"].shape == (0, 11)


def test_what_the_components_do_not_tell_is_not_predicted_either() -> None:
    recorded = moving_body(seconds=30.0, noise=NOISE)
    _, table, tree = run(recorded, protocol="robot-joint", components=("Fx", "Fy"))
    facts = tree.facts["held_out"]
    assert facts["model"]["tauz"] is None
    assert facts["model"]["cop_x"] is None
    assert facts["model"]["Fy"]["r2"] > 0.999
    assert table.frame[["tauz_held_out", "cop_x_held_out"]].isna().all().all()


def test_a_model_that_is_better_than_the_table_and_repeats_gives_no_reason() -> None:
    assert said(found(errors(), errors(), errors(Fy=1.1, tauz=2.0, cop_x=1.01, Fx=0.5))) == []
    assert said(found(errors(), errors(), None)) == []
    assert said({"model": None}) == []


@pytest.mark.parametrize("name", ["Fy", "tauz", "cop_x"])
def test_no_better_than_the_table_is_said(name: str) -> None:
    (reason,) = said(found(errors(), errors(), errors(**{name: 0.8})))
    assert (reason.code, reason.level, reason.limit) == ("held-out-worse", "caution", 1.0)
    assert reason.value == pytest.approx(1.25)
    assert ("the centre of pressure" if name == "cop_x" else name) in reason.message


@pytest.mark.parametrize("name", SERIES)
def test_far_above_the_error_of_the_fit_is_said(name: str) -> None:
    (reason,) = said(found(errors(**{name: 1.6}), errors(), None))
    assert (reason.code, reason.limit) == ("held-out-far", 1.5)
    assert reason.value == pytest.approx(1.6)
    assert said(found(errors(**{name: 1.4}), errors(), None)) == []


def test_far_above_next_to_nothing_is_nothing() -> None:
    tiny = {name: {"bias": 0.0, "sd": 1e-6, "r2": 1 - 1e-9} for name in SERIES}
    tinier = {name: {"bias": 0.0, "sd": 1e-8, "r2": 1.0} for name in SERIES}
    assert said(found(tiny, tinier, None)) == []


def test_an_unknown_error_is_no_evidence() -> None:
    unknown = errors() | {"tauz": None, "cop_x": None}
    assert said(found(unknown, unknown, errors(tauz=0.1, cop_x=0.1))) == []
