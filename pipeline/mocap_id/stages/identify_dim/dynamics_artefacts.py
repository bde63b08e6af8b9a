"""dynamics.parquet and dynamics.h5, from what was found or from what could not be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import BaseSet, base_names, base_units, full_names, structural_base
from mocap_id.dynamics.comparison import compare
from mocap_id.dynamics.consistent import Solution
from mocap_id.dynamics.excitation import Excitation
from mocap_id.dynamics.fold import Fold
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.predict import Prediction
from mocap_id.dynamics.prepare import Prepared, Recorded, arcs
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS, planar_regressor
from mocap_id.protocols.sit_to_stand import Contact
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.rivals import Rivals, rival_facts
from mocap_id.stages.identify_dim.segment_fit import filtered_measured
from mocap_id.stages.identify_dim.validation import SERIES, Validation


@dataclass(frozen=True)
class Identified:
    """Everything that a successful identification puts into its artefacts.

    ``prepared``, ``found`` and ``rivals`` belong to the motion that was used; ``chain``, ``in_chain`` and
    ``chain_reference`` to the chain and its parameters. With the pinned chain they are the same.
    """

    prepared: Prepared
    found: Identification
    chain: Prepared
    in_chain: Identification
    told: Excitation
    model: Prediction
    grid: PointGrid
    rivals: Rivals
    chain_reference: FloatArray
    contact: Contact | None
    validation: Validation
    cop_threshold: float
    prior_share: FloatArray
    folded: Fold | None = None

    @property
    def measured_poses(self) -> bool:
        """The bodies' own poses were used."""
        return self.prepared.prior is not None


def dynamics_columns(result: Identified) -> dict[str, Any]:
    """dynamics.parquet: the ground's measured wrench, clock and constant error of Fx taken out, beside the models'."""
    prepared, model, threshold = result.prepared, result.model, result.cop_threshold
    measured, external = _measured(result), prepared.elsewhere(result.found.fit.offset)
    reference = prepared.regressor @ result.rivals.chosen.parameters - external
    columns = {"time": prepared.recorded.time}
    columns |= _wrench_columns(measured, centre_of_pressure(measured, threshold))
    columns |= _wrench_columns(model.wrench, model.cop, "_model")
    columns |= _wrench_columns(model.wrench_sd, model.cop_sd, "_model", "sd_")
    columns |= _wrench_columns(reference, centre_of_pressure(reference, threshold), "_reference")
    held_out = validation.wrench(result.validation, len(measured))
    columns |= _wrench_columns(held_out, centre_of_pressure(held_out, threshold), "_held_out")
    for j, (torque, sd) in enumerate(zip(model.torque.T, model.torque_sd.T, strict=True), start=1):
        columns[f"tau_{j}"], columns[f"sd_tau_{j}"] = torque, sd
    if prepared.recorded.external:
        columns |= {f"{name}_external": column for name, column in zip(WRENCH_COMPONENTS, external.T, strict=True)}
    return columns | {"in_fit": result.found.fit.in_fit}


def empty_columns(recorded: Recorded, reference: FloatArray, cop_threshold: float) -> dict[str, Any]:
    """dynamics.parquet without a model: the wrench as the plate's clock stamped it, the reference's, the rest NaN.

    Parameters
    ----------
    recorded : Recorded
    reference : (T, 3) array
        What the allometric body would do; NaN where none applies.
    cop_threshold : float
        N.
    """
    absent = np.full((len(recorded.time), 3), np.nan)
    columns = {"time": recorded.time}
    columns |= _wrench_columns(recorded.wrench, centre_of_pressure(recorded.wrench, cop_threshold))
    columns |= _wrench_columns(absent, absent[:, 0], "_model")
    columns |= _wrench_columns(absent, absent[:, 0], "_model", "sd_")
    columns |= _wrench_columns(reference, centre_of_pressure(reference, cop_threshold), "_reference")
    columns |= _wrench_columns(absent, absent[:, 0], "_held_out")
    for j in range(1, recorded.q.shape[1] + 1):
        columns[f"tau_{j}"] = columns[f"sd_tau_{j}"] = absent[:, 0]
    return columns | {"in_fit": np.zeros(len(absent), dtype=np.bool_)}


