"""The tables of a sensitivity study: their columns, units and meanings."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.store import Column, TableSchema

_WHICH = (
    Column("kind", "str", "", "what was perturbed"),
    Column("target", "str", "", "joint, component or marker sd (m) that it acted on; empty: everything alike"),
    Column("level", "float64", "", "how much, in `level_unit`"),
    Column("level_unit", "str", "", "unit of the level; empty: a number of things"),
)

RESPONSES = TableSchema(
    "responses.parquet",
    1,
    (
        Column("perturbation", "str", "", "kind, target and level"),
        *_WHICH,
        Column("parameter", "str", "", "base parameter, or length of a segment"),
        Column("unit", "str", "", "of the parameter"),
        Column("own_value", "float64", "", "unperturbed, in `unit`"),
        Column("own_sd", "float64", "", "its stated standard deviation, in `unit`"),
        Column("value", "float64", "", "perturbed, in `unit`"),
        Column("sd", "float64", "", "its stated standard deviation, in `unit`"),
        Column("change", "float64", "", "perturbed less unperturbed, in `unit`"),
        Column("change_percent", "float64", "%", "of the parameter's size"),
        Column("change_sd", "float64", "1", "in stated standard deviations of the unperturbed parameter"),
        Column("ratio", "float64", "1", "size of the change over what is tolerated; infinite where it is lost"),
        Column("judged", "str", "", "known, weak or not identifiable, by the perturbed trial"),
    ),
)

PERTURBATIONS = TableSchema(
    "perturbations.parquet",
    1,
    (
        Column("perturbation", "str", "", "kind, target and level"),
        *_WHICH,
        Column("enters", "str", "", "the stage that saw it first"),
        Column("verdict", "str", "", "ok or caution, or refused or failed where there is no result"),
        Column("raised", "str", "", "codes that the unperturbed verdict has not"),
        Column("fallen", "str", "", "codes of the unperturbed verdict that are gone"),
        Column("ratio", "float64", "1", "largest change of a parameter over what is tolerated"),
        Column("parameter", "str", "", "whose change that is"),
        Column("tolerated", "bool", "", "ratio is at most 1"),
        Column("samples", "int64", "1", "of the fit"),
        Column("condition_number", "float64", "1", "of the regressor"),
        Column("clock_offset", "float64", "s", "that the program found"),
        Column("Fx_r2", "float64", "1", "of the model against the measurement"),
        Column("Fy_r2", "float64", "1", "of the model against the measurement"),
        Column("tauz_r2", "float64", "1", "of the model against the measurement"),
        Column("cop_rms", "float64", "m", "rms error of the model's centre of pressure"),
        Column("theta_r2", "float64", "1", "worst joint's angle against the unperturbed one"),
        Column("dtheta_r2", "float64", "1", "worst joint's velocity against the unperturbed one"),
        Column("ddtheta_r2", "float64", "1", "worst joint's acceleration against the unperturbed one"),
        Column("theta_rms", "float64", "rad", "worst joint's angle off the unperturbed one, rms"),
    ),
    (Column("tau_{k}_rms", "float64", "N*m", "torque of the joint off the unperturbed one, rms"),),
    ((Column("why", "str", "", "why there is no result, or empty"),),),
)

TOLERATES = TableSchema(
    "tolerates.parquet",
    1,
    (
        Column("kind", "str", "", "what was perturbed"),
        Column("target", "str", "", "what it acted on; empty: everything alike"),
        Column("low", "float64", "", "least tolerated level, in `level_unit`"),
        Column("high", "float64", "", "most tolerated level, interpolated, in `level_unit`"),
        Column("level_unit", "str", "", "unit of the levels; empty: a number of things"),
        Column("least_tried", "float64", "", "mildest level tried"),
        Column("most_tried", "float64", "", "worst level tried"),
        Column("breaks_at", "float64", "", "level that is too much"),
        Column("parameter", "str", "", "the parameter that moves most there"),
        Column("change_percent", "float64", "%", "by so much of its size"),
        Column("silent", "str", "", "levels that are too much with no new caution in the verdict"),
        Column("sentence", "str", "", "the same for people"),
    ),
)

TABLES: Mapping[str, TableSchema] = {
    "responses": RESPONSES,
    "perturbations": PERTURBATIONS,
    "tolerates": TOLERATES,
}
