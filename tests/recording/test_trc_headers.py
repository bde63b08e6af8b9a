"""TRC files whose lines contradict each other: the reading that all other lines support, or a refusal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mocap_id import recording
from mocap_id.errors import RecordingError

FRAMES, MARKERS = 30, 4
NAMES = ["HIP", "KNEE", "ANKLE", "TOE"]
POSITIONS = np.round(np.random.default_rng(3).uniform(0.1, 1.9, (FRAMES, MARKERS, 3)), 5)
ROWS = [
    "\t".join([f"{k + 1}", f"{k / 100:.2f}", *(f"{value:.5f}" for value in row)])
    for k, row in enumerate(POSITIONS.reshape(FRAMES, -1))
]
AXES = "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, MARKERS + 1))


def lines(
    *,
    names: str = "Frame#\tTime\t" + "\t\t\t".join(NAMES),
    axes: str = AXES,
    markers: int = MARKERS,
    frames: int = FRAMES,
) -> list[str]:
    return [
        "PathFileType\t4\t(X/Y/Z)\ttrial.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"100\t100\t{frames}\t{markers}\tm\t100\t1\t{frames}",
        names,
        axes,
        "",
        *ROWS,
    ]


def read(folder: Path, text: list[str], end: str = "\n") -> recording.Recording:
    (folder / "trial.trc").write_text("\n".join(text) + end)
    return recording.read(folder / "trial.trc", vertical="Z")


def check(found: recording.Recording, positions: np.ndarray = POSITIONS) -> None:
    assert found.labels == tuple(NAMES)
    np.testing.assert_allclose(found.positions, positions, rtol=0, atol=1e-12)


def with_line(number: int, change: Callable[[str], str]) -> list[str]:
    text = lines()
    text[number] = change(text[number])
    return text


@pytest.mark.parametrize(
    "names",
    [
        "Frame#\tTimes\t\t" + "\t\t".join(NAMES),
        "Frame#\tTime\t" + "\t\t".join(NAMES),
        "Frame#\tTime\t" + "\t".join(NAMES),
        "Frame#\tTime\t" + "\t\t\t\t".join(NAMES),
        "Frame#\tTime\t" + "\t\t\t\t\t\t".join(NAMES),
    ],
    ids=["Times, two apart", "two apart", "one apart", "four apart", "six apart"],
)
def test_names_elsewhere_are_used_in_their_order(tmp_path: Path, names: str) -> None:
    found = read(tmp_path, lines(names=names))
    check(found)
    assert any("not three columns apart: the 4 names were used in their order" in note for note in found.oddities)
    assert any("NumMarkers 4, the X1 Y1 Z1 line 4; rows with the coordinates of 4" in note for note in found.oddities)


@pytest.mark.parametrize("other", [{"markers": 5}, {"axes": AXES + "\tX5\tY5\tZ5"}], ids=["NumMarkers", "axes"])
def test_names_elsewhere_need_the_support_of_all_other_lines(tmp_path: Path, other: dict[str, object]) -> None:
    with pytest.raises(
        RecordingError, match=r"contradict each other on the number of markers: 4 names.*coordinates of 4"
    ):
        read(tmp_path, lines(names="Frame#\tTime\t" + "\t\t".join(NAMES), **other))  # type: ignore[arg-type]


def test_fewer_names_than_columns_are_never_spread(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="contradict each other"):
        read(tmp_path, lines(names="Frame#\tTime\t" + "\t\t".join(NAMES[:3])))
    with pytest.raises(RecordingError, match=r"the widest row has 14 cells, expected at most 11 for 3 names"):
        read(tmp_path, lines(names="Frame#\tTime\t" + "\t\t\t".join(NAMES[:3])))


def test_a_wrong_number_of_markers_is_reported(tmp_path: Path) -> None:
    found = read(tmp_path, lines(markers=7))
    check(found)
    assert any("declares 7 markers but names 4" in note for note in found.oddities)


def test_unnamed_trajectories_to_the_right_are_not_read(tmp_path: Path) -> None:
    text = lines()
    text[10] += "\t1.0\t2.0\t3.0"
    text[20] += "\t\t\t\t4.0\t5.0\t6.0"
    found = read(tmp_path, text)
    check(found)
    assert any("2 trajectories to the right of the 4 named markers" in note for note in found.oddities)


@pytest.mark.parametrize("shift", ["\t9", "\t9\t9"])
def test_a_column_too_many_is_refused(tmp_path: Path, shift: str) -> None:
    """It may be anywhere and would shift the coordinates."""
    with pytest.raises(RecordingError, match="the widest row has"):
        read(tmp_path, [*lines()[:6], *(row + shift for row in ROWS)])


def test_a_file_shortened_by_hand_is_read_with_a_note(tmp_path: Path) -> None:
    found = read(tmp_path, lines()[:-7])
    check(found, POSITIONS[:-7])
    assert any("declares 30 rows, the file contains 23: all were read" in note for note in found.oddities)


def test_more_rows_than_declared_are_read_with_a_note(tmp_path: Path) -> None:
    found = read(tmp_path, lines(frames=12))
    check(found)
    assert any("declares 12 rows, the file contains 30" in note for note in found.oddities)


@pytest.mark.parametrize("cut", [1, 5, 9, 30])
@pytest.mark.parametrize("end", ["", "\n"])
def test_a_file_cut_within_a_row_is_never_wrong(tmp_path: Path, cut: int, end: str) -> None:
    text = lines()[:-5]
    text[-1] = text[-1][:-cut]
    cells = text[-1].count("\t")
    if cells < 13:
        with pytest.raises(RecordingError, match="truncated: the header declares 30 rows, the file contains 25"):
            read(tmp_path, text, end)
    elif not end:
        found = read(tmp_path, text, end)
        expected = POSITIONS[:-5].copy()
        expected[-1, -1] = np.nan
        check(found, expected)
        assert any("may end within the last cell" in note for note in found.oddities)


def test_a_whole_last_row_without_line_end_is_kept_if_the_number_of_rows_is_right(tmp_path: Path) -> None:
    check(read(tmp_path, lines(), end=""))


@pytest.mark.parametrize(
    "text",
    [
        with_line(0, lambda line: line + " second word"),
        with_line(0, lambda line: "Version2 " + line),
        with_line(1, lambda line: line.replace("NumMarkers", "NumMarker").replace("NumFrames", "NumFrame", 1)),
        with_line(2, lambda line: line.replace("\t", " \t ")),
        with_line(2, lambda line: line.replace("\t", "\t\t")),
        with_line(2, lambda line: "\t" + line),
        with_line(3, lambda line: line + "\t\t\t"),
        with_line(5, lambda line: line + "\t" * 14),
        [*lines()[:5], *lines()[6:]],
        [*lines()[:4], *lines()[6:]],
        [line + "\t" * 9 for line in lines()],
        [line.replace("\t", ",") for line in lines()],
        [*lines()[:6], *("\t" + row for row in ROWS)],
        [*lines()[:6], *(row.replace("\t", "    ") for row in ROWS)],
        [*lines()[:6], *(row.replace("\t", "    ", 1) for row in ROWS)],
        [*lines()[:3], "Frame#\tTime  " + "   ".join(NAMES), AXES.replace("\t", "  "), "", *ROWS],
    ],
)
def test_harmless_differences(tmp_path: Path, text: list[str]) -> None:
    found = read(tmp_path, text)
    check(found)
    assert found.rate == 100
    assert found.units == "m"


def test_blanks_between_spaces_are_refused(tmp_path: Path) -> None:
    """A missing marker between spaces would shift the others."""
    rows = [row.replace("\t", "  ") for row in ROWS]
    rows[7] = "  ".join(ROWS[7].split("\t")[:11])
    with pytest.raises(RecordingError, match=r"line 14 has 11 cells between spaces, expected 14"):
        read(tmp_path, [*lines()[:6], *rows])


def test_the_values_of_the_header_may_be_missing(tmp_path: Path) -> None:
    text = lines()
    del text[2]
    with pytest.raises(RecordingError, match="no length unit"):
        read(tmp_path, text)
    found = recording.read(tmp_path / "trial.trc", vertical="Z", units="m")
    check(found)
    assert found.rate == 100


def test_a_header_without_rows(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="ends within its header"):
        read(tmp_path, lines()[:2])
    with pytest.raises(RecordingError, match="no frames follow"):
        read(tmp_path, lines()[:6])
