"""`mocap-id prescribe` and `mocap-id workspace`: what they print and write, and what they say of mistakes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from mocap_id.errors import ConfigError
from mocap_id_cli.commands import build

ROOT = Path(__file__).resolve().parents[2]
SHOULDER = ROOT / "configs" / "prescriptions" / "shoulder.yaml"
ARM = "prescription: a\narm: {mass_kg: 1, lever_m: 1, inertia_kgm2: 1}\n"
JOINTS = "joints: [{limits_deg: [-60, 180], strength_share: 0.2}]\n"
CHAIN = """prescription: two
chain:
  - {name: shoulder, at_m: [0, 1.5], mass_kg: 2.0, centre_m: [0, 0.135]}
  - {name: elbow, at_m: [0, 0.31], mass_kg: 1.57, centre_m: [0, 0.19]}
tip_m: [0, 0.28]
joints:
  - {limits_deg: [90, 270], strength_Nm: [-4, 4]}
  - {limits_deg: [-130, 0], strength_Nm: [-2, 2]}
"""
CASES = {"healthy": 1.0, "50 %": 0.5, "20 %": 0.2, "flexion": [-1.0, 0.5], "extension": [-0.5, 1.0]}


def call(*arguments: object) -> Result:
    return CliRunner().invoke(build(), [str(argument) for argument in arguments])


def prescribed(folder: Path, text: str) -> dict:
    file = folder / "p.yaml"
    file.write_text(text, "utf-8")
    result = call("prescribe", file, "--json", "-q")
    assert result.exit_code == 0, result.exception
    return dict(json.loads(result.stdout))


@pytest.mark.parametrize("case", CASES)
def test_the_table_of_the_page(case: str, tmp_path: Path) -> None:
    rows = re.findall(
        r"^\| (.+?) \| (.+?) \| (.+?) \| (.+?) \| (.+?) \|$", (ROOT / "docs/prescribe.md").read_text(), re.M
    )
    row = next(row for row in rows if row[0].startswith(case) or f"{case} only" in row[0])
    found = prescribed(tmp_path, ARM + f"joints: [{{limits_deg: [-60, 180], strength_share: {CASES[case]}}}]\n")

    def shown(pair: list[float]) -> str:
        return f"{pair[0]:.1f}° to {pair[1]:.1f}°".replace("-", "−")

    assert row[1] == shown(found["range_without_deg"])
    assert row[4] == shown(found["range_deg"])
    if row[2] == "none helps":
        assert not found["helps"]
        assert found["springs"] == []
    else:
        (spring,) = found["springs"]
        assert row[2] == f"{spring['stiffness_Nm_per_rad'] / found['moment_of_gravity_Nm']:.3f} per rad"
        assert row[3] == f"{spring['rest_deg']:.1f}°"


def test_the_example_writes_everything(tmp_path: Path) -> None:
    result = call("prescribe", SHOULDER, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.exception
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {
        "prescription.json",
        "horizons.csv",
        *(f"{one}.{kind}" for one in ("range", "level_set") for kind in ("svg", "pdf")),
    }
    found = json.loads((tmp_path / "out" / "prescription.json").read_text("utf-8"))
    nodes = {node["name"]: node for node in found["sub_workspaces"]["nodes"]}
    assert nodes["table"]["tasks"] == ["feeding", "drinking"]
    assert nodes["walking"]["springs"] is None
    assert {tuple(switch["between"]) for switch in found["sub_workspaces"]["switches"]} == {("table", "reaching")}
    assert "4.508 N·m/rad" in result.stdout
    ways = {(way["from"], way["to"]): way["by"] for way in found["sub_workspaces"]["ways"]}
    assert ways["table", "walking"] is None


def test_two_joints_with_tasks(tmp_path: Path) -> None:
    tasks = "tasks: [{name: near, point_m: [-0.2, 1.25]}, {name: far, point_m: [-0.45, 1.3]}]\n"
    found = prescribed(tmp_path, CHAIN + tasks + "postures: 1024\nboxes: 3000\n")
    assert found["helps"]
    assert found["functional_workspace_m2"] > 2 * found["functional_workspace_without_m2"]
    assert found["functional_workspace_m2"] + found["gap_m2"] <= found["reachable_m2"] + 0.01
    assert [node["name"] for node in found["sub_workspaces"]["nodes"]] == ["near", "far"]
    assert all(node["springs"] is not None for node in found["sub_workspaces"]["nodes"])


def test_an_arm_that_rests_at_zero_has_an_equilibrium(tmp_path: Path) -> None:
    spring = "{stiffness: 1, rest_deg: 0}"
    text = "joints: [{limits_deg: [-90, 90], strength_share: 0.2}]\n"
    level_set = f"level_set: {{horizons_s: [0.2], angles: 41, velocities: 41, spring: {spring}}}\n"
    found = prescribed(tmp_path, ARM + text + level_set)
    assert found["level_set"]["equilibrium_deg"] == pytest.approx(0.0, abs=1e-9)


def test_a_search_in_which_the_joint_never_rests(tmp_path: Path) -> None:
    """Springs so weak, so far away, that gravity takes the arm out of its limits with each of them."""
    file = tmp_path / "p.yaml"
    limits = "joints: [{limits_deg: [60, 120], strength_share: 0.2}]\n"
    search = "search: {stiffness_mNm_per_deg: [5, 10, 5], rest_deg: [0, 90, 90], angles: 21, velocities: 21}\n"
    file.write_text(ARM + limits + search, "utf-8")
    result = call("prescribe", file, "--out", tmp_path / "out", "-q")
    assert result.exit_code == 0, result.exception
    assert "the joint does not rest within its limits with any of these springs" in result.stdout
    found = json.loads((tmp_path / "out" / "prescription.json").read_text("utf-8"))
    assert found["search"]["best"] is None
    assert (tmp_path / "out" / "search.svg").is_file()


@pytest.mark.parametrize("body", [ARM + JOINTS, CHAIN])
def test_without_springs_it_tells_what_can_be_held(body: str, tmp_path: Path) -> None:
    found = prescribed(tmp_path, body + "springs: []\npostures: 512\n")
    assert not found["helps"]
    assert found["springs"] == []
    if "range_deg" in found:
        assert found["range_deg"] == found["range_without_deg"]
    else:
        assert found["functional_workspace_m2"] == found["functional_workspace_without_m2"] > 0
        assert found["gap_m2"] == 0


MISTAKES = {
    "crossed limits": (
        ARM + "joints: [{limits_deg: [180, -60], strength_share: 0.2}]\n",
        "line 3.*is not below the upper",
    ),
    "missing limits": (ARM + "joints: [{strength_share: 0.2}]\n", "`limits_deg` of joint 1 is missing"),
    "no strength": (ARM + "joints: [{limits_deg: [0, 90]}]\n", "strength_Nm"),
    "crossed strength": (
        ARM + "joints: [{limits_deg: [0, 90], strength_Nm: [1, -1]}]\n",
        "the lower strength of joint 1",
    ),
    "zero mass": (ARM.replace("mass_kg: 1", "mass_kg: 0") + JOINTS, "mass_kg.*greater than 0"),
    "negative stiffness": (
        ARM + JOINTS + "level_set: {spring: {stiffness: -1, rest_deg: 0}}\n",
        "level_set.spring.stiffness.*greater than or equal to 0",
    ),
    "unknown key": (ARM + JOINTS + "stifness: 3\n", "unknown key `stifness`"),
    "no body": ("prescription: a\n" + JOINTS, "no body is given"),
    "too many joints": (ARM + JOINTS.replace("]\n", ", {limits_deg: [0, 9], strength_share: 1}]\n"), "the body has 1"),
    "point of one joint": (ARM + JOINTS + "required_m: [[0, 0]]\n", "`required_m` is for several joints"),
    "angle outside": (ARM + JOINTS + "required_deg: [200]\n", "outside the joint's limits"),
    "angle not to be held": (ARM + JOINTS + "required_deg: [-50, 170]\n", "no spring lets the person hold"),
    "point outside": (CHAIN + "required_m: [[2, 2]]\n", "cannot be reached"),
    "task outside": (ARM + JOINTS + "tasks: [{name: far, angles_deg: [170, 190]}]\n", "exceed the joint's limits"),
    "task without place": (ARM + JOINTS + "tasks: [{name: far, point_m: [0, 1]}]\n", "needs `angles_deg`"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_told(mistake: str, tmp_path: Path) -> None:
    text, told = MISTAKES[mistake]
    file = tmp_path / "p.yaml"
    file.write_text(text, "utf-8")
    error = call("prescribe", file).exception
    assert isinstance(error, ConfigError), error
    assert re.search(told, str(error), re.DOTALL), error
    assert "p.yaml, line" in str(error)


def test_a_chain_in_yaml_has_a_volume(tmp_path: Path) -> None:
    result = call("workspace", ROOT / "configs/chains/isb-arm.yaml", "--samples", 2000, "--out", tmp_path, "--json")
    assert result.exit_code == 0, result.exception
    found = json.loads(result.stdout)["workspace"]
    assert found["kind"] == "volume"
    assert 0.2 < found["low"] < found["value"] < found["high"] < 0.35
    assert {path.name for path in tmp_path.iterdir()} == {f"workspace.{kind}" for kind in ("json", "csv", "svg", "pdf")}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (("[-30, 110]", "[110, -30]"), "is not below the second"),
        (("limits_deg: [-30, 110]", "unit: 3"), "`joints\\[0\\].limits_deg` is missing"),
        (("axis: y, at", "axis: [0, 0, 0], at"), "is zero"),
        (("tip: [0.0, -0.26, 0.0]", "tip: [0.0, -0.26]"), "tip"),
    ],
)
def test_a_chain_with_mistakes(changed: tuple[str, str], told: str, tmp_path: Path) -> None:
    file = tmp_path / "chain.yaml"
    file.write_text((ROOT / "configs/chains/isb-arm.yaml").read_text("utf-8").replace(*changed), "utf-8")
    error = call("workspace", file).exception
    assert isinstance(error, ConfigError)
    assert re.search(told, str(error))


@pytest.mark.recordings
def test_a_trial_without_dynamics_has_a_workspace_alone(reaching_arm: Path, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    joints = "joints: [{strength_Nm: [-4, 4]}, {strength_Nm: [-2, 2]}]\n"
    file.write_text(f"prescription: arm\ntrial: {reaching_arm}\n{joints}", "utf-8")
    result = call("prescribe", file, "--out", tmp_path / "out", "-q")
    assert result.exit_code == 4
    assert "nothing can be prescribed" in result.stdout
    found = json.loads((tmp_path / "out" / "prescription.json").read_text("utf-8"))
    assert found["springs"] is None
    assert "wrench" in found["why"]
    assert found["workspace"]["workspace"]["value"] == pytest.approx(0.2565, rel=0.01)


@pytest.mark.recordings
def test_two_sessions_over_each_other(reaching_arm: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = call("workspace", reaching_arm, "--compare", reaching_arm, "--samples", 2000, "--out", out, "--json", "-q")
    assert result.exit_code == 0, result.exception
    found = json.loads(result.stdout)
    assert found["change"]["gained"] == found["change"]["lost"] == 0
    assert found["change"]["kept"] == pytest.approx(found["workspace"]["value"], rel=0.01)
    assert found["change"]["notes"] == []
    assert (out / "change.svg").is_file()


def test_a_comparison_with_another_person_says_so(tmp_path: Path) -> None:
    def write(name: str, forearm: float, elbow: str = "elbow") -> Path:
        file = tmp_path / f"{name}.yaml"
        joints = (
            f"  - {{name: shoulder, axis: z, limits_deg: [0, 90]}}\n  - {{name: {elbow}, axis: z, at: [0.3, 0, 0], "
        )
        file.write_text(f"chain: {name}\njoints:\n{joints}limits_deg: [0, 120]}}\ntip: [{forearm}, 0, 0]\n", "utf-8")
        return file

    first = write("first", 0.25)
    for later, told in (
        (write("same", 0.26), None),
        (write("other", 0.29), "from elbow to the tip .* by +40 mm"),
        (write("joints", 0.25, "wrist"), "different joints"),
    ):
        result = call("workspace", first, "--compare", later, "--samples", 600, "--json", "-q")
        notes = json.loads(result.stdout)["change"]["notes"]
        assert len(notes) == (told is not None)
        assert told is None or all(part in notes[0] for part in told.split(" .* "))


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--tip", "WRTS"), "did you mean `WRST`"),
        (("--tip", "1,x"), "point"),
        (("--samples", 9), "too few"),
        (("--quantile", 1), "quantile"),
    ],
)
def test_options_that_cannot_be(reaching_arm: Path, options: tuple[object, ...], told: str) -> None:
    error = call("workspace", reaching_arm, *options, "-q").exception
    assert isinstance(error, ConfigError)
    assert told in str(error)


def test_the_figure_of_a_chain_is_written(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(CHAIN + "postures: 256\nboxes: 500\n", "utf-8")
    result = call("prescribe", file, "--out", tmp_path / "out", "-q")
    assert result.exit_code == 0, result.exception
    assert list((tmp_path / "out").glob("*.svg"))