def dynamics_data(result: Identified) -> dict[str, dict[str, Any]]:
    """dynamics.h5."""
    found, chain, centres = result.found, result.in_chain, result.prepared.recorded.centres
    return {
        "base": _base(result.chain.base, centres, chain.base, chain.covariance)
        | {
            "verdict": np.array(result.told.verdict, dtype=object),
            "excitation": result.told.own,
            "own_share": result.told.share,
            "relative_sd": result.told.relative_sd,
            "prior_share": result.prior_share,
        },
        "full": {
            "name": np.array(full_names(len(centres) + 1), dtype=object),
            "value": chain.full,
            "reference": result.chain_reference,
        },
        "bodies": {
            "value": found.full,
            "reference": result.rivals.chosen.parameters,
            "covariance": _full_covariance(result),
        },
        "grid": {"segment": result.grid.segment, "position": result.grid.position, "mass": found.masses},
        "held_out": _held_out(result),
    }


def _held_out(result: Identified) -> dict[str, FloatArray]:
    """What the folds found, as base parameters of the chain."""
    data = validation.data(result.validation, result.found.fit.base)
    if result.folded is None or not len(data["base"]):
        return data | {"base": np.zeros((0, len(result.in_chain.base))) if result.folded else data["base"]}
    full = np.array([result.folded.chain(each) for each in data["base"]])
    return data | {"base": full @ result.chain.base.regrouping.T}


def _full_covariance(result: Identified) -> FloatArray:
    """Covariance (4K, 4K) of the bodies' full parameters; NaN for the pinned chain, which has none."""
    found = result.found
    return found.covariance if result.measured_poses else np.full((len(found.full), len(found.full)), np.nan)


def empty_data(
    centres: FloatArray, grid: PointGrid, mass: float | None, reference: FloatArray
) -> dict[str, dict[str, Any]]:
    """dynamics.h5 with every value NaN but the mass, the first base parameter, and the reference, where known."""
    base = structural_base(centres)
    value = np.full(len(base.kept), np.nan)
    value[0] = np.nan if mass is None else mass
    full = np.full(4 * (len(centres) + 1), np.nan)
    return {
        "base": _base(base, centres, value, np.full((len(value), len(value)), np.nan)) | _untold_base(value),
        "full": {"name": np.array(full_names(len(centres) + 1), dtype=object), "value": full, "reference": reference},
        "bodies": {"value": full, "reference": reference, "covariance": np.full((len(full), len(full)), np.nan)},
        "grid": {"segment": grid.segment, "position": grid.position, "mass": np.full(len(grid.segment), np.nan)},
        "held_out": {"base": np.zeros((0, len(value))), "clock_offset": np.zeros(0)},
    }


def advice_facts(told: Excitation, joints: Sequence[str]) -> list[dict[str, Any]]:
    """JSON rows: for each base parameter the movement that would tell most more of it, nulls where none would.

    No rows where every parameter is known.
    """
    return [
        {
            "name": name,
            "change": None if one is None else one.change,
            "joint": None if one is None or one.joint is None else joints[one.joint],
            "sd_ratio": None if one is None else one.ratio,
            "text": None if one is None else one.said(joints).removesuffix(","),
        }
        for name, one in zip(told.names, told.advice, strict=bool(told.advice))
    ]


def _untold_base(value: FloatArray) -> dict[str, Any]:
    """What stands beside base parameters (b,) that were not fitted: only the mass can be known, from the plates."""
    absent = np.full(len(value), np.nan)
    return {
        "verdict": np.array(["known" if np.isfinite(each) else "not identifiable" for each in value], dtype=object),
        "excitation": absent,
        "own_share": absent,
        "relative_sd": absent,
        "prior_share": absent,
    }


def dynamics_facts(result: Identified, joints: Sequence[str]) -> dict[str, Any]:
    """What summary.json says of the fit, over its samples; ``joints`` are their names."""
    found, fit, prepared = result.found, result.found.fit, result.prepared
    samples: BoolArray = fit.in_fit
    threshold, elsewhere = result.cop_threshold, prepared.elsewhere(fit.offset)
    if result.measured_poses:
        rows, of_model, elsewhere = prepared.filtered, prepared.filtered @ found.base, 0.0 * elsewhere
        measured = filtered_measured(prepared, found)
    else:
        rows, of_model, measured = prepared.regressor, result.model.wrench, _measured(result)
    compared = compare(of_model, measured, samples, threshold)
    return empty_facts(None) | {
        "condition_number": fit.condition,
        "condition_number_scaled": fit.condition_scaled,
        "clock_offset_s": fit.found if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "wrench": {name: None if one is None else asdict(one) for name, one in compared.wrench.items()},
        "cop_rms_m": compared.cop_rms,
        "samples": int(samples.sum()),
        "reference_table": result.rivals.chosen.table,
        "rivals": rival_facts(result.rivals, rows, measured, samples, threshold, external=elsewhere),
        "held_out": validation.facts(
            result.validation,
            of_model,
            rows @ result.rivals.chosen.parameters - elsewhere,
            measured,
            threshold,
            filtered=result.measured_poses,
        ),
        "consistency": found.solution.consistency,
        "solver": _solver(found.solution),
        "reference_pulls": found.pulled,
        "cutoff_hz": prepared.lowpass.cutoff,
        "plate_bias_N": None if found.plate_bias is None else {"Fx": found.plate_bias, "Fx_sd": found.plate_bias_sd},
        "untold": list(result.model.untold),
        "why": _why_untold(result),
        "arc_deg": np.degrees(arcs(prepared.recorded.q, samples)).tolist(),
        "contact": None if result.contact is None else _contact(result.contact),
        "advice": advice_facts(result.told, joints),
    }


