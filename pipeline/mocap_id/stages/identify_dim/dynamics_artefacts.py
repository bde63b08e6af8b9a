"""Contents of dynamics.parquet and dynamics.h5, with or without an identification, and few-marker feet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mocap_id.arrays import BoolArray, FloatArray, as_complex
from mocap_id.design.proposal import Recommendations
from mocap_id.dynamics.base_parameters import BaseSet, base_names, list_base_units, name_parameters, structural_base
from mocap_id.dynamics.cautions import Excitation
from mocap_id.dynamics.consistency import ConsistentSolution, PointGrid
from mocap_id.dynamics.fit import describe_clock
from mocap_id.dynamics.identification import Identification
from mocap_id.dynamics.measured_motion import ChainMap
from mocap_id.dynamics.prediction import Prediction, centre_of_pressure, compare_wrenches
from mocap_id.dynamics.preparation import PreparedTrial, TrialData, measure_arcs
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS, planar_regressor
from mocap_id.dynamics.space.consistency import SemidefiniteSolution
from mocap_id.kinematics.joint import count_positions
from mocap_id.protocols.chair_contact import Contact
from mocap_id.stages.base import Context
from mocap_id.stages.identify_dim import validation
from mocap_id.stages.identify_dim.segment_fit import filter_measured, read_calibration
from mocap_id.stages.identify_dim.trial_data import (
    ReferenceBodies,
    compare_references,
    describe_comparison,
    read_joint_names,
    read_skeleton,
)
from mocap_id.stages.identify_dim.validation import SERIES, Validation
from mocap_id.verdict import Reason


@dataclass(frozen=True)
class IdentifiedDynamics:
    """Results of an identification from which its artefacts are made.

    ``prepared``, ``found`` and ``references`` belong to the motion that is used: measured poses or the pinned chain.
    ``chain``, ``in_chain`` and ``chain_reference`` always belong to the pinned chain.
    """

    prepared: PreparedTrial
    found: Identification
    chain: PreparedTrial
    in_chain: Identification
    excitation: Excitation
    recommendations: Recommendations
    model: Prediction
    grid: PointGrid
    references: ReferenceBodies
    chain_reference: FloatArray
    contact: Contact | None
    validation: Validation
    cop_threshold: float
    prior_share: FloatArray
    chain_map: ChainMap | None = None

    @property
    def measured_poses(self) -> bool:
        """Whether the motion that is used consists of measured poses."""
        return self.prepared.prior is not None


def make_columns(result: IdentifiedDynamics) -> dict[str, Any]:
    """Return the columns of dynamics.parquet; clock offset and bias of Fx are removed from the measured wrench."""
    prepared, model, threshold = result.prepared, result.model, result.cop_threshold
    measured, external = _get_measured(result), prepared.elsewhere(result.found.fit.offset)
    reference = prepared.regressor @ result.references.chosen.parameters - external
    columns = {"time": prepared.recorded.time}
    lower: FloatArray | float = 0.0  # distance along x from the centre of pressure at a board's cells to its surface
    if prepared.recorded.surface:
        vertical = np.where(model.wrench[:, 1] > threshold, model.wrench[:, 1], np.nan)
        lower = prepared.recorded.surface * model.wrench[:, 0] / vertical
    columns |= _make_wrench_columns(measured, centre_of_pressure(measured, threshold) - lower)
    columns |= _make_wrench_columns(model.wrench, model.cop - lower, "_model")
    columns |= _make_wrench_columns(*_compute_sd(result), "_model", "sd_")
    columns |= _make_wrench_columns(reference, centre_of_pressure(reference, threshold) - lower, "_reference")
    held_out = validation.get_wrench(result.validation, len(measured))
    columns |= _make_wrench_columns(held_out, centre_of_pressure(held_out, threshold) - lower, "_held_out")
    for j, (torque, sd) in enumerate(zip(model.torque.T, model.torque_sd.T, strict=True), start=1):
        columns[f"tau_{j}"], columns[f"sd_tau_{j}"] = torque, sd
    if prepared.recorded.external:
        columns |= {f"{name}_external": column for name, column in zip(WRENCH_COMPONENTS, external.T, strict=True)}
    return columns | {"in_fit": result.found.fit.in_fit}


def _compute_sd(result: IdentifiedDynamics) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of the model's wrench (T, 3) and centre of pressure (T,).

    They include the uncertainty of the position of a balance board.
    """
    model, position_sd = result.model, result.prepared.recorded.position_sd
    if position_sd is None:
        return model.wrench_sd, model.cop_sd
    wrench_sd = model.wrench_sd.copy()
    wrench_sd[:, 2] = np.hypot(wrench_sd[:, 2], position_sd * model.wrench[:, 1])
    return wrench_sd, np.hypot(model.cop_sd, position_sd)


