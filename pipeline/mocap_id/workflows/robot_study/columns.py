"""The tables of a robot study: their quantities, columns, units and meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mocap_id.store import Column, TableSchema
from mocap_id.workflows.robot_study import thesis
from mocap_id.workflows.robot_study.obtained import PARAMETERS, STATES, WRENCH

Kind: TypeAlias = Literal["value", "error"]

OURS, THESIS = "this", "thesis"
STATE_UNITS = dict(zip(STATES, ("rad", "rad/s", "rad/s^2"), strict=True))
WRENCH_UNITS = dict(zip(WRENCH, ("N", "N", "N*m"), strict=True))
PARAMETER_UNITS = dict(zip(PARAMETERS, ("kg", "kg*m", "kg*m", "kg*m", "kg*m^2"), strict=True))


@dataclass(frozen=True)
class Quantity:
    """One pair of columns of a table, and how it comes of the trials' rows.

    Parameters
    ----------
    name, unit, meaning : str
    kind : {"value", "error"}
        A value has its mean and standard deviation over the trials. An error has the mean of the trials' biases and the
        root mean square of their standard deviations: those of all samples together.
    to_si : float
        What the thesis's numbers are multiplied by.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind = "value"
    to_si: float = 1.0


@dataclass(frozen=True)
class TableSpec:
    """A table: which rows of the trials it is about, and its quantities, in the thesis's order.

    Parameters
    ----------
    name, title : str
    methods : mapping of str to str
        What the thesis calls each, by the method's name here.
    by_orientation : bool
    quantities : tuple of Quantity
        Those of the thesis first.
    published : mapping
    """

    name: str
    title: str
    methods: Mapping[str, str]
    by_orientation: bool
    quantities: tuple[Quantity, ...]
    published: Mapping[thesis.Cell, thesis.Row]

    @property
    def schema(self) -> TableSchema:
        """Columns of the table's file."""
        pairs = (
            Column(f"{one.name}_{part}", "float64", one.unit, f"{one.meaning}: {words}")
            for one in self.quantities
            for part, words in (("mean", "mean"), ("sd", "standard deviation"))
        )
        return TableSchema(f"{self.name}.parquet", 1, (*_CELL, *pairs))


_CELL = (
    Column("joint", "str", "", "the joint that moves"),
    Column("speed", "str", "", "how it moves"),
    Column("orientation", "float64", "deg", "of the robot about the vertical; NaN: all together"),
    Column(
        "obs", "str", "", "by what the states are: P cameras, R encoder, Ref. the reference parameters, or a method"
    ),
    Column("source", "str", "", "`this`, or `thesis`: what its table has there"),
    Column("trials", "int64", "1", "how many trials the row is about; 0 for the thesis's"),
)


def _with_r2(name: str, unit: str, meaning: str) -> tuple[Quantity, Quantity]:
    return Quantity(name, unit, meaning, "error"), Quantity(f"{name}_r2", "1", f"{meaning}: r²")


_DYNAMICS = (
    Quantity("condition", "1", "condition number of the stacked regressor"),
    *(Quantity(name, PARAMETER_UNITS[name], f"base parameter {name}") for name in PARAMETERS),
    *_with_r2("torque", "N*m", "torque of the model less the encoder's"),
)

