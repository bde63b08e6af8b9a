"""Bad input gives one message and the right exit code, leaves no half-written file, and is not modified."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.store import Folder
from swinging_link import LABELS, pendulum, plate_under


def run(cli, trial, path: Path):
    """Run a trial and check that its inputs are as before."""
    before = trial.inputs()
    said = cli("run", path)
    assert trial.inputs() == before
    assert not [name for name in trial.made() if name.endswith(".tmp")]
    return said


def refused(said, trial) -> str:
    """Return the code of a refusal that the summary and the report describe."""
    assert said.code == 4, said.err
    assert said.out.startswith("verdict: refused\n")
    assert {"summary.json", "report.html"} <= set(trial.made())
    verdict = trial.summary()["verdict"]
    assert verdict["level"] == "refused"
    return str(next(reason["code"] for reason in verdict["reasons"] if reason["level"] == "refused"))


def test_a_good_recording_runs(cli, trial) -> None:
    """Without this, the tests below could pass for the wrong reason."""
    said = run(cli, trial, trial.trc(pendulum()))
    assert said.code == 0, said.err
    assert trial.summary()["segments"]["count"] == 2
    assert "report: " in said.out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.c3d", b""),
        ("text.c3d", b"frame,time,x,y,z\n" * 1000),
        ("empty.trc", b""),
        ("words.trc", b"these are no markers\n" * 100),
        ("random.c3d", bytes(np.random.default_rng(0).integers(0, 256, 20_000, dtype=np.uint8))),
    ],
)
def test_what_is_no_recording(cli, trial, name: str, content: bytes) -> None:
    (trial.folder / name).write_bytes(content)
    said = run(cli, trial, trial.say(name))
    assert said.code == 3, said.err
    assert name in said.err
    assert not (trial.folder / "runs").exists()


def test_a_missing_recording(cli, trial) -> None:
    said = run(cli, trial, trial.say("nowhere.c3d"))
    assert said.code == 3
    assert "nowhere.c3d: no such file" in said.err
    assert not trial.out.exists()


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_a_truncated_c3d(cli, trial, share: float) -> None:
    path = trial.c3d(pendulum(), plates=(plate_under(600),))
    file = trial.folder / "trial.c3d"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    said = run(cli, trial, path)
    assert said.code == 3, said.err
    assert "trial.c3d" in said.err
    assert trial.made() == []


def test_a_truncated_trc(cli, trial) -> None:
    path = trial.trc(pendulum())
    file = trial.folder / "trial.trc"
    file.write_text("\n".join(file.read_text().splitlines()[:300])[:-40])
    assert run(cli, trial, path).code == 3


def test_no_markers(cli, trial) -> None:
    said = run(cli, trial, trial.c3d(np.empty((100, 0, 3)), (), (plate_under(100),)))
    assert said.code == 3, said.err
    assert "marker" in said.err


def test_no_plate(cli, trial) -> None:
    """The kinematics run; the dynamics say why they cannot."""
    said = run(cli, trial, trial.c3d(pendulum()))
    assert said.code == 0, said.err
    assert {"states.parquet", "dynamics.parquet", "dynamics.h5"} <= set(trial.made())
    summary = trial.summary()
    assert summary["verdict"]["level"] == "caution"
    assert not summary["dynamics"]["base"]
    assert "plate" in summary["dynamics"]["why"]


def test_one_marker(cli, trial) -> None:
    assert refused(run(cli, trial, trial.trc(pendulum()[:, 4:5], LABELS[4:5])), trial)


def test_nothing_moves(cli, trial) -> None:
    assert refused(run(cli, trial, trial.trc(pendulum(swing_deg=0.0))), trial)


def test_only_the_base(cli, trial) -> None:
    assert refused(run(cli, trial, trial.trc(pendulum()[:, :4], LABELS[:4])), trial)


def test_a_storm_of_gaps(cli, trial) -> None:
    """With nine of ten samples missing, a link and its joint are still found, with a caution."""
    points = pendulum()
    points[np.random.default_rng(5).random(points.shape[:2]) < 0.9] = np.nan
    said = run(cli, trial, trial.trc(points))
    assert said.code == 0, said.err
    summary = trial.summary()
    assert summary["verdict"]["level"] == "caution"
    assert summary["segments"]["count"] == 2
    assert abs(summary["joints"][0]["centre_m"][1] - 0.3) < 2e-3


def test_nothing_was_ever_seen(cli, trial) -> None:
    said = run(cli, trial, trial.c3d(np.full((600, 8, 3), np.nan)))
    assert said.code == 3, said.err
    assert "no marker is visible" in said.err
    assert not (trial.folder / "runs").exists()


def test_a_marker_that_vanishes_half_way(cli, trial) -> None:
    points = pendulum()
    points[300:, 6] = np.nan
    said = run(cli, trial, trial.trc(points))
    assert said.code == 0, said.err
    assert trial.summary()["segments"]["assignment"]["L3"] == 1


def test_all_of_a_segment_vanishes_half_way(cli, trial) -> None:
    points = pendulum()
    points[300:, 4:] = np.nan
    said = run(cli, trial, trial.trc(points))
    assert said.code == 0, said.err
    verdict = trial.summary()["verdict"]
    (gap,) = [reason for reason in verdict["reasons"] if reason["code"] == "gap"]
    assert verdict["level"] == gap["level"] == "caution"
    assert 2.0 < gap["value"] <= 3.0


@pytest.mark.parametrize("units", ["furlong", "", "m"])
def test_wrong_units(cli, trial, units: str) -> None:
    """Units are unknown, undeclared or wrong: metres instead of millimetres give a pendulum of 400 m."""
    path = trial.trc(pendulum())
    file = trial.folder / "trial.trc"
    file.write_text(file.read_text().replace("\tmm\t", f"\t{units}\t"))
    said = run(cli, trial, path)
    assert said.code == 3, said.err
    assert "unit" in said.err


def test_uneven_times_are_refused_before_anything_is_written(cli, trial) -> None:
    """One frame is two fifths of a frame late."""
    path = trial.trc(pendulum())
    file = trial.folder / "trial.trc"
    text = file.read_text()
    file.write_text(text.replace("\n301\t3\t", "\n301\t3.004\t"))
    assert file.read_text() != text
    said = run(cli, trial, path)
    assert said.code == 3, said.err
    assert "trial.trc: the time column is uneven: at 3.004 s" in said.err
    assert said.err.count("stage ") == 1
    assert not (trial.folder / "runs").exists()


def test_a_plate_of_numbers_that_are_none(cli, trial) -> None:
    """The plate is omitted, and the kinematics run."""
    plate = plate_under(600)
    plate.channels[:, 2] = np.nan
    said = run(cli, trial, trial.c3d(pendulum(), plates=(plate,)))
    assert said.code == 0, said.err
    assert "none of the force plates is under the feet" in said.out


def test_a_file_where_the_results_should_go(cli, trial) -> None:
    path = trial.trc(pendulum())
    (trial.folder / "runs").write_text("not a folder")
    said = run(cli, trial, path)
    assert said.code == 6
    assert "there is a file where a folder is needed" in said.err


def test_a_folder_in_use(cli, trial) -> None:
    path = trial.trc(pendulum())
    with Folder(trial.out).locked():
        for command in ("run", "planarise"):
            said = cli(command, path)
            assert said.code == 6
            assert "in use by another run" in said.err
    assert trial.made() == []


def test_stages_one_by_one_need_those_before(cli, trial) -> None:
    path = trial.trc(pendulum())
    said = cli("fit-joints", path)
    assert said.code == 6
    assert "mocap-id planarise" in said.err
    assert cli("planarise", path).code == 0
    assert "mocap-id segment" in cli("fit-joints", path).err


def test_an_option_before_its_command(cli, trial) -> None:
    said = cli("-q", "run", trial.trc(pendulum()))
    assert said.code == 2
    assert "Give the options of a command after its name: mocap-id COMMAND -q" in said.err


def test_a_run_that_is_not_there(cli, trial) -> None:
    said = cli("export", trial.folder / "runs" / "nothing", "--to", "csv")
    assert said.code == 2
    assert "no such file or folder; expected a trial's YAML file or a run folder" in said.err


def test_a_trc_file_without_plates_is_told_of_its_mot_file(cli, trial) -> None:
    said = run(cli, trial, trial.trc(pendulum()))
    assert said.code == 0, said.err
    assert "If there is a MOT file, name it: `recording: {markers: …, forces: …}`" in said.out
