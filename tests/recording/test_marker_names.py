"""Marker names: prefixes, repetitions, and trajectories that are not markers."""

from __future__ import annotations

import pytest

from mocap_id.recording.markers import name_markers

OUTPUTS = (
    *("LKneeAngles", "RGroundReactionForce", "LHipMoment", "RAnklePower", "LNormalisedGRF"),
    *("CentreOfMass", "CentreOfMassFloor", "L_HJC", "R_HJC_reg", "LAJC", "RKJC", "L.HJC", "LeftHipJointCenter"),
)


def test_subject_prefixes_are_stripped_unless_two_subjects_share_a_name() -> None:
    assert name_markers(["Anna:LKNE", "Anna:RKNE"]).labels == ("LKNE", "RKNE")
    shared = name_markers(["Anna:LKNE", "Ben:LKNE", "C7"])
    assert shared.labels == ("subject-1:LKNE", "subject-2:LKNE", "C7")
    assert "2 subjects" in shared.oddities[0]


def test_no_message_contains_the_name_of_a_subject() -> None:
    for labels in (["Anna:LKNE", "Anna:C7"], ["Anna:LKNE", "Ben:LKNE"], ["Anna:LKNE", "Ben:RKNE", "Anna:LKneeAngles"]):
        naming = name_markers(labels)
        assert naming.oddities
        assert not any(name in text for text in (*naming.oddities, *naming.labels) for name in ("Anna", "Ben"))


@pytest.mark.parametrize(
    ("labels", "subjects"),
    [
        (["Anna_LKNE", "Anna_C7"], ["Anna_"]),
        (["Anna_LKNE", "Anna_C7"], ["Anna"]),
        (["Anna LKNE", "C7"], ["Anna"]),
        (["Anna-Lena.LKNE", "Anna.C7"], ["Anna", "Anna-Lena"]),
    ],
)
def test_declared_subjects_are_removed_without_a_colon(labels: list[str], subjects: list[str]) -> None:
    assert name_markers(labels, subjects=subjects).labels == ("LKNE", "C7")


def test_a_name_that_is_only_part_of_a_word_is_kept() -> None:
    assert name_markers(["HEAD", "HE", "L_KNE"], subjects=["HE", "L"]).labels == ("HEAD", "HE", "KNE")
    assert name_markers(["HEAD", "HE"], subjects=["HE"]).oddities == ()


def test_repeated_labels_are_numbered() -> None:
    naming = name_markers(["A", "B", "A", "A#2", "A"])
    assert naming.labels == ("A", "B", "A#3", "A#2", "A#4")
    assert len(set(naming.labels)) == 5
    assert "A" in naming.oddities[0]


def test_trajectories_without_a_label_are_named() -> None:
    naming = name_markers(["A", "", "  "])
    assert naming.labels == ("A", "unlabelled-1", "unlabelled-2")


@pytest.mark.parametrize("output", OUTPUTS)
def test_outputs_of_models_are_omitted(output: str) -> None:
    naming = name_markers(["C7", output])
    assert naming.labels == ("C7",)
    assert naming.keep == (0,)
    assert output in naming.oddities[0]


@pytest.mark.parametrize(
    "marker", ["C7", "T10", "LASI", "RTHI", "HEAD", "PELO", "LTOP", "*17", "r_sh2", "SACR", "V_Sacral"]
)
def test_markers_are_kept(marker: str) -> None:
    assert name_markers([marker, "STRN"]).labels == (marker, "STRN")


def test_segment_frames_are_recognised_by_their_four_points() -> None:
    assert name_markers(["PELO", "PELA", "PELL", "PELP", "PELV"]).labels == ("PELV",)
    assert name_markers(["PELO", "PELA", "PELP"]).labels == ("PELO", "PELA", "PELP")


def test_declared_outputs_are_omitted_with_and_without_prefix() -> None:
    assert name_markers(["S:Thing", "S:C7"], outputs=["S:Thing"]).labels == ("C7",)
