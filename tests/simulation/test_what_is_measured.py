"""Markers and plate of a simulated trial: noise, occlusions, soft tissue, plate poses and sign conventions."""

from __future__ import annotations

import itertools
import json

import ezc3d
import numpy as np
import pytest

from mocap_id.geometry import PlaneFrame, planar
from mocap_id.recording import read
from mocap_id_simulation import Options, generate, simulate


@pytest.fixture(scope="module")
def trial():
    return generate("sit-to-stand", Options(seed=21, repetitions=2))


def test_only_hidden_markers_vanish_in_bursts(trial):
    markers = trial.scene.markers
    assert trial.bursts
    assert all(5 <= burst.n_frames <= 200 for burst in trial.bursts)
    np.testing.assert_array_equal(np.isnan(trial.points).any(axis=2), ~trial.visible)
    assert not (~trial.visible[:, ~markers.hidden]).any()
    assert (markers.link[markers.hidden] == 3).all()
    assert 0.001 < 1 - trial.visible.mean() < 0.03


def test_noise_is_white_and_as_asked(trial):
    error = (trial.points - trial.positions)[:, ~trial.scene.markers.hidden]
    assert error.std() == pytest.approx(0.0005, rel=0.02)
    lagged = (error[1:] * error[:-1]).mean() / error.var()
    assert abs(lagged) < 0.01


def test_without_soft_tissue_markers_are_fixed_to_the_links():
    made = generate("sit-to-stand", Options(seed=21, repetitions=1, soft_tissue=0.0))
    scene, markers = made.scene, made.scene.markers
    flat = scene.plane.to_plane(made.positions)
    angle, origin = planar.segment_poses(made.state.q, scene.body.centres)
    local = planar.rotate(-angle[:, markers.link], flat[..., :2] - origin[:, markers.link])
    np.testing.assert_allclose(local, np.broadcast_to(markers.local[:, :2], local.shape), atol=1e-12)
    np.testing.assert_allclose(flat[..., 2] - scene.offset, np.broadcast_to(markers.local[:, 2], local.shape[:2]))


def test_the_body_has_43_markers_and_the_plate_seven(trial):
    markers = trial.scene.markers
    assert len(markers.labels) == len(set(markers.labels)) == 50
    assert [int((markers.link == link).sum()) for link in range(4)] == [11, 8, 6, 25]
    assert sum(label.startswith("PLT") for label in markers.labels) == 7
    assert np.ptp(markers.local[:, 2]) > 0.3


def rigid_residuals(flat, seen):
    """Return the residual (T, M, 2) of the rigid least-squares fit of a mean shape to one link's markers (T, M, 2)."""
    keep = seen.all(axis=1)
    z = (flat[..., 0] + 1j * flat[..., 1])[keep]
    z = z - z.mean(axis=1, keepdims=True)
    shape = z[0]
    for _ in range(10):
        turn = z @ shape.conj()
        turn /= np.abs(turn)
        shape = (z * turn.conj()[:, None]).mean(axis=0)
    off = z * turn.conj()[:, None] - shape
    return np.stack([off.real, off.imag], axis=-1)


def size_and_memory(flat, seen, rate):
    """Return the median rms (mm) over a link's markers, and the residuals' mean correlation over half a second."""
    off = rigid_residuals(flat, seen)
    lag = round(rate / 2)
    memory = (off[lag:] * off[:-lag]).sum(axis=(0, 2)) / (off**2).sum(axis=(0, 2))
    return 1e3 * np.median(np.sqrt((off**2).sum(axis=2).mean(axis=0))), np.mean(memory)


@pytest.fixture(scope="module")
def bodies():
    """Trials of several bodies."""
    return [generate("sit-to-stand", Options(seed=seed, repetitions=3)) for seed in range(6)]


@pytest.mark.recordings
@pytest.mark.parametrize("link", [1, 2])
def test_soft_tissue_is_as_large_and_as_slow_as_the_reference(recordings, bodies, link):
    """Compares rigid-fit residuals of thigh and shank with the shared simulated trial, over several bodies."""
    folder = recordings / "simulated" / "sts-normal"
    truth = json.loads((folder / "truth.json").read_text())
    content = ezc3d.c3d(str(folder / "trial.c3d"))
    axes = np.array([truth["plane"][f"{axis}_axis_lab"] for axis in "xy"])
    rows = [i for i, m in enumerate(truth["markers"]) if m["segment"] == link and not m["at_joint"]]
    flat = np.transpose(content["data"]["points"][:3, rows], (2, 1, 0)) / 1e3 @ axes.T
    size, memory = size_and_memory(flat, np.isfinite(flat).all(axis=2), truth["point_rate_hz"])
    ours = []
    for made in bodies:
        markers = made.scene.markers
        rows = [i for i in np.flatnonzero(markers.link == link) if markers.at_joint[i] is None]
        projected = made.scene.plane.to_plane(made.points[:, rows])[..., :2]
        ours.append(size_and_memory(projected, made.visible[:, rows], 100.0))
    found_size, found_memory = np.median(ours, axis=0)
    assert 0.67 < found_size / size < 1.5
    assert abs(found_memory - memory) < 0.15


PLATES = list(itertools.product(["reaction", "action"], [False, True], [False, True]))


@pytest.mark.parametrize(("sense", "moved", "flipped"), PLATES)
@pytest.mark.parametrize("kind", ["sit-to-stand", "robot"])
def test_the_reader_recovers_the_wrench_from_any_plate(tmp_path, kind, sense, moved, flipped):
    options = Options(
        seed=8,
        repetitions=1,
        plate_sense=sense,
        plate_moved=moved,
        plate_origin_flipped=flipped,
        plate_noise=0.0,
        clock_offset=0.05,
    )
    simulate(kind, tmp_path / "trial", options)
    recording = read(tmp_path / "trial" / "trial.c3d")
    scene = generate(kind, options).scene
    plate = recording.plates[0]
    expected = scene.at(np.arange(len(plate.force)) / plate.rate + 0.05).wrench
    frame = PlaneFrame(scene.plane.yaw, scene.plane.origin)
    found = frame.wrench_to_plane(plate.force, plate.moment)
    np.testing.assert_allclose(found, expected, atol=0.01)
    np.testing.assert_allclose(plate.corners.mean(axis=0), scene.plane.origin, atol=1e-6)


def test_bias_and_noise_of_the_plate(tmp_path):
    quiet, loud = (Options(seed=9, repetitions=1, plate_noise=x, plate_bias=y) for x, y in ((0, 0), (2, 1)))
    difference = generate("robot", loud).signals.channels - generate("robot", quiet).signals.channels
    np.testing.assert_allclose(difference.std(axis=0), [2, 2, 2, 0.6, 0.6, 0.6], rtol=0.05)
    bias = generate("robot", loud).scene.plate.bias
    assert (bias != 0).all()
    np.testing.assert_allclose(difference.mean(axis=0), bias, atol=0.15)


def test_markers_come_back_from_the_file(tmp_path):
    options = Options(seed=10, repetitions=1)
    simulate("sit-to-stand", tmp_path / "trial", options)
    recording, made = read(tmp_path / "trial" / "trial.c3d"), generate("sit-to-stand", options)
    assert recording.labels == made.scene.markers.labels
    assert recording.time[0] == 0.0
    np.testing.assert_allclose(recording.positions, made.points, atol=1e-6)
