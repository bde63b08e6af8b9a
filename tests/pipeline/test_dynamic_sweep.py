"""Small parts of benchmarks/dynamic_sweep.py and dynamic_sources.py, on other seeds."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
TRIALS = 4


@pytest.fixture(scope="module")
def modules():
    """The benchmarks, which import each other by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        names = ("dynamic_sweep", "dynamic_sources")
        yield {name: importlib.import_module(name) for name in names}


@pytest.fixture(scope="module")
def clean(modules, tmp_path_factory):
    """An identified trial without noise."""
    sweep = modules["dynamic_sweep"]
    return sweep.run_trial(tmp_path_factory.mktemp("clean") / "trial", replace(sweep.ROWS["clean"], seed=970_001))


def test_the_truth_is_regrouped_as_the_simulator_writes_it_out(modules, clean) -> None:
    truth = modules["dynamic_sweep"]
    written = np.array(clean.truth["base_parameters"]["values"])
    regrouped = truth.compute_true_base(clean)
    np.testing.assert_allclose(truth.compute_norms(regrouped), truth.compute_norms(written), rtol=1e-9)
    np.testing.assert_allclose(regrouped[:8], written[:8], atol=1e-9)
    turn = truth.find_last_frame_turn(clean.truth, clean.chain)
    assert abs(turn) > 0.05
    c, s = np.cos(turn), np.sin(turn)
    np.testing.assert_allclose(np.array([[c, -s], [s, c]]) @ regrouped[8:10], written[8:10], atol=1e-9)


def test_a_clean_trial_keeps_every_limit(modules, clean) -> None:
    sweep = modules["dynamic_sweep"]
    result = sweep.compare(clean)
    values = np.abs([*result.norms, *result.rms, result.offset])
    asked = {name: (column, limit) for name, _, limit, _, column in sweep.list_limits("clean")}
    assert {name: values[k] for name, (k, limit) in asked.items() if not values[k] <= limit} == {}
    assert (np.abs(result.error[2:]) < 0.02).all()  # frames included: the last one is turned by 12 degrees


def test_parameters_are_transferred_to_a_turned_and_shifted_frame(modules, clean) -> None:
    """Parameters transferred to a frame turned by 0.3 rad and moved describe the same body."""
    truth = modules["dynamic_sweep"]
    turn, shift = np.exp(0.3j), 0.01 - 0.02j
    markers = clean.chain.data["markers"]
    local = np.array(markers["local"])
    own = np.asarray(markers["segment"]) == 3
    moved = local @ [1, 1j] * turn + shift
    local[own] = np.column_stack([moved.real, moved.imag])[own]
    other = replace(
        clean, chain=replace(clean.chain, data={**clean.chain.data, "markers": {**markers, "local": local}})
    )
    full = np.asarray(clean.dynamics.data["full"]["value"])
    got = truth.transfer_parameters(clean, other)
    np.testing.assert_allclose(got[:12], full[:12], atol=1e-9)
    mass, first, inertia = full[12], full[13] + 1j * full[14], full[15]
    expected = first * turn + mass * shift
    np.testing.assert_allclose(got[12:15], [mass, expected.real, expected.imag], rtol=1e-9)
    about_com = inertia - abs(first) ** 2 / mass
    assert got[15] == pytest.approx(about_com + abs(expected) ** 2 / mass)


@pytest.mark.slow
def test_with_true_inputs_there_is_no_error(modules) -> None:
    sources, sweep = modules["dynamic_sources"], modules["dynamic_sweep"]
    found = sources.measure(replace(sweep.ROWS["ordinary"], seed=970_002))
    rows = dict(zip((*sources.REPLACED, *sources.CHANGED), found, strict=True))
    limits = np.array([0.05, 0.05, 0.05, 0.05, 0.2, 0.1, 0.1, *6 * [0.2], 0.05])
    assert (rows["true states, centres and wrench"] < limits).all()
    assert not (rows["unchanged"] < limits).all()


@pytest.mark.slow
@pytest.mark.parametrize("row", ["ordinary", "hard"])
def test_most_trials_meet_the_requirements(modules, row: str) -> None:
    sweep = modules["dynamic_sweep"]
    results = [sweep.measure(replace(sweep.ROWS[row], seed=970_100 + k)) for k in range(TRIALS)]
    values = np.array([np.abs([*r.norms, *r.rms, r.offset]) for r in results])
    for name, _, limit, _, column in sweep.list_limits(row):
        assert np.quantile(values[:, column], 0.9) <= limit, name


@pytest.mark.slow
def test_parameters_are_valid_for_another_strategy(modules) -> None:
    sweep = modules["dynamic_sweep"]
    errors = sweep.measure_transfer(replace(sweep.ROWS["ordinary"], seed=970_200))
    assert errors.shape == (3, 4, 6)
    assert np.median(errors[0, 3]) <= 5  # mm, carried
    assert (errors[2, 3] <= errors[0, 3] + 0.5).all()  # own parameters are no worse
