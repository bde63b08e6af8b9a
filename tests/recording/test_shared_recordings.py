"""Reading of real files from many vendors, and of simulated trials with a known truth."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from mocap_id import recording
from mocap_id.errors import RecordingError
from mocap_id.geometry.planar import PlaneFrame
from mocap_id.plates.choice import choose_plates, weigh_person
from mocap_id.recording.lab_plates import compute_centre_of_pressure
from mocap_id.workflows.recording_trial import describe_recording

pytestmark = pytest.mark.recordings

REFUSED = {
    "Empty.c3d": "not a C3D file",
    "badParameterOffset.c3d": "'UNITS' is damaged",
    "dynamic.C3D": "no length unit",
}
READ = {
    "FP1.C3D": (480, 8),
    "Gait.c3d": (487, 33),
    "PiG_Motion-FlatFoot-One.c3d": (255, 35),
    "Sample_Jump2.c3d": (264, 51),
    "Sample_Static.c3d": (275, 39),
    "TYPE-2.C3D": (199, 13),
    "TYPE-3.c3d": (515, 21),
    "TYPE-4.C3D": (199, 13),
    "c3dfile1.c3d": (1095, 70),
    "dec_int.c3d": (89, 36),
    "dec_real.c3d": (89, 36),
    "evart.c3d": (243, 22),
    "kyowadengyo.c3d": (152, 11),
    "marche281.c3d": (961, 29),
    "parameterOverflow.c3d": (101, 70),
    "pc_int.c3d": (89, 36),
    "pc_real.c3d": (89, 36),
    "sample_propulsion.c3d": (700, 41),
    "sgi_int.c3d": (89, 36),
    "sgi_real.c3d": (89, 36),
    "shd01.c3d": (237, 27),
    "stoop1_t169_f620f800.c3d": (181, 38),
    "stoop1_t169_f620f800_2D.c3d": (181, 38),
    "type1.C3D": (296, 28),
    "walking5.c3d": (1103, 34),
    "walkingOptiTrack.c3d": (3361, 12),
}
SIX = ("pc_int", "pc_real", "dec_int", "dec_real", "sgi_int", "sgi_real")
SIMULATED = ("sts-normal-clean", "sts-normal", "sts-dynamic", "sts-stable-rotated-plate", "ur5-elbow-fast")


def test_every_file_is_tested(recordings: Path) -> None:
    assert {path.name for path in (recordings / "c3d").iterdir()} == READ.keys() | REFUSED.keys()


@pytest.mark.parametrize("name", REFUSED)
def test_refused_with_a_reason(recordings: Path, name: str) -> None:
    with pytest.raises(RecordingError, match=REFUSED[name]) as caught:
        recording.read(recordings / "c3d" / name)
    assert name in str(caught.value)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("name", READ)
def test_read_without_a_change_to_the_file(recordings: Path, name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    shutil.copyfile(recordings / "c3d" / name, path)
    path.chmod(0o444)
    before = hashlib.sha256(path.read_bytes()).digest(), path.stat().st_mtime_ns
    found = recording.read(path)
    assert (hashlib.sha256(path.read_bytes()).digest(), path.stat().st_mtime_ns) == before
    assert found.positions.shape == (*READ[name], 3)
    assert len(set(found.labels)) == READ[name][1]
    assert np.all(np.diff(found.frames) == 1)
    description = json.dumps(describe_recording(found), allow_nan=False)
    assert json.loads(description)["frames"] == READ[name][0]


def test_configured_units_allow_a_file_without_units(recordings: Path) -> None:
    with_units = recording.read(recordings / "c3d" / "dynamic.C3D", units="mm")
    assert with_units.positions.shape == (296, 34, 3)
    assert with_units.vertical == "Y"


def test_six_encodings_of_one_trial_agree(recordings: Path) -> None:
    found = [recording.read(recordings / "c3d" / f"{name}.c3d") for name in SIX]
    for other in found[1:]:
        assert other.labels == found[0].labels
        np.testing.assert_array_equal(other.visible, found[0].visible)
        assert np.nanmax(np.abs(other.positions - found[0].positions)) < 0.3e-3
        for a, b in zip(other.plates, found[0].plates, strict=True):
            np.testing.assert_allclose(a.force, b.force, atol=0.5)
            np.testing.assert_allclose(a.moment, b.moment, atol=0.5)


@pytest.mark.parametrize(
    "name", [n for n in READ if n not in ("evart.c3d", "kyowadengyo.c3d", "type1.C3D") and not n.startswith("sgi")]
)
def test_coordinates_agree_with_another_library(recordings: Path, name: str) -> None:
    """For files that ezc3d reads correctly; it loses frames of evart, kyowadengyo and type1, and refuses MIPS."""
    path = recordings / "c3d" / name
    found = recording.read(path)
    content = ezc3d.c3d(str(path))
    metres = {"m": 1.0, "mete": 1.0}.get(found.units, 1e-3)
    names = [label.split(":")[-1].strip() for label in content["parameters"]["POINT"]["LABELS"]["value"]]
    theirs = content["data"]["points"][:3].transpose(2, 1, 0) * metres
    for i, label in enumerate(found.labels):
        if names.count(label) != 1 or names.index(label) >= theirs.shape[1]:
            continue
        one = theirs[:, names.index(label)]
        seen = found.visible[:, i]
        if found.vertical == "Z":
            np.testing.assert_allclose(found.positions[seen, i], one[seen], atol=1e-5)
        assert np.isnan(one[~seen]).any(axis=1).all() or np.all(one[~seen] == 0)


def test_no_recording_has_samples_that_software_repeated_or_filled(recordings: Path) -> None:
    files = [path for kind in ("*.c3d", "*.C3D", "*.trc") for path in recordings.rglob(kind)]
    assert files
    for path in files:
        forces = path.with_name(f"{path.stem}_grf.mot")
        try:
            found = recording.read(path, forces if forces.exists() else None, unit_required=False)
        except RecordingError:
            continue
        assert not found.held, path.name


@pytest.mark.parametrize("name", ["evart.c3d", "kyowadengyo.c3d", "type1.C3D"])
def test_files_that_a_library_misreads_move_smoothly(recordings: Path, name: str) -> None:
    """With a wrong stride, markers would jump by metres between frames."""
    found = recording.read(recordings / "c3d" / name)
    steps = np.linalg.norm(np.diff(found.positions, axis=0), axis=2)
    assert np.nanquantile(steps, 0.999) * found.rate < 8.0  # m/s


def test_two_calibrations_of_the_same_counts(recordings: Path) -> None:
    two, four = (
        recording.read(recordings / "c3d" / name).plates[0].force[:, 2] for name in ("TYPE-2.C3D", "TYPE-4.C3D")
    )
    loaded = two > 100
    assert loaded.sum() > 100
    assert np.abs(four - two).max() < 0.025 * two.max()
    assert np.abs(four[two > 300] / two[two > 300] - 1).max() < 0.025
    assert abs(four[loaded].mean() / two[loaded].mean() - 1) > 0.005


@pytest.mark.parametrize(("name", "kg"), [("Sample_Static.c3d", 79.6), ("c3dfile1.c3d", 61.97)])
def test_masses_of_people_who_stand(recordings: Path, name: str, kg: float) -> None:
    found = describe_recording(recording.read(recordings / "c3d" / name))
    assert found["mass_kg"] == pytest.approx(kg, abs=0.1)


def test_mass_by_a_jump(recordings: Path) -> None:
    """In a regression of vertical force on trunk acceleration, the intercept is the weight."""
    found = recording.read(recordings / "c3d" / "Sample_Jump2.c3d")
    total = sum(recording.decimate(plate, found.time, found.rate).force[:, 2] for plate in found.plates)
    names = [found.labels.index(name) for name in ("RASI", "LASI", "VSAC", "RSHO", "LSHO")]
    height = found.positions[:, names, 2].mean(axis=1)
    window = np.ones(7) / 7
    acceleration = np.gradient(np.gradient(np.convolve(height, window, "same"))) * found.rate**2
    inner = slice(12, -12)
    slope, intercept = np.polyfit(acceleration[inner], total[inner], 1)
    assert np.corrcoef(acceleration[inner], total[inner])[0, 1] > 0.94
    assert intercept / 9.81 == pytest.approx(65.0, abs=1.0)
    assert 40 < slope < 75


def test_masses_of_the_sit_to_stands(recordings: Path) -> None:
    for name, kg, tolerance in (("static1", 60.0, 0.1), ("STS1", 60.0, 0.6), ("squats1", 60.0, 0.6)):
        folder = recordings / "sit-to-stand"
        found = recording.read(folder / f"{name}.trc", folder / f"{name}_grf.mot")
        samples = [recording.decimate(plate, found.time, found.rate) for plate in found.plates]
        choice = choose_plates(found.plates, samples, found.positions)
        assert choice.uses == ("feet", "feet", "unloaded")
        total = samples[0].force[:, 2] + samples[1].force[:, 2]
        mass, _ = weigh_person(found.positions, found.rate, total)
        assert mass == pytest.approx(kg, abs=tolerance)
        assert not any("HJC" in label for label in found.labels)


@pytest.mark.parametrize(
    ("name", "feet"),
    [
        ("kyowadengyo.c3d", "LANK RANK LMT5 RMT5"),
        ("TYPE-3.c3d", "RANK LANK RHEE LHEE RTOE LTOE"),
        ("TYPE-2.C3D", "RA LA RD LD"),
        ("TYPE-4.C3D", "RA LA RD LD"),
        ("Gait.c3d", "RANK RHEE RTOE LANK LHEE LTOE"),
        ("walking5.c3d", "LCAL LMT1 LMT2 RCAL RMT1 RMT2"),
        ("type1.C3D", "RMALL RMET LMALL LMET"),
        ("PiG_Motion-FlatFoot-One.c3d", "LANK LHEE LTOE RANK RHEE RTOE"),
        ("pc_real.c3d", "RFT1 RFT2 RFT3 LFT1 LFT2 LFT3"),
        ("Sample_Jump2.c3d", "RHEE R.TO LHEE L.TO"),
    ],
)
def test_the_load_acts_under_a_foot(recordings: Path, name: str, feet: str) -> None:
    """For types 1 to 4, with any corners, origins and signs, the centre of pressure is near the markers of a foot."""
    found = recording.read(recordings / "c3d" / name)
    markers = found.positions[:, [found.labels.index(label) for label in feet.split()], :2]
    for plate in found.plates:
        ratio = round(plate.rate / found.rate)
        point, vertical = compute_centre_of_pressure(plate, plate)[::ratio], plate.force[::ratio, 2]
        loaded = np.flatnonzero(vertical[: len(markers)] > 0.5 * vertical.max())
        gaps = np.linalg.norm(markers[loaded] - point[loaded, None], axis=2)
        nearest = np.nanmin(np.where(np.isfinite(gaps), gaps, np.inf), axis=1)
        assert np.median(nearest[np.isfinite(nearest)]) < 0.12


def test_oddities_that_files_are_known_for(recordings: Path) -> None:
    expected = {
        "kyowadengyo.c3d": "11 fits its size",
        "evart.c3d": "ANALOG:RATE is 1000 Hz",
        "PiG_Motion-FlatFoot-One.c3d": "occur more than once",
        "FP1.C3D": "'mete' is truncated",
        "shd01.c3d": "subject names",
        "parameterOverflow.c3d": "is ever visible",
        "Sample_Jump2.c3d": "numbered",
    }
    for name, part in expected.items():
        oddities = recording.read(recordings / "c3d" / name).oddities
        assert any(part in oddity for oddity in oddities), (name, oddities)
    broken = recording.read(recordings / "c3d" / "shd01.c3d")
    assert [plate.usable for plate in broken.plates] == [True, False]
    assert not any(plate.usable for plate in recording.read(recordings / "c3d" / "evart.c3d").plates)


def test_no_real_sample_is_called_saturated(recordings: Path) -> None:
    for name in READ:
        for plate in recording.read(recordings / "c3d" / name).plates:
            assert plate.ok.all() or not plate.usable


@pytest.mark.parametrize("share", [0.3, 0.9, 0.995])
def test_truncated_copies_are_refused(recordings: Path, tmp_path: Path, share: float) -> None:
    for name in ("Gait.c3d", "c3dfile1.c3d", "TYPE-3.c3d", "sgi_real.c3d"):
        data = (recordings / "c3d" / name).read_bytes()
        path = tmp_path / name
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(RecordingError, match=r"truncated|corrupt"):
            recording.read(path)


@pytest.mark.parametrize("trial", SIMULATED)
def test_the_wrench_of_simulated_trials(recordings: Path, trial: str) -> None:
    """In the true plane, only noise remains after removing the clock offset and the known bias."""
    folder = recordings / "simulated" / trial
    truth = json.loads((folder / "truth.json").read_text())
    found = recording.read(folder / "trial.c3d")
    (plate,) = found.plates
    assert plate.centre is not None
    np.testing.assert_allclose(plate.centre * 1e3, truth["plate"]["centre_lab_mm"], atol=1e-3)
    frame = PlaneFrame(np.radians(truth["plane"]["yaw_deg"]), plate.centre)
    samples = recording.decimate(plate, found.time - truth["analog_offset_s"], found.rate)
    with np.load(folder / "truth.npz") as arrays:
        error = frame.wrench_to_plane(samples.force, samples.moment) - arrays["wrench"]
    error = error[samples.ok]
    assert samples.ok.mean() > 0.999
    known = _bias(truth, frame)
    assert np.abs(known).max() <= 5.6
    noisy = truth["plate"]["noise_f"] > 0
    np.testing.assert_array_less(np.abs(error.mean(axis=0) - known), [0.05, 0.05, 0.02])
    np.testing.assert_array_less((error - known).std(axis=0), np.array([0.6, 0.6, 0.2]) if noisy else 0.02)
    assert np.sqrt((error[:, 1] ** 2).mean()) <= 4.0
    assert np.sqrt((error[:, 2] ** 2).mean()) <= 1.5


def _bias(truth: dict, frame: PlaneFrame) -> np.ndarray:  # type: ignore[type-arg]
    """Return the constant error of force and moment about the surface in the plane: (Fx, Fy, tauz)."""
    channels = np.array(truth["plate"]["bias_channels_N_Nmm"] or [0.0] * 6) * [1, 1, 1, 1e-3, 1e-3, 1e-3]
    sign = -1.0 if truth["plate"]["sense"] == "action" else 1.0
    axes = np.array(truth["plate"]["axes_lab_columns"])
    force, surface = axes @ channels[:3], axes @ channels[3:]
    return sign * np.array([*(frame.axes[:2] @ force), frame.axes[2] @ surface])


def test_simulated_drop_outs_are_missing_and_nothing_else(recordings: Path) -> None:
    for trial in ("sts-normal", "ur5-elbow-fast"):
        folder = recordings / "simulated" / trial
        with np.load(folder / "truth.npz") as arrays:
            np.testing.assert_array_equal(recording.read(folder / "trial.c3d").visible, arrays["valid"])
