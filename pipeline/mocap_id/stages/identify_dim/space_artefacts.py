"""Contents of dynamics.parquet, dynamics.h5 and phases.parquet of a trial in space."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.comparison import agreement, centre_of_pressure, centre_of_pressure_rows
from mocap_id.dynamics.excitation import Excitation
from mocap_id.dynamics.fit import describe_clock
from mocap_id.dynamics.space.base_parameters import name_parameters
from mocap_id.dynamics.space.identification import SpatialIdentification
from mocap_id.dynamics.space.prediction import SpatialPrediction
from mocap_id.dynamics.space.preparation import COMPONENTS, SpatialTrial
from mocap_id.geometry.spatial_chain import SpatialChain
from mocap_id.stages.identify_dim.dynamics_artefacts import describe_solver, make_empty_facts
from mocap_id.store import Table
from mocap_id.store.schemas import PHASES

_PLANAR = [COMPONENTS.index(name) for name in ("Fx", "Fy", "tauz")]


def make_columns(
    time: FloatArray,
    *,
    measured: FloatArray,
    model: FloatArray,
    model_sd: FloatArray,
    torque: FloatArray,
    torque_sd: FloatArray,
    in_fit: BoolArray,
    threshold: float,
) -> dict[str, Any]:
    """Return the columns of dynamics.parquet.

    Parameters
    ----------
    time : (T,) array
        Sample times, s.
    measured, model, model_sd : (T, 6) arrays
        Wrench of the ground about the origin of the trial's axes, N and N·m.
    torque, torque_sd : (T, N) arrays
        Torque of each joint coordinate, N·m.
    in_fit : (T,) bool array
        Samples of the fit.
    threshold : float
        Largest vertical force without a centre of pressure, N.
    """
    absent = np.full(len(time), np.nan)
    found: dict[str, Any] = {"time": time}
    for prefix, suffix, wrench in (("", "", measured), ("", "_model", model), ("sd_", "_model", model_sd)):
        found |= {f"{prefix}{name}{suffix}": wrench[:, k] for k, name in enumerate(COMPONENTS)}
    found["cop_x"] = centre_of_pressure(measured[:, _PLANAR], threshold)
    found["cop_x_model"] = centre_of_pressure(model[:, _PLANAR], threshold)
    units = np.broadcast_to(np.eye(3), (len(time), 3, 3))
    change = centre_of_pressure_rows(units, model[:, _PLANAR], threshold)
    found["sd_cop_x_model"] = np.sqrt(np.sum((change * model_sd[:, _PLANAR]) ** 2, axis=1))
    for suffix in ("_reference", "_held_out"):
        found |= {f"{name}{suffix}": absent for name in ("Fx", "Fy", "tauz", "cop_x")}
    for j in range(torque.shape[1]):
        found[f"tau_{j + 1}"], found[f"sd_tau_{j + 1}"] = torque[:, j], torque_sd[:, j]
    return found | {"in_fit": in_fit}


def make_data(trial: SpatialTrial, found: SpatialIdentification, excited: Excitation) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5."""
    structure = trial.structure
    return _make_groups(found.full, len(found.base)) | {
        "base": {
            "name": np.array(structure.names, dtype=object),
            "value": found.base,
            "sd": found.base_sd,
            "covariance": found.covariance,
            "unit": np.array(structure.units, dtype=object),
            "verdict": np.array(excited.verdict, dtype=object),
            "excitation": excited.own,
            "own_share": excited.share,
            "relative_sd": excited.relative_sd,
            "prior_share": np.zeros(len(found.base)),
            "regrouping": structure.mapping,
        }
    }


