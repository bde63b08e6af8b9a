"""summary.json always follows its schema; numbers are finite or null, and a null has a reason."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reporting_cases import LOST, Trial, context

from mocap_id.errors import Refused
from mocap_id.reporting.grids import to_number, to_numbers
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.reporting.summary_schema import Summary
from mocap_id.results import join_sentences
from mocap_id.stages.report import report_data
from mocap_id.store import Artefact, Table
from mocap_id.verdict import Reason

PROMISED = {
    "schema", "version", "trial", "product", "verdict", "plane", "segments", "joints", "lengths_m", "markers", "noise",
    "dynamics", "repetitions", "time_s",
}  # fmt: skip
UNSURE = Reason("segments-unsure", "two hypotheses fit alike", 0.41, 0.5)
NOTE = Reason("window-proposed", "used 2.0 to 31.5 s", level="ok")


def summary_of(artefacts: dict[str, Artefact], refused: Refused | None = None) -> dict[str, Any]:
    """The summary as read by another program: strict JSON that follows the schema."""

    def no_constant(name: str) -> float:
        raise AssertionError(f"{name} is not JSON")

    text = encode_summary(summarise(report_data(context(artefacts, refused)))).decode("ascii")
    summary: dict[str, Any] = json.loads(text, parse_constant=no_constant)
    Summary.model_validate(summary)
    assert set(summary) >= PROMISED
    return summary


def objects(value: Any) -> Iterator[dict[str, Any]]:
    """Every object of a JSON document."""
    match value:
        case dict():
            yield value
            for item in value.values():
                yield from objects(item)
        case list():
            for item in value:
                yield from objects(item)


def assert_nulls_explained(summary: dict[str, Any]) -> None:
    """Check that an object has a ``why`` exactly if it contains a null.

    But for a hypothesis, which says why it lost, and the motion, which says why it was chosen.
    """
    explained = [entry for entry in objects(summary) if "why" in entry and not {"chosen", "source"} & set(entry)]
    assert explained
    for entry in explained:
        unknown = [key for key, value in entry.items() if value is None and key != "why"]
        assert bool(unknown) == bool(entry["why"]), entry


def test_the_summary_of_a_good_trial_agrees_with_the_artefacts() -> None:
    trial = Trial()
    summary = summary_of(trial.artefacts())
    assert summary["schema"] == "mocap-id/summary" and summary["version"] == 1 and summary["trial"] == "s01-sts"
    assert summary["verdict"] == {"level": "ok", "reasons": [], "notes": []}
    assert summary["plane"]["yaw_deg"] == 12.5 and summary["plane"]["out_of_plane_share"] == 0.012
    assert summary["segments"]["count"] == 4
    assert summary["segments"]["assignment"] == dict(zip(trial.labels, trial.segment.tolist(), strict=True))
    assert [joint["name"] for joint in summary["joints"]] == ["ankle", "knee", "hip"]
    assert summary["joints"][0]["sd_m"] == pytest.approx([1e-3, 2e-3])
    assert summary["joints"][1]["arc_deg"] == pytest.approx(math.degrees(np.ptp(trial.theta[:, 1])))
    assert {name: length["value"] for name, length in summary["lengths_m"].items()} == {"shank": 0.43, "thigh": 0.42}
    assert summary["markers"]["reprojection_rms_mm"] == pytest.approx(2.8)
    assert summary["noise"] == {"marker_sd_m": 0.0021, "sigma_v": 3200.0, "sigma_v_per_joint": [3200.0], "why": None}
    assert summary["dynamics"]["base"][0] == {
        "name": "m1+m2+m3+m4", "value": 71.2, "sd": 0.3, "unit": "kg", "verdict": "known", "relative_sd": 0.004,
        "excitation": 310.0, "own_share": 0.9, "helps": "none of those tried", "sd_ratio": 1.0,
        "prior_share": 0.0, "why": None,
    }  # fmt: skip
    assert summary["dynamics"]["wrench"]["Fy"]["r2"] == 0.991
    assert summary["dynamics"]["samples"] == 900
    assert summary["dynamics"]["consistency"] == "grid"
    assert list(summary["dynamics"]["rivals"]) == ["winter", "de-leva"]
    rival = summary["dynamics"]["rivals"]["winter"]
    assert (rival["cop_rms_m"], rival["wrench"]["tauz"]["bias"]) == (0.0345, 4.5)
    held_out = summary["dynamics"]["held_out"]
    assert (held_out["repetitions"], held_out["folds"], held_out["samples"]) == (3, 3, 880)
    assert [held_out[of]["tauz"]["bias"] for of in ("model", "in_sample", "reference")] == [0.6, 0.5, 4.5]
    assert held_out["clock_offset_s"] == [0.0070, 0.0071, 0.0073]
    assert summary["time_s"] == {"planarise": 0.21, "segment": 0.4}
    assert_nulls_explained(summary)


def test_the_largest_torques_are_those_without_contact_in_words_and_per_kilogram() -> None:
    """Where an unmeasured support carries the body, or the torque is far less certain than usual, none is reported."""
    trial = Trial()
    artefacts = trial.artefacts()
    table = artefacts["dynamics.parquet"]
    assert isinstance(table, Table)
    tau, sd, contact = 10 * np.sin(3 * trial.time), np.ones(len(trial.time)), table["contact"].copy()
    contact[100], tau[100] = True, 200.0
    contact[200], tau[200], sd[200] = False, 150.0, 30.0
    contact[300], tau[300] = False, 90.0
    facts = {"legs": "both", "positive": {"knee": ["extension", "flexion"]}}
    known = replace(table.with_columns(tau_2=tau, sd_tau_2=sd, contact=contact), facts=facts)
    dynamics = summary_of(artefacts | {"dynamics.parquet": known})["dynamics"]
    knee = dynamics["torques"]["knee"]
    assert dynamics["legs"] == "both" and (knee["positive"], knee["negative"]) == ("extension", "flexion")
    assert (knee["highest_nm"], knee["highest_sd_nm"], knee["highest_time_s"]) == (90.0, 1.0, trial.time[300])
    assert knee["highest_nm_per_kg"] == pytest.approx(90.0 / dynamics["mass_kg"]) and knee["known"] == 1.0
    assert dynamics["torques"]["ankle"]["positive"] == "positive"
    nothing = known.with_columns(tau_2=np.full(len(tau), np.nan), contact=np.ones_like(contact))
    summary = summary_of(artefacts | {"dynamics.parquet": nothing})
    knee = summary["dynamics"]["torques"]["knee"]
    assert knee["highest_nm"] is None and knee["known"] == 0.0 and "no plate measures" in knee["why"]
    assert_nulls_explained(summary)


def test_the_pinned_chain_has_a_reason_and_no_comparison() -> None:
    dynamics = summary_of(Trial().artefacts())["dynamics"]
    gap = {"gap_m": 0.0006, "acceleration_m_s2": 0.012, "pinned": True, "why": None}
    assert dynamics["motion"] == {
        "source": "chain", "why": "the gaps of all joints are within the noise", "bands_hz": None, "bands_why": None,
        "bodies": None, "prior": None,
        "bodies_condition_number": None, "bodies_condition_number_scaled": None,
        "joints": {"ankle": gap, "knee": gap, "hip": gap},
    }  # fmt: skip
    nothing = dict.fromkeys(("samples", "chain", "segments", "clock_offset_s"))
    assert dynamics["pins"] == nothing | {"why": "the dynamics use the pinned chain"}
    assert dynamics["held_out"]["unfiltered"] == dynamics["held_out"]["model"]


def test_measured_poses_agree_with_the_facts() -> None:
    summary = summary_of(Trial().on_segments())
    dynamics = summary["dynamics"]
    motion, pins, held_out = dynamics["motion"], dynamics["pins"], dynamics["held_out"]
    assert motion["source"] == "segments" and motion["bands_hz"] == {"x": 3.5, "y": 6.0, "angle": 4.0}
    assert motion["bodies"] == ["foot", "shank", "trunk", "others"] and motion["prior"] == "winter"
    assert {name: gap["pinned"] for name, gap in motion["joints"].items()} == {
        "ankle": True,
        "knee": False,
        "hip": False,
    }
    assert (pins["samples"], pins["clock_offset_s"], pins["why"]) == (654, -0.0052, None)
    assert (pins["chain"]["cop_rms_m"], pins["segments"]["cop_rms_m"]) == (0.0261, 0.0087)
    assert (pins["chain"]["wrench"]["Fy"]["sd"], pins["segments"]["wrench"]["Fy"]["sd"]) == (8.0, 4.0)
    assert [entry["prior_share"] for entry in dynamics["base"]] == [0.016, 0.848, 0.182, 0.134]
    assert held_out["unfiltered"]["Fx"]["bias"] == 0.8 and held_out["inside"]["Fy"] == 0.968
    assert_nulls_explained(summary)


def test_pins_that_could_not_be_compared_say_why() -> None:
    artefacts = Trial().on_segments()
    tree = artefacts["dynamics.h5"]
    why = "only one repetition was found"
    pins = {"why": why, "chain": None, "segments": None, "clock_offset_s": -0.0052}
    gap = {"gap_m": 0.01, "acceleration_m_s2": float("nan"), "pinned": True}
    facts = tree.facts | {"pins": pins, "motion": tree.facts["motion"] | {"joints": {"hip": gap}}}
    summary = summary_of(artefacts | {"dynamics.h5": replace(tree, facts=facts)})
    assert summary["dynamics"]["pins"]["why"] == why and summary["dynamics"]["pins"]["clock_offset_s"] == -0.0052
    assert summary["dynamics"]["motion"]["joints"]["hip"]["acceleration_m_s2"] is None
    assert_nulls_explained(summary)


def test_missing_left_out_repetitions_are_null_with_a_reason() -> None:
    artefacts = Trial().artefacts()
    tree = artefacts["dynamics.h5"]
    nothing = dict.fromkeys(("folds", "samples", "model", "in_sample", "reference", "clock_offset_s"))
    single = tree.facts | {"held_out": {"repetitions": 1, **nothing, "why": "only one repetition was found"}}
    summary = summary_of(artefacts | {"dynamics.h5": replace(tree, facts=single)})
    held_out = summary["dynamics"]["held_out"]
    unknown = nothing | {"unfiltered": None, "inside": None}
    assert held_out == {"repetitions": 1, **unknown, "why": "only one repetition was found"}
    unmatched = tree.facts | {"held_out": tree.facts["held_out"] | {"reference": None}}
    held_out = summary_of(artefacts | {"dynamics.h5": replace(tree, facts=unmatched)})["dynamics"]["held_out"]
    assert held_out["why"].startswith("reference: there is no reference body")
    assert held_out["model"] is not None
    assert_nulls_explained(summary)


def test_every_rejected_hypothesis_has_a_reason() -> None:
    trial = Trial()
    segments = summary_of(trial.artefacts())["segments"]
    chosen, lost = segments["hypotheses"]
    assert chosen == {
        "segments": 4, "cost": -120.5, "why": "chosen", "chosen": True, "left_out": 0,
        "joint_residual_m": [0.0021] * 3, "arc_deg": [35.5] * 3,
    }  # fmt: skip
    assert (lost["segments"], lost["why"], lost["chosen"], lost["left_out"]) == (3, LOST, False, 4)
    assert segments["against"] == trial.segments().facts["against"]
    early = summary_of({"planar.parquet": trial.planar()}, Refused("no-motion", "no joint moves"))["segments"]
    assert early["against"] is None and early["hypotheses"] is None and "no-motion" in early["why"]


def test_load_shares_are_in_the_order_of_the_movement() -> None:
    """A file contains the keys of its facts in alphabetical order."""
    trial = Trial()
    events = trial.events()
    left = dict(sorted(events.facts["load_share"]["left"].items()))
    facts = {**events.facts, "load_share": {**events.facts["load_share"], "left": left}}
    summary = summarise(report_data(context(trial.artefacts() | {"events.parquet": replace(events, facts=facts)})))
    assert list(left) != list(summary.load_share.left) == ["seated", "rising", "standing"]


def test_unknown_events_are_null_with_the_reason() -> None:
    repetitions = summary_of(Trial().artefacts())["repetitions"]
    assert [entry["seat_on_s"] for entry in repetitions] == [pytest.approx(4.8), pytest.approx(10.8), None]
    assert repetitions[2]["why"] == "no seat-on was found" and not repetitions[2]["complete"]
    assert repetitions[0]["why"] is None and repetitions[0]["complete"]


def test_a_sentence_within_another_is_not_repeated() -> None:
    assert (
        join_sentences(["no plate", None, "no wrench: no plate", "no plate", "too short"])
        == "no wrench: no plate; too short"
    )


def test_cautions_affect_the_verdict_and_notes_do_not() -> None:
    trial = Trial()
    noted = trial.artefacts() | {"planar.parquet": trial.planar((NOTE,))}
    assert summary_of(noted)["verdict"]["level"] == "ok"
    cautious = summary_of(noted | {"segments.parquet": trial.segments((UNSURE, NOTE))})["verdict"]
    assert cautious["level"] == "caution"
    assert [reason["code"] for reason in cautious["reasons"]] == ["segments-unsure"]
    assert cautious["reasons"][0]["value"] == 0.41 and cautious["reasons"][0]["limit"] == 0.5
    assert [note["code"] for note in cautious["notes"]] == ["window-proposed"], "each reason once"


def test_without_a_plate_the_kinematics_are_complete() -> None:
    summary = summary_of(Trial().artefacts(plates=False))
    dynamics = summary["dynamics"]
    known = {key for key, value in dynamics.items() if value is not None}
    assert known == {"rivals", "held_out", "pins", "legs", "torques", "why"}
    assert dynamics["torques"] == {}
    assert dynamics["rivals"] == {}
    assert dynamics["why"] == "the recording has no force plate"
    assert summary["joints"] and summary["repetitions"]
    assert_nulls_explained(summary)


def test_a_refused_trial_reports_what_is_known() -> None:
    trial = Trial()
    artefacts: dict[str, Artefact] = {
        "planar.parquet": trial.planar((Reason("planarity", "some motion is out of plane", 0.1, 0.05),)),
        "wrench.parquet": trial.wrench(),
    }
    summary = summary_of(artefacts, Refused("no-motion", "no joint moves", 0.004, 0.015))
    assert summary["verdict"]["level"] == "refused"
    assert [reason["code"] for reason in summary["verdict"]["reasons"]] == ["no-motion", "planarity"]
    assert summary["plane"]["planarity"] == 0.004
    assert summary["dynamics"]["mass_kg"] == 71.4
    assert summary["dynamics"]["cop_mean_m"] == pytest.approx(np.mean(trial.wrench()["cop_x"]))
    assert summary["joints"] is None and summary["lengths_m"] is None and summary["repetitions"] is None
    assert "no-motion" in summary["why"] and "no-motion" in summary["segments"]["why"]
    assert_nulls_explained(summary)


def test_refused_before_the_first_artefact() -> None:
    summary = summary_of({}, Refused("not-planar", "the motion is not planar"))
    assert summary["plane"]["yaw_deg"] is None
    assert_nulls_explained(summary)


def test_not_finite_numbers_become_null() -> None:
    trial = Trial()
    artefacts = trial.artefacts()
    planar = trial.planar((Reason("odd", "a ratio overflowed", np.inf, np.nan),))
    facts = dict(planar.facts) | {"plane": {"yaw_deg": float("nan"), "planarity": np.float64(0.1), "origin_m": None}}
    states = trial.states()
    artefacts["planar.parquet"] = replace(planar, facts=facts)
    artefacts["states.parquet"] = replace(states, facts=dict(states.facts) | {"sigma_v": [1e3, 2e3, 3e3]})
    chain = trial.chain()
    artefacts["chain.h5"] = replace(
        chain, data=dict(chain.data) | {"joints": dict(chain.data["joints"]) | {"arc": np.full(3, np.nan)}}
    )
    summary = summary_of(artefacts)
    assert summary["plane"]["yaw_deg"] is None and summary["plane"]["planarity"] == 0.1
    assert summary["verdict"]["reasons"][0]["value"] is None
    assert summary["noise"]["sigma_v_per_joint"] == [1e3, 2e3, 3e3]
    assert summary["noise"]["sigma_v"] == pytest.approx(np.sqrt(14 / 3) * 1e3)
    assert [joint["arc_deg"] for joint in summary["joints"]] == [None] * 3
    assert_nulls_explained(summary)


@pytest.mark.parametrize("joints", [1, 4])
def test_short_and_long_chains(joints: int) -> None:
    summary = summary_of(Trial(joints=joints).artefacts())
    assert summary["segments"]["count"] == joints + 1 and len(summary["joints"]) == joints
    assert list(summary["lengths_m"]) == ["shank", "thigh", "torso"][: joints - 1]


def test_no_repetition_is_an_empty_list() -> None:
    trial = Trial()
    summary = summary_of(trial.artefacts() | {"events.parquet": trial.events(0)})
    assert summary["repetitions"] == []


def test_unloaded_samples_do_not_count_for_the_mean_centre_of_pressure() -> None:
    trial = Trial()
    row = np.arange(trial.frames)
    cop = np.where(row < 100, 5.0, np.where(row % 2, 0.01, np.nan))
    artefacts = trial.artefacts() | {"wrench.parquet": trial.wrench().with_columns(cop_x=cop, plate_ok=row >= 100)}
    assert summary_of(artefacts)["dynamics"]["cop_mean_m"] == pytest.approx(0.01)


@given(st.one_of(st.floats(), st.integers(-(2**53), 2**53), st.text(), st.none(), st.booleans()))
def test_known_is_a_finite_float_or_none(value: object) -> None:
    number = to_number(value)
    assert number is None or (type(number) is float and math.isfinite(number) and number == value)


def test_a_vector_with_an_unknown_element_is_unknown() -> None:
    assert to_numbers(np.array([1.0, 2.0])) == [1.0, 2.0]
    assert to_numbers([1.0, float("nan")]) is None
    assert to_numbers([]) is None and to_numbers(None) is None and to_numbers("12") is None


def test_a_known_mass_is_given_alone() -> None:
    trial = Trial()
    tree = trial.dynamics_tree()
    why = "no joint turns where only the ground touches the body"
    unknown = np.full(4, np.nan)
    base = dict(tree.data["base"]) | {"value": np.array([71.4, *unknown[1:]]), "sd": unknown}
    facts = dict.fromkeys(tree.facts) | {"why": why}
    standing = replace(tree, data=dict(tree.data) | {"base": base}, facts=facts)
    dynamics = summary_of(trial.artefacts() | {"dynamics.h5": standing})["dynamics"]
    assert [entry["value"] for entry in dynamics["base"]] == [71.4, None, None, None]
    assert {entry["why"] for entry in dynamics["base"]} == {why}
    assert dynamics["why"] == why and dynamics["mass_kg"] == 71.4


def test_a_null_points_to_the_caution_that_explains_it() -> None:
    trial = Trial()
    tree = trial.dynamics_tree()
    doubt = Reason("clock-offset-unknown", "the movement does not show it")
    facts = dict(tree.facts) | {"clock_offset_s": None, "clock_offset_sd_s": None}
    dynamics = summary_of(trial.artefacts() | {"dynamics.h5": replace(tree, facts=facts, reasons=(doubt,))})["dynamics"]
    assert dynamics["clock_offset_s"] is None and dynamics["why"] == "see clock-offset-unknown in the verdict"
