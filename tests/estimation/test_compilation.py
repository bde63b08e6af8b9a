"""Compiled code is cached between runs, and works without a cache folder."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from simulated_chains import swinging

from mocap_id.compilation import compiled
from mocap_id.estimation.filter_kernels import refine, run_filter, run_smoother
from mocap_id.estimation.filter_problem import noise_shape, transition
from mocap_id.estimation.noise import log_likelihood

RUN = """
import sys
import numpy as np
from mocap_id.estimation.noise import log_likelihood
log_likelihood(np.zeros(5), np.ones(5), np.ones(4), np.eye(4), np.ones(4), 0.001)
print(sum(log_likelihood.stats.cache_hits.values()), "numba.np.arraymath" in sys.modules)
"""


def test_a_second_run_finds_the_code_of_the_first_and_does_not_load_the_compiler(tmp_path: Path) -> None:
    def hits() -> str:
        environment = {"NUMBA_CACHE_DIR": str(tmp_path), "PATH": ""}
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", RUN], env=environment, capture_output=True, text=True, check=True
        )
        assert not done.stderr
        return done.stdout.strip()

    assert hits() == "0 True"
    assert hits() == "1 False"


def test_without_a_cache_folder_it_compiles_in_every_run_with_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    njit = numba.njit

    def without_folder(*function: Any, **options: Any) -> Any:
        if options.pop("cache", False):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(*function, **options)

    monkeypatch.setattr(numba, "njit", without_folder)

    def half(x: float) -> float:
        return x / 2

    with caplog.at_level(logging.WARNING):
        assert compiled(half)(3.0) == 1.5
    assert "NUMBA_CACHE_DIR" in caplog.text


def test_read_only_arrays_cause_no_new_compilation() -> None:
    moving = swinging(joints=2, seconds=0.5)
    functions: list[Any] = [refine, log_likelihood, run_filter, run_smoother]
    moving.smoothed()
    before = [function.signatures for function in functions]
    for array in (moving.markers, moving.centres, moving.segment, moving.local):
        array.flags.writeable = False
    moving.smoothed()
    assert [function.signatures for function in functions] == before


def test_the_compiled_likelihood_equals_the_python_source() -> None:
    from mocap_id.estimation import noise

    rng = np.random.default_rng(0)
    arguments = (rng.standard_normal(20) * 0.01, np.full(20, 1e-4), transition(0.01)[0], 1e4 * noise_shape(0.01))
    start = np.array([1.0, 1.0, 1.0, 1.0])
    source: Any = noise.log_likelihood
    assert noise.log_likelihood(*arguments, start, 1e-3) == pytest.approx(source.py_func(*arguments, start, 1e-3))
