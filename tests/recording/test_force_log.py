"""Logs of further force sensors are read exactly, or refused with a remedy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import RecordingError
from mocap_id.recording import read_force_log


def written(folder: Path, text: str) -> Path:
    path = folder / "hand.csv"
    path.write_text(text, "utf-8")
    return path


def rows(time: np.ndarray, *columns: np.ndarray) -> str:
    return "\n".join(",".join(f"{value:.6f}" for value in row) for row in np.column_stack([time, *columns])) + "\n"


TIME = 0.3 + np.arange(50) / 250
FORCE = np.column_stack([np.sin(TIME), 20 * TIME, 30 + 0 * TIME])


def test_forces_with_and_without_moments(tmp_path: Path) -> None:
    log, _ = read_force_log(written(tmp_path, "time_s, Fx_N, Fy_N, Fz_N\r\n" + rows(TIME, FORCE)))
    np.testing.assert_allclose(log.force, FORCE, atol=1e-6)
    assert not log.moment.any()
    assert (log.start, log.rate) == pytest.approx((0.3, 250))
    text = "Fz_N,Fy_N,Fx_N,Mz_Nm,My_Nm,Mx_Nm,time_s\n" + rows(FORCE[:, 2], FORCE[:, 1], FORCE[:, 0], 3 * FORCE, TIME)
    log, _ = read_force_log(written(tmp_path, text))
    np.testing.assert_allclose(log.force, FORCE, atol=1e-6)
    np.testing.assert_allclose(log.moment, 3 * FORCE[:, ::-1], atol=1e-5)


def test_jitter_is_removed_and_empty_cells_stay_empty(tmp_path: Path) -> None:
    jitter = TIME + np.random.default_rng(0).uniform(-1e-3, 1e-3, len(TIME))
    jitter[[0, -1]] = TIME[[0, -1]]
    smooth = np.column_stack([10 * np.sin(3 * jitter)] * 3)
    text = "time_s,Fx_N,Fy_N,Fz_N\n" + rows(jitter, smooth)
    log, _ = read_force_log(written(tmp_path, text))
    np.testing.assert_allclose(log.force[:, 0], 10 * np.sin(3 * TIME), atol=1e-3)
    lines = text.splitlines()
    lines[20] = lines[20].split(",")[0] + ",,,"
    gap = read_force_log(written(tmp_path, "\n".join(lines)))[0].force
    assert np.isnan(gap[18:21]).any()
    assert np.isfinite(gap[:17]).all()
    assert np.isfinite(gap[22:]).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,Fx,Fy,Fz\n0,1,2,3\n1,1,2,3\n", ["has the columns time_s, Fx, Fy, Fz", "expected time_s, Fx_N"]),
        ("time_s,Fx_N,Fy_N,Fz_kN\n0,1,2,3\n1,1,2,3\n", ["Fz_kN", "convert to the units"]),
        ("time_s,Fx_N,Fy_N\n0,1,2\n1,1,2\n", ["Fz_N"]),
        ("time_s,Fx_N,Fy_N,Fz_N,Mz_Nm\n0,1,2,3,4\n1,1,2,3,4\n", ["Mx_Nm, My_Nm, Mz_Nm"]),
        ("time_s,Fx_N,Fy_N,Fz_N\n0,1,2,3\n", ["at least two times"]),
        ("time_s,Fx_N,Fy_N,Fz_N\n0,1,2,3\n1,1,2,3\n1,1,2,3\n", ["increase"]),
        ("time_s,Fx_N,Fy_N,Fz_N\n0,1,2,3\n,1,2,3\n2,1,2,3\n", ["from row to row"]),
        (
            "time_s,Fx_N,Fy_N,Fz_N\n0,1,2,3\n.1,1,2,3\n.2,1,2,3\n.5,1,2,3\n.6,1,2,3\n",
            ["row", "not even", "without gaps"],
        ),
        ("time_s,Fx_N,Fy_N,Fz_N\n0,1,two,3\n1,1,2,3\n", ["two", "expected a number"]),
        ("", ["not a CSV table"]),
    ],
)
def test_unreadable_files_are_refused_with_a_remedy(tmp_path: Path, text: str, words: list[str]) -> None:
    path = written(tmp_path, text)
    with pytest.raises(RecordingError) as caught:
        read_force_log(path)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"hand\.csv: no such file"):
        read_force_log(tmp_path / "hand.csv")


CSV = "time_s,Fx_N,Fy_N,Fz_N\n" + rows(TIME, FORCE)


@pytest.mark.parametrize("lost", [1, 4, 8, 10, 25])
def test_a_log_that_ends_within_its_last_line_is_refused(tmp_path: Path, lost: int) -> None:
    whole = CSV.rstrip("\n")
    assert len(read_force_log(written(tmp_path, whole))[0].force) == len(TIME)
    with pytest.raises(RecordingError, match="the file ends within its last line"):
        read_force_log(written(tmp_path, whole[:-lost]))


def test_numbers_with_a_varying_number_of_digits_may_end_the_file(tmp_path: Path) -> None:
    """The shortest form of a number often has fewer digits than the numbers above."""
    lines = CSV.splitlines()
    short = [lines[0], *(",".join(f"{float(cell):g}" for cell in line.split(",")) for line in lines[1:])]
    short[10:] = [line.rsplit(",", 1)[0] + f",{30 + 0.25 * (k % 4):g}" for k, line in enumerate(short[10:])]
    for count in range(20, len(short)):
        assert len(read_force_log(written(tmp_path, "\n".join(short[:count])))[0].force) == count - 1


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (CSV.replace("Fy_N", "Fx_N").encode(), "`Fx_N` occurs twice"),
        (CSV.encode("utf-16"), "UTF-16"),
        (CSV.encode("utf-16-le"), "UTF-16"),
        (CSV.encode() + b"\0" * 400, "NUL"),
        (CSV.replace(",", ";").replace(".", ",").encode(), "separated by semicolons"),
        (CSV.replace(",", "\t").encode(), "separated by tabs"),
        (CSV.replace(".", ",").encode(), "decimal comma"),
    ],
)
def test_other_tables_and_encodings_are_named(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "hand.csv"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=words):
        read_force_log(path)


@pytest.mark.parametrize("change", ["\ufeff", "\r\n", "blank lines"])
def test_harmless_differences_between_files_are_accepted(tmp_path: Path, change: str) -> None:
    text = {"\ufeff": "\ufeff" + CSV, "\r\n": CSV.replace("\n", "\r\n")}.get(change, CSV.replace("\n", "\n\n") + "\n\n")
    (tmp_path / "hand.csv").write_bytes(text.encode())
    np.testing.assert_allclose(read_force_log(tmp_path / "hand.csv")[0].force, FORCE, atol=1e-6)


@pytest.mark.parametrize("cell", ["1", "12", "123"])
def test_a_cut_number_is_found_among_numbers_with_varying_digits(tmp_path: Path, cell: str) -> None:
    """Whole numbers are in the column, and numbers as short as the cut one."""
    values = [98, 98.5, 99, 99.25, *np.round(np.linspace(99.5, 1234.56, len(TIME) - 4), 2)]
    lines = ["time_s,Fx_N,Fy_N,Fz_N", *(f"{t:.3f},1,2,{value:g}" for t, value in zip(TIME, values, strict=True))]
    assert len(read_force_log(written(tmp_path, "\n".join(lines)))[0].force) == len(TIME)
    with pytest.raises(RecordingError, match="the file ends within its last line"):
        read_force_log(written(tmp_path, "\n".join([*lines[:-1], lines[-1].rsplit(",", 1)[0] + f",{cell}"])))
