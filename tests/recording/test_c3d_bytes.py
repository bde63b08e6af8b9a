"""Decoding of C3D files in every encoding, compared with the ``c3d`` package and ezc3d; memory use."""

from __future__ import annotations

import io
import subprocess
import sys
import tracemalloc
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import c3d
import ezc3d
import numpy as np
import pytest
from recording_cases import body, build_c3d, save

from mocap_id import recording
from mocap_id.errors import RecordingError
from mocap_id.recording.c3d_file import C3DFile
from mocap_id.recording.c3d_package import compare_with_package

INTEL, DEC, MIPS = 84, 85, 86
FRAMES, MARKERS, PER_FRAME, CHANNELS = 60, 5, 4, 8
UNREADABLE = ("FP1.C3D", "PiG_Motion-FlatFoot-One.c3d", "evart.c3d", "kyowadengyo.c3d", "sample_propulsion.c3d")
"""Valid files that the package cannot read."""


def ours(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in file units, and analog samples (frames * per_frame, channels) in units."""
    file = C3DFile(Path("x.c3d"), io.BytesIO(data))
    points, counts = file.decode_frames(range(file.points), range(file.channels))
    offset, scale = file.read_channel_scales()
    return points, (counts - offset) * scale


def by_package(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the same from the ``c3d`` package, frame by frame."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frames = list(c3d.Reader(io.BytesIO(data)).read_frames())
    points = np.array([np.where(each[:, 3:4] >= 0, each[:, :3], np.nan) for _, each, _ in frames])
    return points.astype(float), np.concatenate([np.atleast_2d(each).T for _, _, each in frames])


def by_ezc3d(path: Path) -> tuple[np.ndarray, np.ndarray]:
    content = ezc3d.c3d(str(path))["data"]
    return content["points"][:3].transpose(2, 1, 0), content["analogs"][0].T


def made(processor: int, scale: float, **parameters: Any) -> bytes:
    rng = np.random.default_rng(4)
    residuals = np.where(rng.random((FRAMES, MARKERS)) < 0.1, -1, rng.integers(0, 9, (FRAMES, MARKERS)))
    points = body(FRAMES, MARKERS) * 1e3 * (residuals >= 0)[..., None]
    lowest, highest = (0, 65535) if parameters.get("ANALOG:FORMAT") == "UNSIGNED" else (-32768, 32767)
    analog = rng.integers(lowest, highest, (FRAMES * PER_FRAME, CHANNELS)).astype(float)
    calibrated: Mapping[str, Any] = {
        "ANALOG:SCALE": rng.uniform(0.1, 2.0, CHANNELS),
        "ANALOG:OFFSET": rng.integers(0, 300, CHANNELS),
        "ANALOG:GEN_SCALE": 0.5,
        **parameters,
    }
    return build_c3d(
        points, residuals=residuals, analog=analog, parameters=calibrated, scale=scale, processor=processor
    )


@pytest.mark.parametrize("unsigned", [False, True])
@pytest.mark.parametrize("scale", [-1.0, -0.1, 0.08])
@pytest.mark.parametrize("processor", [INTEL, DEC, MIPS])
def test_every_encoding_is_decoded_as_other_libraries_do(
    tmp_path: Path, processor: int, scale: float, unsigned: bool
) -> None:
    data = made(processor, scale, **({"ANALOG:FORMAT": "UNSIGNED"} if unsigned else {}))
    points, analog = ours(data)
    assert 0.05 < np.isnan(points[..., 0]).mean() < 0.15
    others = [by_package(data)]
    if processor != MIPS and not unsigned:  # which ezc3d does not read
        others.append(by_ezc3d(save(tmp_path, data)))
    for theirs, their_analog in others:
        np.testing.assert_allclose(theirs, points, rtol=1e-6, atol=1e-3)
        np.testing.assert_allclose(their_analog, analog, rtol=1e-6, atol=1e-3)
    assert compare_with_package(save(tmp_path, data)) == []


def test_all_encodings_give_the_same_trial(tmp_path: Path) -> None:
    """Equal within one count for integer files and within rounding for real ones, mm."""
    everything = [ours(made(processor, scale)) for processor in (INTEL, DEC, MIPS) for scale in (-1.0, 0.08)]
    for points, analog in everything[1:]:
        np.testing.assert_allclose(points, everything[0][0], atol=0.041)
        np.testing.assert_allclose(analog, everything[0][1], atol=0.01)


@pytest.mark.recordings
def test_shared_recordings_are_decoded_as_the_package_does(recordings: Path) -> None:
    """All frames if the package needs less than a second, otherwise the first 100."""
    compared = 0
    for path in sorted(p for p in recordings.rglob("*") if p.suffix.lower() == ".c3d"):
        if path.name in (*UNREADABLE, "Empty.c3d", "badParameterOffset.c3d", "marche281.c3d", "walkingOptiTrack.c3d"):
            continue
        assert compare_with_package(path) == []
        data = path.read_bytes()
        if len(data) > 4e6:
            continue
        for here, there in zip(ours(data), by_package(data), strict=True):
            if here.size:
                np.testing.assert_allclose(there, here, rtol=1e-6, atol=1e-3, err_msg=path.name)
        compared += 1
    assert compared > 30


@pytest.mark.recordings
def test_differences_of_the_package_are_reported(recordings: Path) -> None:
    def said(name: str) -> str:
        (sentence,) = compare_with_package(recordings / "c3d" / name)
        return sentence

    for name in UNREADABLE:
        assert "cannot read this file" in said(name)
    assert said("walkingOptiTrack.c3d") == "the c3d package counts 3362 frames, the file contains 3361"
    assert said("marche281.c3d") == "the c3d package treats 2900 measured samples of the first 100 frames as missing"


def test_different_values_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path, made(INTEL, -1.0))
    read = c3d.Reader.read_frames
    monkeypatch.setattr(c3d.Reader, "read_frames", lambda self: ((n, p + 1, a + 9) for n, p, a in read(self)))
    assert compare_with_package(path) == [
        "the c3d package reads different positions",
        "the c3d package reads different analog values",
    ]
    monkeypatch.setattr(c3d.Reader, "read_frames", lambda self: iter(()))
    assert compare_with_package(path) == ["the c3d package reads no frames of this file"]


def test_a_file_that_only_the_package_cannot_read_needs_no_action() -> None:
    (said,) = compare_with_package(Path(__file__).parents[2] / "sample_trials" / "curl" / "trial.c3d")
    assert "cannot read this file" in said
    assert said.endswith("read without that package, and you need to do nothing")


def test_the_block_size_has_no_influence(monkeypatch: pytest.MonkeyPatch) -> None:
    """The block size has no influence, even if smaller than a frame."""
    data = made(INTEL, 0.08)
    whole = ours(data)
    for size in (1, 1000, 7777):
        monkeypatch.setattr("mocap_id.recording.c3d_file._BLOCK_BYTES", size)
        for part, expected in zip(ours(data), whole, strict=True):
            np.testing.assert_array_equal(part, expected)


def test_a_file_that_is_truncated_while_it_is_read(tmp_path: Path) -> None:
    stream = io.BytesIO(made(INTEL, -1.0))
    file = C3DFile(Path("x.c3d"), stream)
    stream.truncate(file.start + 100)
    with pytest.raises(RecordingError, match=r"x.c3d: it changed while it was being read"):
        file.decode_frames(range(file.points), ())


def test_reading_needs_little_more_memory_than_the_positions(tmp_path: Path) -> None:
    """Neither the bytes of the file nor channels without a plate are kept in memory."""
    points = np.tile(body(1000, 40) * 1e3, (20, 1, 1))
    path = save(tmp_path, build_c3d(points, analog=np.zeros((len(points) * 4, 30))))
    tracemalloc.start()
    try:
        found = recording.read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < found.positions.nbytes + 8e6
    assert path.stat().st_size > found.positions.nbytes


def test_reading_imports_only_numpy(tmp_path: Path) -> None:
    path = save(tmp_path, made(INTEL, -1.0))
    script = "import sys, pathlib; from mocap_id import recording; recording.read(pathlib.Path(sys.argv[1]))"
    told = subprocess.run(
        [sys.executable, "-c", f"{script}; print(*sys.modules)", path], capture_output=True, text=True, check=True
    )
    loaded = set(told.stdout.split())
    assert "numpy" in loaded
    assert not loaded & {"pandas", "scipy.spatial", "scipy.ndimage", "scipy.stats", "c3d", "ezc3d"}