def make_empty_data(segments: int, mass: float | None) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5 of a trial without an identification; ``mass``, kg, is None if unknown."""
    value = np.array([np.nan if mass is None else mass])
    absent = np.full(1, np.nan)
    full = np.full(10 * segments, np.nan)
    regrouping = np.zeros((1, 10 * segments))
    regrouping[0, ::10] = 1.0
    return _make_groups(full, 1) | {
        "base": {
            "name": np.array(["+".join(name_parameters(segments)[::10])], dtype=object),
            "value": value,
            "sd": absent,
            "covariance": absent[:, None],
            "unit": np.array(["kg"], dtype=object),
            "verdict": np.array(["not identifiable" if mass is None else "known"], dtype=object),
            "excitation": absent,
            "own_share": absent,
            "relative_sd": absent,
            "prior_share": absent,
            "regrouping": regrouping,
        }
    }


def _make_groups(full: FloatArray, base: int) -> dict[str, dict[str, Any]]:
    """Return the groups of dynamics.h5 except ``base``, without a reference body and a grid."""
    absent = np.full(len(full), np.nan)
    return {
        "full": {
            "name": np.array(name_parameters(len(full) // 10), dtype=object),
            "value": full,
            "reference": absent,
        },
        "bodies": {"value": full, "reference": absent, "covariance": np.full((len(full), len(full)), np.nan)},
        "grid": {"segment": np.zeros(0, dtype=np.int64), "position": np.zeros((0, 2)), "mass": np.zeros(0)},
        "held_out": {"base": np.zeros((0, base)), "clock_offset": np.zeros(0)},
    }


def make_facts(
    trial: SpatialTrial, found: SpatialIdentification, model: SpatialPrediction, threshold: float
) -> dict[str, Any]:
    """Return the facts of dynamics.h5 about an identification."""
    fit = found.fit
    compared = {
        name: agreement(model.wrench[:, k], model.measured[:, k], fit.in_fit) for k, name in enumerate(COMPONENTS)
    }
    cop = agreement(
        centre_of_pressure(model.wrench[:, _PLANAR], threshold),
        centre_of_pressure(model.measured[:, _PLANAR], threshold),
        fit.in_fit,
    )
    bias = {COMPONENTS[k]: float(value) for k, value in zip(trial.constants, found.plate_bias, strict=True)}
    return make_empty_facts_in_space(trial.recorded.chain, None) | {
        "condition_number": fit.condition,
        "condition_number_scaled": fit.condition_scaled,
        "clock_offset_s": fit.total_offset if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "clock": describe_clock(trial, fit),
        "wrench": {name: None if one is None else asdict(one) for name, one in compared.items()},
        "cop_rms_m": None if cop is None else float(np.hypot(cop.bias, cop.sd)),
        "samples": int(fit.in_fit.sum()),
        "consistency": "cone",
        "solver": describe_solver(found.solution, "cone"),
        "reference_pulls": False,
        "cutoff_hz": trial.lowpass.cutoff,
        "plate_bias": bias,
        "residual_covariance": found.residual_covariance.tolist(),
        "unit_covariance": found.unit_covariance.tolist(),
        "error_modes": [[mode.name, mode.parameters[: len(found.base)].tolist()] for mode in found.modes],
        "frames": trial.structure.frames[:, :3, :3].tolist(),
        "moments_about_m": trial.recorded.base[:3, 3].tolist(),
    }


def make_empty_facts_in_space(chain: SpatialChain, why: str | None) -> dict[str, Any]:
    """Return the facts of dynamics.h5 without an identification; ``why`` says why there is none.

    The fact ``torques`` contains the joint, from 1, and the direction of the torque in each column ``tau_k``.
    """
    words = {
        "hinge": ("axis",),
        "two-axis": ("first axis", "second axis"),
        "ball": ("x of the parent", "y of the parent", "z of the parent"),
    }
    every = [(k, word) for k, joint in enumerate(chain.joints, start=1) for word in words[joint.kind]]
    torques = [{"column": f"tau_{k}", "joint": joint, "about": word} for k, (joint, word) in enumerate(every, 1)]
    motion = {"source": "chain", "why": "the joints of a chain in space are pinned"}
    return make_empty_facts(why) | {"motion": motion, "rivals": {}, "torques": torques}


def make_no_averages() -> Table:
    """Return phases.parquet without rows, because trials in space are not averaged."""
    empty = np.zeros(0)
    names = np.zeros(0, dtype=object)
    values = {"span": names, "percent": empty, "quantity": names, "unit": names, "mean": empty, "sd": empty}
    why = "the repetitions of a trial in space are not averaged"
    return Table(PHASES, values | {"count": empty}, {"repetitions": {}, "compared": [], "why": why})