def unknown_facts(
    why: str, recorded: Recorded, bodies: Rivals, free: BoolArray, *, cop_threshold: float, gravity: float
) -> tuple[FloatArray, dict[str, Any]]:
    """The reference's wrench (T, 3) of a trial whose parameters stay unknown, and its facts.

    The rivals are compared over the samples on which only the ground touches the body.
    """
    regressor = planar_regressor(recorded.centres, recorded.q, recorded.dq, recorded.ddq, gravity)
    facts = empty_facts(why) | {
        "reference_table": bodies.chosen.table,
        "rivals": rival_facts(bodies, regressor, recorded.wrench, free, cop_threshold, external=recorded.elsewhere),
    }
    return regressor @ bodies.chosen.parameters - recorded.elsewhere, facts


def empty_facts(why: str | None) -> dict[str, Any]:
    """Facts of dynamics.h5 where nothing is known, and why."""
    keys = (
        "condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "wrench", "cop_rms_m",
        "samples", "reference_table", "rivals", "held_out", "consistency", "solver", "reference_pulls", "cutoff_hz",
        "plate_bias_N", "untold", "arc_deg", "contact", "external", "advice",
        "motion", "pins",
    )  # fmt: skip
    return {**dict.fromkeys(keys), "why": why}


def components_short(result: Identified) -> list[str]:
    """Columns of the model that are NaN because the fitted components of the wrench do not tell them."""
    within = _inside_one_body(result)
    return [name for name in result.model.untold if name not in within]


def _why_untold(result: Identified) -> str | None:
    short = ", ".join(components_short(result))
    if not short:
        return None
    return f"the fitted components of the wrench do not tell {short}: see `identify-dim: {{components: …}}`"


def _inside_one_body(result: Identified) -> set[str]:
    """Names of the torques of joints whose two sides are one body."""
    joint = result.prepared.motion.joint
    return {f"tau_{j + 1}" for j in range(joint.shape[1]) if not np.isfinite(joint[:, j]).any()}


def _measured(result: Identified) -> FloatArray:
    """The ground's wrench (T, 3) at the corrected clock, less the plates' constant error of Fx."""
    bias = np.array([result.found.plate_bias or 0.0, 0.0, 0.0])
    return np.asarray(result.prepared.ground(result.found.fit.offset) - bias)


def _solver(solution: Solution) -> dict[str, Any]:
    answer = solution.answer
    return {
        "name": answer.solver,
        "status": answer.status,
        "iterations": answer.iterations or None,
        "kkt": answer.optimality.excess,
        "proven": answer.optimality.proven,
        **asdict(answer.optimality),
        "asked": solution.asked,
        "price_of_consistency": solution.price,
    }


def _contact(contact: Contact) -> dict[str, Any]:
    weight = contact.weight if np.isfinite(contact.weight) else None
    return {
        "chair": contact.chair,
        "rule": contact.rule,
        "converged": contact.converged,
        "standing_weight_N": weight,
        "threshold_N": contact.threshold,
    }


def _base(base: BaseSet, centres: FloatArray, value: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    return {
        "name": np.array(base_names(base, centres), dtype=object),
        "value": value,
        "sd": np.sqrt(np.diag(covariance)),
        "covariance": covariance,
        "unit": np.array(base_units(base), dtype=object),
        "regrouping": base.regrouping,
    }


def _wrench_columns(wrench: FloatArray, cop: FloatArray, suffix: str = "", prefix: str = "") -> dict[str, FloatArray]:
    return {f"{prefix}{name}{suffix}": column for name, column in zip(SERIES, (*wrench.T, cop), strict=True)}
