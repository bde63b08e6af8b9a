"""events.parquet, dynamics.parquet and dynamics.h5, from what was found or from what could not be."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from mocap_id.arrays import BoolArray, FloatArray
from mocap_id.dynamics.base import BaseSet, base_names, base_units, full_names, structural_base
from mocap_id.dynamics.grid import PointGrid
from mocap_id.dynamics.identify import Identification
from mocap_id.dynamics.predict import Prediction, agreement
from mocap_id.dynamics.prepare import Prepared, Recorded, arcs
from mocap_id.dynamics.pressure import centre_of_pressure
from mocap_id.dynamics.regressor import WRENCH_COMPONENTS
from mocap_id.protocols.reference_body import ReferenceBody
from mocap_id.protocols.repetitions import Repetition
from mocap_id.protocols.sit_to_stand import Contact
from mocap_id.store import Table
from mocap_id.store.schemas import EVENTS

_WRENCH = (*WRENCH_COMPONENTS, "cop_x")


@dataclass(frozen=True)
class Identified:
    """Everything that a successful identification puts into its artefacts."""

    prepared: Prepared
    found: Identification
    model: Prediction
    grid: PointGrid
    body: ReferenceBody
    contact: Contact | None
    cop_threshold: float


def events_table(repetitions: tuple[Repetition, ...]) -> Table:
    """events.parquet: one row a repetition."""
    rows = [asdict(repetition) for repetition in repetitions]
    frame = pd.DataFrame(rows, columns=[column.name for column in EVENTS.columns])
    return Table(EVENTS, frame.astype({column.name: column.dtype for column in EVENTS.columns}))


def dynamics_frame(result: Identified) -> pd.DataFrame:
    """dynamics.parquet: the measured wrench, clock and constant error of Fx taken out, beside the models'."""
    prepared, model, threshold = result.prepared, result.model, result.cop_threshold
    time = prepared.recorded.time
    measured = prepared.wrench(time - result.found.fit.offset) - [result.found.plate_bias or 0.0, 0.0, 0.0]
    reference = prepared.regressor @ result.body.parameters
    columns = {"time": time}
    columns |= _wrench_columns(measured, centre_of_pressure(measured, threshold))
    columns |= _wrench_columns(model.wrench, model.cop, "_model")
    columns |= _wrench_columns(model.wrench_sd, model.cop_sd, "_model", "sd_")
    columns |= _wrench_columns(reference, centre_of_pressure(reference, threshold), "_reference")
    for j, (torque, sd) in enumerate(zip(model.torque.T, model.torque_sd.T, strict=True), start=1):
        columns[f"tau_{j}"], columns[f"sd_tau_{j}"] = torque, sd
    return pd.DataFrame(columns).assign(in_fit=result.found.fit.in_fit)


def empty_frame(recorded: Recorded, cop_threshold: float) -> pd.DataFrame:
    """dynamics.parquet without a model: the measured wrench as the plate's clock stamped it, everything else NaN."""
    absent = np.full((len(recorded.time), 3), np.nan)
    columns = {"time": recorded.time}
    columns |= _wrench_columns(recorded.wrench, centre_of_pressure(recorded.wrench, cop_threshold))
    for prefix, suffix in (("", "_model"), ("sd_", "_model"), ("", "_reference")):
        columns |= _wrench_columns(absent, absent[:, 0], suffix, prefix)
    for j in range(1, recorded.q.shape[1] + 1):
        columns[f"tau_{j}"] = columns[f"sd_tau_{j}"] = absent[:, 0]
    return pd.DataFrame(columns).assign(in_fit=np.zeros(len(absent), dtype=bool))


def dynamics_data(result: Identified) -> dict[str, dict[str, Any]]:
    """dynamics.h5."""
    found, centres = result.found, result.prepared.recorded.centres
    return {
        "base": _base(result.prepared.base, centres, found.base, found.base_sd),
        "full": {
            "name": np.array(full_names(len(centres) + 1), dtype=object),
            "value": found.full,
            "reference": result.body.parameters,
        },
        "grid": {"segment": result.grid.segment, "position": result.grid.position, "mass": found.masses},
    }


