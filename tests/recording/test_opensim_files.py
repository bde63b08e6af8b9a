"""Reading of TRC and MOT files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_cases import body

from mocap_id import recording
from mocap_id.errors import ConfigError, RecordingError

FRAMES = 40
POSITIONS = body(FRAMES, 3)
"""Points in the lab with Z up, m."""

TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
FORCE = np.array([10.0, -5.0, 600.0]) + np.random.default_rng(2).normal(size=(FRAMES, 3))
POINT = np.array([0.2, 0.1, 0.0]) + np.random.default_rng(3).normal(size=(FRAMES, 3)) * [0.01, 0.01, 0]
FREE = np.array([0.0, 0.0, 3.0]) + np.zeros((FRAMES, 3))
MOMENT = np.cross(POINT, FORCE) + FREE
PATTERNS = {
    "ground_force_1_v{}": ("ground_force_1_p{}", "ground_force_1_m{}"),
    "ground_force_v{}": ("ground_force_p{}", "ground_torque_{}"),
    "1_ground_force_v{}": ("1_ground_force_p{}", "1_ground_torque_{}"),
    "ground_force_r_v{}": ("ground_force_r_p{}", "ground_torque_r_{}"),
    "ground_force1_v{}": ("ground_force1_p{}", "ground_torque1_{}"),
    "FP1_force_v{}": ("FP1_force_p{}", "FP1_moment_{}"),
}


def trc(positions: np.ndarray, *, units: str = "m", rate: float = 100.0, frames: int | None = None) -> str:
    count, markers = positions.shape[:2]
    names = [f"M{i}" for i in range(markers)]
    rows = [
        f"{i + 1}\t{i / rate:.6g}\t" + "\t".join("" if np.isnan(v) else f"{v:.7g}" for v in row)
        for i, row in enumerate(positions.reshape(count, -1))
    ]
    return "\n".join(
        [
            "PathFileType\t4\t(X/Y/Z)\ttrial.trc",
            "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
            f"{rate:g}\t{rate:g}\t{frames or count}\t{markers}\t{units}\t{rate:g}\t1\t{count}",
            "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
            "\t\t" + "\t".join(f"X{i}\tY{i}\tZ{i}" for i in range(1, markers + 1)),
            "",
            *rows,
            "",
        ]
    )


def mot(columns: dict[str, np.ndarray], *, rate: float = 100.0, rows: int | None = None, start: float = 0.0) -> str:
    count = len(next(iter(columns.values())))
    values = np.column_stack([start + np.arange(count) / rate, *columns.values()])
    head = [
        "forces",
        "version=1",
        f"nRows={rows or count}",
        f"nColumns={values.shape[1]}",
        "inDegrees=yes",
        "endheader",
    ]
    body_ = ["\t".join(f"{v:.9g}" for v in row) for row in values]
    return "\n".join([*head, "time\t" + "\t".join(columns), *body_, ""])


def force_columns(pattern: str = "ground_force_1_v{}", turn: np.ndarray = TO_Y_UP) -> dict[str, np.ndarray]:
    point, moment = PATTERNS[pattern]
    columns: dict[str, np.ndarray] = {}
    for name, vectors in ((pattern, FORCE), (point, POINT), (moment, FREE)):
        turned = vectors @ turn.T
        columns |= {name.format(axis): turned[:, i] for i, axis in enumerate("xyz")}
    return columns


def write(folder: Path, markers: str, forces: str | None = None) -> recording.Recording:
    (folder / "trial.trc").write_text(markers)
    if forces is None:
        return recording.read(folder / "trial.trc")
    (folder / "trial_grf.mot").write_text(forces)
    return recording.read(folder / "trial.trc", folder / "trial_grf.mot")


@pytest.mark.parametrize("units", ["m", "mm"])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_pair_with_y_up(tmp_path: Path, units: str, pattern: str) -> None:
    scale = 1 if units == "m" else 1e3
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T * scale, units=units), mot(force_columns(pattern)))
    assert found.vertical == "Y"
    assert found.format == "TRC + MOT"
    assert found.labels == ("M0", "M1", "M2")
    np.testing.assert_allclose(found.positions, POSITIONS, atol=1e-6)
    (plate,) = found.plates
    assert plate.kind == "mot"
    np.testing.assert_allclose(plate.force, FORCE, atol=1e-5)
    np.testing.assert_allclose(plate.moment, MOMENT, atol=1e-4)
    assert found.oddities == ()


def test_z_up_is_recognised_by_the_force(tmp_path: Path) -> None:
    found = write(tmp_path, trc(POSITIONS), mot(force_columns(turn=np.eye(3))))
    assert found.vertical == "Z"
    np.testing.assert_allclose(found.positions, POSITIONS, atol=1e-6)


@pytest.mark.parametrize("markers_up", ["Y", "Z"])
def test_files_with_different_axes_are_refused(tmp_path: Path, markers_up: str) -> None:
    """The markers were turned with the force, and no chain was found in a body that lies on the ground."""
    person = np.tile(np.random.default_rng(4).uniform([0, -0.1, 0], [0.4, 0.3, 1.6], (1, 12, 3)), (FRAMES, 1, 1))
    markers = trc(person @ TO_Y_UP.T if markers_up == "Y" else person)
    both = write(tmp_path, markers, mot(force_columns(turn=TO_Y_UP if markers_up == "Y" else np.eye(3))))
    np.testing.assert_allclose(both.positions, person, rtol=0, atol=1e-6)
    other = {"Y": "Z", "Z": "Y"}[markers_up]
    found = f"acts along {other}, but the markers in trial.trc stand along {markers_up}"
    with pytest.raises(RecordingError, match=found):
        write(tmp_path, markers, mot(force_columns(turn=TO_Y_UP if other == "Y" else np.eye(3))))


def test_without_forces_y_up_is_assumed(tmp_path: Path) -> None:
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T))
    assert found.vertical == "Y"
    assert any("Y was assumed" in oddity for oddity in found.oddities)
    assert found.plates == ()


def test_the_opposite_sign_is_reversed(tmp_path: Path) -> None:
    columns = {name: -v if "_v" in name or "_m" in name else v for name, v in force_columns().items()}
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(columns))
    np.testing.assert_allclose(found.plates[0].force, FORCE, atol=1e-5)
    assert any("reversed" in oddity for oddity in found.oddities)


def test_zero_plates_are_reported(tmp_path: Path) -> None:
    columns = force_columns()
    columns |= {name.replace("_1_", "_2_"): np.zeros(FRAMES) for name in columns}
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(columns))
    assert len(found.plates) == 2
    assert any("zero throughout" in oddity for oddity in found.oddities)


def test_blank_cells_are_missing_markers(tmp_path: Path) -> None:
    positions = POSITIONS.copy()
    positions[5:10, 1] = np.nan
    positions[7, 2] = np.nan
    found = write(tmp_path, trc(positions @ TO_Y_UP.T))
    np.testing.assert_array_equal(~found.visible, np.isnan(positions[..., 0]))


def test_different_spans_are_reported(tmp_path: Path) -> None:
    columns = {name: values[:30] for name, values in force_columns().items()}
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(columns))
    assert any("runs from" in oddity for oddity in found.oddities)
    samples = recording.decimate(found.plates[0], found.time, found.rate)
    assert samples.ok.tolist() == [True] * 30 + [False] * 10
    with pytest.raises(RecordingError, match="do not overlap"):
        write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(force_columns(), start=10.0))


def test_tables_are_read_as_tables(tmp_path: Path) -> None:
    path = tmp_path / "angles.mot"
    path.write_text(mot({"knee_angle_r": np.arange(5.0), "hip": -np.arange(5.0)}))
    table = recording.read_table(path)
    assert table.columns == ("knee_angle_r", "hip")
    assert table.in_degrees
    np.testing.assert_array_equal(table["hip"], -np.arange(5.0))
    np.testing.assert_allclose(table.time, np.arange(5) / 100)


@pytest.mark.parametrize(
    ("markers", "reason"),
    [
        (trc(POSITIONS, frames=99)[:-25], "truncated"),
        (trc(POSITIONS).replace("Units", "Sinut"), "no length unit"),
        (trc(POSITIONS, units="parsec"), "ambiguous or unknown"),
        (trc(POSITIONS).replace("\n7\t0.06\t", "\n7\t0.02\t"), "does not increase"),
        (trc(POSITIONS).replace("\n7\t0.06\t", "\n7\t0.06\tx"), "not a table of numbers"),
        ("\n".join(trc(POSITIONS).splitlines()[:5]), "no frames follow"),
    ],
)
def test_broken_trc_files_are_refused(tmp_path: Path, markers: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        write(tmp_path, markers)


def test_missing_frames_are_refused(tmp_path: Path) -> None:
    lines = trc(POSITIONS, frames=FRAMES - 3).splitlines()
    with pytest.raises(RecordingError, match="frames are missing"):
        write(tmp_path, "\n".join(lines[:12] + lines[15:]))


def test_uneven_times_are_refused(tmp_path: Path) -> None:
    jittered = trc(POSITIONS @ TO_Y_UP.T).replace("\n21\t0.2\t", "\n21\t0.204\t")
    with pytest.raises(RecordingError, match=r"trial.trc: the time column is uneven: at 0.204 s it is off by 0.39"):
        write(tmp_path, jittered)
    forces = mot(force_columns()).replace("\n0.2\t", "\n0.204\t")
    with pytest.raises(RecordingError, match=r"trial_grf.mot: the time column is uneven"):
        write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), forces)


def test_rounded_times_become_even(tmp_path: Path) -> None:
    lines = trc(POSITIONS @ TO_Y_UP.T, rate=240.0).splitlines()
    rows = [line.split("\t") for line in lines[6:]]
    rounded = ["\t".join([row[0], f"{float(row[1]):.3f}", *row[2:]]) for row in rows]
    found = write(tmp_path, "\n".join([*lines[:6], *rounded]))
    assert found.rate == 240
    np.testing.assert_allclose(np.diff(found.time), 1 / 240, rtol=1e-9)
    assert any("rounded" in oddity for oddity in found.oddities)


def test_spikes_do_not_reverse_a_plate(tmp_path: Path) -> None:
    columns = force_columns()
    columns["ground_force_1_vy"] = columns["ground_force_1_vy"].copy()
    columns["ground_force_1_vy"][[3, 20]] = -20e3
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(columns))
    np.testing.assert_allclose(np.delete(found.plates[0].force, [3, 20], 0), np.delete(FORCE, [3, 20], 0), atol=1e-5)
    assert not any("reversed" in oddity for oddity in found.oddities)


def test_configured_units_of_force(tmp_path: Path) -> None:
    """A table in lbf and lbf·ft, with points in m."""
    pound, foot = 4.4482216152605, 0.3048
    scales = {"v": pound, "m": pound * foot, "p": 1.0}
    columns = {name: values / scales[name[-2]] for name, values in force_columns().items()}
    (tmp_path / "trial.trc").write_text(trc(POSITIONS @ TO_Y_UP.T))
    (tmp_path / "trial.mot").write_text(mot(columns))
    found = recording.read(tmp_path / "trial.trc", tmp_path / "trial.mot", force_unit="lbf", moment_unit="lbf.ft")
    np.testing.assert_allclose(found.plates[0].force, FORCE, atol=1e-5)
    np.testing.assert_allclose(found.plates[0].moment, MOMENT, atol=1e-4)


def simm(columns: dict[str, np.ndarray], *, rows: int = FRAMES, timed: bool = True) -> str:
    lines = mot(columns).splitlines()
    head = ["# include <simmkeys.h>", "", "name sts\t\t", f"datacolumns {1 + len(columns)}", f"datarows {rows}\t\t"]
    head += ["otherdata 0", f"range 0.0 {(FRAMES - 1) / 100}", "keys w_key", "wrap", "endheader\t", ""]
    body_ = lines[6:] if timed else ["\t".join(line.split("\t")[1:]) for line in lines[6:]]
    return "\n".join([*head, *body_, ""])


@pytest.mark.parametrize("timed", [True, False])
def test_simm_headers(tmp_path: Path, timed: bool) -> None:
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), simm(force_columns(), timed=timed))
    np.testing.assert_allclose(found.plates[0].force, FORCE, atol=1e-5)
    np.testing.assert_allclose(found.plates[0].moment, MOMENT, atol=1e-4)
    assert found.plates[0].rate == pytest.approx(100)
    assert any("no times: its rows were spread evenly" in note for note in found.oddities) == (not timed)


def test_forces_with_another_number_of_rows_are_read_with_a_note(tmp_path: Path) -> None:
    for forces in (mot(force_columns(), rows=99), simm(force_columns(), rows=99)):
        found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), forces)
        np.testing.assert_allclose(found.plates[0].force, FORCE, atol=1e-5)
        assert any("trial_grf.mot: the header declares 99 rows, the file contains 40" in it for it in found.oddities)


@pytest.mark.parametrize(
    ("forces", "reason"),
    [
        (mot(force_columns(), rows=99)[:-30], "declares 99 rows"),
        (mot(force_columns()).replace("\n0.02\t", "\n0.2\t"), "does not increase"),
        ("\n".join(mot(force_columns()).splitlines()[:8]), "has 1 value,"),
        (mot({"knee_angle": FORCE[:, 0]}), "no column is a ground force"),
        (mot({"ground_force_vx": FORCE[:, 0]}), "only the components"),
        ("a\tb\n1\t2\n", "endheader"),
        (mot(force_columns()).replace("time\t", "zeit\t"), "expected 'time'"),
        (mot(force_columns()).replace("force_1_vz", "force_1_vx"), "`ground_force_1_vx` occurs twice"),
        (mot({**force_columns(), "plate1_vx": FORCE[:, 0]}), "are the same quantity"),
    ],
)
def test_broken_mot_files_are_refused(tmp_path: Path, forces: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), forces)


def test_a_force_without_a_point_gives_an_unusable_plate(tmp_path: Path) -> None:
    columns = {name: values for name, values in force_columns().items() if "_p" not in name}
    found = write(tmp_path, trc(POSITIONS @ TO_Y_UP.T), mot(columns))
    assert "no point of application" in found.plates[0].problem


def test_a_declared_rate_that_the_time_column_contradicts(tmp_path: Path) -> None:
    text = trc(POSITIONS @ TO_Y_UP.T)
    lines = text.splitlines()
    lines[2] = lines[2].replace("100\t100", "60\t60", 1)
    with pytest.raises(RecordingError, match="DataRate is 60 Hz, the Time column has 100 Hz"):
        write(tmp_path, "\n".join(lines))


@pytest.mark.parametrize(
    ("markers", "forces", "words"),
    [
        ("a_grf.mot", "a.trc", r"exchange them, `recording: \{markers: a.trc, forces: a_grf.mot\}`"),
        ("a_grf.mot", None, "contains no markers: give the C3D or TRC file"),
        ("a.trc", "a.c3d", "`forces` must be a MOT file"),
    ],
)
def test_files_under_the_wrong_key(tmp_path: Path, markers: str, forces: str | None, words: str) -> None:
    for name, text in (("a.trc", trc(POSITIONS @ TO_Y_UP.T)), ("a_grf.mot", mot(force_columns())), ("a.c3d", "")):
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=words):
        recording.read(tmp_path / markers, None if forces is None else tmp_path / forces)


@pytest.mark.parametrize(("factor", "declared", "right"), [(1000.0, "m", "mm"), (100.0, "m", "cm"), (1.0, "mm", "m")])
def test_a_wrong_unit_is_refused_with_the_right_one(tmp_path: Path, factor: float, declared: str, right: str) -> None:
    far = np.linspace(0.0, 1.5, POSITIONS.shape[1])[None, :, None] * [0.0, 0.0, 1.0]
    with pytest.raises(RecordingError, match=rf"set `planarise: \{{units: …\}}`.*\b{right} gives 2[.][0-9]+ m"):
        write(tmp_path, trc(factor * (POSITIONS + far) @ TO_Y_UP.T, units=declared))
