"""Columns of dynamics.parquet, datasets and facts of dynamics.h5, for plane and space, with or without a fit.

What a trial does not have is NaN in columns and datasets, and None in facts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.cautions import Excitation
from mocap_id.dynamics.cone_solver import Solution
from mocap_id.dynamics.consistency import PointGrid
from mocap_id.stages.identify_dim.validation import SERIES

NO_FACTS: Mapping[str, Any] = dict.fromkeys((
    "condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "clock", "wrench",
    "cop_rms_m", "samples", "reference_table", "rivals", "held_out", "consistency", "solver", "reference_pulls",
    "cutoff_hz", "plate_bias_N", "untold", "arc_deg", "contact", "external", "advice",
    "motion", "pins", "scales", "calibration_covariance", "why",
))  # fmt: skip
"""Facts of dynamics.h5 in their order, without an identification; ``why`` says why there is none."""


def make_dynamics_columns(
    time: FloatArray,
    components: Sequence[str],
    series: Mapping[str, tuple[FloatArray, FloatArray]],
    *,
    torque: FloatArray,
    torque_sd: FloatArray,
    in_fit: BoolArray,
) -> dict[str, Any]:
    """Return the columns of dynamics.parquet.

    ``series`` has the wrench (T, C), N and N·m, and the centre of pressure (T,), m, by the form of the columns' names:
    ``{}`` measured, ``{}_model``, ``sd_{}_model``, ``{}_reference``, ``{}_held_out``. Columns of a missing form are
    NaN. The C ``components`` are names. ``torque`` and its standard deviation (T, N) are those of each joint
    coordinate, N·m.
    """
    columns: dict[str, Any] = {"time": time}
    for form in ("{}", "{}_model", "sd_{}_model", "{}_reference", "{}_held_out"):
        if form not in series:
            columns |= {form.format(name): np.full(len(time), np.nan) for name in SERIES}
            continue
        wrench, cop = series[form]
        columns |= {form.format(name): column for name, column in zip(components, wrench.T, strict=True)}
        columns[form.format("cop_x")] = cop
    for j, (value, sd) in enumerate(zip(torque.T, torque_sd.T, strict=True), start=1):
        columns[f"tau_{j}"], columns[f"sd_tau_{j}"] = value, sd
    return columns | {"in_fit": in_fit}


def make_datasets(
    names: Sequence[str],
    value: FloatArray,
    covariance: FloatArray,
    *,
    sd: FloatArray,
    units: Sequence[str],
    regrouping: FloatArray,
    full_names: Sequence[str],
    full: FloatArray,
    excitation: Excitation | None = None,
    prior_share: FloatArray | None = None,
    reference: FloatArray | None = None,
    bodies: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    grid: PointGrid | None = None,
    masses: FloatArray | None = None,
    held_out: tuple[FloatArray, FloatArray] | None = None,
) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5, for b base parameters of a chain with p parameters.

    Parameters
    ----------
    value, sd : (b,) arrays
        Base parameters and their standard deviations, SI; without a fit, a finite value is known in another way.
    covariance : (b, b) array
        Covariance of the base parameters.
    regrouping : (b, p) array
        Matrix from the parameters of the chain to the base parameters.
    full, reference : (p,) arrays
        Parameters of the chain, and those of the reference body.
    excitation, prior_share
        Accuracy of each base parameter, and the share (b,) of its precision that comes from the prior, 0 … 1.
    bodies : tuple, optional
        Parameters (q,) of bodies with measured poses, those of the reference body, and their covariance (q, q) without
        errors of scale. Default: the parameters of the chain, without a covariance.
    grid, masses
        Point masses of the physical consistency: their places, and their values (m,), kg.
    held_out : tuple, optional
        Base parameters (f, b) and clock offsets (f,), s, of the f models of the cross-validation.
    """
    absent = np.full(len(value), np.nan)
    verdict: Sequence[str] = ["known" if np.isfinite(each) else "not identifiable" for each in value]
    reference = np.full(len(full), np.nan) if reference is None else reference
    of_bodies, of_reference, of_errors = bodies or (full, reference, np.full((len(full), len(full)), np.nan))
    segment = np.zeros(0, dtype=np.int64) if grid is None else grid.segment
    models, offsets = held_out or (np.zeros((0, len(value))), np.zeros(0))
    return {
        "base": {
            "name": np.array(names, dtype=object),
            "value": value,
            "sd": sd,
            "covariance": covariance,
            "unit": np.array(units, dtype=object),
            "regrouping": regrouping,
            "verdict": np.array(verdict if excitation is None else excitation.verdict, dtype=object),
            "excitation": absent if excitation is None else excitation.own,
            "own_share": absent if excitation is None else excitation.share,
            "relative_sd": absent if excitation is None else excitation.relative_sd,
            "prior_share": absent if prior_share is None else prior_share,
        },
        "full": {"name": np.array(full_names, dtype=object), "value": full, "reference": reference},
        "bodies": {"value": of_bodies, "reference": of_reference, "covariance": of_errors},
        "grid": {
            "segment": segment,
            "position": np.zeros((0, 2)) if grid is None else grid.position,
            "mass": np.full(len(segment), np.nan) if masses is None else masses,
        },
        "held_out": {"base": models, "clock_offset": offsets},
    }


def describe_solver(solution: Solution, requested: str) -> dict[str, Any]:
    """Return JSON about the solver of the physical consistency; ``requested`` is the requested kind."""
    answer = solution.answer
    return {
        "name": answer.solver,
        "status": answer.status,
        "iterations": answer.iterations or None,
        "kkt": answer.optimality.excess,
        "proven": answer.optimality.proven,
        **asdict(answer.optimality),
        "asked": requested,
        "price_of_consistency": solution.price,
    }