def empty_data(centres: FloatArray, grid: PointGrid, mass: float | None) -> dict[str, dict[str, Any]]:
    """dynamics.h5 with every value NaN but the mass, where that much is known: the first base parameter."""
    base = structural_base(centres)
    value = np.full(len(base.kept), np.nan)
    value[0] = np.nan if mass is None else mass
    full = np.full(4 * (len(centres) + 1), np.nan)
    return {
        "base": _base(base, centres, value, np.full(len(value), np.nan)),
        "full": {"name": np.array(full_names(len(centres) + 1), dtype=object), "value": full, "reference": full},
        "grid": {"segment": grid.segment, "position": grid.position, "mass": np.full(len(grid.segment), np.nan)},
    }


def dynamics_facts(result: Identified, frame: pd.DataFrame) -> dict[str, Any]:
    """What summary.json says of the fit, over its samples."""
    found, fit, solution = result.found, result.found.fit, result.found.solution
    samples: BoolArray = frame["in_fit"].to_numpy()
    compared = {name: agreement(frame[f"{name}_model"].to_numpy(), frame[name].to_numpy(), samples) for name in _WRENCH}
    cop = compared.pop("cop_x")
    return empty_facts(None) | {
        "condition_number": fit.condition,
        "condition_number_scaled": fit.condition_scaled,
        "clock_offset_s": fit.found if fit.offset_known else None,
        "clock_offset_sd_s": found.offset_sd if fit.offset_known else None,
        "wrench": {name: None if one is None else asdict(one) for name, one in compared.items()},
        "cop_rms_m": None if cop is None else float(np.hypot(cop.bias, cop.sd)),
        "samples": int(samples.sum()),
        "reference_table": result.body.table,
        "solver": {
            "name": solution.solver,
            "status": solution.status,
            "iterations": solution.iterations,
            "kkt": solution.kkt,
            "disagreement": solution.disagreement,
            "price_of_consistency": solution.price,
        },
        "cutoff_hz": result.prepared.lowpass.cutoff,
        "plate_bias_N": None if found.plate_bias is None else {"Fx": found.plate_bias, "Fx_sd": found.plate_bias_sd},
        "untold": list(result.model.untold),
        "why": _why_untold(result.model.untold),
        "arc_deg": np.degrees(arcs(result.prepared.recorded.q, samples)).tolist(),
        "contact": None if result.contact is None else _contact(result.contact),
    }


def empty_facts(why: str | None) -> dict[str, Any]:
    """Facts of dynamics.h5 where nothing is known, and why."""
    keys = (
        "condition_number", "condition_number_scaled", "clock_offset_s", "clock_offset_sd_s", "wrench", "cop_rms_m",
        "samples", "reference_table", "solver", "cutoff_hz", "plate_bias_N", "untold", "arc_deg", "contact",
    )  # fmt: skip
    return {**dict.fromkeys(keys), "why": why}


def _why_untold(untold: tuple[str, ...]) -> str | None:
    if not untold:
        return None
    return f"the fitted components of the wrench do not tell {', '.join(untold)}: see `identify-dim: {{components: …}}`"


def _contact(contact: Contact) -> dict[str, Any]:
    weight = contact.weight if np.isfinite(contact.weight) else None
    return {
        "chair": contact.chair,
        "rule": contact.rule,
        "converged": contact.converged,
        "standing_weight_N": weight,
        "threshold_N": contact.threshold,
    }


def _base(base: BaseSet, centres: FloatArray, value: FloatArray, sd: FloatArray) -> dict[str, Any]:
    return {
        "name": np.array(base_names(base, centres), dtype=object),
        "value": value,
        "sd": sd,
        "unit": np.array(base_units(base), dtype=object),
        "regrouping": base.regrouping,
    }


def _wrench_columns(wrench: FloatArray, cop: FloatArray, suffix: str = "", prefix: str = "") -> dict[str, FloatArray]:
    return {f"{prefix}{name}{suffix}": column for name, column in zip(_WRENCH, (*wrench.T, cop), strict=True)}
