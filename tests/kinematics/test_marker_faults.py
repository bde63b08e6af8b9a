"""Markers that are bad for some time: found and named, and no good marker named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mocap_id.arrays import FloatArray
from mocap_id.config import load
from mocap_id.kinematics.bundle import frames_along_motion
from mocap_id.kinematics.link_fit import SegmentationRules
from mocap_id.kinematics.marker_faults import (
    RecordedMarkers,
    find_bad_stretches,
    find_lone_markers,
    find_repeats,
    sample_rows,
)
from mocap_id.kinematics.segmentation import segment_markers
from mocap_id.runner import run_stage
from mocap_id.store import Folder, LongTable, Table
from mocap_id_simulation import Options, generate, simulate
from mocap_id_simulation.options import read_faults

RATE = 100.0
FEW = "*FHD,*BHD,RBAK,*UPA,*ELB,*FRM,*WR*,*FIN,CLAV,STRN,*2,*TOE"


@pytest.fixture(scope="module", params=["clusters", "plug-in-gait"])
def trial(request: pytest.FixtureRequest) -> SimpleNamespace:
    """Return a simulated trial in its true plane, and its segments when nothing is wrong."""
    without = FEW if request.param == "clusters" else ""
    simulated = generate(
        "sit-to-stand",
        Options(seed=71, repetitions=2, analog_rate=100, marker_set=request.param, without=without, occlusions=0),
    )
    points = simulated.scene.plane.to_plane(simulated.points)
    plane = points[..., 0] + 1j * points[..., 1]
    fitted = plane[frames_along_motion(plane, 300)]
    found = segment_markers(fitted, np.nanmean(points[..., 2], axis=0), SegmentationRules(longest=5))
    return SimpleNamespace(points=points, labels=simulated.labels, found=found, fitted=fitted)


def bad_in(trial: SimpleNamespace, points: FloatArray) -> Mapping[str, tuple[str, int, int]]:
    """Return cause, first and last frame of the bad stretches, by label."""
    rows = sample_rows(len(points), RATE)
    recorded = RecordedMarkers(points[rows], rows, lambda marker: points[:, marker], RATE)
    bad = find_bad_stretches(recorded, trial.found, trial.fitted, np.arange(points.shape[1]))
    return {trial.labels[each.marker]: (each.how, each.first, each.last) for each in bad}


def test_no_good_marker_is_named(trial: SimpleNamespace) -> None:
    assert bad_in(trial, trial.points) == {}


@pytest.mark.parametrize("label", ["LTHI", "LASI", "C7", "RSHO"])
def test_a_frozen_marker_is_named_with_its_times(trial: SimpleNamespace, label: str) -> None:
    points, column = trial.points.copy(), trial.labels.index(label)
    points[200:500, column] = points[200, column]
    assert bad_in(trial, points) == {label: ("frozen", 200, 499)}


def test_the_shorter_part_of_a_marker_that_was_taped_on_again_is_bad(trial: SimpleNamespace) -> None:
    points, column = trial.points.copy(), trial.labels.index("RASI")
    points[:600, column] += (0.04, 0.03, 0.01)
    assert bad_in(trial, points) == {"RASI": ("moved", 0, 599)}


def test_exchanged_labels_are_elsewhere(trial: SimpleNamespace) -> None:
    points, pair = trial.points.copy(), [trial.labels.index("LSHO"), trial.labels.index("LTHI")]
    points[300:400, pair] = points[300:400, pair[::-1]]
    assert bad_in(trial, points) == {"LSHO": ("elsewhere", 300, 399), "LTHI": ("elsewhere", 300, 399)}


def test_a_reflection_is_lone_and_an_arm_is_not(trial: SimpleNamespace) -> None:
    points = trial.points
    reflection = points[:, [trial.labels.index("C7")]] * (-0.6, 0.8, 1.0) + (0.3, 0.4, 0.0)
    swing = 0.3 * np.sin(np.arange(len(points)) / 40)
    wrist = points[:, trial.labels.index("LSHO")] + np.stack([swing, -0.5 - swing**2, 0 * swing], axis=1)
    arm = np.stack([wrist, wrist + np.array([0.02, 0.01, 0.05])], axis=1)
    lone = find_lone_markers(np.concatenate([points, arm, reflection], axis=1))
    assert np.flatnonzero(lone).tolist() == [points.shape[1] + 2]


def test_bad_samples_reach_no_later_stage(tmp_path: Path) -> None:
    options = Options(seed=31102, repetitions=2, analog_rate=100, marker_set="plug-in-gait")
    path = simulate("sit-to-stand", tmp_path, replace(options, faults=read_faults("frozen_s=4")))
    trial = load(path)
    for stage in ("planarise", "segment", "fit-joints", "ukf-smooth"):
        done = run_stage(trial, stage)
        assert done.refused is None
    segments, markers = (Folder(trial.out).read(f"{name}.parquet") for name in ("segments", "markers"))
    assert isinstance(segments, Table)
    assert isinstance(markers, LongTable)
    (bad,) = segments.facts["bad_stretches"]
    assert (bad["marker"], bad["how"]) == ("RPSI", "frozen")
    assert segments.facts["against"]["left-out"] == 0
    assert [reason.code for reason in segments.reasons if reason.code.startswith("marker-")] == ["marker-frozen"]
    used = markers.values["used"][:, markers.labels.index("RPSI")]
    inside = (markers.time >= bad["first_s"]) & (markers.time <= bad["last_s"])
    assert not used[inside].any()
    assert used[~inside].mean() > 0.9


def test_exact_repeats_are_found_unless_the_body_rests() -> None:
    rng = np.random.default_rng(4)
    sway = np.cumsum(rng.normal(size=(400, 1, 3)), axis=0) * 1e-3
    points = rng.normal(size=(8, 3)) * 0.1 + sway + 1e-5 * rng.normal(size=(400, 8, 3))
    assert find_repeats(points, RATE) == ()
    for frozen in ([2], [0, 1, 2, 3, 4]):
        held = points.copy()
        held[100:200, frozen] = points[100, frozen]
        assert {(each.marker, each.first, each.last) for each in find_repeats(held, RATE)} == {
            (marker, 100, 199) for marker in frozen
        }
    still = points.copy()
    still[:, :] = points[0]
    assert find_repeats(still, RATE) == ()
    base = points.copy()
    base[:, :4] = points[0, :4]  # without noise, as some simulations
    assert find_repeats(base, RATE) == ()
