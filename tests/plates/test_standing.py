"""Standing is recognised from the markers, not from the load, so that a seated person gives no mass."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from mocap_id import recording
from mocap_id.plates.choice import choose_plates, weigh_person
from mocap_id.recording.sample_checks import shows_standing

FRAMES = np.ones(5, dtype=bool)
LEGS = [(0.0, 0.06), (0.02, 0.25), (-0.03, 0.48)]
STANDING = [*LEGS, (0.03, 0.7), (0.0, 0.95), (-0.08, 1.1), (0.08, 1.4), (0.0, 1.7)]
SEATED = [*LEGS, (-0.2, 0.5), (-0.42, 0.52), (-0.5, 0.7), (-0.36, 1.0), (-0.42, 1.25)]


def body(sagittal: list[tuple[float, float]], turn: float = 0.0) -> np.ndarray:
    """Return both sides of a person, 0.3 m apart, (5, M, 3)."""
    x, z = np.array(sagittal).T
    sides = np.concatenate([np.stack([x, np.full_like(x, side), z], axis=1) for side in (-0.15, 0.15)])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.tile(sides @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]), (5, 1, 1))


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.0])
def test_upright_legs_are_thin_and_level_thighs_are_not(turn: float) -> None:
    assert shows_standing(body(STANDING, turn), FRAMES)
    assert not shows_standing(body(SEATED, turn), FRAMES)


def test_markers_up_to_the_pelvis_are_sufficient() -> None:
    assert shows_standing(body(STANDING[:5]), FRAMES)
    assert not shows_standing(body(SEATED[:5]), FRAMES)


def test_flat_or_absent_markers_show_nothing() -> None:
    flat = body(STANDING) * [1, 0, 1]
    assert not shows_standing(flat, FRAMES)
    assert not shows_standing(np.full_like(flat, np.nan), FRAMES)


def test_arms_forwards_do_not_matter() -> None:
    assert shows_standing(body([*STANDING, (0.42, 1.3)]), FRAMES)


read = lru_cache(maxsize=1)(recording.read)
"""Cached, since several windows of a recording are used in turn."""


def shown(markers: Path, forces: Path | None, window: tuple[float, float]) -> tuple[float | None, str | None]:
    """Return the mass from the plates within a window."""
    source = read(markers, forces)
    inside = (source.time >= window[0]) & (source.time <= window[1])
    positions, time = source.positions[inside], source.time[inside]
    samples = [recording.decimate(plate, time, source.rate) for plate in source.plates]
    feet = choose_plates(source.plates, samples, positions).indices("feet")
    return weigh_person(positions, source.rate, sum(samples[index].force[:, 2] for index in feet))


@pytest.mark.recordings
@pytest.mark.parametrize("end", [2.2, 2.6, 3.0])
@pytest.mark.parametrize("name", ["sts-normal", "sts-dynamic", "sts-stable-rotated-plate"])
def test_a_seated_load_gives_no_mass(recordings: Path, name: str, end: float) -> None:
    mass, why = shown(recordings / "simulated" / name / "trial.c3d", None, (0.0, end))
    assert mass is None
    assert why is not None


@pytest.mark.recordings
def test_a_seated_person_gives_no_mass(recordings: Path) -> None:
    trc = recordings / "sit-to-stand" / "STS1.trc"
    assert shown(trc, trc.with_name("STS1_grf.mot"), (0.0, 1.0))[0] is None


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("markers", "forces", "expected"),
    [
        ("sit-to-stand/static1.trc", "sit-to-stand/static1_grf.mot", 60.0),
        ("sit-to-stand/STS1.trc", "sit-to-stand/STS1_grf.mot", 60.0),
        ("sit-to-stand/squats1.trc", "sit-to-stand/squats1_grf.mot", 60.0),
        ("c3d/Sample_Static.c3d", None, 79.6),
        ("simulated/sts-normal/trial.c3d", None, 82.4),
    ],
)
def test_a_standing_person_gives_the_mass(recordings: Path, markers: str, forces: str | None, expected: float) -> None:
    mass, why = shown(recordings / markers, forces and recordings / forces, (-np.inf, np.inf))
    assert why is None
    assert mass == pytest.approx(expected, rel=0.01)
