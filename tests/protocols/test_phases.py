"""Averages over repetitions and comparison with other angles, on curves with a known result."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mocap_id.errors import ConfigError, RecordingError
from mocap_id.protocols.movement import GRID, average_repetitions, compare_angles, resample_repetitions
from mocap_id.recording import read_angles
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import IdentifyDimSettings
from mocap_id.stages.identify_dim.events import average_signals
from mocap_id.stages.trial_keys import Compare, Files, TrialKeys
from mocap_id.store import Table, Tree
from mocap_id.store.provenance import CHAIN, DYNAMICS_TABLE, EVENTS, STATES

TIME = np.arange(0.0, 20.0, 0.01)
BOUNDS = np.array([[1.0, 4.0], [6.0, 8.0], [10.0, 15.0]])


def shape(share: np.ndarray) -> np.ndarray:
    return np.sin(np.pi * share) ** 2


def signal(scale: Mapping[int, float]) -> np.ndarray:
    out = np.zeros(len(TIME))
    for k, (begin, finish) in enumerate(BOUNDS):
        share = (TIME - begin) / (finish - begin)
        out += np.where((share >= 0) & (share <= 1), scale[k] * shape(share), 0.0)
    return out


def test_repetitions_of_different_lengths_are_aligned() -> None:
    mean, sd, count = average_repetitions(resample_repetitions(TIME, signal({0: 1.0, 1: 2.0, 2: 3.0}), BOUNDS))
    np.testing.assert_allclose(mean, 2.0 * shape(GRID), atol=2e-3)
    np.testing.assert_allclose(sd, 1.0 * shape(GRID), atol=2e-3)
    assert (count == 3).all()


def test_unknown_samples_are_averaged_over_the_other_repetitions() -> None:
    values = signal({0: 1.0, 1: 1.0, 2: 1.0})
    values[(TIME > 7.0) & (TIME < 7.5)] = np.nan
    mean, _, count = average_repetitions(resample_repetitions(TIME, values, BOUNDS))
    np.testing.assert_allclose(mean, shape(GRID), atol=2e-3)
    assert count.min() == 2 and count[0] == 3
    single = average_repetitions(resample_repetitions(TIME, values, BOUNDS[:1]))
    assert np.isnan(single[1]).all()
    assert np.isnan(average_repetitions(np.full((2, 101), np.nan))[0]).all()


def test_agreement_finds_sign_offset_and_noise() -> None:
    ours = signal({0: 1.0, 1: 1.0, 2: 1.0})
    noise = 0.01 * np.random.default_rng(0).normal(size=len(ours))
    r, offset, rmse, _ = compare_angles(ours, ours + 0.3 + noise)
    assert (offset, rmse) == (pytest.approx(0.3, abs=1e-3), pytest.approx(0.01, rel=0.05))
    assert r > 0.99
    assert compare_angles(ours, -ours)[0] == pytest.approx(-1.0)
    assert np.isnan(compare_angles(ours, np.zeros_like(ours))[0])
    assert compare_angles(ours, np.where(TIME < 10, ours, np.nan))[3] == np.count_nonzero(TIME < 10)


def run(compare: Compare | None, complete: bool = True) -> Table:
    theta = signal({0: 1.0, 1: 1.2, 2: 1.4})
    orders = ("theta", "dtheta", "ddtheta", "dddtheta", "sd_theta", "sd_dtheta", "sd_ddtheta")
    states = pd.DataFrame({"time": TIME} | {f"{name}_1": theta for name in orders} | {"observed_1": True})
    kinds = (("", ""), ("", "_model"), ("sd_", "_model"), ("", "_reference"), ("", "_held_out"))
    names = [f"{prefix}{name}{suffix}" for name in ("Fx", "Fy", "tauz", "cop_x") for prefix, suffix in kinds]
    wrench = dict.fromkeys(names, theta)
    dynamics = pd.DataFrame({"time": TIME} | wrench | {"tau_1": 2 * theta, "sd_tau_1": theta, "in_fit": True})
    nan = np.full(len(BOUNDS), np.nan)
    end = BOUNDS[:, 1] if complete else nan
    events = pd.DataFrame({"start": BOUNDS[:, 0], "seat_off": nan, "stand": nan, "seat_on": nan, "end": end})
    inputs = {
        "chain.h5": Tree(CHAIN, {"joints": {"name": np.array(["knee"])}}),
        "states.parquet": Table.from_frame(STATES, states),
    }
    keys = TrialKeys(trial="t", recording=Files(markers=Path("t.c3d")), compare=compare)
    return average_signals(
        Context(keys, IdentifyDimSettings(), inputs),
        Table.from_frame(EVENTS, events),
        Table.from_frame(DYNAMICS_TABLE, dynamics),
    )


def test_the_table_contains_every_signal_and_reports_missing_repetitions() -> None:
    frame = run(None).frame
    assert set(frame["span"]) == {"repetition"}  # no stand, so no rise
    torque = frame[frame["quantity"] == "tau_1"]
    np.testing.assert_allclose(torque["mean"], 2.4 * shape(GRID), atol=5e-3)
    assert set(torque["unit"]) == {"N*m"}
    empty = run(None, complete=False)
    assert len(empty.frame) == 0
    assert empty.facts["repetitions"] == {"repetition": 0, "rise": 0}
    assert "no repetition" in empty.facts["why"]


def written(folder: Path, name: str, degrees: bool) -> Path:
    """The same angle plus 0.2 rad, at 50 Hz, in the unit and format of another file."""
    time = np.arange(0.5, 19.0, 0.02)
    angle = np.interp(time, TIME, signal({0: 1.0, 1: 1.2, 2: 1.4})) + 0.2
    values = np.degrees(angle) if degrees else angle
    file = folder / name
    if file.suffix == ".csv":
        head, separator = [f"time_s,knee_{'deg' if degrees else 'rad'}"], ","
    else:
        flag = "yes" if degrees else "no"
        head, separator = (
            ["angles", f"nRows={len(time)}", "nColumns=2", f"inDegrees={flag}", "endheader", "time\tk"],
            "\t",
        )
    file.write_text(
        "\n".join([*head, *(f"{t:.4f}{separator}{v:.9f}" for t, v in zip(time, values, strict=True))]) + "\n"
    )
    return file


@pytest.mark.parametrize("name", ["a.mot", "a.sto", "a.csv"])
@pytest.mark.parametrize("degrees", [True, False])
def test_other_angles_are_read_in_their_unit_and_resampled(tmp_path: Path, name: str, degrees: bool) -> None:
    file = written(tmp_path, name, degrees)
    column = f"knee_{'deg' if degrees else 'rad'}" if name == "a.csv" else "k"
    table = run(Compare(angles=file, columns={"knee": column}))
    (told,) = table.facts["compared"]
    assert told["r"] == pytest.approx(1.0, abs=1e-4)
    assert told["offset_rad"] == pytest.approx(0.2, abs=1e-3)
    assert told["rmse_rad"] < 2e-3
    other = table.frame[table.frame["quantity"] == "theta_1_other"]
    np.testing.assert_allclose(other["mean"], 1.2 * shape(GRID) + 0.2, atol=5e-3)
    turned = run(Compare(angles=file, columns={"knee": f"-{column}"}))
    assert turned.facts["compared"][0]["r"] == pytest.approx(-1.0, abs=1e-4)


def test_missing_columns_and_times_are_named(tmp_path: Path) -> None:
    file = written(tmp_path, "a.mot", degrees=False)
    with pytest.raises(ConfigError, match=r"no joint 'elbow'.*knee"):
        run(Compare(angles=file, columns={"elbow": "k"}))
    with pytest.raises(ConfigError, match="no column x; it has k"):
        run(Compare(angles=file, columns={"knee": "x"}))
    unitless = tmp_path / "b.csv"
    unitless.write_text("time_s,knee\n0,1\n0.01,2\n")
    with pytest.raises(RecordingError, match="_deg or _rad"):
        read_angles(unitless, ["knee"])
    unitless.write_text("time_s,knee_deg\n1,1\n0,2\n")
    with pytest.raises(RecordingError, match="does not increase"):
        read_angles(unitless, ["knee_deg"])
    unitless.write_text("t,knee_deg\n1,1\n2,2\n")
    with pytest.raises(RecordingError, match="time_s"):
        read_angles(unitless, ["knee_deg"])
