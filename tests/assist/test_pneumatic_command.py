"""`mocap-id pneumatic`: JSON of every command, and what it says of mistakes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from mocap_id.config.device import load_device
from mocap_id.errors import ConfigError
from mocap_id.store import Table
from mocap_id_assist import pneumatic as identification
from mocap_id_assist.devices import TorqueLog, predict_torque
from mocap_id_cli.commands import build

DEVICE = Path(__file__).resolve().parents[2] / "configs" / "devices" / "elbow.yaml"


def call(*arguments: object) -> Result:
    return CliRunner().invoke(build(), ["pneumatic", *(str(argument) for argument in arguments)])


def document(*arguments: object) -> dict:
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.exception
    return dict(json.loads(result.stdout))


def test_pressures_then_curve_give_the_spring() -> None:
    """Within 1 %, through both commands, for springs that known pressures give."""
    rng, tried = np.random.default_rng(5), 0
    while tried < 8:
        one, other = rng.uniform(1.1e5, 6.9e5, 2)
        given = document("curve", DEVICE, "--flexion", one, "--extension", other)
        rest = given["rest_angle_rad"]
        if rest is None:
            assert "torque is not zero" in given["why"]
            continue
        tried += 1
        stiffness = float(np.interp(rest, given["angle_rad"], given["stiffness_Nm_rad"]))
        found = document("pressures", DEVICE, "--stiffness", stiffness, "--rest-angle", rest)
        assert found["why"] == ""
        again = document("curve", DEVICE, "--flexion", found["flexion_Pa"], "--extension", found["extension_Pa"])
        assert again["rest_angle_rad"] == pytest.approx(rest, rel=0.01)
        slope = np.interp(rest, again["angle_rad"], again["stiffness_Nm_rad"])
        assert slope == pytest.approx(stiffness, rel=0.01)
        np.testing.assert_allclose(again["torque_Nm"], given["torque_Nm"], atol=0.01)


def test_curve_of_conditions(tmp_path: Path) -> None:
    bare = document("curve", DEVICE, "--condition", "C")
    assert not any(bare["torque_Nm"] + bare["stiffness_Nm_rad"] + bare["torque_flexing_Nm"])
    assert "no torque" in bare["why"]
    five = document("curve", DEVICE, "--condition", "5", "--out", tmp_path / "five")
    fast = document("curve", DEVICE, "--condition", "5", "--polytropic", 1.4)
    assert fast["torque_Nm"] == five["torque_adiabatic_Nm"]
    assert {file.name for file in (tmp_path / "five").iterdir()} == {"curve.json", "curve.svg", "curve.pdf"}
    worn = document("curve", DEVICE, "--condition", "C", "--flexion", 446_063, "--extension", 101_325)
    assert worn["torque_Nm"] == five["torque_Nm"]


def test_budget_and_what_it_needs(tmp_path: Path) -> None:
    changes = {(one["from"], one["to"]): one for one in document("budget", DEVICE)["changes"]}
    assert ("C", "AC") not in changes
    assert changes["4", "5"]["gas_g"] == 0
    assert changes["4", "5"]["changes_per_reservoir"] is None
    assert changes["3", "4"]["gas_g"] == pytest.approx(changes["3", "2"]["gas_g"] + changes["3", "5"]["gas_g"])
    text = DEVICE.read_text("utf-8")
    (tmp_path / "device.yaml").write_text(text[: text.index("conditions:")], "utf-8")
    result = call("budget", tmp_path / "device.yaml")
    assert "at least two worn conditions" in str(result.exception)


def test_a_trial_of_a_relaxed_person(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = load_device(DEVICE).keys
    time = np.linspace(0, 20, 2000)
    angle, velocity = 1.2 + 0.9 * np.sin(1.3 * time), 1.17 * np.cos(1.3 * time)
    torque = keys.cylinder().torque(angle, keys.sealed.setting()) + keys.cylinder().friction(velocity)
    torque += 0.02 * np.random.default_rng(0).normal(size=len(time))
    states = Table(None, {"theta_1": angle, "dtheta_1": velocity})  # type: ignore[arg-type]
    artefacts = {"states.parquet": states, "dynamics.parquet": Table(None, {"tau_1": torque})}  # type: ignore[arg-type]
    run = SimpleNamespace(artefacts=artefacts, in_space=False, why_missing=lambda file: "the plate is missing")
    monkeypatch.setattr(identification, "open_run", lambda source: run)
    found = identification.identify_device(load_device(DEVICE), Path("run"))
    values = {one["name"]: one for one in found["parameters"]}
    assert values["coulomb_Nm"]["value"] == pytest.approx(0.2, abs=0.02)
    assert values["area_extension_m2"]["value"] is None
    assert "does not determine" in values["area_extension_m2"]["why"]
    with pytest.raises(Exception, match="no torque of joint 2: the plate is missing"):
        identification.identify_device(load_device(DEVICE), Path("run"), joint=2)


def test_a_trial_in_space_of_a_relaxed_person(monkeypatch: pytest.MonkeyPatch) -> None:
    """Condition and torque are those of the trial; an error of its torque that lasts is inside the intervals."""
    config = load_device(DEVICE)
    true = replace(config.keys.cylinder(), area_flexion=3.0e-4, dead_flexion=0.1)
    time = np.linspace(0, 20, 1000)
    flexion, rate = 1.2 + 0.9 * np.sin(1.3 * time), 1.17 * np.cos(1.3 * time)
    wrong = 0.3 * np.ones(len(time))
    torque = true.torque(flexion, config.condition("5").setting()) + true.friction(rate) + wrong
    torque += 0.02 * np.random.default_rng(0).normal(size=len(time))
    angles = {"elbow_flexion": flexion, "delbow_flexion": rate, "constant_sd_elbow_flexion": 0 * time + 0.02}
    dynamics = {"elbow_torque": torque, "sd_elbow_torque": wrong}
    tables = {"angles.parquet": angles, "dynamics.parquet": dynamics}
    curl = {"condition": "5"}
    run = SimpleNamespace(
        artefacts={name: Table(None, columns) for name, columns in tables.items()},  # type: ignore[arg-type]
        in_space=True,
        facts=lambda file: {"curl": curl},
        why_missing=lambda file: "no plate",
    )
    monkeypatch.setattr(identification, "open_run", lambda source: run)
    found = {one["name"]: one for one in identification.identify_device(config, Path("run"))["parameters"]}
    low, high = found["area_flexion_m2"]["interval"]
    assert low < true.area_flexion < high
    assert found["coulomb_Nm"]["value"] == pytest.approx(0.2, abs=0.02)
    curl["condition"] = "C"
    with pytest.raises(ConfigError, match="not worn in condition `C`"):
        identification.identify_device(config, Path("run"))
    curl["condition"] = "weak"
    with pytest.raises(ConfigError, match="there is no condition `weak`"):
        identification.identify_device(config, Path("run"))
    del run.artefacts["dynamics.parquet"].columns["elbow_torque"]
    with pytest.raises(ConfigError, match="no torque of the elbow, which needs `protocol: curl`"):
        identification.identify_device(config, Path("run"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("curve", DEVICE, "--condition", "55"), "did you mean `5`"),
        (("curve", DEVICE, "--flexion", 9e6), "up to the supply's 700000 Pa"),
        (("curve", DEVICE, "--flexion", "nan"), "expected pressures above 0 Pa"),
        (("curve", DEVICE, "--polytropic", 2), "expected 1 (isothermal)"),
        (("pressures", DEVICE, "--stiffness", -1, "--rest-angle", 1), "above zero"),
        (("pressures", DEVICE, "--stiffness", 1, "--rest-angle", 1, "--range", 2, 1), "is empty"),
        (("pressures", DEVICE, "--stiffness", 1, "--rest-angle", 1, "--range", 5, 6), "no angle of the range"),
        (("identify", DEVICE, "nothing.csv"), "no such file"),
    ],
)
def test_mistakes_are_said(arguments: tuple[object, ...], said: str) -> None:
    result = call(*arguments)
    assert result.exit_code != 0
    assert said in str(result.exception)


def test_a_log_far_from_the_description_gives_a_caution(tmp_path: Path) -> None:
    """Torque in N·m and in inch-pounds."""
    device = load_device(DEVICE)
    time = np.linspace(0, 20, 800)
    angle, velocity, which = 1.2 + 0.9 * np.sin(time), 0.9 * np.cos(time), np.zeros(800, dtype=np.int64)
    log = TorqueLog(angle, angle, velocity, (device.keys.sealed.setting(),), which)
    torque = predict_torque(device.keys.cylinder(), log)
    for unit, caution in ((1.0, False), (8.85, True)):
        rows = np.column_stack([angle, unit * torque, velocity])
        file = tmp_path / "log.csv"
        np.savetxt(file, rows, delimiter=",", header="angle_rad,torque_Nm,velocity_rad_s", comments="")
        result = call("identify", DEVICE, file)
        assert result.exit_code == 0
        assert ("caution: " in result.output) == caution


def test_mistakes_of_the_file_and_the_log(tmp_path: Path) -> None:
    text = DEVICE.read_text("utf-8")
    for old, new, said in (
        ("supply_Pa: 700000", "supply_Pa: 60000", "pressures are absolute"),
        (
            "flexion_Pa: 446063, extension_Pa: 101325}   #",
            "flexion_Pa: -3, extension_Pa: 1}   #",
            "up to the supply's",
        ),
        ("polytropic: 1.2 ", "polytropic: 2 ", "polytropic"),
        ("{fill_s: 0.2", "{fill_s: 0", "fill_s"),
    ):
        assert old in text
        file = tmp_path / "device.yaml"
        file.write_text(text.replace(old, new), "utf-8")
        assert said in str(call("curve", file).exception)
    for header, said in (
        ("angle_rad,force_N", "expected angle_rad, torque_Nm"),
        ("angle_rad,torque_Nm", "at least 20"),
    ):
        log = tmp_path / "log.csv"
        log.write_text(f"{header}\n1,2\n2,3\n", "utf-8")
        assert said in str(call("identify", DEVICE, log).exception)
