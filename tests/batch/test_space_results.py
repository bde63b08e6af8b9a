"""Results of a trial in space in baselines, batch tables and comparisons; commands for the plane refuse it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mocap_id.errors import StoreError
from mocap_id.reporting.summary import encode_summary, summarise
from mocap_id.stages.report import report_data
from mocap_id.store.artefacts import Skeleton
from mocap_id.workflows.batch import make_row
from mocap_id.workflows.parallel import TrialRun
from mocap_id.workflows.regress import compare_results, compare_tables, list_expected
from mocap_id.workflows.run_folder import RunFolder
from mocap_id.workflows.trial_outcome import TrialOutcome
from spatial_trial import SpatialTrial, context


def summary_of(**options: Any) -> dict[str, Any]:
    artefacts = SpatialTrial(frames=120, **options).artefacts(plates=True)
    return dict(json.loads(encode_summary(summarise(report_data(context(artefacts))))))


def test_a_baseline_holds_joints_and_ranges() -> None:
    found = dict(list_expected(summary_of()))
    assert found["joints.shoulder.z"].value == pytest.approx(0.17)
    assert found["joints.shoulder.z"].tolerance == pytest.approx(1.96 * 3e-3)
    assert (found["joints.elbow.kind"].value, found["joints.elbow.known"].value) == ("two-axis", "True")
    flexion = found["angles.elbow_flexion.range_deg"]
    assert flexion.unit == "deg" and 3.0 < flexion.tolerance < 4.0
    assert found["lengths_m.upper_arm"].value == pytest.approx(0.3)


def test_a_centre_that_is_unknown_has_no_number_in_a_baseline() -> None:
    found = dict(list_expected(summary_of(known=False)))
    assert "joints.shoulder.x" not in found and found["joints.shoulder.known"].value == "False"


def test_a_row_of_a_batch(tmp_path: Path) -> None:
    run = TrialRun("s07", 0, None, None, None, computed=True, seconds=1.0)
    trial = TrialOutcome(run=run, summary=summary_of())
    found = make_row(trial, tmp_path / "s07.yaml", tmp_path, tmp_path)
    assert (found["file"], found["folder"]) == ("s07.yaml", ".")
    assert (found["segments"], found["verdict"], found["mass"]) == (4, "ok", 71.4)


def test_two_runs_are_compared(tmp_path: Path) -> None:
    one, other = summary_of(), summary_of(known=False)
    assert [difference.name for difference in compare_results(one, one) if difference.differs] == []
    changed = [difference.name for difference in compare_results(one, other) if difference.differs]
    assert {"shoulder x", "shoulder y", "shoulder z"} <= set(changed)
    run = RunFolder(tmp_path, tmp_path, SpatialTrial(frames=120).artefacts(plates=True), {})
    found = {difference.name: difference for difference in compare_tables(run, run)}
    assert found["dshoulder_plane"].unit == "rad/s" and not any(one.differs for one in found.values())
    assert {"Fz", "tauy", "isb_condition"} <= set(found)


def test_a_chain_in_space_is_never_read_as_one_in_the_plane() -> None:
    with pytest.raises(StoreError, match="space: 3d"):
        Skeleton(SpatialTrial(frames=60).tree())