def make_empty_columns(recorded: TrialData, reference: FloatArray, cop_threshold: float) -> dict[str, Any]:
    """Return the columns of dynamics.parquet without a model: the wrenches of plate and reference body.

    The other columns are NaN. ``reference`` (T, 3) is NaN without a reference body; ``cop_threshold`` is the largest
    vertical force without a centre of pressure, N.
    """
    absent = np.full((len(recorded.time), 3), np.nan)
    columns = {"time": recorded.time}
    columns |= _make_wrench_columns(
        recorded.as_measured(recorded.wrench), centre_of_pressure(recorded.wrench, cop_threshold)
    )
    columns |= _make_wrench_columns(absent, absent[:, 0], "_model")
    columns |= _make_wrench_columns(absent, absent[:, 0], "_model", "sd_")
    columns |= _make_wrench_columns(reference, centre_of_pressure(reference, cop_threshold), "_reference")
    columns |= _make_wrench_columns(absent, absent[:, 0], "_held_out")
    for j in range(1, recorded.q.shape[1] + 1):
        columns[f"tau_{j}"] = columns[f"sd_tau_{j}"] = absent[:, 0]
    return columns | {"in_fit": np.zeros(len(absent), dtype=np.bool_)}


def make_data(result: IdentifiedDynamics) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5."""
    found, chain, centres = result.found, result.in_chain, result.prepared.recorded.centres
    return {
        "base": _make_base(result.chain.base, centres, chain.base, chain.covariance)
        | {
            "verdict": np.array(result.excitation.verdict, dtype=object),
            "excitation": result.excitation.own,
            "own_share": result.excitation.share,
            "relative_sd": result.excitation.relative_sd,
            "prior_share": result.prior_share,
        },
        "full": {
            "name": np.array(name_parameters(len(centres) + 1), dtype=object),
            "value": chain.full,
            "reference": result.chain_reference,
        },
        "bodies": {
            "value": found.full,
            "reference": result.references.chosen.parameters,
            "covariance": _get_full_covariance(result),
        },
        "grid": {"segment": result.grid.segment, "position": result.grid.position, "mass": found.solution.masses},
        "held_out": _make_held_out(result),
    }


def _make_held_out(result: IdentifiedDynamics) -> dict[str, FloatArray]:
    """Return base parameters of the chain and clock offsets of the models of the cross-validation."""
    data = validation.get_parameters(result.validation, result.found.fit.base)
    if result.chain_map is None or not len(data["base"]):
        return data | {"base": np.zeros((0, len(result.in_chain.base))) if result.chain_map else data["base"]}
    full = np.array([result.chain_map.apply(each) for each in data["base"]])
    return data | {"base": full @ result.chain.base.regrouping.T}


def _get_full_covariance(result: IdentifiedDynamics) -> FloatArray:
    """Return the covariance (4K, 4K) of the parameters of K bodies, without errors of scale; NaN for a pinned chain."""
    found = result.found
    if not result.measured_poses:
        return np.full((len(found.full), len(found.full)), np.nan)
    return found.covariance if found.calibration is None else found.covariance - found.calibration.covariance


def make_empty_data(
    centres: FloatArray, grid: PointGrid, mass: float | None, reference: FloatArray
) -> dict[str, dict[str, Any]]:
    """Return the datasets of dynamics.h5 without a model: mass and reference body; other values are NaN."""
    base = structural_base(centres)
    value = np.full(len(base.kept), np.nan)
    value[0] = np.nan if mass is None else mass
    full = np.full(4 * (len(centres) + 1), np.nan)
    return {
        "base": _make_base(base, centres, value, np.full((len(value), len(value)), np.nan))
        | _make_base_without_fit(value),
        "full": {
            "name": np.array(name_parameters(len(centres) + 1), dtype=object),
            "value": full,
            "reference": reference,
        },
        "bodies": {"value": full, "reference": reference, "covariance": np.full((len(full), len(full)), np.nan)},
        "grid": {"segment": grid.segment, "position": grid.position, "mass": np.full(len(grid.segment), np.nan)},
        "held_out": {"base": np.zeros((0, len(value))), "clock_offset": np.zeros(0)},
    }


def _make_advice(result: IdentifiedDynamics, joints: Sequence[str]) -> list[dict[str, Any]]:
    """Return JSON with the best change of the movement for each base parameter; empty if no parameter is doubtful."""
    return [
        {
            "name": name,
            "change": None if one is None else one.change,
            "joint": None if one is None or one.joint is None else joints[one.joint],
            "sd_ratio": None if one is None else one.ratio,
            "text": None if one is None else one.describe(joints).removesuffix(","),
        }
        for name, one in zip(result.excitation.names, result.recommendations, strict=bool(result.recommendations))
    ]


def _make_base_without_fit(value: FloatArray) -> dict[str, Any]:
    """Return the datasets about excitation in the group ``base``, for base parameters ``value`` without a fit."""
    absent = np.full(len(value), np.nan)
    return {
        "verdict": np.array(["known" if np.isfinite(each) else "not identifiable" for each in value], dtype=object),
        "excitation": absent,
        "own_share": absent,
        "relative_sd": absent,
        "prior_share": absent,
    }


def make_facts(result: IdentifiedDynamics, joints: Sequence[str]) -> dict[str, Any]:
    """Return the facts of dynamics.h5 about an identification; ``joints`` are the names of the joints."""
    found, fit, prepared = result.found, result.found.fit, result.prepared
    samples: BoolArray = fit.in_fit
    threshold, elsewhere = result.cop_threshold, prepared.elsewhere(fit.offset)
    if result.measured_poses:
        rows, model, elsewhere = prepared.filtered, prepared.filtered @ found.base, 0.0 * elsewhere
        measured = filter_measured(prepared, found)
    else:
        rows, model, measured = prepared.regressor, result.model.wrench, _get_measured(result)
    undetermined = ", ".join(find_undetermined(result))
    why = f"the fitted components of the wrench do not determine {undetermined}: see `identify-dim: {{components: …}}`"
    return make_empty_facts(None) | {
        "condition_number": result.in_chain.fit.condition,
        "condition_number_scaled": result.in_chain.fit.condition_scaled,
        "clock_offset_s": fit.total_offset if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "clock": describe_clock(prepared, fit),
        **describe_comparison(compare_wrenches(model, measured, samples, threshold)),
        "samples": int(samples.sum()),
        "reference_table": result.references.chosen.table,
        "rivals": compare_references(result.references, rows, measured, samples, threshold, external=elsewhere),
        "held_out": validation.make_facts(
            result.validation,
            model,
            rows @ result.references.chosen.parameters - elsewhere,
            measured,
            threshold,
            filtered=result.measured_poses,
        ),
        "consistency": found.solution.consistency,
        "solver": describe_solver(found.solution, found.solution.requested),
        "reference_pulls": found.uses_reference,
        "cutoff_hz": prepared.lowpass.cutoff,
        "plate_bias_N": None if found.plate_bias is None else {"Fx": found.plate_bias, "Fx_sd": found.plate_bias_sd},
        "untold": list(result.model.undetermined),
        "why": why if undetermined else None,
        "arc_deg": np.degrees(measure_arcs(prepared.recorded.q, samples)).tolist(),
        "contact": None if result.contact is None else _describe_contact(result.contact),
        "advice": _make_advice(result, joints),
    }


def make_facts_without_model(
    why: str, recorded: TrialData, bodies: ReferenceBodies, free: BoolArray, *, cop_threshold: float, gravity: float
) -> tuple[FloatArray, dict[str, Any]]:
    """Return the reference body's wrench (T, 3) and the facts of dynamics.h5 of a trial without an identification.

    ``why`` says why there is none. Reference bodies are compared in the samples ``free`` (T,), without chair contact.
    """
    regressor = planar_regressor(recorded.centres, recorded.q, recorded.dq, recorded.ddq, gravity)
    facts = make_empty_facts(why) | {
        "reference_table": bodies.chosen.table,
        "rivals": compare_references(
            bodies,
            regressor,
            recorded.as_measured(recorded.wrench),
            free,
            cop_threshold,
            external=recorded.elsewhere,
        ),
    }
    return regressor @ bodies.chosen.parameters - recorded.elsewhere, facts


def make_empty_facts(why: str | None) -> dict[str, Any]:
    """Return the facts of dynamics.h5 without an identification; ``why`` says why there is none."""
    keys = (
        "condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "clock", "wrench",
        "cop_rms_m", "samples", "reference_table", "rivals", "held_out", "consistency", "solver", "reference_pulls",
        "cutoff_hz", "plate_bias_N", "untold", "arc_deg", "contact", "external", "advice",
        "motion", "pins", "scales", "calibration_covariance",
    )  # fmt: skip
    return {**dict.fromkeys(keys), "why": why}


def find_undetermined(result: IdentifiedDynamics) -> list[str]:
    """Return the columns of the model that are NaN because the fitted wrench components do not determine them.

    Torques of joints whose two sides are in one body are not listed.
    """
    joint = result.prepared.motion.joint
    inner = {f"tau_{j + 1}" for j in range(joint.shape[1]) if not np.isfinite(joint[:, j]).any()}
    return [name for name in result.model.undetermined if name not in inner]


def _get_measured(result: IdentifiedDynamics) -> FloatArray:
    """Return the ground's wrench (T, 3) with the clock offset corrected and the bias of Fx removed."""
    bias = np.array([result.found.plate_bias or 0.0, 0.0, 0.0])
    return np.asarray(result.prepared.ground(result.found.fit.offset) - bias)


