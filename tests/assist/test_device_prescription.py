"""A prescription with pneumatic devices: pressures, what is lost, and the controller."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mocap_id.errors import ConfigError
from mocap_id_assist.devices import find_held_angles
from mocap_id_assist.files import load_prescription
from mocap_id_assist.prescription_output import prescription_lines, prescription_output
from mocap_id_assist.prescriptions import prescribe_from

ROOT = Path(__file__).resolve().parents[2]
DEVICE = ROOT / "configs" / "devices" / "elbow.yaml"
ARM = """prescription: p
arm: {mass_kg: 2.6, lever_m: 0.17, inertia_kgm2: 0.11}
joints: [{limits_deg: [0, 140], strength_Nm: [-2.2, 2.2]}]
"""
CHAIN = """prescription: two
chain:
  - {name: shoulder, at_m: [0, 1.5], mass_kg: 2.0, centre_m: [0, 0.135]}
  - {name: elbow, at_m: [0, 0.31], mass_kg: 1.57, centre_m: [0, 0.19]}
tip_m: [0, 0.28]
joints:
  - {limits_deg: [90, 270], strength_Nm: [-4, 4]}
  - {limits_deg: [0, 130], strength_Nm: [-1.2, 1.2]}
postures: 1024
boxes: 500
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "p.yaml"
    file.write_text(text.replace("DEVICE", str(DEVICE)), "utf-8")
    return file


def test_the_example_is_held_by_its_device(tmp_path: Path) -> None:
    found = prescribe_from(load_prescription(ROOT / "configs" / "prescriptions" / "elbow.yaml"))
    content = json.loads(json.dumps(prescription_output(found).document, allow_nan=False))
    devices, controller = content["devices"], content["controller"]
    assert devices["range_lost_deg"] == pytest.approx(np.ptp(content["range_deg"]) - np.ptp(devices["range_deg"]))
    assert 0 < devices["range_lost_deg"] < 30
    assert "would need" in devices["springs"][0]["nearest_spring"]["why"]
    each, joint = found.devices[0], found.joint  # type: ignore[index]
    assert joint is not None
    angle = np.linspace(*found.device_range, 300)  # type: ignore[misc]
    assert find_held_angles(joint, each.device.keys.cylinder(), each.setting, angle).all()
    assert controller["problems"] == []
    assert all(visit["held"] for visit in controller["tour"]["tasks"])
    assert controller["tour"]["shortest_dwell_s"] > controller["tour"]["settling_s"]
    assert 0 < controller["tour"]["gas_g"] < 1
    assert len(controller["nodes"]) == 2


@pytest.mark.slow
def test_the_controller_finds_what_fails(tmp_path: Path) -> None:
    tasks = "tasks:\n  - {name: down, angles_deg: [0, 10]}\n  - {name: up, angles_deg: [70, 130]}\ncontroller:\n"
    weak = ARM.replace("2.2", "1.2") + "springs: [{joints: [1], device: DEVICE}]\n" + tasks
    found = prescribe_from(load_prescription(written(tmp_path, weak)))
    problems = " ".join(found.controlled.problems)  # type: ignore[union-attr]
    assert "down and up have no overlap" in problems
    assert "up is not held throughout" in problems
    assert any(line.startswith("problem: ") for line in prescription_lines(found))
    device = f"springs: [{{joints: [1], device: {_slow(tmp_path)}}}]\n"
    hectic = written(tmp_path, ARM + tasks + "  speed_deg_s: 400\n  hold_s: 0\n" + device)
    found = prescribe_from(load_prescription(hectic))
    assert any("chatters" in problem for problem in found.controlled.problems)  # type: ignore[union-attr]


def _slow(folder: Path) -> Path:
    file = folder / "slow.yaml"
    file.write_text(DEVICE.read_text("utf-8").replace("{fill_s: 0.2, vent_s: 0.4}", "{fill_s: 2, vent_s: 2}"), "utf-8")
    return file


def test_devices_on_a_chain_lose_an_area(tmp_path: Path) -> None:
    text = CHAIN + "springs: [{joints: [1], stiffest: 8}, {joints: [2], stiffest: 4, device: DEVICE}]\n"
    found = prescribe_from(load_prescription(written(tmp_path, text)))
    content = prescription_output(found).document
    lost = content["devices"]["functional_workspace_lost_m2"]
    assert lost == pytest.approx(content["functional_workspace_m2"] - content["devices"]["functional_workspace_m2"])
    assert content["devices"]["functional_workspace_m2"] > 0
    assert [spring["joints"] for spring in content["devices"]["springs"]] == [[2]]
    assert any("less than with linear springs" in line for line in prescription_lines(found))


@pytest.mark.slow
def test_the_controller_of_a_chain(tmp_path: Path) -> None:
    """Both tasks are held with pressures of their own; a stronger task without any is said."""
    tasks = "tasks:\n  - {name: lap, point_m: [0.2, 1.05]}\n  - {name: mouth, point_m: [0.3, 1.45]}\n"
    shoulder = tmp_path / "shoulder.yaml"
    text = DEVICE.read_text("utf-8").replace("full_flexion_deg: 140", "full_flexion_deg: 275")
    shoulder.write_text(text.replace("stroke_m: 0.080", "stroke_m: 0.110"), "utf-8")
    springs = (
        f"springs: [{{joints: [1], stiffest: 8, device: {shoulder}}}, {{joints: [2], stiffest: 4, device: DEVICE}}]\n"
    )
    strong = CHAIN.replace("-4, 4", "-5, 5").replace("-1.2, 1.2", "-1.7, 1.7")
    found = prescribe_from(load_prescription(written(tmp_path, strong + springs + tasks + "controller: {}\n")))
    output = prescription_output(found)
    controller = json.loads(json.dumps(output.document, allow_nan=False))["controller"]
    assert [node["name"] for node in controller["nodes"]] == ["lap", "mouth"]
    assert [one["joints"] for one in controller["nodes"][0]["devices"]] == [[1], [2]]
    assert [visit["task"] for visit in controller["tour"]["tasks"]] == ["lap", "mouth", "lap"]
    assert controller["problems"] == []
    assert any("3 of 3 visits held" in line for line in prescription_lines(found))
    assert {"controller.svg", "unsafe_postures.csv"} <= set(output.write(tmp_path / "out"))
    assert all(visit.missing == 0 for visit in found.controlled.visits)  # type: ignore[union-attr]


def test_mistakes(tmp_path: Path) -> None:
    for text, said in (
        (ARM + "controller: {}\n", "needs `tasks:` and a spring"),
        (ARM + "springs: [{joints: [1], device: nowhere.yaml}]\n", "no such file"),
        (CHAIN + "controller: {}\n", "needs `tasks:` and a spring"),
    ):
        with pytest.raises(ConfigError, match=said):
            prescribe_from(load_prescription(written(tmp_path, text)))