TABLES = (
    TableSpec(
        "table_5_1",
        "Kinematic parameters and errors (thesis table 5.1)",
        {"cameras": "P"},
        True,
        (
            Quantity("base", "m", "distance of the joint from the plane's origin", to_si=1e-3),
            Quantity("marker", "m", "distance of the markers from their prediction", "error", 1e-3),
            Quantity("theta", "rad", "angle less the truth's or the encoder's", "error", np.pi / 180),
            Quantity("dtheta", "rad/s", "velocity less the truth's or the encoder's", "error", np.pi / 180),
            Quantity("base_error", "m", "distance less the reference's"),
        ),
        thesis.KINEMATICS,
    ),
    TableSpec(
        "table_5_2",
        "Dynamic parameters (thesis table 5.2)",
        {"reference": "Ref.", "encoder": "R", "cameras": "P"},
        False,
        _DYNAMICS,
        thesis.DYNAMICS,
    ),
    TableSpec(
        "table_5_3",
        "Joint states against the truth or the encoder (thesis table 5.3)",
        {"encoder": "R", "cameras": "P"},
        False,
        tuple(
            quantity for name in STATES for quantity in _with_r2(name, STATE_UNITS[name], f"{name} less the truth's")
        ),
        thesis.STATES,
    ),
    TableSpec(
        "table_5_4",
        "Contact wrench of the models less the measured one (thesis table 5.4)",
        {"reference": "Ref.", "encoder": "R", "cameras": "P"},
        False,
        tuple(
            quantity
            for name in WRENCH
            for quantity in _with_r2(name, WRENCH_UNITS[name], f"{name} of the model less the measured")
        ),
        thesis.WRENCH,
    ),
    TableSpec(
        "table_5_5_6",
        "Dynamic parameters by every method for the states (thesis tables 5.5 and 5.6)",
        {"cameras": "UKF", "differences": "Diff.", "differences-6": "Diff. 6 Hz", "spline": "Spline"},
        False,
        (*_DYNAMICS, Quantity("ddtheta_r2", "1", "r² of the acceleration against the truth or the encoder")),
        thesis.METHODS,
    ),
)


def _of_trial(name: str, unit: str, meaning: str) -> tuple[Column, ...]:
    return tuple(
        Column(f"{name}_{part}", "float64", "1" if part == "r2" else unit, f"{meaning}: {words}")
        for part, words in (("bias", "mean"), ("sd", "standard deviation"), ("r2", "r²"))
    )


def _parameter(name: str) -> tuple[Column, ...]:
    unit = PARAMETER_UNITS[name]
    return (
        Column(name, "float64", unit, f"base parameter {name} in the robot's own frame"),
        Column(f"{name}_sd", "float64", unit, "its standard deviation"),
        Column(f"{name}_reference", "float64", unit, "by the reference"),
        Column(f"{name}_verdict", "str", "", "known, weak or not identifiable"),
    )


TRIALS = TableSchema(
    "trials.parquet",
    1,
    (
        Column("trial", "str", "", "name of the trial and of its run folder"),
        *_CELL[:3],
        Column("method", "str", "", "cameras, encoder, differences, differences-6, spline, or reference"),
        Column("verdict", "str", "", "of the trial: ok, caution, refused or failed"),
        Column("codes", "str", "", "codes of the verdict's reasons"),
        Column("against", "str", "", "what the states are held against: truth, encoder, or nothing"),
        Column("base", "float64", "m", "distance of the joint from the plane's origin"),
        Column("base_sd", "float64", "m", "its standard deviation"),
        Column("base_error", "float64", "m", "distance less the reference's"),
        *_of_trial("marker", "m", "distance of the moving markers from their prediction")[:2],
        *(
            column
            for name in STATES
            for column in _of_trial(name, STATE_UNITS[name], f"{name} less the truth's or the encoder's")
        ),
        Column("condition", "float64", "1", "condition number of the stacked regressor"),
        *(column for name in PARAMETERS for column in _parameter(name)),
        *_of_trial("torque", "N*m", "torque of the model less the encoder's"),
        *(
            column
            for name in WRENCH
            for column in _of_trial(name, WRENCH_UNITS[name], f"{name} of the model less the measured")
        ),
        Column("clock_offset", "float64", "s", "plates after cameras"),
        Column("encoder_offset", "float64", "s", "an encoder's row at t is the state at t + this"),
        Column("encoder_offset_sd", "float64", "s", "its standard deviation"),
        Column("encoder_offset_truth", "float64", "s", "the true one, where it is known"),
    ),
)
