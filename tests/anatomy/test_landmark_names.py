"""Landmarks by the names that laboratories use."""

from __future__ import annotations

import pytest

from mocap_id.anatomy.landmarks import MIDDLE, SIDED, find_landmarks
from mocap_id.errors import RecordingError

CORE = {"IJ", "PX", "C7", "T8", "AC", "EL", "EM", "RS", "US"}

SETS = {
    "isb": "IJ PX C7 T8 AC EL EM US RS THX1 UPA1 FOR1 HND1",
    "isb, sides in front": "IJ PX C7 T8 RAC REL REM RRS RUS",
    "isb, sides behind": "IJ PX C7 T8 AC_R EL_R EM_R RS_R US_R",
    "gait model": "S1:CLAV S1:XYPH S1:C7 S1:T8 S1:RSHO S1:RELB S1:RELBM S1:RWRA S1:RWRB S1:RUPA S1:RFRM S1:RFIN",
    "human body model": "JugularNotch XYPH C7 T8 RSHO RLEE RMEE RLW RMW RDELT",
    "words": "Sternum_Notch Xiphoid C7 T8 Right_Acromion Right_Lateral_Epicondyle Right_Medial_Epicondyle "
    "Right_Radial_Styloid Right_Ulnar_Styloid",
    "inertial suit": "pIJ pPX pC7SpinalProcess pT8SpinalProcess pRightAcromion pRightArmLatEpicondyle "
    "pRightArmMedEpicondyle pRightRadialStyloid pRightUlnarStyloid pRightKneeLatEpicondyle",
    "sides in the middle": "SternumNotch XiphoidProcess C7 T8 RAcromion R_LatEpicondyle R.MedEpicondyle RWristRad "
    "RWristUln",
    "elbow lat, med": "CLAV XPRO CV7 TV8 RACR RLEL RMEL RRSP RUSP RHMC2",
}


@pytest.mark.parametrize("name", SETS)
def test_common_marker_sets_are_read(name: str) -> None:
    found = find_landmarks(SETS[name].split())
    assert set(found.markers) >= CORE
    assert found.side in ("right", None)
    assert not found.reasons
    order = [found.markers[k] for k in ("IJ", "PX", "C7", "T8", "AC")]
    assert order == [0, 1, 2, 3, 4]


def test_a_left_arm_with_clusters_is_read_and_clusters_are_not() -> None:
    clusters = "CH1 CH2 LUA1 LUA2 LUA3 LUA4 LLA1 LLA2 LLA3 LLA4 LH1 LH2 LH3 LACR1 LACR2 LACR3 ST1 ST2 ST3 P1 P2"
    landmarks = "LEL LEM LRS LUS LMC3 LMCP2 LMCP3 LMCP5 LAA LAI LTS LPC LAC LGH C7 T8 IJ PX"
    labels = f"{clusters} {landmarks}".split()
    found = find_landmarks(labels)
    assert found.side == "left"
    assert {name: labels[i] for name, i in found.markers.items()} == {
        name: name if name in ("C7", "T8", "IJ", "PX") else "L" + name for name in (*MIDDLE, *SIDED)
    }


def test_both_arms_need_a_choice() -> None:
    labels = ["IJ", "PX", "C7", "T8", "REL", "REM", "RRS", "LEL", "LEM", "LRS", "LUS"]
    free = find_landmarks(labels)
    assert free.side == "left"
    assert [r.code for r in free.reasons] == ["two-arms"]
    right = find_landmarks(labels, side="right")
    assert right.markers["EL"] == labels.index("REL")
    assert "US" not in right.markers
    assert not right.reasons


def test_the_wrong_side_is_an_error_that_names_the_markers() -> None:
    with pytest.raises(RecordingError, match=r"left arm .*LEL"):
        find_landmarks(["LEL", "LEM"], side="right")


def test_two_equal_names_are_not_used() -> None:
    found = find_landmarks(["RLatEpi", "RElbowLat", "REM"])
    assert "EL" not in found.markers
    (reason,) = found.reasons
    assert reason.code == "landmark-ambiguous"
    assert "RLatEpi and RElbowLat" in reason.message


def test_given_names_win_and_doubtful_ones_are_told() -> None:
    labels = ["Sternum", "STRN", "T10", "REL", "LatSpot"]
    found = find_landmarks(labels)
    assert found.markers == {"IJ": 0, "PX": 1, "T8": 2, "EL": 3}
    assert {r.code for r in found.reasons} == {"landmark-doubtful"}
    given = find_landmarks(labels, {"EL": "LatSpot", "IJ": "Sternum", "PX": "STRN", "T8": "T10"})
    assert given.markers["EL"] == 4
    assert not given.reasons


@pytest.mark.parametrize(("given", "words"), [({"EL": "XX"}, "no marker"), ({"ELBOW": "REL"}, "not a landmark")])
def test_a_wrong_given_name_is_an_error(given: dict[str, str], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        find_landmarks(["REL"], given)


def test_clusters_without_names_give_nothing() -> None:
    assert find_landmarks(["M001", "M002", "*12", "unlabelled-1", "LUA1", "RTHI", "LASI", ""]).markers == {}
