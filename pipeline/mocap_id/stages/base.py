"""What a stage is: a frozen record with its inputs, outputs, its own settings and one function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from mocap_id.errors import Refused
from mocap_id.store import Artefact, Document, LongTable, Table, Tree
from mocap_id.verdict import Reason


class Settings(BaseModel):
    """A stage's slice of the configuration: immutable, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


class Subject(Settings):
    """Who moves; everything optional."""

    height: float | None = Field(None, gt=0.3, lt=2.8, description="stature, m")
    mass: float | None = Field(None, gt=2, lt=400, description="body mass, kg")
    sex: Literal["female", "male"] | None = Field(None, description="chooses the allometric table where it matters")


class Files(Settings):
    """A recording in two files."""

    markers: Path = Field(description="TRC (or C3D) file with the markers")
    forces: Path | None = Field(None, description="MOT file with the ground's forces")


class Compare(Settings):
    """Joint angles of another system, to show beside this one's."""

    angles: Path = Field(description="MOT, STO or CSV file with angles, on the recording's clock")
    columns: dict[str, str] = Field(
        min_length=1, description="joint: column of the file, with a minus in front where it counts the other way round"
    )


PlateNumber: TypeAlias = Annotated[int, Field(ge=1)]


class PlateUse(Settings):
    """Which force plates carry what, counted from 1; told apart by the program where not given."""

    feet: tuple[PlateNumber, ...] = Field((), description="plates under the feet, summed")
    seat: tuple[PlateNumber, ...] = Field((), description="plates under the chair; their force acts on the body too")

    @field_validator("seat")
    @classmethod
    def _one_use_a_plate(cls, value: tuple[int, ...], info: ValidationInfo) -> tuple[int, ...]:
        both = sorted(set(value) & set(info.data.get("feet", ())))
        if both:
            raise ValueError(f"plate {both[0]} is named under `feet` too")
        return value


class ExternalForce(Settings):
    """A force sensor beside the plates: a rail in the hand, a cable."""

    file: Path = Field(description="CSV with time_s, Fx_N, Fy_N, Fz_N[, Mx_Nm, My_Nm, Mz_Nm] in the recording's axes")
    name: str = Field(pattern=r"^\w[\w -]*$", max_length=40, description="what exerts it, for messages: hand, rail")
    segment: str | int = Field(description="segment that it acts on, by name or number (0 = base)")
    at: str | tuple[float, float, float] = Field(
        description="where it acts: a marker, or a fixed point [x, y, z] in the recording's axes, m"
    )
    force: Literal["on-body", "on-sensor"] = Field(
        "on-body", description="whose force the file holds: the sensor's on the body, or the body's on the sensor"
    )
    clock_offset_s: float = Field(
        0.0, description="the row at time_s was taken at time_s + this on the recording's clock, s"
    )


Protocol: TypeAlias = Literal["free", "sit-to-stand", "robot-joint"]


class TrialKeys(Settings):
    """The keys of a trial that several stages read; paths are absolute here."""

    trial: str = Field(
        pattern=r"^\w[\w.+-]*$", max_length=100, description="name of the trial: letters, digits, and . _ + - within"
    )
    recording: Files = Field(description="C3D file, or a TRC file with the markers and a MOT file with the forces")
    protocol: Protocol = Field("free", description="the movement: sit-to-stand (squats too), robot-joint or free")
    subject: Subject = Field(Subject(), description="who moves; everything optional")
    encoder: Path | None = Field(
        None, description="robot-joint only: CSV with time_s, position_rad, velocity_rad_s[, torque_Nm]"
    )
    window: tuple[float, float] | None = Field(
        None, description="first and last time to use, s in the recording's clock; proposed where not given"
    )
    plates: PlateUse = Field(PlateUse(), description="which force plates carry what; told apart where not given")

    compare: Compare | None = Field(None, description="joint angles of another system, shown beside this one's")
    external: tuple[ExternalForce, ...] = Field((), description="force sensors beside the plates that act on the body")

    @field_validator("external")
    @classmethod
    def _one_name_a_sensor(cls, value: tuple[ExternalForce, ...]) -> tuple[ExternalForce, ...]:
        names = [sensor.name for sensor in value]
        twice = sorted({name for name in names if names.count(name) > 1 or name == "seat"})
        if twice:
            raise ValueError(f"`{twice[0]}` stands twice or is the chair's: give every sensor a name of its own")
        return value

    @field_validator("encoder")
    @classmethod
    def _encoder_has_a_joint(cls, value: Path | None, info: ValidationInfo) -> Path | None:
        if value is not None and info.data.get("protocol") != "robot-joint":
            raise ValueError("only `protocol: robot-joint` has an encoder")
        return value

    @field_validator("window")
    @classmethod
    def _window_runs_forwards(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not value[0] < value[1]:
            raise ValueError("the first time must come before the last")
        return value


@dataclass(frozen=True)
class Context:
    """All that a stage's function may look at.

    ``inputs`` holds the stage's artefacts by file name. ``refused`` is set only for the report of a refused trial,
    whose ``inputs`` are those that exist. ``seconds`` are the stages' own times.
    """

    trial: TrialKeys
    settings: Any
    inputs: Mapping[str, Artefact]
    refused: Refused | None = None
    seconds: Mapping[str, float] | None = None

    def table(self, file: str) -> Table:
        """The Parquet input of this name."""
        artefact = self.inputs[file]
        assert isinstance(artefact, Table)
        return artefact

    def long(self, file: str) -> LongTable:
        """The Parquet input of this name, which has a row for every frame and marker."""
        artefact = self.inputs[file]
        assert isinstance(artefact, LongTable)
        return artefact

    def tree(self, file: str) -> Tree:
        """The HDF5 input of this name."""
        artefact = self.inputs[file]
        assert isinstance(artefact, Tree)
        return artefact

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """The reasons that the inputs carry, in the order of the inputs, none twice."""
        return tuple(dict.fromkeys(reason for artefact in self.inputs.values() for reason in artefact.reasons))


Outputs: TypeAlias = tuple[Artefact | Document, ...]


@dataclass(frozen=True)
class Stage:
    """One stage of the pipeline.

    Parameters
    ----------
    name : str
        As on the command line (``fit-joints``).
    version : int
        Raised whenever the same inputs would give another output.
    inputs, outputs : tuple of str
        Artefact file names. A stage may give more documents than its outputs name (figures), never more artefacts.
    uses : tuple of str
        Keys of :class:`TrialKeys` that the function reads; with ``settings`` they make the stage's slice.
    settings : type of Settings
        The model behind the stage's own name in the YAML.
    function : callable
        From a :class:`Context` to the outputs, in the order of ``outputs``.
    help : str
        One line for the command line and the docs.
    """

    name: str
    version: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    uses: tuple[str, ...]
    settings: type[Settings]
    function: Callable[[Context], Outputs]
    help: str
