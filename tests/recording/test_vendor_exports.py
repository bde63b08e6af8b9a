"""Text exports of QTM, Motive and Nexus: positions, names, times and gaps, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocap_id import recording
from mocap_id.errors import RecordingError

FRAMES = 20
POSITIONS = np.round(np.random.default_rng(5).uniform(-900.0, 1900.0, (FRAMES, 3, 3)), 3)
POSITIONS[4:7, 1] = np.nan
POSITIONS[9] = np.nan  # no marker at all
POSITIONS[12, 0] = np.nan
LABELS = ("hip", "knee joint", "foot")


def cells(values: np.ndarray) -> list[str]:
    return ["" if np.isnan(value) else f"{value:.3f}" for value in values.ravel()]


def qtm(*, timed: bool, columns: bool = False, trailing: str = "", count: int = FRAMES, kinds: str = "Measured") -> str:
    head = [
        "FILE_VERSION\t2.0.0",
        f"NO_OF_FRAMES\t{count}",
        "NO_OF_CAMERAS\t8",
        "NO_OF_MARKERS\t3",
        "FREQUENCY\t100",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2024-05-17, 10:39:38.777\t406646.66137317",
        "DATA_INCLUDED\t3D",
        "EVENT\tstart\t3\t0.02",
        "MARKER_NAMES\t" + "\t".join(LABELS),
        "TRAJECTORY_TYPES\tMeasured\tMixed\t" + kinds,
    ]
    if columns:
        names = [f"{label} {axis}" for label in LABELS for axis in "XYZ"]
        head.append("\t".join(["Frame", "Time", *names] if timed else names))
    rows = [
        "\t".join([*([f"{k + 1}", f"{k / 100:.5f}"] if timed else []), *cells(row)]) + trailing
        for k, row in enumerate(POSITIONS)
    ]
    return "\r\n".join([*head, *rows, ""])


def motive(*, space: str = "Global", units: str = "Millimeters", body: bool = True, markers: bool = True) -> str:
    kinds, names, quantities, axes = [], [], [], []
    if body:
        kinds += ["Rigid Body"] * 8
        names += ["box"] * 8
        quantities += ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
        axes += [*"XYZW", *"XYZ", ""]
    kinds += ["Marker" if markers else "Bone Marker"] * 9
    names += [f"take7:{label}" for label in LABELS for _ in "XYZ"]
    quantities += ["Position"] * 9
    axes += [*"XYZXYZXYZ"]
    info = (
        "Format Version,1.23,Take Name,anna, slow,Take Notes,,Capture Frame Rate,120.000000,"
        f"Export Frame Rate,120.000000,Total Exported Frames,{FRAMES},Rotation Type,Quaternion,"
        f"Length Units,{units},Coordinate Space,{space}"
    )
    rows = [
        ",".join([f"{k + 50}", f"{(k + 50) / 120:.6f}", *(["0.1"] * 8 if body else []), *cells(row)])
        for k, row in enumerate(POSITIONS)
    ]
    head = [",Type," + ",".join(kinds), ",Name," + ",".join(names), ",ID," + ",".join('"A1"' for _ in kinds)]
    return "\n".join(
        [info, "", *head, ",," + ",".join(quantities), "Frame,Time (Seconds)," + ",".join(axes), *rows, ""]
    )


def nexus(*, separator: str = ",", first: int = 1, devices: bool = True, unit: str = "mm") -> str:
    block = [
        "Devices",
        "1000",
        ",,Force plate,,",
        "Frame,Sub Frame,Fx,Fy,Fz",
        ",,N,N,N",
        "1,0,0,0,700",
        "1,1,0,0,700",
        "",
    ]
    head = [
        "Trajectories",
        "100",
        ",," + ",".join(f"Anna:{label},," for label in LABELS),
        "Frame,Sub Frame," + ",".join("XYZXYZXYZ"),
        ",," + ",".join([unit] * 9),
    ]
    rows = [",".join([f"{k + first}", "0", *cells(row)]) for k, row in enumerate(POSITIONS)]
    text = "\n".join([*(block if devices else []), *head, *rows, "", ""])
    return text.replace(",", separator).replace(".", ",") if separator == ";" else text.replace(",", separator)


def read(path: Path, text: str) -> recording.Recording:
    path.write_text(text, "utf-8", newline="")
    return recording.read(path, vertical="Z")


def check(found: recording.Recording, labels: tuple[str, ...] = LABELS) -> None:
    assert found.labels == labels
    np.testing.assert_allclose(found.positions, POSITIONS[:, : len(labels)] / 1000, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("timed", "columns"), [(True, True), (True, False), (False, False), (False, True)])
@pytest.mark.parametrize("trailing", ["", "\t"])
def test_qtm(tmp_path: Path, timed: bool, columns: bool, trailing: str) -> None:
    found = read(tmp_path / "sts.tsv", qtm(timed=timed, columns=columns, trailing=trailing))
    check(found)
    assert (found.format, found.rate, found.units, found.frames[0], found.time[0]) == ("QTM TSV", 100, "mm", 1, 0)
    assert found.oddities == ()


def test_the_first_frames_of_qtm_may_have_no_marker(tmp_path: Path) -> None:
    """The first row of numbers is found, not the first row that has one."""
    text = qtm(timed=False).split("\r\n")
    text[11:13] = ["\t" * 8] * 2
    found = read(tmp_path / "sts.tsv", "\r\n".join(text))
    assert len(found.frames) == FRAMES
    assert found.missing_fraction == pytest.approx((3 + 3 + 3 + 3 + 1) / 60)


def test_virtual_trajectories_of_qtm_are_omitted(tmp_path: Path) -> None:
    found = read(tmp_path / "sts.tsv", qtm(timed=True, kinds="Virtual"))
    check(found, LABELS[:2])
    assert any("computed, not measured" in note for note in found.oddities)


def test_motive(tmp_path: Path) -> None:
    found = read(tmp_path / "sts.csv", motive())
    check(found)
    assert (found.format, found.rate, found.units, found.frames[0]) == ("Motive CSV", 120, "Millimeters", 50)
    assert found.time[0] == pytest.approx(50 / 120)
    assert any("were not read, since they are computed: Rigid Body" in note for note in found.oddities)
    assert not any("anna" in note.lower() for note in found.oddities)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("first", [1, 341])
def test_nexus(tmp_path: Path, separator: str, first: int) -> None:
    found = read(tmp_path / "sts.csv", nexus(separator=separator, first=first))
    check(found)
    assert (found.format, found.rate, found.units, found.frames[0]) == ("Nexus CSV", 100, "mm", first)
    assert found.time[0] == pytest.approx((first - 1) / 100)
    assert any("section Devices was not read" in note for note in found.oddities)
    assert not any("Anna" in text for text in (*found.labels, *found.oddities))


def test_the_usual_upward_axis(tmp_path: Path) -> None:
    for name, text, up in (("a.tsv", qtm(timed=True), "Z"), ("b.csv", motive(), "Y"), ("c.csv", nexus(), "Z")):
        (tmp_path / name).write_text(text)
        found = recording.read(tmp_path / name)
        assert found.vertical == up
        assert any(f"{up} was assumed" in note for note in found.oddities)


def test_a_missing_row_of_an_export_is_noticed(tmp_path: Path) -> None:
    for name, text in (("a.tsv", qtm(timed=True)), ("b.csv", motive()), ("c.csv", nexus())):
        rows = text.split("\n")
        del rows[-9]
        with pytest.raises(RecordingError, match="frames are missing"):
            read(tmp_path / name, "\n".join(rows))


@pytest.mark.parametrize("cut", [3, 20])
def test_an_export_that_ends_within_a_row(tmp_path: Path, cut: int) -> None:
    """The last number may have lost digits: it is never used."""
    for name, text in (("a.tsv", qtm(timed=True)), ("b.csv", motive()), ("c.csv", nexus())):
        kept = "\n".join(text.splitlines()[: -4 if name != "c.csv" else -3])[:-cut]
        try:
            found = read(tmp_path / name, kept)
        except RecordingError as error:
            assert "declares" in str(error)
        else:
            assert cut == 3
            assert np.isnan(found.positions[-1, -1]).all()
            np.testing.assert_allclose(found.positions[-1, :-1], POSITIONS[len(found.frames) - 1, :-1] / 1000)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.tsv", qtm(timed=True).replace("\t3D", "\t6D"), "contains 6D data"),
        ("a.tsv", qtm(timed=True).replace("MARKER_NAMES", "BODY_NAMES"), "0 MARKER_NAMES"),
        ("a.tsv", qtm(timed=False).replace("FREQUENCY\t100", "FREQUENCY\tEXT"), "FREQUENCY is 'EXT'"),
        ("a.tsv", qtm(timed=True).replace("FREQUENCY\t100", "FREQUENCY\t50"), "the Time column has 100 Hz"),
        ("a.tsv", qtm(timed=True).replace("knee joint", "knee\tjoint"), "MARKER_NAMES need 12"),
        ("b.csv", motive(space="Local"), "coordinates are Local"),
        ("b.csv", motive(markers=False), "no measured markers, only Bone Marker, Rigid Body"),
        ("b.csv", motive().replace("Length Units,Millimeters,", ""), "no length unit"),
        ("b.csv", motive(units="Furlongs"), "ambiguous or unknown"),
        ("c.csv", nexus().replace("Trajectories", "Segments"), "no section Trajectories"),
        ("c.csv", nexus().replace(",mm,mm,mm\n", ",mm,mm,cm\n"), "several units"),
        ("c.csv", nexus().replace("X,Y,Z\n", "X,Y,W\n"), "not X, Y, Z for each marker"),
        ("c.csv", nexus().replace("Anna:foot,,", ",Anna:foot,"), "not above their columns"),
        ("c.csv", nexus().replace("\n7,0,", "\n7,1,"), "sub-frames"),
        ("d.csv", "time_s,x\n0,1\n", "neither a QTM TSV, Motive CSV nor Nexus CSV"),
        ("d.csv", "time_s,x\n0,1\n", "skeleton log of a depth camera goes into `recording: {skeleton: FILE}`"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, text: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        read(tmp_path / name, text)


def test_markers_of_an_export_with_forces(tmp_path: Path) -> None:
    rows = ["\t".join(f"{value:g}" for value in (k / 100, 0, 700, 0, 0.1, 0, 0.2)) for k in range(FRAMES)]
    names = "time\t" + "\t".join(f"ground_force_1_{what}{axis}" for what in "vp" for axis in "xyz")
    header = ["name sts", "datacolumns 7", f"datarows {FRAMES}", f"range 0.0 {(FRAMES - 1) / 100}", "endheader", names]
    (tmp_path / "sts.mot").write_text("\n".join([*header, *rows, ""]))
    (tmp_path / "sts.tsv").write_text(qtm(timed=True))
    found = recording.read(tmp_path / "sts.tsv", tmp_path / "sts.mot")
    assert (found.format, found.vertical) == ("QTM TSV + MOT", "Y")
    assert found.plates[0].mean_vertical() == pytest.approx(700)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.tsv", qtm(timed=True).replace(".", ",").encode(), "decimal commas"),
        ("a.tsv", qtm(timed=False).replace(".", ",").encode(), "decimal commas"),
        ("a.csv", motive().replace(",", ";").encode(), "separated by semicolons"),
        *((name, text.encode(code), "UTF-16") for code in ("utf-16", "utf-16-le")
          for name, text in (("a.tsv", qtm(timed=True)), ("a.csv", motive()), ("b.csv", nexus()))),
    ],
)  # fmt: skip
def test_decimal_commas_and_other_encodings_are_named(tmp_path: Path, name: str, data: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=words):
        recording.read(tmp_path / name)


def test_the_last_number_may_have_lost_digits_although_the_number_of_rows_is_right(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.tsv", qtm(timed=True).rstrip()
    path.write_text(whole)
    found = recording.read(path)
    assert np.isfinite(found.positions[-1]).all()
    assert not any("last row" in note for note in found.oddities)
    path.write_text(whole[:-2])
    found = recording.read(path)
    assert np.isnan(found.positions[-1, -1]).any()
    assert any("its last number may have lost digits" in note for note in found.oddities)


@pytest.mark.parametrize("blank", ["", ",,,", ","])
def test_a_blank_line_among_the_frames_of_nexus_ends_nothing(tmp_path: Path, blank: str) -> None:
    """The frames below it were not read, without a word."""
    lines = nexus().split("\n")
    first = next(k for k, line in enumerate(lines) if line.startswith("1,0,") and k > 10)
    lines.insert(first + 8, blank)
    text = "\n".join([*lines, "Joints", "100", ",,hip,,", "Frame,Sub Frame,X,Y,Z", ",,deg,deg,deg", "1,0,1,2,3", ""])
    check(read(tmp_path / "sts.csv", text))


@pytest.mark.parametrize("format", ["qtm", "untimed qtm", "motive", "nexus", "trc"])
def test_a_line_that_has_lost_a_cell_is_refused(tmp_path: Path, format: str) -> None:
    """All coordinates to the right of the lost cell were those of another axis or marker."""
    trc = ["PathFileType\t4", "DataRate\tNumFrames\tNumMarkers\tUnits", f"100\t{FRAMES}\t3\tmm"]
    trc += ["Frame#\tTime\t" + "\t\t\t".join(LABELS), "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\tX3\tY3\tZ3"]
    trc += ["\t".join([str(k + 1), f"{k / 100:.2f}", *cells(row)]) for k, row in enumerate(POSITIONS)]
    text, name = {
        "qtm": (qtm(timed=True).replace("\r\n", "\n"), "sts.tsv"),
        "untimed qtm": (qtm(timed=False).replace("\r\n", "\n"), "sts.tsv"),
        "motive": (motive(body=False), "sts.csv"),
        "nexus": (nexus(), "sts.csv"),
        "trc": ("\n".join([*trc, ""]), "sts.trc"),
    }[format]
    lines = text.split("\n")
    between = "," if name.endswith("csv") else "\t"
    lost = f"{POSITIONS[10, 1, 0]:.3f}{between}"
    at = next(k for k, line in enumerate(lines) if lost in line)
    lines[at] = lines[at].replace(lost, "")
    with pytest.raises(RecordingError, match=rf"line {at + 1} ends between the coordinates of a marker"):
        read(tmp_path / name, "\n".join(lines))