def describe_solver(solution: ConsistentSolution | SemidefiniteSolution, requested: str) -> dict[str, Any]:
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


def _describe_contact(contact: Contact) -> dict[str, Any]:
    weight = contact.weight if np.isfinite(contact.weight) else None
    return {
        "chair": contact.chair,
        "rule": contact.rule,
        "converged": contact.converged,
        "standing_weight_N": weight,
        "threshold_N": contact.threshold,
    }


def _make_base(base: BaseSet, centres: FloatArray, value: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    return {
        "name": np.array(base_names(base, centres), dtype=object),
        "value": value,
        "sd": np.sqrt(np.diag(covariance)),
        "covariance": covariance,
        "unit": np.array(list_base_units(base), dtype=object),
        "regrouping": base.regrouping,
    }


def _make_wrench_columns(
    wrench: FloatArray, cop: FloatArray, suffix: str = "", prefix: str = ""
) -> dict[str, FloatArray]:
    return {f"{prefix}{name}{suffix}": column for name, column in zip(SERIES, (*wrench.T, cop), strict=True)}


_FOOT_PRIOR = Reason(
    "foot-prior",
    "a segment has markers at only one or two positions. The foot's first moment is therefore taken from the reference "
    "body and the position of the ankle, not from the data alone; the torque of the ankle then follows from the centre "
    "of pressure. Set `identify-dim: {reference_pulls: false}` to use the data alone",
    level="ok",
)
_FOOT_IN_TORQUES = Reason(
    "foot-prior",
    "the torques also use the first moment of the reference body's foot, which the data hardly determine; parameters "
    "and wrench depend on the data alone. Set `identify-dim: {reference_pulls: false}` to use the data alone for both",
    level="ok",
)
_FEW = 3  # marker positions on a segment; clusters have at least as many
_FOOT_SD = 0.001  # m; from the variation of people's feet, which have 3 % of the body's mass
_TORQUE = 5.0  # N·m, largest rms error of a torque without a caution
_ONE_IN_100 = 2.576  # standard deviations that a normal error exceeds in one of 100 cases


def has_few_markers(context: Context) -> bool:
    """Return whether a moving segment of a person has markers at only one or two positions."""
    chain = read_skeleton(context)
    local = as_complex(chain.local)
    counts = [count_positions(local[chain.marker_segment == k]) for k in range(1, len(chain.centres) + 1)]
    return context.trial.protocol != "robot-joint" and min(counts) < _FEW


def choose_foot_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the standard deviation of the foot's first moment divided by the body's mass, m; None without this prior.

    A robot has no prior, and neither has a person if the standard deviation of the ankle's position is unknown. With
    measured forces of a chair or on a hand, there is a prior only for few markers, because other cases were not tested.
    """
    chosen, covariance = context.settings.reference_pulls, read_skeleton(context).covariance
    if chosen not in {None, "foot"} or context.trial.protocol == "robot-joint" or not np.isfinite(covariance[:1]).any():
        return None
    if chosen is None and recorded.external and not has_few_markers(context):
        return None
    return float(np.hypot(_FOOT_SD, np.sqrt(covariance[0, 0, 0])))


def choose_plate_sd(context: Context, recorded: TrialData) -> float | None:
    """Return the standard deviation of the plate's position, m, if only the torques use the foot's prior, else None.

    With few markers, the parameters also need the prior.
    """
    if has_few_markers(context) or context.settings.reference_pulls == "foot":
        return None
    return recorded.position_sd or read_calibration(context).position


def explain_foot_prior(context: Context, found: Identification) -> tuple[Reason, ...]:
    """Return a note if parameters or torques use the prior of the foot; an empty tuple if they do not."""
    if found.with_foot is not None:
        return (_FOOT_IN_TORQUES,)
    foot_alone = found.uses_reference and context.settings.reference_pulls is not True
    return (_FOOT_PRIOR,) if foot_alone else ()


def check_torques(context: Context, result: IdentifiedDynamics, free: BoolArray) -> tuple[Reason, ...]:
    """Return a caution about torques of the pinned chain that may be wrong by more than 5 N·m rms.

    The errors of parameters and geometry are constant in a trial and normal over trials; errors of the motion add their
    mean square. The caution is for torques whose error exceeds 5 N·m in more than one of 100 trials. Errors of scale
    are left out, because they are the same in all trials of a laboratory. ``free`` (T,) marks the samples in which only
    the ground touches the body.
    """
    model = result.model
    used = free & np.isfinite(model.torque_sd).any(axis=1)
    untested = bool(result.prepared.recorded.external) and not has_few_markers(context)
    if context.trial.protocol == "robot-joint" or untested or result.measured_poses or not used.any():
        return ()
    constant, noise = (np.nanmean(sd[used] ** 2, axis=0) for sd in (model.torque_lasting_sd, model.torque_noise_sd))
    measured = result.prepared.measured(result.found.fit.offset)
    off = np.asarray((measured - model.wrench)[:, WRENCH_COMPONENTS.index("tauz")])
    excess = max(float(np.nanmean(off[used] ** 2) - np.mean(off[result.found.fit.in_fit] ** 2)), 0.0)
    error = np.sqrt(_ONE_IN_100**2 * constant + noise + excess)
    large = np.flatnonzero(error > _TORQUE)
    if not len(large):
        return ()
    names = read_joint_names(context)
    text = ", ".join(f"{names[j]} {error[j]:.1f} N·m" for j in large)
    worst = large[np.argmax(error[large])]
    why = "The positions of the joints and the masses of the segments after them are uncertain"
    if excess > _ONE_IN_100**2 * constant[worst]:
        at = result.prepared.recorded.time[used][np.nanargmax(np.abs(off[used]))]
        why = f"The model differs from the plate around {at:.1f} s: fill marker gaps there, or exclude it by `window:`"
    message = (
        f"in one of 100 trials like this one, the rms error of a torque exceeds these values: {text} (expected at most "
        f"{_TORQUE:g} N·m). {why}. Use the torques with their intervals"
    )
    return (Reason("torque-uncertain", message, float(error[worst]), _TORQUE),)
